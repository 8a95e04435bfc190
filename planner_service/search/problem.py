"""A search problem, its oracle and its result, as all planners share them.

A planner knows neither robot nor scene, only joint bounds and an oracle that checks configurations and edges and
counts its checks. Tests use discs in a plane instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner_service.collision.budget import SearchStopped
from planner_service.collision.edge_sampling import Known
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, all_read_only
from planner_service.geometry.validation import whole

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = [
    "SELF",
    "CoarseOracle",
    "Configuration",
    "Oracle",
    "Planner",
    "SearchProblem",
    "SearchResult",
    "SearchSpace",
    "Space",
    "distances",
    "of_tuples",
    "require_seed",
]

SELF = ""
"""Takes the place of an obstacle's name where the robot collides with itself or with what it carries."""

Configuration = tuple[float, ...]


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
        lower, upper = all_read_only(self.lower, self.upper)
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

    def __post_init__(self) -> None:
        start, goals, lower, upper = all_read_only(self.start, self.goals, self.lower, self.upper)
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
