"""A joint value beyond its limits that would fit as degrees is answered by the radians that were probably meant."""

from __future__ import annotations

from pathlib import Path

from planner_service import PlannerService, PlanRequest, Scene, load_robot
from tests.support.optional import present

DESK_ARM = Path(__file__).parents[3] / "examples" / "desk_arm.urdf"
MEANT = "; if these are degrees, write [0.5236, 0.7854, -0.3491, 0.1745]"


def test_values_that_fit_as_degrees_are_answered_by_radians() -> None:
    for q, hint in [
        ([30.0, 45.0, -20.0, 10.0], MEANT),
        ([3.4, 0.0, 0.0, 0.0], ""),  # a little beyond is no degree
        ([30.0, 400.0, 0.0, 0.0], ""),  # neither fits
    ]:
        service = PlannerService(load_robot(DESK_ARM), Scene())
        home = service.robot.home
        for request in (PlanRequest(home, q), PlanRequest(q, home)):
            text = str(present(service.plan(request).failure))
            assert "is outside [" in text
            assert text.partition("]")[2] == hint
