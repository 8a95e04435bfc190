"""The roadmap planners: settings that grow a ``Roadmap`` and search it.

PRM and PRMstar run OMPL's algorithm of the same name (Sucan, Moll & Kavraki, IEEE RAM 19(4), 2012); LazyPRM is ours.
Equal problems, seeds included, have equal results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner_service.concurrency.polling import waited
from planner_service.geometry.arrays import IntArray
from planner_service.roadmap.roadmap import Roadmap, RoadmapSearchResult
from planner_service.search.planners import Settings
from planner_service.search.problem import SearchProblem, Space, require_seed

__all__ = ["PRM", "LazyPRM", "PRMstar", "Progress"]

Progress = Callable[[int, int], None]

_NEIGHBOURS_PER_POLL = 20_000
"""Neighbours looked up between two polls."""


class _Grown(Settings):
    """A planner that grows a roadmap of ``milestones``, checking at most ``max_checks`` states."""

    milestones: int
    max_checks: int

    def grow(self, space: Space, *, seed: int = 0, progress: Progress | None = None) -> Roadmap:
        """Grow a roadmap of ``space``, without milestones that no edge joins.

        Args:
            progress: Called now and then with the number of milestones so far and the number wanted.

        Raises:
            InvalidRequest: ``seed`` is not a whole number of at least 0. What the oracle and ``poll`` raise passes
                through.
        """
        from planner_service.search import ompl  # 0.05 s

        require_seed(seed)
        size = (self.milestones, self.max_checks)
        grown = ompl.grow(space, type(self).__name__, self.for_ompl, size=size, seed=seed, progress=progress)
        return Roadmap.judged(grown.milestones, grown.free, grown.blocked, reach=space.reach)

    def search(self, problem: SearchProblem) -> RoadmapSearchResult:
        """Grow a roadmap for this query alone, and search it; see ``Planner``."""
        return self.grow(problem, seed=problem.seed).search(problem)


@dataclass(frozen=True)
class PRM(_Grown):
    """A roadmap of the whole free space, for many queries (Kavraki et al., IEEE T-RA 12(4), 1996).

    Attributes:
        milestones: Free configurations sampled.
        neighbours: Nearest milestones to which each is joined where the edge is free.
        max_checks: States after which growing stops, with fewer milestones.
    """

    milestones: int = 1000
    neighbours: int = 10
    max_checks: int = 2_000_000
    name: ClassVar[str] = "prm"


@dataclass(frozen=True)
class PRMstar(_Grown):
    """PRM whose number of neighbours grows with the roadmap, for ever shorter paths (Karaman & Frazzoli, 2011).

    Attributes:
        milestones: Free configurations sampled.
        max_checks: States after which growing stops, with fewer milestones.
    """

    milestones: int = 1000
    max_checks: int = 2_000_000
    name: ClassVar[str] = "prmstar"


@dataclass(frozen=True)
class LazyPRM(Settings):
    """A roadmap whose milestones and edges are checked only when a path needs them (Bohlin & Kavraki, ICRA 2000).

    Its milestones are drawn uniformly; each is joined to the nearest others by the robot's motion, unchecked.

    Attributes:
        milestones: Configurations sampled.
        neighbours: Nearest milestones to which each is joined.
    """

    milestones: int = 1000
    neighbours: int = 10
    name: ClassVar[str] = "lazyprm"

    def grow(self, space: Space, *, seed: int = 0, progress: Progress | None = None) -> Roadmap:
        """Grow a roadmap of ``space`` without any check; ``progress`` is ignored.

        Raises:
            InvalidRequest: ``seed`` is not a whole number of at least 0.
        """
        from scipy.spatial import cKDTree

        require_seed(seed)
        lower, span = space.lower, space.upper - space.lower
        points = lower + span * np.random.default_rng(seed).random((self.milestones, lower.size))
        scaled = points if space.reach is None else points * space.reach
        tree, blocks, most = cKDTree(scaled), list[IntArray](), min(self.neighbours + 1, self.milestones)
        many = max(1, _NEIGHBOURS_PER_POLL // most)
        for start in range(0, self.milestones, many):
            space.poll()
            rows = scaled[start : start + many]
            near = tree.query(rows, k=most, p=1)[1]
            ends = np.repeat(np.arange(start, start + len(rows)), near.shape[1])
            blocks.append(np.stack([ends, near.ravel()], axis=1)[ends != near.ravel()])
        return waited(lambda: Roadmap.of(points, np.concatenate(blocks), reach=space.reach))

    def search(self, problem: SearchProblem) -> RoadmapSearchResult:
        """Grow a roadmap for this query alone, and search it; see ``Planner``."""
        return self.grow(problem, seed=problem.seed).search(problem)
