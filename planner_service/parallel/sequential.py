"""The engine that needs no workers: items are answered one by one, here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from planner_service.parallel.engine import Answers, InWorker, Limit, Lost, Work

__all__ = ["Sequential"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Sequential:
    """Answers in this process, each item when its answer is asked for.

    Nothing can be ended here: limits do not hold, and whatever takes the process down takes the rest along.
    """

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """See ``Engine``."""
        return _InTurn(work, items)


class _InTurn(Generic[Answer]):
    def __init__(self, work: Work[Item, Answer], items: Iterable[Item]) -> None:
        self.finished: dict[int, Answer | Lost] = {}
        self._steps = self._all(work, items)

    def _all(self, work: Work[Item, Answer], items: Iterable[Item]) -> Iterator[tuple[int, Answer]]:
        for index, item in enumerate(items):
            if index == 0:
                work.prepare()
            try:
                answer = work(item)
            except Exception as error:
                raise error from InWorker(index, "")
            self.finished = {index: answer}
            yield index, answer

    def __iter__(self) -> Iterator[tuple[int, Answer | Lost]]:
        return self

    def __next__(self) -> tuple[int, Answer | Lost]:
        return next(self._steps)

    def close(self) -> None:
        self._steps = iter(())
