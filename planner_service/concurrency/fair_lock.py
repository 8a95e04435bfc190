"""One caller at a time, first come, first served."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

__all__ = ["Turns"]

T = TypeVar("T")

_LOOK_AROUND = 0.02
"""Seconds between looks around while waiting."""


class Turns:
    """A fair lock: threads get it in the order in which they asked.

    Ctrl-C may come between any two steps. So the turn is given back twice, the second time in case the first did not
    come about: leaving a line in which one does not stand does nothing.
    """

    def __init__(self) -> None:
        self._line: deque[threading.Lock] = deque()  # its operations are atomic; each caller's bell, not rung yet

    @property
    def waiting(self) -> int:
        """How many callers stand in line behind the one whose turn it is."""
        return max(0, len(self._line) - 1)

    def taken(self, act: Callable[[], T], poll: Callable[[], None] = lambda: None) -> T:
        """What ``act`` returns, holding the turn.

        Args:
            poll: Called now and then while waiting; what it raises ends the wait.
        """
        bell = threading.Lock()
        try:
            try:
                bell.acquire()
                self._line.append(bell)
                while self._line[0] is not bell:
                    poll()
                    bell.acquire(timeout=_LOOK_AROUND)
                return act()
            finally:
                self._leave(bell)
        finally:
            self._leave(bell)

    def _leave(self, bell: threading.Lock) -> None:
        """Leave the line, wherever in it, and ring for the first."""
        with suppress(ValueError):
            self._line.remove(bell)
        with suppress(IndexError, RuntimeError):  # nobody is there; it was rung for already
            self._line[0].release()
