"""Whether the call that this thread is in is still wanted: asked wherever work takes long, however deep.

A call says it once for its thread, not to every function between it and a loop: see ``stagebook.in_turn``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

__all__ = ["ask_from_now_on", "poll"]


class _Asked(threading.local):
    """Whom each thread asks."""

    ask: Callable[[], None] | None = None


_asked = _Asked()


def ask_from_now_on(ask: Callable[[], None] | None) -> None:
    """Have ``poll`` call this in this thread; None for nothing."""
    _asked.ask = ask


def poll() -> None:
    """Raise if the running call is over its time or was cancelled; outside of one, and in other threads, do nothing."""
    ask = _asked.ask
    if ask is not None:
        ask()
