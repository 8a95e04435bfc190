"""Gives items to workers, one at a time each, and hands out the answers in order; for processes and for Ray alike."""

from __future__ import annotations

import gc
import math
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from planner_service.errors import BrokenInvariant
from planner_service.parallel.engine import LOOK_AHEAD, InWorker, Limit, Lost, Work

__all__ = ["Answered", "Backend", "Died", "Event", "Noted", "Raised", "WorkerPool", "outcome", "prepare_and_freeze"]

Answer = TypeVar("Answer")
Worker = TypeVar("Worker")

MAX_FAILED_STARTS = 3
"""Workers that may die in a row before one of them is ready."""


@dataclass(frozen=True)
class Answered:
    """A worker's answer to its item; the first of each worker says that it is ready."""

    value: Any


@dataclass(frozen=True, eq=False)
class Raised:
    """The exception that the work raised in a worker, with its traceback there."""

    error: Exception
    traceback: str


@dataclass(frozen=True)
class Died:
    """A worker's end; ``blameless`` if its item certainly did not cause it."""

    detail: str
    blameless: bool = False


@dataclass(frozen=True)
class Noted:
    """What a ``TalkingWork`` says while it is at its item."""

    value: Any


Event = Answered | Raised | Died | Noted


def outcome(call: Callable[..., Any], *arguments: Any) -> Event:
    """What a call in a worker comes to; a worker without memory gives up."""
    try:
        return Answered(call(*arguments))
    except MemoryError as error:
        return Died(f"it ran out of memory: {error}" if str(error) else "it ran out of memory")
    except Exception as error:
        return Raised(error, traceback.format_exc())


def prepare_and_freeze(work: Work[Any, Any]) -> None:
    """Prepare a work in a process of its own, and keep what it has loaded, which stays, out of garbage collection.

    That is 8 % more pick-and-places a second.
    """
    work.prepare()
    gc.collect()
    gc.freeze()


class Backend(Protocol[Worker]):
    """Starts workers and talks to them."""

    @property
    def max_workers(self) -> int:
        """How many workers there may be at once."""

    def start(self) -> Worker:
        """Start a worker, which takes the work and answers once when it is ready."""

    def send(self, worker: Worker, item: Any) -> None:
        """Send an item to a worker that waits for one; nothing happens if it has died."""

    def tell(self, worker: Worker, note: Any) -> None:
        """Send a note to a worker whose work is a ``TalkingWork``, at any time; nothing happens if it has died."""

    def receive(self, workers: Sequence[Worker], timeout: float | None) -> list[tuple[Worker, Event]]:
        """At most one event of each worker; wait up to ``timeout`` seconds for the first."""

    def kill(self, workers: Sequence[Worker]) -> None:
        """Kill workers, busy or not."""

    def close(self) -> None:
        """Release everything but the workers."""


@dataclass(eq=False)
class _Task:
    index: int
    item: Any
    deaths: int = 0


@dataclass(eq=False)
class _State:
    """Whether a worker is ready, its task, and when the time limit of that task is up."""

    ready: bool = False
    task: _Task | None = None
    deadline: float = math.inf


