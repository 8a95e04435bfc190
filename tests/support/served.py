"""A server as its users start it, in a process of its own."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

__all__ = ["asked", "free_port", "served"]

STARTED, STOPPED = 60.0, 20.0
"""Seconds within which a server is ready, and has ended."""


def free_port() -> int:
    """A port of this machine that nothing listens on."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


@contextmanager
def served(folder: Path, *options: str) -> Iterator[str]:
    """The address of a server that is ready.

    Args:
        folder: Where it keeps its state and its log.
        options: Of ``planner-service serve``, beside address and state.
    """
    port = free_port()
    command = [sys.executable, "-m", "planner_service", "serve", "--port", str(port), "--state", str(folder / "state")]
    with (
        (folder / "log").open("w") as log,
        subprocess.Popen([*command, *options], stdout=log, stderr=subprocess.STDOUT) as process,
    ):
        try:
            end = time.monotonic() + STARTED
            while not _ready(port):
                assert process.poll() is None, (folder / "log").read_text()
                assert time.monotonic() < end, (folder / "log").read_text()
                time.sleep(0.05)
            yield f"http://127.0.0.1:{port}"
        finally:
            process.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.wait(STOPPED)
            process.kill()


def asked(url: str, method: str, path: str, body: Any = None, token: str = "") -> tuple[int, dict[str, str], Any]:
    """Status, headers by lower-case name, and JSON of an answer that is waited for.

    Args:
        body: Sent as JSON.
    """
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=120.0)
    try:
        headers = {"Prefer": "wait"} | ({} if body is None else {"Content-Type": "application/json"})
        headers |= {"Authorization": f"Bearer {token}"} if token else {}
        connection.request(method, path, None if body is None else json.dumps(body), headers)
        answer = connection.getresponse()
        return answer.status, {name.lower(): value for name, value in answer.getheaders()}, json.loads(answer.read())
    finally:
        connection.close()


def _ready(port: int) -> bool:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    try:
        connection.request("GET", "/ready")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()
