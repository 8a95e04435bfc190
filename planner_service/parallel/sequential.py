"""The engine without workers: items are answered one by one in this process."""

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
    """Answers in this process, each item when its answer is requested.

    Nothing can be killed here: time limits are ignored, and a crash ends this process.
    """

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """See ``Engine``."""
        return _SequentialAnswers(work, items)


class _SequentialAnswers(Generic[Answer]):
    def __init__(self, work: Work[Item, Answer], items: Iterable[Item]) -> None:
        self.finished: dict[int, Answer | Lost] = {}
        self._answers = self._all(work, items)

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
        return next(self._answers)

    def close(self) -> None:
        self._answers = iter(())
