"""A search problem, the oracles that it asks, and its result, as all planners share them.

A planner knows neither robot nor scene, only joint bounds and an oracle that checks configurations and edges and
counts its checks. Tests use discs in a plane instead. Compiled searches and smoothing ask the ``core`` of an oracle; a
caller's own oracle gets one (``compiled``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

import numpy as np

from planner_service.collision.budget import SearchStopped
from planner_service.collision.checker import CollisionChecker, EdgeHit
from planner_service.collision.edge_sampling import KNOWN_ENDS, Known
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import numbers, whole
from planner_service.native.loading import load_core

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = [
    "SELF",
    "CoarseOracle",
    "CompiledOracle",
    "Configuration",
    "ConstrainedOracle",
    "Oracle",
    "Planner",
    "SearchOracle",
    "SearchProblem",
    "SearchResult",
    "SearchSpace",
    "Space",
    "TieredOracle",
    "compiled",
    "distances",
    "of_tuples",
    "require_seed",
]

T = TypeVar("T")

Configuration = tuple[float, ...]
State = FloatArray | Configuration

SELF = ""
"""Takes the place of an obstacle's name where the robot collides with itself or with what it carries."""

MIN_MOTIONS_BOXED_IN = 20
"""Motions tried at a start or goal, none of them free, before it is reported as boxed in."""

NEAR_END = 0.2
"""Radians from a start or goal within which an edge needs no more clearance than that state."""


class Oracle(Protocol):
    """Checks states and edges and counts the checks. Any call may raise when a limit is reached."""

    @property
    def states(self) -> int:
        """Configurations checked so far."""

    def state_is_free(self, q: FloatArray) -> bool:
        """Whether configuration q (n,) is free."""

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        """Whether the straight line from q1 to q2 is free; ``known`` ends are not checked again."""


