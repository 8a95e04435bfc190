"""Whether the call that this thread is in is still wanted: asked wherever work takes long, however deep.

A call says it once for its thread, not to every function between it and a loop: see ``stagebook.in_turn``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Prepared", "ask_from_now_on", "asked", "poll", "waited"]

T = TypeVar("T")

_LOOK_AROUND = 0.01
"""Seconds between looks around while waiting."""


class _Asked(threading.local):
    """Whom each thread asks."""

    ask: Callable[[], None] | None = None


_asked = _Asked()


def ask_from_now_on(ask: Callable[[], None] | None) -> None:
    """Have ``poll`` call this in this thread; None for nothing."""
    _asked.ask = ask


def asked() -> bool:
    """Whether this thread is in a call that may be over at some time."""
    return _asked.ask is not None


def poll() -> None:
    """Raise if the running call is over its time or was cancelled; outside of one, and in other threads, do nothing."""
    ask = _asked.ask
    if ask is not None:
        ask()


class Prepared(Generic[T]):
    """A value that may take long to make: made once, when first asked for, in a thread of its own.

    Who waits polls, and may be called away; the value is made all the same, for those who ask again.
    """

    def __init__(self, make: Callable[[], T]) -> None:
        self._make = make
        self._made: list[T] = []
        self._failed: list[BaseException] = []
        self._thread: threading.Thread | None = None

    def get(self) -> T:
        """The value, or what making it raises."""
        if not self._made:
            if self._thread is None:
                thread = threading.Thread(target=self._work, name="planner-service: prepared", daemon=True)
                thread.start()
                self._thread = thread
            while self._thread.is_alive():
                self._thread.join(_LOOK_AROUND)
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
    """What ``work`` returns, which does not poll: left to itself in a thread if the call is over."""
    return Prepared(work).get() if asked() else work()
