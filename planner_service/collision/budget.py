"""The one place where collision checks are counted, and where their limits are enforced."""

from __future__ import annotations

import math
import threading
import time
import weakref
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from operator import add, sub
from typing import NamedTuple, TypeVar

from planner_service.concurrency.polling import asking
from planner_service.errors import InvalidRequest, PlannerServiceError
from planner_service.geometry.validation import number, whole
from planner_service.presentation.tables import Table

__all__ = [
    "CancelToken",
    "Cancelled",
    "CheckBudgetSpent",
    "CheckCounts",
    "Ledger",
    "SearchStopped",
    "Tally",
    "TimeBoxSpent",
]

Number = TypeVar("Number", int, float)
T = TypeVar("T")

MAX_STATES = 2**63 - 1
"""More states than anyone judges."""


@dataclass(frozen=True)
class CheckCounts:
    """The work of the collision checker, counted.

    Attributes:
        states: Configurations judged free or not, samples along edges one by one, up to and
            including the first that collides.
        edges: Edges judged.
        distances: (configuration, pair) clearance bounds requested.
        projections: Configurations moved to where they keep constraints.
    """

    states: int = 0
    edges: int = 0
    distances: int = 0
    projections: int = 0

    def __str__(self) -> str:
        parts = [(self.states, "state"), (self.edges, "edge")]
        parts += [(self.distances, "distance")] if self.distances else []
        parts += [(self.projections, "projection")] if self.projections else []
        return ", ".join(f"{number:,} {noun}{'' if number == 1 else 's'}" for number, noun in parts)

    @property
    def named(self) -> dict[str, int]:
        """Each count by its name; projections only if there are any."""
        counts = {"states": self.states, "edges": self.edges, "distances": self.distances}
        return counts | ({"projections": self.projections} if self.projections else {})

    def _repr_html_(self) -> str:
        named = self.named
        return Table([*named], [[f"{count:,}" for count in named.values()]], numeric=[*named]).html()

    def __add__(self, other: CheckCounts) -> CheckCounts:
        return CheckCounts(*map(add, vars(self).values(), vars(other).values()))

    def __sub__(self, other: CheckCounts) -> CheckCounts:
        return CheckCounts(*map(sub, vars(self).values(), vars(other).values()))


class SearchStopped(PlannerServiceError):
    """A limit was reached inside a check; it unwinds to the service, which turns it into a Failure of a plan."""


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


class Tally:
    """The checks of one thread. No other thread changes it, so it needs no lock.

    Attributes:
        states: As in ``CheckCounts``; so are ``edges``, ``distances`` and ``projections``.
        hits: How often each pair was found to collide, by names.
    """

    def __init__(self) -> None:
        self.states = 0
        self.edges = 0
        self.distances = 0
        self.projections = 0
        self.hits: Counter[tuple[str, str]] = Counter()

    @property
    def counts(self) -> CheckCounts:
        """The counts so far."""
        return CheckCounts(self.states, self.edges, self.distances, self.projections)


class Ledger:
    """Running counts, shared by a checker and its variants, and the limits of each thread.

    Each thread counts by itself: what a call costs is the difference of its thread's counts, whatever other threads ask
    meanwhile. Limits too belong to the thread whose block set them.
    """

    def __init__(self) -> None:
        self._tallies: dict[int, Tally] = {}
        self._threads = _Threads(self._tallies)

    @property
    def counts(self) -> CheckCounts:
        """The counts so far, of all threads."""
        return sum((tally.counts for tally in list(self._tallies.values())), CheckCounts())

    @property
    def hits(self) -> Counter[tuple[str, str]]:
        """How often each pair was found to collide, by names, in all threads."""
        return sum((tally.hits for tally in list(self._tallies.values())), Counter())

    @property
    def own(self) -> Tally:
        """The checks of this thread so far."""
        return self._threads.tally

    def held(
        self,
        act: Callable[[], T],
        *,
        states: int | None = None,
        seconds: float | None = None,
        cancel: CancelToken | None = None,
    ) -> T:
        """What ``act`` returns, held to limits, which ``concurrency.polling.poll`` then watches, too.

        However it ends, this thread is left as it was, even by Ctrl-C between any two steps: this is why the steps that
        undo it are there twice.

        Args:
            states: How many more it may judge.
            seconds: Wall time.
            cancel: Ends it when cancelled.

        Raises:
            SearchStopped: A limit was reached.
        """
        try:
            try:
                self.let_go()
                deadline = None if seconds is None else time.monotonic() + seconds
                with self.limited(states=states, deadline=deadline, token=cancel):
                    asking.ask = self.poll
                    return act()
            finally:
                asking.ask = None
                self.let_go()
        finally:
            asking.ask = None
            self.let_go()

    def limited(
        self, *, states: int | None = None, deadline: float | None = None, token: CancelToken | None = None
    ) -> AbstractContextManager[None]:
        """Within the block, stop before ``states`` more are exceeded, or ``time.monotonic()`` passes ``deadline``.

        Limits around the block hold on within it.
        """
        if states is not None and not (type(states) is int and 0 <= states <= MAX_STATES):
            states = whole("states", states, 0, MAX_STATES)
        if deadline is not None and not (type(deadline) is float and math.isfinite(deadline)):
            deadline = number("deadline", deadline, "a time of time.monotonic()", -math.inf, math.inf)
        if token is not None and not isinstance(token, CancelToken):
            raise InvalidRequest("cancel", token, "a CancelToken, or None")
        return _Block(self._threads.own, states, deadline, token)

    def apart(self) -> AbstractContextManager[None]:
        """Within the block no number of states limits; what it spends does not use up the limits around it."""
        return _Block(self._threads.own, apart=True)

    def let_go(self) -> None:
        """End the limits that a call of this thread may have left behind when Ctrl-C came."""
        own = self._threads.own
        if own.limits.blocks:
            own.hold()

    def poll(self) -> None:
        """Raise if the time box is over or the call was cancelled; costs no check."""
        own = self._threads.own
        if own.limits.tokens or own.limits.deadline is not None:
            own.check(own.poll)

    def require_room(self) -> None:
        """Poll, and raise if not one more state may be judged."""
        own = self._threads.own
        if own.limits.blocks:
            self.poll()
            if own.limits.most is not None and own.states >= own.limits.most:
                own.check(own.require_room)

    def allowance(self) -> tuple[int, bool]:
        """How many more states compiled code may judge, -1 without a limit; and whether it is to poll before the first,
        as a limit was reached."""
        reached = False
        try:
            self.require_room()
        except SearchStopped:
            reached = True
        room = self.room()
        return -1 if room is None else room, reached

    def room(self) -> int | None:
        """How many more states may be judged; None without a limit."""
        own = self._threads.own
        return None if own.limits.most is None else max(0, own.limits.most - own.states)

    def time_left(self) -> float | None:
        """Seconds until the deadline, none below 0; None without one."""
        deadline = self._threads.own.limits.deadline
        return None if deadline is None else max(0.0, deadline - time.monotonic())

    def record_states(self, judged: int) -> None:
        """Record states that were judged, as many as there was room for."""
        threads = self._threads
        threads.tally.states += judged
        threads.own.states += judged

    def record(self, states: int, edges: int, hits: Mapping[int, int], names: Mapping[int, tuple[str, str]]) -> None:
        """Record what compiled code judged, and how often each pair of pieces, by its number, was found to collide."""
        self.record_states(states)
        tally = self._threads.tally
        tally.edges += edges
        before = tally.hits
        for pair, count in hits.items():
            name = names[pair]
            before[name] = before.get(name, 0) + count

    def record_hit(self, pair: tuple[str, str]) -> None:
        """Record that a pair was found to collide, by its names."""
        self._threads.tally.hits[pair] += 1

    def charge(self, bounds: int) -> None:
        """Record clearance bounds that are going to be computed; raise instead if the call is over."""
        self.poll()
        self.charge_distances(bounds)

    def charge_distances(self, bounds: int) -> None:
        """Record clearance bounds."""
        self._threads.tally.distances += bounds


