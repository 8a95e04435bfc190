"""Ways round what stands between an arm at rest and where it is to be, as targets that a gate can judge."""

from __future__ import annotations

from collections.abc import Iterator

from planner_service.geometry.arrays import FloatArray
from planner_service.planning.request import PlanRequest
from planner_service.service import PlannerService

__all__ = ["ways_round"]

PADDINGS = (0.03, 0.01)
"""Metres that a plan keeps from everything: as much as the arm may need room, or what there is."""

MAX_CHECKS = 20_000
"""States that one plan may check; most need some hundreds. With 5,000 some ways are twice as long."""


def ways_round(
    service: PlannerService, start: FloatArray, end: FloatArray, rate: float, *, speed: float, acceleration: float
) -> Iterator[FloatArray]:
    """Targets (k, n), one each period, of plans for an arm at rest, the roomiest first.

    What a plan may cost is counted, not timed: the same request gives the same ways on every machine.

    Args:
        service: Plans.
        rate: Targets a second.
        speed: Part of the limits of velocity that plans use.
        acceleration: The same of the limits of acceleration.
    """
    for padding in PADDINGS:
        request = PlanRequest(
            start,
            end,
            padding=padding,
            velocity_scale=speed,
            acceleration_scale=acceleration,
            max_checks=MAX_CHECKS,
            time_limit=None,
        )
        result = service.plan(request)
        if result.trajectory is not None:
            yield result.trajectory.sample(1.0 / rate).q[1:]
