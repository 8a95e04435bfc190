"""The engine of one machine: a process for each core, on nothing but the standard library."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, TypeVar

from planner_service.errors import BrokenInvariant, InvalidRequest, shown
from planner_service.geometry.shapes import whole
from planner_service.parallel.engine import Answers, Limit, Work
from planner_service.parallel.events import Event, Gone, Raised, Ready
from planner_service.parallel.scheduler import Schedule

__all__ = ["ONE_THREAD", "Processes", "available_cores", "require_workers"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

AHEAD = 16_384
"""Bytes that are sent to a worker that is busy: they fit into its socket, so that sending them waits for nobody."""

BOOT = (
    "import sys; sys.path[:] = sys.argv[2:]; from planner_service.parallel.worker import main; main(int(sys.argv[1]))"
)
"""Run by a worker's interpreter: the calling script is not imported, it needs no ``if __name__ == "__main__"``. Before
``sys.path`` is ours the working directory is in it, with files that may be named like modules.
"""

LAST_MOMENT = 1.0
"""Seconds in which a worker that has hung up has to be gone."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""The environment of a worker, which has one core."""


def available_cores() -> int:
    """How many cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return os.cpu_count() or 1 if affinity is None else len(affinity(0))


MAX_WORKERS = 10_000


def require_workers(value: object) -> None:
    """Refuse what is neither None nor a number of workers."""
    if value is not None:
        whole("workers", value, 1, MAX_WORKERS)


@dataclass(frozen=True)
class Processes:
    """Answers in processes of this machine.

    Attributes:
        workers: How many at most; None for one on each core that this process may use.

    Raises:
        InvalidRequest: no number of workers.
    """

    workers: int | None = None

    def __post_init__(self) -> None:
        require_workers(self.workers)

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """See ``Engine``."""
        return Schedule(_Crew(self.workers or available_cores(), work), items, limit)


class _Hand:
    """A process, and the socket over which one talks to it."""

    def __init__(self) -> None:
        self.connection, theirs = Pipe()
        self.begun, self.unanswered = False, 0
        self.held: Any = None
        with theirs:
            socket = theirs.fileno()
            self.process = subprocess.Popen(
                [sys.executable, "-c", BOOT, str(socket), *map(str, sys.path)],
                stdin=subprocess.PIPE,  # nobody writes to it: when it closes, we are no more
                pass_fds=[socket],
                env=os.environ | ONE_THREAD,
                start_new_session=True,  # Ctrl-C is for us alone
            )

    def send(self, message: Any) -> None:
        """Send what was pickled; if the process is gone, the next look says what became of it."""
        with suppress(BrokenPipeError, ConnectionResetError):
            self.connection.send_bytes(message)

    def became(self) -> str:
        """What became of it, in words, once it has hung up; it may live on, if its work closed what is not its own."""
        try:
            code = self.process.wait(LAST_MOMENT)
        except subprocess.TimeoutExpired:
            return "it closed its connection"
        if code >= 0:
            return f"it ended with exit code {code}"
        name = signal.Signals(-code).name
        return f"it was ended by {name}{', as when memory runs out' if name == 'SIGKILL' else ''}"


class _Crew:
    def __init__(self, size: int, work: Work[Any, Any]) -> None:
        self.size = size
        self._work = _pickled("work", work)

    def hire(self) -> _Hand:
        return _Hand()

    def give(self, hand: _Hand, item: Any) -> None:
        message = _pickled("item", item)
        hand.unanswered += 1
        if hand.unanswered > 1 and len(message) > AHEAD:
            hand.held = message
        else:
            hand.send(message)

    def look(self, hands: Sequence[_Hand], timeout: float | None) -> list[tuple[_Hand, Event]]:
        by_connection = {hand.connection: hand for hand in hands}
        told = ((by_connection[found], self._heard(by_connection[found])) for found in _ready(by_connection, timeout))
        return [(hand, event) for hand, event in told if event is not None]

    def _heard(self, hand: _Hand) -> Event | None:
        try:
            sent = hand.connection.recv_bytes()
        except (EOFError, OSError):
            return Gone(hand.became())
        event = _opened(sent)
        if isinstance(event, Ready) and not hand.begun:  # up and reading: a large work does not block
            hand.begun = True
            hand.send(self._work)
            return None
        hand.unanswered -= not isinstance(event, Ready)
        if hand.held is not None:
            hand.send(hand.held)
            hand.held = None
        return event

    def end(self, hands: Sequence[_Hand]) -> None:
        for hand in hands:
            hand.process.kill()
        for hand in hands:
            with hand.process:  # waits, and closes its input
                hand.connection.close()

    def close(self) -> None:
        pass


def _opened(sent: bytes) -> Event:
    try:
        event: Event = ForkingPickler.loads(sent)
    except Exception as error:  # it was made by classes that are not like that here
        return Raised(BrokenInvariant(f"what a worker sent cannot be read: {error}"), traceback.format_exc())
    return event


def _pickled(name: str, value: Any) -> Any:
    try:
        return ForkingPickler.dumps(value)
    except Exception as error:
        message = f"{name}: {shown(value)} cannot be sent to a worker: {error}"
        raise InvalidRequest(name, value, "what can be pickled", message=message) from error


def _ready(connections: Iterable[Connection[Any, Any]], timeout: float | None) -> list[Any]:
    return wait(list(connections), timeout)