class WorkerPool(Generic[Answer, Worker]):
    """Answers in order from the workers of a backend; see ``Answers``."""

    def __init__(self, backend: Backend[Worker], items: Iterable[Any], limit: Limit[Any] | None) -> None:
        self.finished: dict[int, Answer | Lost] = {}
        self._raised: dict[int, Raised] = {}
        self._closed = False
        self._backend, self._limit = backend, limit
        self._workers: dict[Worker, _State] = {}
        self._waiting: deque[_Task] = deque()
        self._taken = self._next = self._failed_starts = 0
        self._items_end: Exception | None = None
        self._items = iter(items)

    def __iter__(self) -> WorkerPool[Answer, Worker]:
        return self

    def __next__(self) -> tuple[int, Answer | Lost]:
        if self._closed:
            raise StopIteration
        index = self._next
        self.finished.pop(index - 1, None)
        try:
            self._assign()
            self._receive(0.0)  # workers that are done get their next item even if the answer is there already
            self._assign()
            while index not in self.finished and index not in self._raised:
                if not self._waiting and not any(state.task for state in self._workers.values()):
                    raise self._items_end or StopIteration
                self._receive(None)
                self._assign()
            if index in self._raised:
                raise self._raised[index].error from InWorker(index, self._raised[index].traceback)
        except BaseException:
            self.close()
            raise
        self._next += 1
        return index, self.finished[index]

    def close(self) -> None:
        """See ``Answers``."""
        if not self._closed:
            self._closed = True
            try:
                self._backend.kill(list(self._workers))
            finally:
                self._workers.clear()
                self._backend.close()

    def __del__(self) -> None:
        self.close()

    def _available(self, count: int) -> int:
        """How many tasks are waiting, at most ``count``, for which items are taken as needed."""
        most = self._next + LOOK_AHEAD * self._backend.max_workers
        while len(self._waiting) < count and self._taken < most and self._items_end is None:
            try:
                self._waiting.append(_Task(self._taken, next(self._items)))
                self._taken += 1
            except Exception as error:  # StopIteration too; any other is raised when all items before are answered
                self._items_end = error
        return min(count, len(self._waiting))

    def _assign(self) -> None:
        """Give each idle worker a task, and start workers for further tasks."""
        for worker, state in self._workers.items():
            if state.ready and state.task is None and self._available(1):
                state.task = self._waiting.popleft()
                seconds = None if self._limit is None else self._limit(state.task.item)
                state.deadline = math.inf if seconds is None else time.monotonic() + seconds
                self._backend.send(worker, state.task.item)
        starting = sum(not state.ready for state in self._workers.values())
        free = self._backend.max_workers - len(self._workers)
        if free > 0:
            for _ in range(self._available(starting + free) - starting):
                self._workers[self._backend.start()] = _State()

    def _receive(self, timeout: float | None) -> None:
        """Wait for events, at most until a time limit is up, handle them, and kill workers over their limit."""
        deadline = min((state.deadline for state in self._workers.values()), default=math.inf)
        if timeout is None and deadline < math.inf:
            timeout = max(0.0, deadline - time.monotonic())
        for worker, event in self._backend.receive(list(self._workers), timeout):
            self._handle(worker, event)
        now = time.monotonic()
        for worker in [worker for worker, state in self._workers.items() if state.deadline <= now]:
            task = self._remove(worker).task
            assert task is not None
            self.finished[task.index] = Lost("its worker was ended", over_limit=True)

    def _handle(self, worker: Worker, event: Event) -> None:
        state = self._workers[worker]
        if isinstance(event, Noted):
            return
        if isinstance(event, Died):
            self._remove(worker)
            self._retry(state, event)
        elif state.task is not None:
            if isinstance(event, Answered):
                self.finished[state.task.index] = event.value
            else:
                self._raised[state.task.index] = event
            state.task, state.deadline = None, math.inf
        elif isinstance(event, Raised):
            raise event.error from InWorker(None, event.traceback)
        else:
            state.ready, self._failed_starts = True, 0

    def _retry(self, state: _State, death: Died) -> None:
        """Have another worker try the task of one that died, unless it is the second; give up if none gets ready."""
        if not state.ready:
            self._failed_starts += not death.blameless
            if self._failed_starts >= MAX_FAILED_STARTS:
                detail = f"{MAX_FAILED_STARTS} workers ended before they were ready; the last one: {death.detail}"
                raise BrokenInvariant(detail)
        elif state.task is not None:
            state.task.deaths += not death.blameless
            if state.task.deaths > 1:
                self.finished[state.task.index] = Lost(f"two workers were lost; the second one: {death.detail}")
            else:
                self._waiting.appendleft(state.task)

    def _remove(self, worker: Worker) -> _State:
        self._backend.kill([worker])
        return self._workers.pop(worker)
