"""A lock that serves callers in the order in which they came."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

__all__ = ["FairLock"]

T = TypeVar("T")

_POLL_SECONDS = 0.02
"""Seconds between polls while waiting."""


class FairLock:
    """A lock that threads get in the order in which they asked for it.

    Ctrl-C may come between any two steps, so a caller leaves the queue twice, in case the first time was interrupted;
    leaving a queue in which one does not stand does nothing.
    """

    def __init__(self) -> None:
        self._queue: deque[threading.Lock] = deque()  # each caller's bell; operations are atomic

    @property
    def waiting(self) -> int:
        """How many callers wait for the holder."""
        return max(0, len(self._queue) - 1)

    def hold(self, act: Callable[[], T], poll: Callable[[], None] = lambda: None) -> T:
        """Call ``act`` while holding the lock; returns its result.

        Args:
            poll: Called repeatedly while waiting; an exception from it ends the wait.
        """
        bell = threading.Lock()
        try:
            try:
                bell.acquire()
                self._queue.append(bell)
                while self._queue[0] is not bell:
                    poll()
                    bell.acquire(timeout=_POLL_SECONDS)
                return act()
            finally:
                self._leave(bell)
        finally:
            self._leave(bell)

    def _leave(self, bell: threading.Lock) -> None:
        """Leave the queue, from anywhere in it, and wake the first."""
        with suppress(ValueError):
            self._queue.remove(bell)
        with suppress(IndexError, RuntimeError):  # nobody waits, or it is awake already
            self._queue[0].release()
