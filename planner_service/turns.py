"""One caller at a time, first come, first served."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from planner_service.collision.ledger import Cancelled, CancelToken

__all__ = ["Turns"]

_LOOK_AROUND = 0.01
"""Seconds between looks at the cancel token while waiting."""


class Turns:
    """A fair lock: threads get it in the order in which they asked."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._queue: deque[object] = deque()

    @property
    def waiting(self) -> int:
        """How many callers stand in line behind the one whose turn it is."""
        with self._condition:
            return max(0, len(self._queue) - 1)

    @contextmanager
    def taken(self, token: CancelToken | None = None) -> Iterator[None]:
        """Hold the turn within the block.

        Raises:
            Cancelled: ``token`` was cancelled while waiting.
        """
        ticket = object()
        with self._condition:
            self._queue.append(ticket)
        try:
            with self._condition:
                while self._queue[0] is not ticket:
                    if token is not None and token.cancelled:
                        raise Cancelled("cancelled while waiting for its turn")
                    self._condition.wait(_LOOK_AROUND if token is not None else None)
            yield
        finally:
            with self._condition:
                self._queue.remove(ticket)
                self._condition.notify_all()
