"""The best of several plans: each way round has an optimum of its own, and a seed finds one way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import instance, items
from planner_service.parallel import Engine, Sequential
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.service import PlannerService

__all__ = ["best_of_seeds", "plan_seeds"]

MAX_SEEDS = 100_000

LACKING = 1e-3
"""Metres of distance, summed over a curve, by which two that lack some are not told apart."""


def best_of_seeds(
    service: PlannerService, request: PlanRequest, seeds: Sequence[int], *, engine: Engine | None = None
) -> PlanResult:
    """The best plan of a request with any of some seeds: that lacks least distance, and of such the fastest.

    Without a plan it is the first failure. Ties go to the seed that comes first, whatever the engine.

    Args:
        engine: As for ``plan_seeds``.

    Raises:
        InvalidRequest: no seeds, or one that is none.
    """
    found = plan_seeds(service, request, seeds, engine=engine)
    return min(found, key=_worth)


def plan_seeds(
    service: PlannerService, request: PlanRequest, seeds: Sequence[int], *, engine: Engine | None = None
) -> tuple[PlanResult, ...]:
    """The plans of a request with some seeds, in their order.

    Args:
        engine: As for ``service.plan_many``; if not given they are planned one after the other in this process, which
            takes less time than to start others unless plans take some tenths of a second.

    Raises:
        InvalidRequest: no seeds, or one that is none.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, PlanRequest, "a PlanRequest")
    given = items("seeds", seeds, object, "at least one, in a list", MAX_SEEDS)
    if not given:
        raise InvalidRequest("seeds", seeds, "at least one, in a list")
    requests = [replace(request, seed=seed) for seed in given]  # type: ignore[arg-type]
    return tuple(service.plan_many(requests, engine=Sequential() if engine is None else engine, progress=False))


def _worth(result: PlanResult) -> tuple[float, ...]:
    """Smaller is better."""
    if result.motion is None:
        return (1.0,)
    report = result.polish
    lacking = 0.0 if report is None else (report.after if report.kept else report.before).shortfall
    return 0.0, math.floor(lacking / LACKING), result.motion.duration