class _Limits(NamedTuple):
    """The blocks a thread is in, and the least of their limits; replaced as a whole, for Ctrl-C may come in between."""

    blocks: tuple[weakref.ref[_Block], ...] = ()
    most: int | None = None
    deadline: float | None = None
    tokens: tuple[CancelToken, ...] = ()


class _Thread:
    """How many states one thread has spent, and the limits of the blocks it is in, the outermost first.

    A block is known weakly: one that Ctrl-C kept from ending is gone with its frame, and so are its limits.
    """

    def __init__(self) -> None:
        self.states = 0
        self.limits = _Limits()

    def hold(self, *blocks: _Block) -> None:
        """Take the limits of these blocks for all there are."""
        most, deadline = None, None
        for block in blocks:
            most = _least(None if block.apart else most, block.most)
            deadline = _least(deadline, block.deadline)
        tokens = tuple([block.token for block in blocks if block.token is not None])
        self.limits = _Limits(tuple(map(weakref.ref, blocks)), most, deadline, tokens)

    def living(self) -> list[_Block]:
        """The blocks there are."""
        return [block for ref in self.limits.blocks if (block := ref()) is not None]

    def check(self, limit: Callable[[], None]) -> None:
        """Raise what a limit raises, unless the block that it is of has ended or is gone."""
        try:
            limit()
        except SearchStopped:
            self.hold(*self.living())
            limit()

    def poll(self) -> None:
        _, _, deadline, tokens = self.limits
        if any(token.cancelled for token in tokens):
            raise Cancelled("cancelled by the caller")
        if deadline is not None and time.monotonic() > deadline:
            raise TimeBoxSpent("the time limit passed")

    def require_room(self) -> None:
        if self.limits.most is not None and self.states >= self.limits.most:
            raise CheckBudgetSpent("the check budget is spent")


def _least(a: Number | None, b: Number | None) -> Number | None:
    """The smaller of two limits, each of which may be None."""
    return b if a is None or (b is not None and b < a) else a


class _Threads(threading.local):
    """What each thread has of its own.

    Tallies are kept by the number of their thread. A thread that ended leaves its number to a later one, which counts
    on from there: so there are never more tallies than there were threads at a time.
    """

    def __init__(self, tallies: dict[int, Tally]) -> None:
        self.own = _Thread()
        self.tally = tallies.setdefault(threading.get_ident(), Tally())


@dataclass(eq=False)
class _Block(AbstractContextManager[None]):
    """Limits while it is entered. Blocks of a thread may end in any order: each takes back its own limits alone."""

    thread: _Thread
    states: int | None = None
    deadline: float | None = None
    token: CancelToken | None = None
    apart: bool = False
    most: int | None = None
    before: int = 0

    def __enter__(self) -> None:
        thread = self.thread
        self.before = thread.states
        self.most = None if self.states is None else thread.states + self.states
        thread.hold(*thread.living(), self)

    def __exit__(self, *_: object) -> None:
        thread = self.thread
        if self.apart:
            thread.states = self.before
        thread.hold(*(block for block in thread.living() if block is not self))
