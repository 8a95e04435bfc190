"""Processes without rights to harm, in which attacks run: another user, an empty folder, caps on memory and time."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import pwd
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks.attack.harness import Case, Outcome, Part, judged, rng_of

__all__ = ["MEMORY", "Jail", "become_nobody", "give_to_nobody"]

MEMORY = 6_000_000_000
"""Bytes of address space that an attacker may have."""

FILE_SIZE = 300_000_000

CLOCK = 3.0
"""An input hangs that has had its seconds of the processor, or so many times as many of the clock."""

TELL = 1.0
"""Seconds between two reports of a worker."""

_PR_SET_KEEPCAPS, _PR_CAP_AMBIENT, _RAISE = 8, 47, 2
_CAP_DAC_READ_SEARCH, _CAPABILITY_VERSION_3 = 2, 0x20080522

_FORK = multiprocessing.get_context("fork")


class Jail:
    """One worker at a time, and a new one whenever it dies; a context manager that leaves nothing behind."""

    def __init__(self, make: Callable[[], Part], *, seconds: float = 86400.0) -> None:
        self._make, self._cpu = make, int(seconds) + 600
        self.limit = make().limit
        self._process: Any = None
        self._pipe: Connection | None = None
        self._now = _FORK.RawArray("d", 2)  # which input is being run, and since when
        self.folder = Path(tempfile.mkdtemp(prefix="attack-"))
        give_to_nobody(self.folder)

    def __enter__(self) -> Jail:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def campaign(self, seed: int, first: int, until: float, most: int) -> Iterator[tuple[Any, ...]]:
        """Run inputs of a seed from number ``first`` on, until the clock says so or there were ``most``.

        Yields ``("told", kinds, counted, extremes)`` about once a second, ``("found", number, outcome, case)`` and
        ``("died", kind, signature, detail, number)``.
        """
        number = first
        while most > 0 and time.perf_counter() < until:
            self._ask(("campaign", seed, number, until, most))
            for answer in self._answers():
                if answer[0] == "done":
                    return
                if answer[0] == "told":
                    most -= answer[1].get("inputs", 0)
                if answer[0] == "died":
                    number = int(self._now[0]) + 1
                    yield (*answer, number - 1)
                    break
                yield answer

    def ask(self, case: Case | tuple[int, int]) -> tuple[Outcome, Case]:
        """How one input goes, given as it is or by seed and number, and the input."""
        self._ask(("case", case))
        found: Case = case if isinstance(case, dict) else {}
        for answer in self._answers():
            if answer[0] == "drawn":
                found = answer[1]
            elif answer[0] == "case":
                return answer[1], found
            elif answer[0] == "died":
                return Outcome(answer[1], 1, answer[2], answer[3]), found
        raise RuntimeError("a worker ended without a word")

    def end(self) -> list[int]:
        """End the worker; the ids of processes that it leaves, which are ended, too."""
        if self._process is None:
            return []
        group = int(self._process.pid)
        if self._process.is_alive() and self._pipe is not None:
            with contextlib.suppress(OSError):
                self._pipe.send(("end",))
            self._process.join(5.0)
        left = [pid for pid in _group(group) if pid != group]
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)
        self._process.join(5.0)
        self._process = None
        return left

    def leftovers(self) -> list[str]:
        """Half-written files in the worker's folder."""
        return sorted(str(path.relative_to(self.folder)) for path in self.folder.rglob("*.tmp"))

    def _ask(self, what: tuple[Any, ...]) -> None:
        if self._process is None or not self._process.is_alive():
            self.end()
            self._pipe, theirs = _FORK.Pipe()
            self._process = _FORK.Process(
                target=_work, args=(self._make, self.folder, theirs, self._now, self._cpu), daemon=False
            )
            sys.stdout.flush()
            self._process.start()
            theirs.close()
        assert self._pipe is not None
        self._now[1] = 0.0
        self._pipe.send(what)

    def _answers(self) -> Iterator[tuple[Any, ...]]:
        """What the worker says, until it is done, dies or has to be ended."""
        assert self._pipe is not None
        since, cpu = -1.0, 0.0
        while True:
            try:
                if self._pipe.poll(0.2):
                    answer = self._pipe.recv()
                    if answer[0] == "broken":
                        raise RuntimeError(f"the attack itself failed:\n{answer[1]}")
                    yield answer
                    continue
            except (EOFError, OSError):
                self._process.join(10.0)
                code = self._process.exitcode
                self.end()
                name = signal.Signals(-code).name if code and code < 0 else f"exit code {code}"
                yield "died", "crash", f"crash: {name}", f"the process ended with {name}"
                return
            began = self._now[1]
            if began != since:
                since, cpu = began, _cpu_seconds(self._process.pid)
            elif began:
                clock, spent = time.monotonic() - began, _cpu_seconds(self._process.pid) - cpu
                if spent > self.limit or clock > CLOCK * self.limit:
                    os.killpg(self._process.pid, signal.SIGKILL)
                    self._process.join(10.0)
                    self.end()
                    yield "died", "hang", "hang", f"{clock:.0f} s, {spent:.0f} s of them on the processor"
                    return


