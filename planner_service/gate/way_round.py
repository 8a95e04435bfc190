"""A way round what stands between an arm and where a chunk ends, as targets that a gate can judge."""

from __future__ import annotations

from collections.abc import Iterator

from planner_service.geometry.arrays import FloatArray
from planner_service.planning.request import PlanRequest
from planner_service.service import PlannerService

__all__ = ["ways_round"]

PADDINGS = (0.03, 0.01)
"""Metres that a plan keeps from everything: as much as the arm may need room, or what there is."""

MAX_CHECKS = 5_000
"""States that one plan may check; most need some hundreds, and thousands take tens of milliseconds."""

SPEED = 0.8
"""Part of the limits of velocity that plans use: the room that a late target costs needs some."""


def ways_round(
    service: PlannerService, start: FloatArray, end: FloatArray, rate: float, acceleration_scale: float
) -> Iterator[FloatArray]:
    """Targets (k, n), one each period, of plans from an arm at rest to where a chunk ends, the roomiest first.

    Args:
        service: Plans.
        rate: Targets a second.
        acceleration_scale: Part of the limits of acceleration that plans use.
    """
    for padding in PADDINGS:
        request = PlanRequest(
            start,
            end,
            padding=padding,
            velocity_scale=SPEED,
            acceleration_scale=acceleration_scale,
            max_checks=MAX_CHECKS,
        )
        result = service.plan(request)
        if result.trajectory is not None:
            yield result.trajectory.sample(1.0 / rate).q[1:]
