"""What an engine does: apply one work to many items and return the answers in order."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

from planner_service.errors import PlannerServiceError

__all__ = ["LOOK_AHEAD", "Answers", "Engine", "InWorker", "Limit", "Lost", "TalkingWork", "Work"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")
Item_contra = TypeVar("Item_contra", contravariant=True)
Answer_co = TypeVar("Answer_co", covariant=True)

LOOK_AHEAD = 64
"""Items per worker that may be taken beyond the next one to be handed out, so that a slow item delays no others."""

Limit = Callable[[Item], float | None]
"""Seconds that an item may take before its worker is killed; None for no limit."""


class Work(Protocol[Item_contra, Answer_co]):
    """What is done with every item: an object of an importable class, sent to each worker once.

    Items and answers are pickled, so they should be plain data, and small.
    """

    def prepare(self) -> None:
        """Set up what every item needs; called once in each worker, before its first item."""

    def __call__(self, item: Item_contra, /) -> Answer_co:
        """The answer to one item, which must depend on the item alone."""


@runtime_checkable
class TalkingWork(Protocol):
    """A work that takes notes while it is at an item, and sends some; see ``Backend.tell`` and ``Noted``."""

    def connect(self, send: Callable[[Any], None]) -> None:
        """Take the function that sends a note; called once, before ``prepare``, and used while it is at an item.

        One thread at a time may use it.
        """

    def told(self, note: Any, /) -> None:
        """Take a note, in another thread than the item's. It may come before its item, or when that is answered."""


@dataclass(frozen=True)
class Lost:
    """Takes the place of an answer if two workers died of an item, or it exceeded its time limit.

    Attributes:
        detail: How the worker ended, in words.
        over_limit: Whether it was killed at its time limit; such an item is not tried again.
    """

    detail: str
    over_limit: bool = False


class InWorker(PlannerServiceError):
    """The cause of an exception that a work raised: the item's index (None while getting ready) and the traceback."""

    def __init__(self, index: int | None, traceback: str) -> None:
        super().__init__(f"{'while getting ready' if index is None else f'item {index}'}, in a worker:\n{traceback}")
        self.index = index
        self.traceback = traceback


class Answers(Protocol[Answer_co]):
    """An iterator over the answers in the order of the items, each with its index from 0.

    Close it if you do not read it to its end, also after Ctrl-C: its workers are then killed within a second.
    """

    @property
    def finished(self) -> Mapping[int, Answer_co | Lost]:
        """The answers not handed out yet, and the one handed out last, by index: what an interrupt would lose."""

    def __iter__(self) -> Iterator[tuple[int, Answer_co | Lost]]: ...

    def __next__(self) -> tuple[int, Answer_co | Lost]:
        """The next answer.

        Raises:
            StopIteration: There are no more items.
            Exception: What the work raised for this item, with ``InWorker`` as its cause; or what the iterator of items
                raised, once all items before are answered.
        """

    def close(self) -> None:
        """Kill all workers; ``finished`` keeps its answers."""


class Engine(Protocol):
    """Where items are answered, and by how many workers."""

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """Start answering. Items are taken as workers are free, and at most ``LOOK_AHEAD`` per worker ahead.

        If a worker dies, another one tries its item again; if that dies too, this item is ``Lost``, and no other.
        """
