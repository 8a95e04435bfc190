"""An adapter run in its peer's environment, and ended when it is silent for too long; each problem gets an answer.

What a peer does to its process is its answer to the problem it was at: a crash, silence, or lines that are no answer.
The rest of the problems goes to a new process.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from benchmarks.baselines.peers.jobs import write_job
from benchmarks.harness.environment import ROOT

__all__ = ["Child", "Reply"]

MAX_LINE = 32_000_000
"""Bytes of an answer: a motion of an hour in steps of 10 ms."""

TOLD = 400
"""Characters of standard error that are quoted."""


@dataclass(frozen=True, eq=False)
class Reply:
    """The outcome of a problem.

    Attributes:
        problem: Its part of the job.
        answer: What the adapter said; None if it said nothing that can be understood.
        versions: Of the peer's packages; empty if it never got ready.
        failure: ``crashed``, ``hung`` or ``garbled`` where there is no answer, else None.
        detail: More about that.
        waited: Seconds after which that was known.
    """

    problem: Mapping[str, Any]
    answer: Mapping[str, Any] | None
    versions: Mapping[str, str]
    failure: str | None = None
    detail: str = ""
    waited: float = 0.0


@dataclass(frozen=True)
class Child:
    """How to run an adapter.

    Attributes:
        command: What is run; the path of the job file is added to it.
        surroundings: Its environment variables.
        folder: Where the job and what the peer prints are put.
        start_seconds, problem_seconds: Silence after which it is ended, before it is ready and from then on.
    """

    command: tuple[str, ...]
    surroundings: Mapping[str, str]
    folder: Path
    start_seconds: float = 300.0
    problem_seconds: float = 60.0

    def replies(self, job: Mapping[str, Any]) -> Iterator[Reply]:
        """A reply to each problem of a job, in order; a problem is begun when its reply is asked for."""
        left: Sequence[Mapping[str, Any]] = job["problems"]
        while left:
            done = 0
            for reply in self._round({**job, "problems": left}):
                done += 1
                yield reply
            left = left[done:]

    def _round(self, job: Mapping[str, Any]) -> Iterator[Reply]:
        """Replies of one process: it ends with the job, or with the first problem that has no answer."""
        write_job(dict(job), self.folder / "job.json")
        errors = self.folder / "stderr.txt"
        surroundings = {**self.surroundings, "PYTHONPATH": str(ROOT)}
        with open(errors, "wb") as said:
            process = subprocess.Popen(
                [*self.command, str(self.folder / "job.json")],
                cwd=self.folder,
                env=surroundings,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                start_new_session=True,
            )
        assert process.stdin is not None
        assert process.stdout is not None
        lines: queue.Queue[bytes | None] = queue.Queue()
        reader = threading.Thread(target=_listen, args=(process.stdout, lines), daemon=True)
        reader.start()
        try:
            yield from self._conversation(job, process, lines, errors)
        finally:
            _end(process)
            reader.join()
            process.stdout.close()
            with suppress(BrokenPipeError):
                process.stdin.close()

    def _conversation(
        self, job: Mapping[str, Any], process: subprocess.Popen[bytes], lines: queue.Queue[bytes | None], errors: Path
    ) -> Iterator[Reply]:
        versions: dict[str, str] = {}
        problems = job["problems"]
        ready, failure = self._next(lines, process, self.start_seconds)
        if failure is None and ready is not None and isinstance(ready.get("ready"), dict):
            versions = {str(name): str(version) for name, version in ready["ready"].items()}
        elif failure is None:
            failure = ("garbled", "its first line does not say that it is ready")
        if failure is not None:  # the next process would fare no better
            detail = f"before the first problem: {_quoted(failure[1], errors)}"
            yield from (Reply(problem, None, versions, failure[0], detail) for problem in problems)
            return
        for problem in problems:
            began = time.monotonic()
            _call_for_the_next(process)
            answer, failure = self._next(lines, process, self.problem_seconds)
            if failure is None and not _fits(answer, problem):
                failure = ("garbled", f"answered {str(answer)[:80]!r} instead of {problem['problem']}")
            if failure is not None:
                waited = time.monotonic() - began
                yield Reply(problem, None, versions, failure[0], _quoted(failure[1], errors), waited)
                return
            yield Reply(problem, answer, versions)

    def _next(
        self, lines: queue.Queue[bytes | None], process: subprocess.Popen[bytes], seconds: float
    ) -> tuple[dict[str, Any] | None, tuple[str, str] | None]:
        """The next line's content, or what went wrong and how."""
        try:
            line = lines.get(timeout=seconds)
        except queue.Empty:
            return None, ("hung", f"silent for {seconds:g} s, ended")
        if line is None:
            return None, ("crashed", _ending(process.wait()))
        try:
            content = json.loads(line, parse_constant=_refused)
        except (ValueError, RecursionError):
            return None, ("garbled", f"said {line[:80]!r}, which is no answer")
        return (content, None) if isinstance(content, dict) else (None, ("garbled", f"said {line[:80]!r}"))


def _listen(pipe: IO[bytes], lines: queue.Queue[bytes | None]) -> None:
    """Lines as they come, then None."""
    while line := pipe.readline(MAX_LINE):
        lines.put(line)
    lines.put(None)


def _call_for_the_next(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    with suppress(BrokenPipeError):  # its end is seen when its answer is read
        process.stdin.write(b"\n")
        process.stdin.flush()


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the process and what it has started."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _ending(code: int) -> str:
    if code < 0:
        try:
            return f"ended by {signal.Signals(-code).name}"
        except ValueError:
            return f"ended by signal {-code}"
    return f"ended with exit code {code} before its answer"


def _quoted(reason: str, errors: Path) -> str:
    """The reason, and the last thing that was printed."""
    said = errors.read_bytes()[-20_000:].decode("utf-8", "replace").split("\n")
    last = next((line.strip() for line in reversed(said) if line.strip()), "")
    return f"{reason}; last printed: {last[-TOLD:]}" if last else reason


def _fits(answer: Mapping[str, Any] | None, problem: Mapping[str, Any]) -> bool:
    """Whether it is an answer to that problem."""
    return answer is not None and all(answer.get(key) == problem[key] for key in ("problem", "seed"))


def _refused(name: str) -> float:
    raise ValueError(f"{name} is not a number")
