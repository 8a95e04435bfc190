"""Ends long work when its call is over its time or cancelled: loops ``poll``, however deep in the call they are.

A call sets the check once for its thread instead of passing it to every function down to the loops.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Prepared", "asked", "asking", "poll", "waited"]

T = TypeVar("T")

_POLL_SECONDS = 0.01
"""Seconds between polls while waiting."""


class _Asking(threading.local):
    """The check that ``poll`` calls in each thread; None for no check."""

    ask: Callable[[], None] | None = None


asking = _Asking()


def asked() -> bool:
    """Whether this thread has a check."""
    return asking.ask is not None


def poll() -> None:
    """Raise if this thread's call is over its time or cancelled; without a check do nothing."""
    ask = asking.ask
    if ask is not None:
        ask()


class Prepared(Generic[T]):
    """A value that takes long to compute: computed once, when first requested, in a thread of its own.

    Callers poll while they wait. If one is interrupted, the computation continues for the next caller.

    Args:
        quick: It takes a few milliseconds: the caller computes it.
    """

    def __init__(self, make: Callable[[], T], *, quick: bool = False) -> None:
        self._make, self._quick = make, quick
        self._made: list[T] = []
        self._failed: list[BaseException] = []
        self._thread: threading.Thread | None = None

    def get(self) -> T:
        """The value; raises what computing it raised."""
        if not self._made and self._quick:
            self._made.append(self._make())
        if not self._made:
            if self._thread is None:
                thread = threading.Thread(target=self._work, name="planner-service: prepared", daemon=True)
                thread.start()
                self._thread = thread
            while self._thread.is_alive():
                self._thread.join(_POLL_SECONDS)
                poll()
        if self._failed:
            raise self._failed[0]
        return self._made[0]

    def _work(self) -> None:
        try:
            self._made.append(self._make())
        except BaseException as error:
            self._failed.append(error)


def waited(work: Callable[[], T]) -> T:
    """Call ``work``, which does not poll itself; if the call is over meanwhile, it is left to finish in its thread."""
    return Prepared(work).get() if asked() else work()
