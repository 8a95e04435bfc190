"""How a search shares its states among tries, each with a fresh seed.

The time a search takes has a long tail, which a fresh start cuts off; one that would end well is over long before. So
the first tries are short. What they leave may be hard: then each try gets twice what the one before it had.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, repeat

__all__ = ["FIRST_TRIES", "fresh_tries"]

FIRST_TRIES, FIRST_STATES = 4, 10_000
"""Tries before they become longer, and the states of each; a fourth of the states where there are few."""


def fresh_tries(states: int, retries: int | None, patience: int) -> Iterator[int]:
    """How many states each try may use, one after the other, without an end if ``retries`` is None.

    Args:
        states: What all of them may use.
        retries: ``PlanRequest.retries``; if given, all tries have equal parts.
        patience: States that each try is to have at least.
    """
    if retries is not None:
        yield from repeat(max(1, states // (retries + 1), patience), retries + 1)
        return
    first = max(1, min(FIRST_STATES, states // FIRST_TRIES), patience)
    for attempt in count():
        yield first << max(0, attempt - FIRST_TRIES + 1)