def _work(make: Callable[[], Part], folder: Path, pipe: Connection, now: Any, cpu: int) -> None:
    try:
        _drop(folder, cpu)
        _serve(make(), pipe, now)
    except Exception:  # of the attack itself, not of what it attacks
        pipe.send(("broken", traceback.format_exc()))


def _serve(part: Part, pipe: Connection, now: Any) -> None:
    while True:
        asked = pipe.recv()
        if asked[0] == "end":
            return
        if asked[0] == "case":
            case = asked[1]
            now[1] = time.monotonic()
            if not isinstance(case, dict):
                case = part.draw(rng_of(*case))
                pipe.send(("drawn", case))
            outcome = judged(part, case)
            now[1] = 0.0
            pipe.send(("case", outcome))
        else:
            _campaign(part, pipe, now, *asked[1:])


def _campaign(part: Part, pipe: Connection, now: Any, seed: int, first: int, until: float, most: int) -> None:
    kinds: Counter[str] = Counter()
    told = time.perf_counter()
    number, done = first - 1, 0
    while done < most:
        number += 1
        now[0], now[1] = number, time.monotonic()
        case = part.draw(rng_of(seed, number))
        outcome = judged(part, case)
        now[1] = 0.0
        kinds[outcome.kind] += outcome.inputs
        kinds["inputs"] += outcome.inputs
        done += outcome.inputs
        if outcome.kind not in ("passed", "refused"):
            pipe.send(("found", number, outcome, case))
        if (clock := time.perf_counter()) - told > TELL or clock > until:
            pipe.send(("told", dict(kinds), dict(part.counted), dict(part.extremes)))
            kinds.clear()
            part.counted.clear()
            told = clock
        if clock > until:
            break
    pipe.send(("told", dict(kinds), dict(part.counted), dict(part.extremes)))
    part.counted.clear()
    pipe.send(("done",))


def _drop(folder: Path, cpu: int) -> None:
    """Become nobody, in a folder of one's own, with caps."""
    os.setsid()
    os.chdir(folder)
    for name in ("HOME", "TMPDIR", "XDG_CACHE_HOME"):
        os.environ[name] = str(folder)
    tempfile.tempdir = str(folder)
    for what, most in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_FSIZE, FILE_SIZE),
        (resource.RLIMIT_CPU, cpu),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(what, (most, most))
    become_nobody()
    quiet = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(quiet, stream)


def become_nobody() -> None:
    """Give up what root may do, but to read; nothing for other users."""
    if os.getuid() == 0:
        user, group = _nobody()
        ctypes.CDLL(None).prctl(_PR_SET_KEEPCAPS, 1, 0, 0, 0)
        os.setgroups([])
        os.setresgid(group, group, group)
        os.setresuid(user, user, user)
        _keep_reading()


def give_to_nobody(path: str | os.PathLike[str]) -> None:
    """Make a file or a folder the user's that root becomes."""
    if os.getuid() == 0:
        os.chown(path, *_nobody())


def _nobody() -> tuple[int, int]:
    entry = pwd.getpwnam("nobody")
    return entry.pw_uid, entry.pw_gid


def _keep_reading() -> None:
    """Keep, of all of root's rights, that to read: Python and the package may be where only root can look.

    Where root itself has not got it, as in many containers, importing fails, and the attack says so.
    """
    libc, bit = ctypes.CDLL(None), 1 << _CAP_DAC_READ_SEARCH
    version = ctypes.create_string_buffer(struct.pack("=Ii", _CAPABILITY_VERSION_3, 0))
    rights = ctypes.create_string_buffer(struct.pack("=6I", bit, bit, bit, 0, 0, 0))
    if libc.capset(version, rights) == 0:
        libc.prctl(_PR_CAP_AMBIENT, _RAISE, _CAP_DAC_READ_SEARCH, 0, 0)  # for programs that are started, too


def _cpu_seconds(pid: int) -> float:
    try:
        words = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _group(group: int) -> list[int]:
    """The processes of a group."""
    out = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError, ProcessLookupError):
                if os.getpgid(int(entry.name)) == group:
                    out.append(int(entry.name))
    return out
