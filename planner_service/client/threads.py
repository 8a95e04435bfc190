"""An engine that waits for many answers at once: for work that is done elsewhere."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from planner_service.parallel import Answers, InWorker, Limit, Lost, Work

__all__ = ["Threads"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

AHEAD = 4
"""Items per thread that are taken beyond the next one to be handed out."""


@dataclass(frozen=True)
class Threads:
    """Answers in threads of this process, each of which waits for one answer; time limits are the work's own."""

    count: int

    def run(
        self, work: Work[Item, Answer], items: Iterable[Item], *, limit: Limit[Any] | None = None
    ) -> Answers[Answer]:
        """See ``Engine``."""
        return _ThreadAnswers(work, items, self.count)


class _ThreadAnswers(Generic[Answer]):
    def __init__(self, work: Work[Item, Answer], items: Iterable[Item], count: int) -> None:
        work.prepare()
        self._threads, self._open = ThreadPoolExecutor(count), deque[Future[Answer]]()
        self._last: dict[int, Answer | Lost] = {}
        self._handed_out = 0
        self._answers = self._all(work, items, AHEAD * count)

    def _all(self, work: Work[Item, Answer], items: Iterable[Item], most: int) -> Iterator[tuple[int, Answer]]:
        try:
            for item in items:
                self._open.append(self._threads.submit(work, item))
                if len(self._open) >= most:
                    yield self._next()
            while self._open:
                yield self._next()
        finally:
            self._threads.shutdown(wait=False, cancel_futures=True)

    def _next(self) -> tuple[int, Answer]:
        index = self._handed_out
        try:
            answer = self._open[0].result()
        except Exception as error:
            raise error from InWorker(index, "")
        self._open.popleft()
        self._handed_out, self._last = index + 1, {index: answer}
        return index, answer

    @property
    def finished(self) -> dict[int, Answer | Lost]:
        """See ``Answers``."""
        done = {
            self._handed_out + k: future.result()
            for k, future in enumerate(self._open)
            if future.done() and not future.cancelled() and future.exception() is None
        }
        return self._last | done

    def __iter__(self) -> Iterator[tuple[int, Answer | Lost]]:
        return self

    def __next__(self) -> tuple[int, Answer | Lost]:
        return next(self._answers)

    def close(self) -> None:
        """See ``Answers``: what was sent already is answered, and nobody reads it."""
        self._answers = iter(())
        self._threads.shutdown(wait=False, cancel_futures=True)
