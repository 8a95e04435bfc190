"""The one place where collision checks are counted, and where their limits are enforced."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from planner_service.errors import InvalidRequest

__all__ = ["CancelToken", "Cancelled", "CheckBudgetSpent", "CheckCounts", "Ledger", "SearchStopped", "TimeBoxSpent"]


@dataclass(frozen=True)
class CheckCounts:
    """What was asked of the collision checker.

    Attributes:
        states: Configurations judged free or not, samples along edges one by one, up to and
            including the first that collides.
        edges: Edges judged.
        distances: (configuration, pair) clearance bounds requested.
    """

    states: int = 0
    edges: int = 0
    distances: int = 0

    def __add__(self, other: CheckCounts) -> CheckCounts:
        return CheckCounts(self.states + other.states, self.edges + other.edges, self.distances + other.distances)

    def __sub__(self, other: CheckCounts) -> CheckCounts:
        return CheckCounts(self.states - other.states, self.edges - other.edges, self.distances - other.distances)


class SearchStopped(Exception):
    """A limit was reached inside a check; it unwinds to the service, which turns it into a Failure."""


class CheckBudgetSpent(SearchStopped):
    """The next state would exceed ``max_checks``."""


class TimeBoxSpent(SearchStopped):
    """The time limit passed."""


class Cancelled(SearchStopped):
    """The caller's token was cancelled."""


class CancelToken:
    """Lets another thread end a running call: it stops before its next check."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def cancel(self) -> None:
        """Ask the call that holds this token to stop."""
        self._event.set()

    @property
    def cancelled(self) -> bool:
        """Whether ``cancel`` was called."""
        return self._event.is_set()


_Limit = TypeVar("_Limit", int, float)


def _least(a: _Limit | None, b: _Limit | None) -> _Limit | None:
    """The smaller of two limits, None meaning no limit."""
    if a is None or b is None:
        return b if a is None else a
    return min(a, b)


class Ledger:
    """Running counts with their limits, shared by a checker and its variants, and the lock that guards both."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.states = 0
        self.edges = 0
        self.distances = 0
        self.hits: Counter[tuple[str, str]] = Counter()
        self._state_limit: int | None = None
        self._deadline: float | None = None
        self._token: CancelToken | None = None

    @property
    def counts(self) -> CheckCounts:
        """The counts so far."""
        return CheckCounts(self.states, self.edges, self.distances)

    @contextmanager
    def limited(
        self, *, states: int | None = None, deadline: float | None = None, token: CancelToken | None = None
    ) -> Iterator[None]:
        """Within the block, stop before ``states`` more are exceeded, or ``time.monotonic()`` passes ``deadline``.

        Limits around the block hold on within it.
        """
        if token is not None and not isinstance(token, CancelToken):
            raise InvalidRequest("cancel", token, "a CancelToken, or None")
        before = (self._state_limit, self._deadline, self._token)
        self._state_limit = _least(self._state_limit, None if states is None else self.states + states)
        self._deadline = _least(self._deadline, deadline)
        self._token = token if token is not None else self._token
        try:
            yield
        finally:
            self._state_limit, self._deadline, self._token = before

    @contextmanager
    def apart(self, *, states: int | None) -> Iterator[None]:
        """Within the block only ``states`` and the token limit; what it spends does not use up the limits around it."""
        limit, deadline = self._state_limit, self._deadline
        began, clock = self.states, time.monotonic()
        try:
            self._state_limit, self._deadline = None, None
            with self.limited(states=states):
                yield
        finally:
            self._state_limit = None if limit is None else limit + self.states - began
            self._deadline = None if deadline is None else deadline + time.monotonic() - clock

    def poll(self) -> None:
        """Raise if the time box is over or the call was cancelled; costs no check."""
        if self._token is not None and self._token.cancelled:
            raise Cancelled("cancelled by the caller")
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise TimeBoxSpent("the time limit passed")

    def room(self) -> int | None:
        """How many more states may be judged; None without a limit."""
        return None if self._state_limit is None else self._state_limit - self.states

    def time_left(self) -> float | None:
        """Seconds until the deadline, none below 0; None without one."""
        return None if self._deadline is None else max(0.0, self._deadline - time.monotonic())

    def charge_states(self, judged: int) -> None:
        """Record ``judged`` states; when that is more than there is room for, record the room and stop."""
        if self._state_limit is not None and self.states + judged > self._state_limit:
            self.states = max(self.states, self._state_limit)
            raise CheckBudgetSpent("the check budget is spent")
        self.states += judged

    def settle(self, judged: int) -> None:
        """Poll and record ``judged`` states, in one."""
        if self._deadline is not None or self._token is not None:
            self.poll()
        states, limit = self.states + judged, self._state_limit
        if limit is not None and states > limit:
            self.charge_states(judged)
        self.states = states

    def charge_edge(self) -> None:
        """Record one edge."""
        with self.lock:
            self.edges += 1

    def charge_distances(self, bounds: int) -> None:
        """Record clearance bounds."""
        with self.lock:
            self.distances += bounds

    def hit(self, pair: tuple[str, str]) -> None:
        """Record which pair made a state collide."""
        self.hits[pair] += 1
