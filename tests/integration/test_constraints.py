"""Plans under constraints: what is checked first, what is proven, and what failures say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner_service import (
    BalancedRRTConnect,
    InvalidRequest,
    Optimise,
    PlannerService,
    PlanRequest,
    Pose,
    RRTConnect,
    load_robot,
)
from planner_service.constraints import Constraint, JointRange, KeepUpright, OnPlane
from planner_service.kinematics.constraint_set import ConstraintSet
from planner_service.kinematics.projection import projector_of
from planner_service.planning.result import Reason, Stage
from planner_service.scene.loading import load_scene
from planner_service.timing.laws import SCurve, Trapezoidal
from tests.support.constraints import CASES, kept_configurations
from tests.support.optional import present

UPRIGHT = KeepUpright((-1.0, 0.0, 0.0), 0.1)
SCENES = {"upright": "bin", "narrow": "shelf"}


def asked(name: str, seed: int) -> tuple[PlannerService, PlanRequest]:
    """A service, and a request between two configurations that keep the constraints of a case."""
    robot, constraints = load_robot(CASES[name][0]), CASES[name][1]
    service = PlannerService(robot, load_scene(SCENES.get(name, "empty")))
    resolved = ConstraintSet(robot, constraints)
    start, goal = kept_configurations(resolved, projector_of(resolved), service.checker, seed)
    return service, PlanRequest(start, goal, seed=seed, constraints=constraints)


@pytest.mark.parametrize("name", ["upright", "narrow", "plane", "line"])
def test_a_plan_keeps_its_constraints_and_says_how_well(name: str) -> None:
    for seed in (0, 1, 2):
        service, request = asked(name, seed)
        result = service.plan(request)
        if result.failure is not None:
            assert result.failure.reason in {Reason.TIMED_OUT, Reason.CHECK_BUDGET_EXHAUSTED, Reason.PLANNING_FAILED}
            continue
        resolved = ConstraintSet(service.robot, list(request.constraints))
        path, certificate = present(result.path), present(result.certificate)
        assert [kept.name for kept in certificate.kept] == [getattr(c, "name", "") for c in request.constraints]
        worst = max(
            quantity.share for s in np.linspace(0.0, path.length, 500) for quantity in resolved.quantities(path(s))
        )
        assert worst <= 1.0 + 1e-9
        for bound in (bound for kept in certificate.kept for bound in kept.bounds):
            assert bound.bound <= bound.tolerance + 1e-9
        assert "kept" in result.stage(Stage.CERTIFY).note


def test_the_same_request_costs_the_same_and_projections_are_counted() -> None:
    service, request = asked("narrow", 3)
    first, second = service.plan(request), service.plan(request)
    assert first.counts == second.counts
    assert present(first.path).waypoints.tolist() == present(second.path).waypoints.tolist()
    assert first.counts.projections > 0
    assert first.counts.projections == sum(report.counts.projections for report in first.stages)
    assert "projection" in str(first.counts)


@pytest.mark.parametrize("timing", [Trapezoidal(), SCurve()])
def test_every_timing_law_follows_the_proven_curve(timing: Trapezoidal | SCurve) -> None:
    service, request = asked("upright", 1)
    result = service.plan(replace(request, timing=timing))
    assert present(result.trajectory).path is result.path
    assert present(result.certificate).kept


def test_ends_that_do_not_keep_a_constraint_are_named_with_the_amount() -> None:
    service, request = asked("upright", 0)
    tilted = np.add(request.start, [0.0, 0.0, 0.0, 0.4, 0.0, 0.0])
    failure = present(service.plan(replace(request, start=tilted)).failure)
    assert (failure.stage, failure.reason) == (Stage.ENDPOINTS, Reason.START_VIOLATES_CONSTRAINT)
    assert failure.detail.startswith("start does not keep upright: tilted by 0.")
    assert failure.detail.endswith(" rad, at most 0.1")
    failure = present(service.plan(replace(request, goal=[tilted, tilted])).failure)
    assert failure.reason is Reason.GOAL_VIOLATES_CONSTRAINT
    assert failure.detail.startswith("goal[0] does not keep upright")
    goal = np.array(request.goal)
    result = service.plan(replace(request, goal=[tilted, goal]))
    assert (result.failure, result.goal_index) == (None, 1)


def test_a_pose_that_is_not_upright_is_no_goal() -> None:
    service, request = asked("upright", 0)
    pose = Pose.from_matrix(service.robot.tool_pose(np.array(request.goal)))
    leaning = pose @ Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.4, 0.0))
    failure = present(service.plan(replace(request, goal=leaning)).failure)
    assert failure.reason in {Reason.GOAL_VIOLATES_CONSTRAINT, Reason.NO_IK_SOLUTION}
    assert service.plan(replace(request, goal=pose)).failure is None


def test_contradictory_constraints_and_ranges_are_named() -> None:
    service, request = asked("upright", 0)
    height = float(service.robot.tool_pose(np.array(request.start))[2, 3])
    low, high = OnPlane(Pose((0.0, 0.0, height)), 0.001), OnPlane(Pose((0.0, 0.0, height + 0.1)), 0.001)
    failure = present(service.plan(replace(request, constraints=[low, high])).failure)
    assert failure.reason is Reason.START_VIOLATES_CONSTRAINT
    assert "plane: z is -100 mm, from -1 to 1" in failure.detail
    joint = service.robot.joint_names[0]
    beside = float(np.array(request.start)[0]) + 0.5
    failure = present(service.plan(replace(request, constraints=[JointRange(joint, beside, beside + 1.0)])).failure)
    assert "start does not keep joint range: joint_0 is" in failure.detail


def test_an_end_may_be_beyond_a_range_by_rounding() -> None:
    cases = (asked("upright", seed) for seed in range(10))
    service, request = next((s, r) for s, r in cases if s.plan(r).attempts > 0)
    low = float(min(np.array(request.start)[1], np.array(request.goal)[1])) + 5e-10
    at_range = JointRange(service.robot.joint_names[1], low, low + 3.0)
    result = service.plan(replace(request, constraints=[*request.constraints, at_range], max_checks=20_000))
    assert result.attempts > 0
    assert result.failure is None or result.failure.reason is not Reason.START_VIOLATES_CONSTRAINT


def test_no_connection_is_said_to_be_while_keeping_the_constraints() -> None:
    service, request = asked("upright", 0)
    failure = present(service.plan(replace(request, max_checks=30)).failure)
    assert "while keeping upright" in failure.detail


def test_what_cannot_keep_constraints_is_refused() -> None:
    more: Any
    for field, more in [
        ("planner", {"planner": RRTConnect()}),
        ("planner", {"planner": Optimise()}),
        ("polish", {"planner": BalancedRRTConnect(), "polish": Optimise()}),
        ("constraints[0]", {"constraints": ["upright"]}),
        ("constraints", {"constraints": [UPRIGHT] * 17}),
        ("constraints", {"constraints": UPRIGHT}),
    ]:
        with pytest.raises(InvalidRequest) as refused:
            PlanRequest(np.zeros(6), np.ones(6), **{"constraints": [UPRIGHT], **more})
        assert refused.value.field == field


def test_both_hands_keep_a_tray() -> None:
    service, request = asked("both hands", 0)
    goal = np.array(request.start)
    for _ in range(40):  # a small way along what both hands can do
        step = projector_of(ConstraintSet(service.robot, list(request.constraints))).project(
            tuple((goal + 0.02 * np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])).tolist())
        )
        if step is None or not service.checker.edge_is_free(goal, np.array(step)):
            break
        goal = np.array(step)
    constraints: list[Constraint] = list(request.constraints)
    result = service.plan(replace(request, goal=goal, constraints=constraints))
    assert result.failure is None
    (kept,) = present(result.certificate).kept
    assert {bound.unit for bound in kept.bounds} == {"m", "rad"}
