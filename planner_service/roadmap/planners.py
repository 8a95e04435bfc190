"""The roadmap planners: settings that grow a ``Roadmap``, and search it.

PRM and PRMstar run OMPL's algorithm of the same name (Sucan, Moll & Kavraki, IEEE RAM 19(4), 2012); LazyPRM is ours.
Equal problems, seeds included, have equal results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planner_service.concurrency.polling import waited
from planner_service.roadmap.roadmap import Roadmap, RoadmapSearchResult
from planner_service.search import ompl
from planner_service.search.planners import Settings
from planner_service.search.problem import SearchProblem, Space, require_seed

__all__ = ["PRM", "LazyPRM", "PRMstar", "Progress"]

Progress = Callable[[int, int], None]

_AT_ONCE = 20_000
"""Neighbours that are looked up between two looks at the clock."""


class _Grown(Settings):
    """A planner that grows a roadmap, up to so many ``milestones`` and at most ``max_checks`` states."""

    milestones: int
    max_checks: int

    def grow(self, space: Space, *, seed: int = 0, progress: Progress | None = None) -> Roadmap:
        """A roadmap of ``space``: milestones that joined to nothing are left out.

        Args:
            progress: Told now and then how many milestones there are, and how many are wanted.

        Raises:
            InvalidRequest: ``seed`` is not a whole number of at least 0. What the oracle and
                ``poll`` raise comes out unchanged.
        """
        require_seed(seed)
        size = (self.milestones, self.max_checks)
        found = ompl.grow(space, type(self).__name__, self._settings(), size=size, seed=seed, progress=progress)
        return Roadmap.judged(found.milestones, found.free, found.blocked, reach=space.reach)

    def search(self, problem: SearchProblem) -> RoadmapSearchResult:
        """Grow a roadmap for this one query, and query it; see ``Planner``."""
        return self.grow(problem, seed=problem.seed).search(problem)

    def _settings(self) -> dict[str, ompl.Setting]:
        return {}


@dataclass(frozen=True)
class PRM(_Grown):
    """A roadmap of the whole free space, for many queries (Kavraki et al., IEEE T-RA 12(4), 1996).

    Attributes:
        milestones: Free configurations sampled.
        neighbours: Nearest milestones each is joined to where the edge is free.
        max_checks: States after which growing ends with fewer milestones.
    """

    milestones: int = 1000
    neighbours: int = 10
    max_checks: int = 2_000_000
    name: ClassVar[str] = "prm"

    def _settings(self) -> dict[str, ompl.Setting]:
        return {"setMaxNearestNeighbors": self.neighbours}


@dataclass(frozen=True)
class PRMstar(_Grown):
    """PRM whose number of neighbours grows with the roadmap, for ever shorter paths (Karaman & Frazzoli, 2011).

    Attributes:
        milestones: Free configurations sampled.
        max_checks: States after which growing ends with fewer milestones.
    """

    milestones: int = 1000
    max_checks: int = 2_000_000
    name: ClassVar[str] = "prmstar"


@dataclass(frozen=True)
class LazyPRM(Settings):
    """A roadmap of which nothing is judged before a path needs it (Bohlin & Kavraki, ICRA 2000).

    Of its milestones, drawn uniformly, each is joined to those nearest by the robot's motion, whatever lies between.

    Attributes:
        milestones: Configurations sampled.
        neighbours: Nearest milestones each is joined to.
    """

    milestones: int = 1000
    neighbours: int = 10
    name: ClassVar[str] = "lazyprm"

    def grow(self, space: Space, *, seed: int = 0, progress: Progress | None = None) -> Roadmap:
        """A roadmap of ``space`` of which nothing is known; no state is judged, which takes no time worth telling of.

        Raises:
            InvalidRequest: ``seed`` is not a whole number of at least 0.
        """
        from scipy.spatial import cKDTree

        require_seed(seed)
        lower, span = space.lower, space.upper - space.lower
        points = lower + span * np.random.default_rng(seed).random((self.milestones, lower.size))
        scaled = points if space.reach is None else points * space.reach
        tree, blocks, most = cKDTree(scaled), list[NDArray[np.intp]](), min(self.neighbours + 1, self.milestones)
        many = max(1, _AT_ONCE // most)
        for start in range(0, self.milestones, many):
            space.poll()
            rows = scaled[start : start + many]
            near = tree.query(rows, k=most, p=1)[1]
            ends = np.repeat(np.arange(start, start + len(rows)), near.shape[1])
            blocks.append(np.stack([ends, near.ravel()], axis=1)[ends != near.ravel()])
        return waited(lambda: Roadmap.of(points, np.concatenate(blocks), reach=space.reach))

    def search(self, problem: SearchProblem) -> RoadmapSearchResult:
        """Grow a roadmap for this one query, and query it; see ``Planner``."""
        return self.grow(problem, seed=problem.seed).search(problem)
