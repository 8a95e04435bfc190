"""Which worker is given which item, and what is done when one is lost; the same for processes and for Ray."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from planner_service.errors import BrokenInvariant
from planner_service.parallel.engine import LOOK_AHEAD, InWorker, Limit, Lost
from planner_service.parallel.events import Answered, Event, Gone, Raised, Ready

__all__ = ["Crew", "Schedule"]

Answer = TypeVar("Answer")
Hand = TypeVar("Hand")

ON_A_DESK = 2
"""Items that a worker may have: it goes on with the second while we look at the answer to the first."""

STILLBORN = 3
"""Workers that may end in a row before one is ready."""


class Crew(Protocol[Hand]):
    """Where workers come from, and how one talks to them."""

    size: int

    def hire(self) -> Hand:
        """A new worker, which is sent its work and will say that it is ready."""

    def give(self, hand: Hand, item: Any) -> None:
        """Send an item to a worker, without waiting for it, whatever it does; if it is gone, nothing."""

    def look(self, hands: Sequence[Hand], timeout: float | None) -> list[tuple[Hand, Event]]:
        """What workers report, at most one event of each; wait up to ``timeout`` seconds for the first."""

    def end(self, hands: Sequence[Hand]) -> None:
        """End workers, whatever they do."""

    def close(self) -> None:
        """Give back what is not a worker."""


@dataclass(eq=False)
class _Task:
    index: int
    item: Any
    lost: int = 0


@dataclass(eq=False)
class _Desk:
    """What a worker has to do, the first of which it is doing; nothing before it is ready."""

    ready: bool = False
    tasks: deque[_Task] = field(default_factory=deque)
    deadline: float = math.inf


class Schedule(Generic[Answer, Hand]):
    """Answers in order from a crew; see ``Answers``."""

    def __init__(self, crew: Crew[Hand], items: Iterable[Any], limit: Limit[Any] | None) -> None:
        self.finished: dict[int, Answer | Lost] = {}
        self._closed = False
        self._crew = crew
        self._desks: dict[Hand, _Desk] = {}
        self._raised: dict[int, Raised] = {}
        self._items, self._taken = iter(items), 0
        self._no_more: Exception | None = None
        self._waiting: deque[_Task] = deque()
        self._limit = limit
        self._next = 0
        self._stillborn = 0

    def __iter__(self) -> Schedule[Answer, Hand]:
        return self

    def __next__(self) -> tuple[int, Answer | Lost]:
        if self._closed:
            raise StopIteration
        self.finished.pop(self._next - 1, None)
        there = self._is_there(self._next)
        try:
            while True:
                self._hand_out()
                if not there and not self._waiting and not any(desk.tasks for desk in self._desks.values()):
                    raise self._no_more or StopIteration
                self._look(0.0 if there else None)  # whoever is done meanwhile gets something to do, in any case
                if self._is_there(self._next):
                    break
            self._hand_out()
        except BaseException:
            self.close()
            raise
        return self._handed_out()

    def _is_there(self, index: int) -> bool:
        return index in self.finished or index in self._raised

    def _handed_out(self) -> tuple[int, Answer | Lost]:
        index = self._next
        raised = self._raised.get(index)
        if raised is not None:
            self.close()
            raise raised.error from InWorker(index, raised.traceback)
        self._next += 1
        return index, self.finished[index]

    def close(self) -> None:
        """See ``Answers``."""
        if not self._closed:
            self._closed = True
            try:
                self._crew.end(list(self._desks))
            finally:
                self._desks.clear()
                self._crew.close()

    def __del__(self) -> None:
        self.close()

    def _available(self, count: int) -> int:
        """How many tasks are to be had, of at most ``count``."""
        most = self._next + LOOK_AHEAD * self._crew.size
        while len(self._waiting) < count and self._taken < most and self._no_more is None:
            try:
                found = _Task(self._taken, next(self._items))
            except Exception as error:  # StopIteration, too; another is raised in its turn: no answer depends on when
                self._no_more = error
                break
            self._taken += 1
            self._waiting.append(found)
        return min(count, len(self._waiting))

    def _hand_out(self) -> None:
        """Give everyone something to do, and hire more if there is more to do."""
        size, ready = self._crew.size, [(hand, desk) for hand, desk in self._desks.items() if desk.ready]
        for hand, desk in ready:
            if not desk.tasks and self._available(1):
                self._give(hand, desk)
        starting = len(self._desks) - len(ready)
        free = size - len(self._desks)
        if free > 0:
            for _ in range(self._available(starting + free) - starting):
                self._desks[self._crew.hire()] = _Desk()
        for hand, desk in ready:
            if len(desk.tasks) < ON_A_DESK and self._available(size + 1) > size:  # nobody else will have to go without
                self._give(hand, desk)

    def _give(self, hand: Hand, desk: _Desk) -> None:
        task = self._waiting.popleft()
        desk.tasks.append(task)
        self._crew.give(hand, task.item)
        if len(desk.tasks) == 1:
            self._begun(desk)

    def _begun(self, desk: _Desk) -> None:
        """The time of a worker's first task begins now, or did some moments ago."""
        seconds = None if self._limit is None or not desk.tasks else self._limit(desk.tasks[0].item)
        desk.deadline = math.inf if seconds is None else time.monotonic() + seconds

    def _look(self, timeout: float | None) -> None:
        """Wait for reports, at most until somebody's time is up, and enter them; end those whose time is up."""
        if timeout is None:
            soonest = min((desk.deadline for desk in self._desks.values()), default=math.inf)
            timeout = None if soonest == math.inf else max(0.0, soonest - time.monotonic())
        for hand, event in self._crew.look(list(self._desks), timeout):
            self._enter(hand, self._desks[hand], event)
        now = time.monotonic()
        late = {hand: desk for hand, desk in self._desks.items() if desk.deadline <= now}
        for hand, desk in late.items():
            del self._desks[hand]
            self.finished[desk.tasks.popleft().index] = Lost("its worker was ended", over_limit=True)
            self._waiting.extendleft(reversed(desk.tasks))
        self._crew.end(list(late))

    def _enter(self, hand: Hand, desk: _Desk, event: Event) -> None:
        if isinstance(event, Ready):
            desk.ready, self._stillborn = True, 0
        elif isinstance(event, Gone):
            del self._desks[hand]
            self._crew.end([hand])
            self._mourn(desk, event)
        elif not desk.tasks:
            if isinstance(event, Raised):
                raise event.error from InWorker(None, event.traceback)
            raise BrokenInvariant("a worker answered what it was not asked")
        else:
            index = desk.tasks.popleft().index
            self._begun(desk)
            if isinstance(event, Answered):
                self.finished[index] = event.value
            else:
                self._raised[index] = event

    def _mourn(self, desk: _Desk, gone: Gone) -> None:
        if not desk.ready:
            self._stillborn += not gone.blameless
            if self._stillborn >= STILLBORN:
                raise BrokenInvariant(f"{STILLBORN} workers ended before they were ready; the last one: {gone.detail}")
        elif desk.tasks:
            desk.tasks[0].lost += not gone.blameless
            if desk.tasks[0].lost > 1:
                lost = Lost(f"two workers were lost; the second one: {gone.detail}")
                self.finished[desk.tasks.popleft().index] = lost
            self._waiting.extendleft(reversed(desk.tasks))
