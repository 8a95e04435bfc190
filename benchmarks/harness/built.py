"""Planners as a run asks them, some of which are built first: a roadmap, once for each scene and seed."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import lru_cache

from benchmarks.harness.report import Row
from benchmarks.harness.suite import ROADMAP, grower_of, planner_of
from planner_service import PlannerService, Roadmap
from planner_service.errors import BrokenInvariant
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import Planner, SearchProblem

__all__ = ["Ready", "ready"]

KEPT = 64
"""Roadmaps at a time: rows come problem by problem, so that those of a scene are asked one after the other."""


@dataclass(frozen=True, eq=False)
class Ready:
    """A planner, and what a row says about building it: nothing if it is not built."""

    planner: Planner
    told: Row = field(default_factory=dict)


def ready(service: PlannerService, text: str, seed: int) -> Ready:
    """The planner that a text names; a roadmap is grown with the row's seed, unless that was done for this service."""
    if text.partition(":")[0] != ROADMAP:
        return Ready(planner_of(text))
    return _built(service, text, seed)


@lru_cache(maxsize=KEPT)
def _built(service: PlannerService, text: str, seed: int) -> Ready:
    clock = time.process_time()
    roadmap = service.build_roadmap(grower_of(text), seed=seed, progress=False)
    _ask_once(service, roadmap)
    if roadmap.built is None:
        raise BrokenInvariant("a roadmap that was built does not say how")
    size = {"milestones": len(roadmap.milestones), "joined": len(roadmap.edges)}
    return Ready(roadmap, {"built": {**roadmap.built.counts.named, **size, "cpu_seconds": time.process_time() - clock}})


def _ask_once(service: PlannerService, roadmap: Roadmap) -> None:
    """A query for nobody: what a roadmap works out once for all of them is not the first one's cost."""
    home, limits = service.robot.home, service.robot.limits
    oracle = SearchOracle(service.checker.variant(padding=0.0))
    roadmap.search(SearchProblem(home, home[None], limits.lower, limits.upper, oracle, reach=service.checker.reach))
