"""A server in a process of its own, without rights to harm, and what it and its workers take of the machine."""

from __future__ import annotations

import http.client
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.attack.jail import become_nobody, give_to_nobody

__all__ = ["Link", "Reply", "Server", "connected", "server"]

READY_SECONDS, STOP_SECONDS = 120.0, 30.0

TICKS, PAGE = os.sysconf("SC_CLK_TCK"), os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Reply:
    """What a server answered, and after how many seconds."""

    status: int
    headers: Mapping[str, str]
    data: bytes
    seconds: float

    @property
    def document(self) -> Any:
        """The JSON value."""
        return json.loads(self.data)


class Link:
    """One connection that is kept open, for one thread."""

    def __init__(self, port: int, seconds: float) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=seconds)

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> Reply:
        """The reply to one request; ``headers`` by their names with underscores."""
        began = time.perf_counter()
        self.send(method, path, body, **headers)
        response = self._connection.getresponse()
        content = response.read()
        seconds = time.perf_counter() - began
        told = {name.lower(): value for name, value in response.getheaders()}
        return Reply(response.status, told, content, seconds)

    def send(self, method: str, path: str, body: Any = None, **headers: str) -> None:
        """Send a request without reading what comes back."""
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        data = None
        if body is not None:
            data, named["Content-Type"] = json.dumps(body).encode(), "application/json"
        self._connection.request(method, path, data, named)

    def drop(self) -> None:
        """Close it, whatever is under way."""
        self._connection.close()


@contextmanager
def connected(port: int, seconds: float = 60.0) -> Iterator[Link]:
    """A connection to a server of this machine."""
    link = Link(port, seconds)
    try:
        yield link
    finally:
        link.drop()


@dataclass(frozen=True)
class Server:
    """A server that runs."""

    port: int
    process: subprocess.Popen[bytes]
    log: Path

    @property
    def pids(self) -> list[int]:
        """Its process, and those it has started."""
        found, new = list[int](), [self.process.pid]
        while new:
            found += new
            new = [child for pid in new for child in _children(pid)]
        return found

    @property
    def megabytes(self) -> float:
        """Memory that is resident, of all of its processes together, shared pages counted once for each."""
        return sum(_statm(pid) for pid in self.pids) * PAGE / 1e6

    @property
    def cpu_seconds(self) -> dict[str, float]:
        """What the server has computed, and what its workers have."""
        first, *workers = self.pids
        return {"server": _cpu(first), "workers": sum(map(_cpu, workers))}

    @property
    def cpu_nanoseconds(self) -> list[int]:
        """What each of its processes has computed, to the nanosecond."""
        return [_nanoseconds(pid) for pid in self.pids]


def _nanoseconds(pid: int) -> int:
    total = 0
    with suppress(OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            total += int((thread / "schedstat").read_text("ascii").split()[0])
    return total


def _children(pid: int) -> list[int]:
    with suppress(OSError):
        threads = Path(f"/proc/{pid}/task").iterdir()
        return [int(word) for thread in threads for word in (thread / "children").read_text("ascii").split()]
    return []


def _statm(pid: int) -> int:
    with suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1])
    return 0


def _cpu(pid: int) -> float:
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS
    return 0.0


@contextmanager
def server(
    *options: str,
    scenes: tuple[str, ...] = ("bin",),
    folder: Path | None = None,
    memory: int | None = None,
    python: Path | None = None,
) -> Iterator[Server]:
    """A server of the WidowX AI that is ready.

    Args:
        options: Of ``planner-service serve``, beside its robot, its scenes and where it is.
        folder: Where its state is and stays; one of its own that is deleted if None.
        memory: Bytes of address space that each of its processes may have; None for any.
        python: Of an environment with another version; this one if None.
    """

    def confined() -> None:
        become_nobody()
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))

    stays = folder is not None
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="serve-"))
        give_to_nobody(folder)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = int(taken.getsockname()[1])
    command = [str(python or sys.executable), "-m", "planner_service", "serve", "--robot", "wxai", "--port", str(port)]
    command += ["--state", str(folder / "state"), *(word for name in scenes for word in ("--scene", name)), *options]
    surroundings = {**os.environ, "HOME": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    log = folder / "log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, env=surroundings, cwd=folder, preexec_fn=confined
        )
    try:
        _wait_until_ready(port, process, log)
        yield Server(port, process, log)
    finally:
        process.send_signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(STOP_SECONDS)
        process.kill()
        process.wait()
        if not stays:
            shutil.rmtree(folder, ignore_errors=True)


def _wait_until_ready(port: int, process: subprocess.Popen[bytes], log: Path) -> None:
    end = time.monotonic() + READY_SECONDS
    while True:
        with suppress(OSError), connected(port, 5.0) as link:
            if link.ask("GET", "/ready").status == 200:
                return
        if process.poll() is not None or time.monotonic() > end:
            raise RuntimeError(f"the server does not start: {log.read_text('utf-8', 'replace')[-2000:]}")
        time.sleep(0.05)
