"""What keeps constraints passes them on, and what does not keep them refuses them: nothing ignores them."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from planner_service import (
    Attached,
    Cylinder,
    Handling,
    InvalidRequest,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    RRTConnect,
    Scene,
    TaskResult,
    inverse_kinematics,
)
from planner_service.constraints import KeepUpright
from planner_service.datasets.bin_task import BinPickPlace
from planner_service.datasets.episode import EpisodeWork
from planner_service.parallel import Processes
from planner_service.records.result import result_record

DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
UPRIGHT = KeepUpright((-1, 0, 0), 0.1)


@cache
def service() -> PlannerService:
    return PlannerService("wxai", "post")


def request(**changes: Any) -> PlanRequest:
    start = inverse_kinematics(service().robot, Pose((0.25, -0.2, 0.12), DOWN))[0]
    goal = Pose((0.25, 0.2, 0.12), DOWN)
    return PlanRequest(start, goal, **{"seed": 7, "time_limit": None, "constraints": [UPRIGHT], **changes})


@cache
def planned() -> PlanResult:
    return service().plan(request())


def without_seconds(result: PlanResult) -> Any:
    return {key: value for key, value in result_record(result).items() if key != "stages"}


# What keeps them.


def test_plans_of_many_requests_keep_them() -> None:
    found = service().plan_many([request(), request()], engine=Processes(2), progress=False)
    assert [without_seconds(each) for each in found] == [without_seconds(planned())] * 2
    assert found[0].counts.projections > 0
    assert [each.origin is not None and each.origin.request is not None for each in found] == [True, True]


# What refuses them.


@pytest.mark.parametrize("field", ["planner", "polish"])
def test_optimisers_refuse_them(field: str) -> None:
    with pytest.raises(InvalidRequest, match=f"{field}: got Optimise"):
        request(**{field: Optimise()})


def test_planners_of_ompl_refuse_them() -> None:
    with pytest.raises(InvalidRequest, match=r"planner: got RRTConnect.*as there are constraints"):
        request(planner=RRTConnect())


def test_roadmaps_refuse_them() -> None:
    with pytest.raises(InvalidRequest, match=r"planner: got .*as there are constraints"):
        request(planner=service().path_memory())


def test_a_planner_that_keeps_none_does_not_carry_what_is_to_stay_upright() -> None:
    carried = Attached("cup", Cylinder(0.03, 0.1), Pose(), constraints=(UPRIGHT,))
    carrying = PlannerService("wxai", Scene(attached=(carried,)))
    asked = request(planner=RRTConnect(), constraints=())
    with pytest.raises(InvalidRequest, match=r"planner: got RRTConnect.*as there are constraints \(upright\)"):
        carrying.plan(asked)
    with pytest.raises(InvalidRequest, match=r"planner: got RRTConnect.*as there are constraints \(upright\)"):
        Handling(upright=0.1, request=asked)


def test_a_motion_is_not_replanned_with_something_that_is_to_stay_upright() -> None:
    carried = Attached("cup", Cylinder(0.03, 0.1), Pose((0.0, 0.0, 0.3)), constraints=(UPRIGHT,))
    with pytest.raises(InvalidRequest, match=r"scene: got 'something carried with constraints \(upright\)'"):
        service().replan(planned(), at_time=0.1, scene=service().scene.with_attached(carried))


class UprightTask(BinPickPlace):
    """A task of one's own that asks for constraints."""

    def solve(self, service: PlannerService, drawn: Any, request: PlanRequest) -> TaskResult:
        solved = super().solve(service, drawn, request)
        return replace(solved, request=replace(request, constraints=[UPRIGHT]))


def test_a_data_set_refuses_motions_that_keep_them() -> None:
    work = EpisodeWork(service().robot, UprightTask(), seed=0, chunk=10)
    with pytest.raises(InvalidRequest, match=r"task: got 'a motion with constraints \(upright\)'; expected none"):
        work(0)
