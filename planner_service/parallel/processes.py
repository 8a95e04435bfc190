"""The engine of one machine: a process for each core, with the standard library alone."""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Pipe
from multiprocessing.reduction import ForkingPickler
from typing import Any, TypeVar

from planner_service.errors import BrokenInvariant, InvalidRequest, shown
from planner_service.geometry.validation import whole
from planner_service.parallel.engine import Answers, Limit, Work
from planner_service.parallel.pool import Backend, Died, Event, Noted, Raised, WorkerPool

__all__ = ["Processes", "available_cores", "require_workers"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

PROGRAM = (
    "import sys; sys.path[:] = sys.argv[2:]; from planner_service.parallel.worker import main; main(int(sys.argv[1]))"
)
"""Run by a worker's interpreter. It does not import the calling script, which so needs no ``if __name__ ==
"__main__"``, and sets ``sys.path`` first: it would else start with the working directory, whose files may be named
like modules.
"""

EXIT_SECONDS = 1.0
"""How long a worker that closed its connection may take to exit."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Set in the environment of a worker, which has one core."""

MAX_WORKERS = 10_000


def available_cores() -> int:
    """How many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return os.cpu_count() or 1 if affinity is None else len(affinity(0))


def require_workers(value: object) -> None:
    """Refuse what is neither None nor a number of workers."""
    if value is not None:
        whole("workers", value, 1, MAX_WORKERS)


@dataclass(frozen=True)
class Processes:
    """Answers in processes of this machine.

    Attributes:
        workers: The most there may be; None for one on each core that this process may use.

    Raises:
        InvalidRequest: ``workers`` is not a whole number from 1 to 10,000.
    """

    workers: int | None = None

    def __post_init__(self) -> None:
        require_workers(self.workers)

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """See ``Engine``."""
        return WorkerPool(self.backend(work), items, limit)

    def backend(self, work: Work[Any, Any]) -> Backend[_Worker]:
        """What starts workers for a work, and talks to them."""
        return _Backend(self.workers or available_cores(), _pickled("work", work))


class _Worker:
    """A process, and the connection to it."""

    def __init__(self) -> None:
        self.started = False
        self.connection, theirs = Pipe()
        with theirs:
            socket = theirs.fileno()
            self.process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, str(socket), *map(str, sys.path)],
                stdin=subprocess.PIPE,  # never written to; it closes when this process dies
                pass_fds=[socket],
                env=os.environ | ONE_THREAD,
                start_new_session=True,  # Ctrl-C does not reach it
            )

    def send(self, message: Any) -> None:
        with suppress(BrokenPipeError, ConnectionResetError):  # its death is seen when its answer is read
            self.connection.send_bytes(message)

    def exit_detail(self) -> str:
        """How it ended, in words, after it closed its connection; it lives on if its work closed that."""
        try:
            code = self.process.wait(EXIT_SECONDS)
        except subprocess.TimeoutExpired:
            return "it closed its connection"
        if code >= 0:
            return f"it ended with exit code {code}"
        name = signal.Signals(-code).name
        return f"it was ended by {name}{', as when memory runs out' if name == 'SIGKILL' else ''}"


class _Watched:
    """The connections that are waited for: registered once, as that takes longer than to look at them."""

    def __init__(self) -> None:
        self.workers: dict[int, _Worker] = {}
        self._poll = select.poll()

    def poll(self, workers: Sequence[_Worker], timeout: float | None) -> list[tuple[int, int]]:
        """The descriptors of those over whose connections something has come, within so many seconds."""
        if list(self.workers.values()) != list(workers):
            self.workers, self._poll = {worker.connection.fileno(): worker for worker in workers}, select.poll()
            for descriptor in self.workers:
                self._poll.register(descriptor, select.POLLIN)
        return self._poll.poll(None if timeout is None else math.ceil(timeout * 1e3))


@dataclass(frozen=True)
class _Backend:
    max_workers: int
    work: Any
    _watched: _Watched = field(default_factory=_Watched)

    def start(self) -> _Worker:
        return _Worker()

    def send(self, worker: _Worker, item: Any) -> None:
        worker.send(_pickled("item", item))

    def tell(self, worker: _Worker, note: Any) -> None:
        worker.send(_pickled("note", Noted(note)))

    def receive(self, workers: Sequence[_Worker], timeout: float | None) -> list[tuple[_Worker, Event]]:
        events = []
        for descriptor, _ in self._watched.poll(workers, timeout):
            worker = self._watched.workers[descriptor]
            event = self._received(worker)
            if event is not None:
                events.append((worker, event))
        return events

    def _received(self, worker: _Worker) -> Event | None:
        try:
            message = worker.connection.recv_bytes()
        except (EOFError, OSError):
            return Died(worker.exit_detail())
        if not worker.started:
            worker.started = True
            worker.send(self.work)
            return None
        return _unpickled(message)

    def kill(self, workers: Sequence[_Worker]) -> None:
        for worker in workers:
            worker.process.kill()
        for worker in workers:
            with worker.process:  # waits for it and closes its standard input
                worker.connection.close()

    def close(self) -> None:
        pass


def _unpickled(message: bytes) -> Event:
    try:
        event: Event = ForkingPickler.loads(message)
    except Exception as error:  # its classes differ here
        return Raised(BrokenInvariant(f"what a worker sent cannot be read: {error}"), traceback.format_exc())
    return event


def _pickled(name: str, value: Any) -> Any:
    try:
        return ForkingPickler.dumps(value)
    except Exception as error:
        message = f"{name}: {shown(value)} cannot be sent to a worker: {error}"
        raise InvalidRequest(name, value, "what can be pickled", message=message) from error
