"""The tree planners of most plans: small frozen dataclasses of settings with one method, ``search``.

``BalancedRRTConnect`` is our own, compiled (native/search/balanced.cpp); the others, and those of
``search/ompl_planners.py``, run OMPL's algorithm of the same name (Sucan, Moll & Kavraki, IEEE RAM 19(4), 2012) through
``search/ompl.py``.
Distances are L2 norms over the joints, in radians if all of them are revolute. Equal problems with equal seeds have
equal results.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from planner_service.geometry.validation import number, whole
from planner_service.native.loading import load_core
from planner_service.search.problem import SearchProblem, SearchResult, compiled

if TYPE_CHECKING:
    from planner_service.search import ompl

__all__ = [
    "RRT",
    "BalancedRRTConnect",
    "BiasedTree",
    "OmplSearch",
    "RRTConnect",
    "Settings",
    "Tree",
    "metric",
]

_WORD = 2**64 - 1

MIN_RANGE, MAX_RANGE = 1e-6, 1e6
"""Of edges: with shorter ones a search fills the memory before it gets anywhere, and a longer range is no bound."""

LEAST_REACH = 0.01
"""Of a joint in distances, as a share of the largest: one that moves nothing has to arrive at its goal too."""

_WHOLE = {
    "samples": (2, 100_000),
    "milestones": (2, 100_000),  # more of either take gigabytes
    "neighbours": (1, 100_000),
    "checks": (1, 2**31 - 1),
    "max_checks": (1, 2**31 - 1),
}
"""The smallest and largest values of the settings that are whole numbers."""

_SETTERS = {
    "range": "setRange",
    "goal_bias": "setGoalBias",
    "samples": "setSamplesPerBatch",
    "neighbours": "setMaxNearestNeighbors",
}
"""OMPL's setters for our settings."""


@dataclass(frozen=True)
class Settings:
    """The settings of a planner; a value that no planner can use is refused."""

    patience: ClassVar[int | None] = None

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in _WHOLE:
                least, most = _WHOLE[item.name]
                value = whole(item.name, value, least, most)
            else:
                low, high = (MIN_RANGE, MAX_RANGE) if item.name == "range" else (0.0, 1.0)
                value = number(item.name, value, f"a number from {low:g} to {high:g}", low, high)
            object.__setattr__(self, item.name, value)

    @property
    def for_ompl(self) -> dict[str, ompl.Setting]:
        """OMPL's setters and their arguments."""
        return {_SETTERS[item.name]: getattr(self, item.name) for item in fields(self) if item.name in _SETTERS}


@dataclass(frozen=True)
class OmplSearch(Settings):
    """A planner that OMPL runs until it has a path, or, if it has ``checks``, until so many states were checked."""

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        from planner_service.search import ompl  # 0.05 s

        return ompl.solve(problem, type(self).__name__, self.for_ompl, checks=getattr(self, "checks", None))


@dataclass(frozen=True)
class Tree(OmplSearch):
    """A planner that grows one or two trees with edges of at most ``range``; long searches are restarted."""

    range: float = 0.5
    patience: ClassVar[int | None] = 0


@dataclass(frozen=True)
class BiasedTree(Tree):
    """A planner that grows its tree towards a goal in the share ``goal_bias`` of its steps."""

    goal_bias: float = 0.05


@dataclass(frozen=True)
class BalancedRRTConnect(Tree):
    """The default: RRTConnect that always grows the smaller of its trees, with dynamic domains.

    Distances are weighted by how far a joint moves the body (``SearchProblem.reach``), scaled so that the longest one
    in the space is that of the joint values themselves; with constraints, or where no reach is known, they are not.

    Two trees grow, one from the start and one from all goals. The smaller one takes a step towards a random
    configuration, and the other then grows towards that step as far as it is free; that the smaller one grows is what
    keeps hard searches short (Kuffner & LaValle, CMU-RI-TR-05-34, 2005). A node that could not be extended is from then
    on extended only towards samples near it (Yershova, Jaillet, Simeon & LaValle, ICRA 2005). Of more than seven joints
    a step moves about seven, drawn anew each time: a step of all fourteen joints of two arms is seldom free.

    Most edges never become part of a path. So each is judged coarsely first, and in full only when the trees have met
    over it; one that collides then is cut off with all that grew from it.

    Where the length of the path is bounded (``SearchProblem.longest``), samples are drawn where such a path may go,
    each with a share of the length that is left, and the nearest node over which the way to it is no longer than that
    is extended: no node is added that such a path cannot have. Close to AORRTC (Wilson et al., arXiv 2505.10542).

    Attributes:
        range: Longest edge, in that distance (rad). Measured on public problems of arms of 6, 7, 8 and 14 joints,
            0.7 and 0.8 take the fewest states; 0.5 and 1.4 take up to a third more.
    """

    range: float = 0.7
    name: ClassVar[str] = "balancedrrtconnect"

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        start, goals = tuple(problem.start.tolist()), list(map(tuple, problem.goals.tolist()))
        seed = (problem.seed ^ problem.seed >> 64) & _WORD
        oracle, bounds = compiled(problem.oracle, problem.poll), (problem.lower.tolist(), problem.upper.tolist())
        weights = metric(problem)
        run = load_core().BalancedSearch(
            oracle.core, *bounds, weights, self.range, seed, problem.projector, problem.longest
        )
        try:
            path = oracle.counted(partial(run.run, start, goals))
        finally:
            if problem.grown is not None:
                milestones, edges = run.grown()
                problem.grown(np.array(milestones), edges)
        if not path:
            return SearchResult(waypoints=None)
        return SearchResult(waypoints=np.array(path), goal_index=goals.index(tuple(path[-1])))


def metric(problem: SearchProblem) -> list[float]:
    """The weight of each joint's squared difference in a squared distance, the same bits everywhere: its squared reach.

    They are scaled so that the longest distance between two configurations is as without them.
    """
    reach = () if problem.reach is None or problem.projector is not None else tuple(problem.reach.tolist())
    return list(_metric(tuple((problem.upper - problem.lower).tolist()), reach))


@lru_cache(maxsize=64)
def _metric(spans: tuple[float, ...], reach: tuple[float, ...]) -> list[float]:
    """The same of the sides of the space; one for all searches of a robot."""
    if not any(reach):
        return [1.0] * len(spans)
    least = LEAST_REACH * max(reach)
    squares = [max(r, least) * max(r, least) for r in reach]
    whole_space = math.fsum(span * span for span in spans)
    scale = whole_space / math.fsum(w * span * span for w, span in zip(squares, spans, strict=True))
    return [w * scale for w in squares]


@dataclass(frozen=True)
class RRTConnect(Tree):
    """OMPL's two trees that grow towards each other, quick to a first path (Kuffner & LaValle, ICRA 2000).

    Attributes:
        range: Longest edge, in joint distance (rad). Measured on the WidowX AI in six scenes, 0.7 to 1.0 take a fifth
            fewer states than 0.5; seven-joint arms in tighter scenes do better with 0.35 to 0.5. OMPL's own default, a
            fifth of the space, takes several times as many.
    """

    range: float = 0.7
    name: ClassVar[str] = "rrtconnect"


@dataclass(frozen=True)
class RRT(BiasedTree):
    """One tree from the start (LaValle & Kuffner, IJRR 20(5), 2001).

    Attributes:
        range: Longest edge, in joint distance (rad).
        goal_bias: Share of the samples that are a goal.
    """

    name: ClassVar[str] = "rrt"
