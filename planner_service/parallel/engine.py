"""What an engine is: many items through one work, in order, on whatever there is to work on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from planner_service.errors import PlannerServiceError

__all__ = ["LOOK_AHEAD", "Answers", "Engine", "InWorker", "Limit", "Lost", "Work"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")
Item_contra = TypeVar("Item_contra", contravariant=True)
Answer_co = TypeVar("Answer_co", covariant=True)

LOOK_AHEAD = 64
"""Items per worker that may be taken beyond the next one to be handed out: one that takes long keeps nobody waiting."""

Limit = Callable[[Item], float | None]
"""Seconds that an item may take before its worker is ended; None for no limit."""


class Work(Protocol[Item_contra, Answer_co]):
    """What is done with every item: a value of a class that others can import, sent to each worker once.

    Items and answers cross to and fro, so both are best plain data, and small.
    """

    def prepare(self) -> None:
        """Make what every item needs; called once in each worker, before its first item."""

    def __call__(self, item: Item_contra, /) -> Answer_co:
        """The answer to one item; it depends on nothing but the item."""


@dataclass(frozen=True)
class Lost:
    """Stands for the answer to an item that cost two workers their life, or was over its limit.

    Attributes:
        detail: What became of the worker, for a person.
        over_limit: Whether it was ended because its time was up; such an item is not tried again.
    """

    detail: str
    over_limit: bool = False


class InWorker(PlannerServiceError):
    """The cause of an error that a work raised: at which item (None: while getting ready), and the traceback there."""

    def __init__(self, index: int | None, traceback: str) -> None:
        super().__init__(f"{'while getting ready' if index is None else f'item {index}'}, in a worker:\n{traceback}")
        self.index = index
        self.traceback = traceback


class Answers(Protocol[Answer_co]):
    """The answers in the order of the items, each with its index from 0; an iterator that is closed when done with.

    Whoever leaves early, by Ctrl-C, too, closes it: the workers are then ended within a second.
    """

    @property
    def finished(self) -> Mapping[int, Answer_co | Lost]:
        """What is finished and was not handed out yet, and the answer handed out last: what an interrupt would lose."""

    def __iter__(self) -> Iterator[tuple[int, Answer_co | Lost]]: ...

    def __next__(self) -> tuple[int, Answer_co | Lost]:
        """The next answer.

        Raises:
            StopIteration: there are no more items.
            Exception: whatever the work raised for this item, in its turn, with ``InWorker`` as its cause; or the items
                themselves, when all before are answered.
        """

    def close(self) -> None:
        """End all workers. What is ``finished`` stays there."""


class Engine(Protocol):
    """Where and by how many workers items are answered."""

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """Start to answer; items are taken as there are workers for them, and at most ``LOOK_AHEAD`` a worker ahead.

        A worker that dies costs its item a second try with another worker, then that item is ``Lost``, and no other.
        """