class CoarseOracle(Protocol):
    """An oracle that can also check an edge coarsely first, for searches that use few of the edges they check.

    It takes configurations as tuples, as searches store them: arrays would be a large part of an edge's cost.
    """

    @property
    def states(self) -> int:
        """Configurations checked so far."""

    def state_is_free(self, q: Configuration) -> bool:
        """Whether configuration q is free."""

    def edge_is_free(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether the straight line from q1 to q2 is free; ``known`` ends are not checked again."""

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """False if the edge collides; if True, ``edge_is_free`` has the last word, and judges only what is left."""


class _OfArrays:
    """Passes configurations given as tuples to an oracle that takes arrays."""

    def __init__(self, oracle: Oracle) -> None:
        self._oracle = oracle

    @property
    def states(self) -> int:
        return self._oracle.states

    def state_is_free(self, q: Configuration) -> bool:
        return self._oracle.state_is_free(np.array(q))

    def edge_is_free(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        return self._oracle.edge_is_free(np.array(q1), np.array(q2), known=known)

    edge_is_free_coarse = edge_is_free


def of_tuples(oracle: Oracle) -> CoarseOracle:
    """The oracle itself if it has coarse checks, and so takes tuples; else one that converts them to arrays."""
    if hasattr(oracle, "edge_is_free_coarse"):  # isinstance of a Protocol takes longer than an edge
        return oracle  # type: ignore[return-value]
    return _OfArrays(oracle)


class CompiledOracle(Protocol):
    """What compiled searching and smoothing ask."""

    @property
    def core(self) -> _core.Oracle:
        """What answers."""

    def counted(self, ask: Callable[[], T]) -> T:
        """What ``ask`` returns, which asks ``core``: what that judges is counted, and limits hold."""

    def blocker_of(self, pair: int) -> str | None:
        """The obstacle of a pair that ``core`` found to collide, by its number; None if that is not known."""


def compiled(oracle: Oracle | CoarseOracle, poll: Callable[[], None] = lambda: None) -> CompiledOracle:
    """The oracle itself if it is compiled, else one that asks its methods.

    Args:
        poll: Called often by the latter; what it raises ends the search.
    """
    return cast(CompiledOracle, oracle) if hasattr(oracle, "core") else _Asked(oracle, poll)


class _Asked:
    """An oracle behind its methods, for one call; the numbers of its pairs are those of the collisions that were told.

    After the call nothing leads to the oracle any more: through the core no cycle of references is ever found.
    """

    def __init__(self, oracle: Oracle | CoarseOracle, poll: Callable[[], None]) -> None:
        held, self._blockers = [of_tuples(cast(Oracle, oracle))], list[str | None]()
        told, blockers, self._held = [oracle], self._blockers, held
        self._told = told

        def edge(a: Configuration, b: Configuration, known: int) -> bool:
            return bool(held[0].edge_is_free(a, b, known=KNOWN_ENDS[known]))

        def coarse(a: Configuration, b: Configuration, known: int) -> bool:
            return bool(held[0].edge_is_free_coarse(a, b, known=KNOWN_ENDS[known]))

        def last() -> tuple[float, int]:
            hit = getattr(told[0], "last_hit", None)
            blockers.append(getattr(told[0], "blocker", None))
            return 0.5 if hit is None else hit.fraction, len(blockers) - 1

        glance = coarse if hasattr(oracle, "edge_is_free_coarse") else None
        self.core: _core.AskedOracle = load_core().AskedOracle(
            lambda q: bool(held[0].state_is_free(q)), edge, glance, last, poll
        )

    def counted(self, ask: Callable[[], T]) -> T:
        """What ``ask`` returns; the oracle counts by itself."""
        try:
            return ask()
        finally:
            self._held.clear()
            self._told.clear()

    def blocker_of(self, pair: int) -> str | None:
        """As of ``CompiledOracle``."""
        return self._blockers[pair]


class Counted(Protocol):
    """Returns what a function returns that asks compiled code: what that judges is counted, and limits hold."""

    def __call__(self, ask: Callable[[], T]) -> T: ...


class SearchOracle:
    """The checker with the padding of the search and a memory of free edges.

    It also counts free and colliding motions at the starts and goals, to report which of them is boxed in.

    Attributes:
        core: The same compiled, which answers. Whoever asks it does so within ``counted``.
        counted: Returns what a function returns that asks ``core``.
    """

    def __init__(
        self, checker: CollisionChecker, starts: Iterable[FloatArray] = (), goals: Iterable[FloatArray] = ()
    ) -> None:
        self._checker = checker
        self.core = checker.oracle([_tuple(q) for q in starts], [_tuple(q) for q in goals])
        self.counted: Counted = cast(Counted, partial(checker.counted, self.core))

    @property
    def states(self) -> int:
        """States that this thread has counted so far."""
        return self._checker.ledger.own.states

    @property
    def last_hit(self) -> EdgeHit | None:
        """The last collision found."""
        return self._checker.last_hit

    @property
    def blocker(self) -> str | None:
        """The obstacle of the last collision, ``SELF`` if it was a self-collision; None before the first."""
        hit = self._checker.last_hit
        return None if hit is None else self._obstacle(hit.b)

    def blocker_of(self, pair: int) -> str:
        """The same of a pair that ``core`` found to collide, by its number."""
        return self._obstacle(self._checker.parts.names[pair][1])

    def _obstacle(self, name: str) -> str:
        return name if name in self._obstacles else SELF

    @cached_property
    def _obstacles(self) -> frozenset[str]:
        return frozenset(obstacle.name for obstacle in self._checker.scene.obstacles)

    def state_is_free(self, q: State) -> bool:
        """Whether q (n,) is free with the padding of the search."""
        return self._checker.state_is_free(q)

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge is free with the padding of the search; a free edge is checked only once."""
        return self.counted(partial(self.core.edge_is_free, _tuple(q1), _tuple(q2), known._value_))

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision; ``edge_is_free`` judges the others."""
        return self.counted(partial(self.core.edge_is_free_coarse, q1, q2, known._value_))

    def edge_hit(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, None if free; a free edge is checked only once."""
        return None if self.edge_is_free(q1, q2, known=known) else self.last_hit

    def boxed_in(self) -> str:
        """Which ends no motion could leave, as the end of a sentence; empty if both could be left."""
        tried = zip(("start", "goal"), self.core.motions, strict=True)
        return "".join(
            f"; none of the {colliding} motions tried at the {end} was free: it is boxed in"
            for end, (free, colliding) in tried
            if colliding >= MIN_MOTIONS_BOXED_IN and not free
        )


class _Around:
    """An oracle around a ``SearchOracle``, which counts; its ``core`` answers.

    Attributes:
        inner: That oracle.
        core: As of ``SearchOracle``.
        counted: The same.
    """

    def __init__(self, inner: SearchOracle, core: _core.Oracle) -> None:
        self.inner, self.core, self.counted = inner, core, inner.counted

    @property
    def states(self) -> int:
        """States that this thread has counted so far."""
        return self.inner.states

    def blocker_of(self, pair: int) -> str:
        """As of ``SearchOracle``."""
        return self.inner.blocker_of(pair)

    def state_is_free(self, q: State) -> bool:
        """Whether q (n,) is free."""
        return self.counted(partial(self.core.state_is_free, _tuple(q)))

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge is free."""
        return self.counted(partial(self.core.edge_is_free, _tuple(q1), _tuple(q2), known._value_))

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision."""
        return self.counted(partial(self.core.edge_is_free_coarse, q1, q2, known._value_))


class TieredOracle(_Around):
    """An oracle with less padding near starts and goals that are closer to something than the padding of the rest.

    Args:
        roomy: Checks all other states, and edges beyond 0.2 rad from such a start or goal.
        tight: For each such start or goal the oracle of that state and of edges within 0.2 rad.
    """

    def __init__(self, roomy: SearchOracle, tight: Mapping[Configuration, SearchOracle]) -> None:
        self._tight = dict(tight)  # kept alive for ``core``
        cores = [(q, oracle.core) for q, oracle in tight.items()]
        super().__init__(roomy, load_core().TieredOracle(roomy.core, cores, NEAR_END))


class ConstrainedOracle(_Around):
    """What ``SearchOracle`` says, but an edge is free only if it keeps the constraints, too.

    Attributes:
        projector: Says which edges keep them.
    """

    core: _core.ConstrainedOracle

    def __init__(self, oracle: SearchOracle, projector: _core.Projector) -> None:
        self.projector = projector
        super().__init__(oracle, load_core().ConstrainedOracle(oracle.core, projector))

    def edge_hit(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, constraints aside; None if it does not."""
        return self.inner.edge_hit(q1, q2, known=known)

    def boxed_in(self) -> str:
        """As of ``SearchOracle``."""
        return self.inner.boxed_in()

    def keeps(self, q1: State, q2: State) -> bool:
        """Whether the edge keeps the constraints."""
        return self.projector.keeps(_tuple(q1), _tuple(q2))


def _tuple(q: State) -> Configuration:
    return q if isinstance(q, tuple) else tuple(q.tolist())


def _never() -> None:
    """The ``poll`` of a search without a time limit."""


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """Joint bounds and an oracle: the space in which a roadmap is grown.

    Attributes:
        lower: Smallest joint values, shape (n,).
        upper: Largest joint values, shape (n,), each above ``lower``.
        oracle: Checks states and edges.
        poll: Called often; raises when the time is up or the call is cancelled.
        reach: Cost of moving each joint, shape (n,), as ``Robot.reach``; None for the same cost for all.
    """

    lower: FloatArray
    upper: FloatArray
    oracle: Oracle
    poll: Callable[[], None] = _never
    reach: FloatArray | None = None

    def __post_init__(self) -> None:
        lower, upper = numbers("lower", self.lower, "joint values"), numbers("upper", self.upper, "joint values")
        _require_bounds(lower, upper)
        self.__dict__.update(lower=lower, upper=upper)


@dataclass(frozen=True, eq=False)
class SearchProblem:
    """One query. The caller has checked that the start and the goals are free.

    Attributes:
        start: Shape (n,), within the bounds.
        goals: Shape (k, n), k >= 1; reaching any of them solves the problem.
        lower: Smallest joint values, shape (n,).
        upper: Largest joint values, shape (n,), each above ``lower``.
        oracle: Checks states and edges.
        seed: At least 0. Equal problems with equal seeds have equal results.
        poll: Called often, even while nothing is checked; raises when the time is up or the call is cancelled.
        reach: Cost of moving each joint, shape (n,), as ``Robot.reach``; None for the same cost for all.
        grown: Called with the milestones (N, n) and edges of each tree that the search drops or ends with.
        projector: Keeps the constraints on edges; None without any.
        longest: Length that no path may have more of; a planner that cannot keep to it may return a longer one.

    Raises:
        InvalidRequest: Shapes disagree, or a number is not finite or outside the bounds.
    """

    start: FloatArray
    goals: FloatArray
    lower: FloatArray
    upper: FloatArray
    oracle: Oracle
    seed: int = 0
    poll: Callable[[], None] = _never
    reach: FloatArray | None = None
    grown: Callable[[FloatArray, list[tuple[int, int]]], None] | None = None
    projector: _core.Projector | None = None
    longest: float = math.inf

    def __post_init__(self) -> None:
        fields = (self.start, self.goals, self.lower, self.upper)
        names = ("start", "goals", "lower", "upper")
        start, goals, lower, upper = (numbers(name, q, "joint values") for name, q in zip(names, fields, strict=True))
        _require_bounds(lower, upper)
        if start.shape != lower.shape:
            raise InvalidRequest("start", start.tolist(), f"{lower.size} joint values")
        if goals.ndim != 2 or len(goals) == 0 or goals.shape[1] != lower.size:
            raise InvalidRequest("goals", goals.tolist(), f"at least one row of {lower.size} joint values")
        lows, highs = lower.tolist(), upper.tolist()
        for field, points in (("start", start[None]), ("goals", goals)):
            # A NaN fails both comparisons, so it is refused here too.
            if not all(low <= x <= high for q in points.tolist() for low, x, high in zip(lows, q, highs, strict=True)):
                expected = f"joint values within {lower.tolist()} and {upper.tolist()}"
                raise InvalidRequest(field, points.tolist(), expected)
        require_seed(self.seed)
        self.__dict__.update(start=start, goals=goals, lower=lower, upper=upper)


Space = SearchSpace | SearchProblem
"""What a roadmap is grown in: of a problem, all but its start and goals."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The path that a search found, if any.

    Attributes:
        waypoints: Shape (N, n), from the start to a goal, both to the last bit; each piece is an edge that the oracle
            found free. None without a path.
        goal_index: Which goal the path reaches; None without a path.
        note: How the search went, for the user.
        stopped: The limit that ended an anytime planner that had a path, or a roadmap query.
    """

    waypoints: FloatArray | None
    goal_index: int | None = None
    note: str = ""
    stopped: SearchStopped | None = None


class Planner(Protocol):
    """Searches for a path of free edges."""

    @property
    def name(self) -> str:
        """The name on the command line, in lower case."""

    @property
    def patience(self) -> int | None:
        """States to spend before a restart with another seed is worth more; None for no restarts."""

    def search(self, problem: SearchProblem) -> SearchResult:
        """A path, or a result without one.

        Exceptions of the oracle and of ``poll`` pass through, unless there is a path, or a roadmap that learned
        something, to return (``SearchResult.stopped``).
        """


def distances(points: FloatArray, q: FloatArray) -> FloatArray:
    """``joint_distance`` from each row of points (m, n) to q (n,), shape (m,)."""
    total = np.zeros(len(points))
    for column, value in zip(points.T, q, strict=True):
        total = total + (value - column) * (value - column)
    return np.asarray(np.sqrt(total))


def require_seed(seed: int) -> None:
    """Refuse a seed that is not a whole number of at least 0."""
    whole("seed", seed, 0, 2**128 - 1)


def _require_bounds(low: FloatArray, high: FloatArray) -> None:
    if low.ndim != 1 or low.size == 0 or low.shape != high.shape:
        raise InvalidRequest("lower", low.tolist(), "as many joint values as upper, at least one")
    if not all(-math.inf < a < b < math.inf for a, b in zip(low.tolist(), high.tolist(), strict=True)):
        raise InvalidRequest("upper", high.tolist(), f"finite joint values above {low.tolist()}")
