"""Workers that answer when a test says so."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from planner_service.parallel.pool import Answered, Event

__all__ = ["ScriptedWorkers"]


@dataclass
class ScriptedWorkers:
    """A backend whose workers start at once, and whose other events a test makes.

    Attributes:
        answer: Makes the answer to a request by its id; None if the test tells ``events`` of it.
        allowed: No event comes before it is set.
    """

    max_workers: int
    answer: Callable[[str], Any] | None = None
    allowed: threading.Event = field(default_factory=threading.Event)
    started: int = 0
    sent: list[tuple[int, str]] = field(default_factory=list)
    told: list[tuple[int, Any]] = field(default_factory=list)
    killed: list[int] = field(default_factory=list)
    events: SimpleQueue[tuple[int, Event]] = field(default_factory=SimpleQueue)

    def start(self) -> int:
        """Start a worker, which is ready."""
        self.started += 1
        self.events.put((self.started, Answered(None)))
        return self.started

    def send(self, worker: int, item: Any) -> None:
        """Note a request."""
        self.sent.append((worker, item.id))
        if self.answer is not None:
            self.events.put((worker, Answered(self.answer(item.id))))

    def tell(self, worker: int, note: Any) -> None:
        """Record a message that is sent to a worker."""
        self.told.append((worker, note))

    def receive(self, workers: Sequence[int], timeout: float | None) -> list[tuple[int, Event]]:
        """The next event."""
        if not self.allowed.wait(timeout):
            return []
        try:
            worker, event = self.events.get(timeout=timeout)
        except Empty:
            return []
        return [(worker, event)] if worker in workers else []

    def kill(self, workers: Sequence[int]) -> None:
        """Note who is killed."""
        self.killed += workers

    def close(self) -> None:
        """Nothing is left to end."""
