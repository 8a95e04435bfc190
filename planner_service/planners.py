"""The planners: small frozen settings with one verb, ``search``.

All but ``Roadmap`` run OMPL's algorithm of the same name (Sucan, Moll & Kavraki, IEEE RAM 19(4),
2012); ``ompl_bridge`` does that. Distances are L2 norms over the joints, in radians where they
all revolve. Equal problems, seeds included, have equal results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from planner_service import ompl_bridge
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.roadmap import Roadmap
from planner_service.search import (
    Oracle,
    Planner,
    SearchProblem,
    SearchResult,
    SearchSpace,
    Space,
    require_seed,
)

__all__ = [
    "AORRTC",
    "BFMT",
    "BKPIECE1",
    "FMT",
    "KPIECE1",
    "LBKPIECE1",
    "PLANNERS",
    "PRM",
    "RRT",
    "BITstar",
    "InformedRRTstar",
    "Oracle",
    "PRMstar",
    "Planner",
    "RRTConnect",
    "RRTstar",
    "Roadmap",
    "SORRTstar",
    "SearchProblem",
    "SearchResult",
    "SearchSpace",
    "Space",
    "planner_by_name",
]

_DEFAULT_CHECKS = 20_000
"""States after which an anytime planner stops improving: about ten times what a first path costs."""


def _positive(planner: Any, field: str) -> None:
    value = getattr(planner, field)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
        raise InvalidRequest(field, value, "a positive number")


def _share(planner: Any, field: str) -> None:
    value = getattr(planner, field)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise InvalidRequest(field, value, "a number from 0 to 1")


def _whole(planner: Any, field: str, least: int = 1) -> None:
    value = getattr(planner, field)
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**31:
        raise InvalidRequest(field, value, f"a whole number of at least {least}")


@dataclass(frozen=True)
class RRTConnect:
    """Two trees that grow towards each other: the default, quick to a first path (Kuffner & LaValle, ICRA 2000).

    Attributes:
        range: Longest edge, in joint distance (rad). Measured on the WidowX AI among six scenes, 0.7 to 1.0 cost a
            fifth fewer states than 0.5; seven-joint arms in tighter scenes favour 0.35 to 0.5. OMPL's own default, a
            fifth of the space, is several times dearer.
    """

    range: float = 0.7
    name: ClassVar[str] = "rrtconnect"

    def __post_init__(self) -> None:
        _positive(self, "range")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "RRTConnect", {"setRange": self.range})


@dataclass(frozen=True)
class RRT:
    """One tree from the start (LaValle & Kuffner, IJRR 20(5), 2001).

    Attributes:
        range: Longest edge.
        goal_bias: Share of the samples that are a goal.
    """

    range: float = 0.5
    goal_bias: float = 0.05
    name: ClassVar[str] = "rrt"

    def __post_init__(self) -> None:
        _positive(self, "range")
        _share(self, "goal_bias")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "RRT", {"setRange": self.range, "setGoalBias": self.goal_bias})


@dataclass(frozen=True)
class RRTstar:
    """One tree that is rewired for ever shorter paths (Karaman & Frazzoli, IJRR 30(7), 2011).

    Attributes:
        range: Longest edge of the tree before rewiring.
        goal_bias: Share of the samples that are a goal.
        checks: States after which it ends with its best path; without one it goes on.
    """

    range: float = 0.5
    goal_bias: float = 0.05
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "rrtstar"

    def __post_init__(self) -> None:
        _positive(self, "range")
        _share(self, "goal_bias")
        _whole(self, "checks")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        settings = {"setRange": self.range, "setGoalBias": self.goal_bias}
        return ompl_bridge.solve(problem, "RRTstar", settings, checks=self.checks)


@dataclass(frozen=True)
class InformedRRTstar:
    """RRTstar that samples only where a shorter path may run (Gammell, Srinivasa & Barfoot, IROS 2014).

    Attributes:
        range: Longest edge of the tree before rewiring.
        goal_bias: Share of the samples that are a goal.
        checks: States after which it ends with its best path; without one it goes on.
    """

    range: float = 0.5
    goal_bias: float = 0.05
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "informedrrtstar"

    def __post_init__(self) -> None:
        _positive(self, "range")
        _share(self, "goal_bias")
        _whole(self, "checks")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        settings = {"setRange": self.range, "setGoalBias": self.goal_bias}
        return ompl_bridge.solve(problem, "InformedRRTstar", settings, checks=self.checks)


@dataclass(frozen=True)
class SORRTstar:
    """InformedRRTstar over batches sorted by promise (Gammell, Barfoot & Srinivasa, IEEE T-RO 34(4), 2018).

    Attributes:
        range: Longest edge of the tree before rewiring.
        goal_bias: Share of the samples that are a goal.
        checks: States after which it ends with its best path; without one it goes on.
    """

    range: float = 0.5
    goal_bias: float = 0.05
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "sorrtstar"

    def __post_init__(self) -> None:
        _positive(self, "range")
        _share(self, "goal_bias")
        _whole(self, "checks")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        settings = {"setRange": self.range, "setGoalBias": self.goal_bias}
        return ompl_bridge.solve(problem, "SORRTstar", settings, checks=self.checks)


@dataclass(frozen=True)
class BITstar:
    """Batches of samples searched best first, edges judged only on promising paths (Gammell et al., IJRR 39(5), 2020).

    Attributes:
        samples: Samples per batch.
        checks: States after which it ends with its best path; without one it goes on.
    """

    samples: int = 100
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "bitstar"

    def __post_init__(self) -> None:
        _whole(self, "samples")
        _whole(self, "checks")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "BITstar", {"setSamplesPerBatch": self.samples}, checks=self.checks)


@dataclass(frozen=True)
class AORRTC:
    """RRTConnect repeated with a shrinking bound on the path's length (Wilson et al., arXiv 2505.10542).

    Attributes:
        range: Longest edge.
        checks: States after which it ends with its best path; without one it goes on. OMPL's own
            shortening of a path is not interrupted and may add a few thousand.
    """

    range: float = 0.5
    checks: int = _DEFAULT_CHECKS
    name: ClassVar[str] = "aorrtc"

    def __post_init__(self) -> None:
        _positive(self, "range")
        _whole(self, "checks")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "AORRTC", {"setRange": self.range}, checks=self.checks)


@dataclass(frozen=True)
class FMT:
    """A tree marching through one batch of samples in order of cost (Janson et al., IJRR 34(7), 2015).

    Goals are tried in order; when all fail, the batch is doubled.

    Attributes:
        samples: Free samples of the first batch. Its edges are long: with six joints 100 samples
            cost some 30,000 states, 1000 five times as many.
    """

    samples: int = 100
    name: ClassVar[str] = "fmt"

    def __post_init__(self) -> None:
        _whole(self, "samples", least=2)

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve_in_batches(problem, "FMT", self.samples)


@dataclass(frozen=True)
class BFMT:
    """FMT from both ends at once (Starek et al., IROS 2015).

    Goals are tried in order; when all fail, the batch is doubled.

    Attributes:
        samples: Free samples of the first batch. Its edges are long: with six joints 100 samples
            cost some 30,000 states, 1000 five times as many.
    """

    samples: int = 100
    name: ClassVar[str] = "bfmt"

    def __post_init__(self) -> None:
        _whole(self, "samples", least=2)

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve_in_batches(problem, "BFMT", self.samples)


@dataclass(frozen=True)
class KPIECE1:
    """One tree that grows where a grid of its projection is least covered (Sucan & Kavraki, WAFR 2008).

    Attributes:
        range: Longest edge.
        goal_bias: Share of the extensions that aim at a goal.
    """

    range: float = 0.5
    goal_bias: float = 0.05
    name: ClassVar[str] = "kpiece1"

    def __post_init__(self) -> None:
        _positive(self, "range")
        _share(self, "goal_bias")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "KPIECE1", {"setRange": self.range, "setGoalBias": self.goal_bias})


@dataclass(frozen=True)
class BKPIECE1:
    """KPIECE1 from both ends at once.

    Attributes:
        range: Longest edge.
    """

    range: float = 0.5
    name: ClassVar[str] = "bkpiece1"

    def __post_init__(self) -> None:
        _positive(self, "range")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "BKPIECE1", {"setRange": self.range})


@dataclass(frozen=True)
class LBKPIECE1:
    """BKPIECE1 that judges an edge only once a path needs it.

    Attributes:
        range: Longest edge.
    """

    range: float = 0.5
    name: ClassVar[str] = "lbkpiece1"

    def __post_init__(self) -> None:
        _positive(self, "range")

    def search(self, problem: SearchProblem) -> SearchResult:
        """See ``Planner``."""
        return ompl_bridge.solve(problem, "LBKPIECE1", {"setRange": self.range})


@dataclass(frozen=True)
class PRM:
    """A roadmap of the whole free space, for many queries (Kavraki et al., IEEE T-RA 12(4), 1996).

    Attributes:
        milestones: Free configurations sampled.
        neighbours: Nearest milestones each is joined to where the edge is free; also those that a
            query tries at its ends.
        max_checks: States after which growing ends with fewer milestones.
    """

    milestones: int = 1000
    neighbours: int = 10
    max_checks: int = 2_000_000
    name: ClassVar[str] = "prm"

    def __post_init__(self) -> None:
        _whole(self, "milestones", least=2)
        _whole(self, "neighbours")
        _whole(self, "max_checks")

    def grow(self, space: Space, *, seed: int = 0) -> Roadmap:
        """A roadmap of ``space``: milestones that joined to nothing are left out.

        Raises:
            InvalidRequest: ``seed`` is not a whole number of at least 0. What the oracle and
                ``poll`` raise comes out unchanged.
        """
        require_seed(seed)
        settings: dict[str, ompl_bridge.Setting] = {"setMaxNearestNeighbors": self.neighbours}
        size = (self.milestones, self.max_checks)
        points, edges = ompl_bridge.grow(space, "PRM", settings, size=size, seed=seed)
        return Roadmap(points, edges, neighbours=self.neighbours)

    def search(self, problem: SearchProblem) -> SearchResult:
        """Grow a roadmap for this one query, and query it; see ``Planner``."""
        return self.grow(problem, seed=problem.seed).search(problem, trusted=True)


@dataclass(frozen=True)
class PRMstar:
    """PRM whose number of neighbours grows with the roadmap, for ever shorter paths (Karaman & Frazzoli, 2011).

    Attributes:
        milestones: Free configurations sampled.
        neighbours: Nearest milestones that a query tries at its ends.
        max_checks: States after which growing ends with fewer milestones.
    """

    milestones: int = 1000
    neighbours: int = 10
    max_checks: int = 2_000_000
    name: ClassVar[str] = "prmstar"

    def __post_init__(self) -> None:
        _whole(self, "milestones", least=2)
        _whole(self, "neighbours")
        _whole(self, "max_checks")

    def grow(self, space: Space, *, seed: int = 0) -> Roadmap:
        """See ``PRM.grow``."""
        require_seed(seed)
        points, edges = ompl_bridge.grow(space, "PRMstar", {}, size=(self.milestones, self.max_checks), seed=seed)
        return Roadmap(points, edges, neighbours=self.neighbours)

    def search(self, problem: SearchProblem) -> SearchResult:
        """Grow a roadmap for this one query, and query it; see ``Planner``."""
        return self.grow(problem, seed=problem.seed).search(problem, trusted=True)


PLANNERS: Mapping[str, type[Any]] = MappingProxyType(
    {
        planner.name: planner
        for planner in (
            RRTConnect,
            RRT,
            RRTstar,
            InformedRRTstar,
            SORRTstar,
            BITstar,
            AORRTC,
            FMT,
            BFMT,
            KPIECE1,
            BKPIECE1,
            LBKPIECE1,
            PRM,
            PRMstar,
        )
    }
)
"""Every planner that can be made from its name alone, by that name."""


def planner_by_name(name: str) -> Planner:
    """The planner of that name (any case) with its default settings.

    Raises:
        UnknownName: there is none; the message offers the nearest.
    """
    try:
        planner: Planner = PLANNERS[name.lower()]()
    except KeyError:
        raise UnknownName("planner", name, PLANNERS) from None
    return planner
