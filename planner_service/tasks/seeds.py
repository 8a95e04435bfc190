"""The best plan of several seeds: each way around an obstacle has an optimum of its own, and a seed finds one way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from planner_service.errors import InvalidRequest
from planner_service.geometry.validation import instance, items
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.service import PlannerService

if TYPE_CHECKING:
    from planner_service.parallel import Engine

__all__ = ["best_of_seeds", "plan_seeds"]

MAX_SEEDS = 100_000

SAME_SHORTFALL = 1e-3
"""Metres of missing clearance, summed over a curve, up to which two curves count as equally good."""


def best_of_seeds(
    service: PlannerService, request: PlanRequest, seeds: Sequence[int], *, engine: Engine | None = None
) -> PlanResult:
    """The best plan of a request over several seeds: the one with the least missing clearance, then the fastest.

    Without a plan it is the first failure. Ties go to the seed that comes first, whatever the engine.

    Args:
        engine: As for ``plan_seeds``.

    Raises:
        InvalidRequest: There are no seeds, or one is not a seed.
    """
    return min(plan_seeds(service, request, seeds, engine=engine), key=_worth)


def plan_seeds(
    service: PlannerService, request: PlanRequest, seeds: Sequence[int], *, engine: Engine | None = None
) -> tuple[PlanResult, ...]:
    """The plans of a request with each of several seeds, in their order.

    Args:
        engine: As for ``service.plan_many``. If not given, they are planned one after the other in this process: that
            is faster than starting others unless a plan takes some tenths of a second.

    Raises:
        InvalidRequest: There are no seeds, or one is not a seed.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, PlanRequest, "a PlanRequest")
    given = items("seeds", seeds, object, "at least one, in a list", MAX_SEEDS)
    if not given:
        raise InvalidRequest("seeds", seeds, "at least one, in a list")
    requests = [replace(request, seed=seed) for seed in given]  # type: ignore[arg-type]
    from planner_service.parallel import Sequential

    return tuple(service.plan_many(requests, engine=Sequential() if engine is None else engine, progress=False))


def _worth(result: PlanResult) -> tuple[float, ...]:
    """Smaller is better."""
    if result.motion is None:
        return (1.0,)
    report = result.polish
    shortfall = 0.0 if report is None else (report.after if report.kept else report.before).shortfall
    return 0.0, math.floor(shortfall / SAME_SHORTFALL), result.motion.duration
