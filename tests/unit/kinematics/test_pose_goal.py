"""Tool poses with room: every candidate is within it, and a plan may end at any of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planner_service import (
    Box,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    PoseGoal,
    load_scene,
)
from planner_service.kinematics.tool_line import rotation_distance

DOWN = Pose((0.25, -0.20, 0.10), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
APPROACH = (1.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def arm() -> PlannerService:
    return PlannerService("wxai", "table")


ROUNDED = 3 * math.ulp(0.25)
"""Metres by which rounding may move a place whose coordinates are at most 0.25 m."""


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 0.1), st.floats(0.0, 1.0), st.integers(1, 40))
@example(metres=2.0**-52, lean=0.0, count=16)
def test_every_candidate_is_within_the_tolerances_and_the_first_is_the_pose(
    metres: float, lean: float, count: int
) -> None:
    goal = PoseGoal(DOWN, metres, lean, candidates=count)
    poses = goal.poses()
    assert poses[0] == DOWN
    assert len(poses) == (count if metres > 0.0 or lean > 0.0 else 1)
    for pose in poses:
        assert math.dist(pose.position, DOWN.position) <= metres * (1 + 1e-12) + ROUNDED
        assert rotation_distance(pose, DOWN) <= lean + 1e-7


def test_turning_about_the_free_axis_keeps_that_axis_and_the_place() -> None:
    poses = PoseGoal(DOWN, free_axis=(2.0, 0.0, 0.0), candidates=12).poses()
    for pose in poses:
        np.testing.assert_allclose(pose.rotation[:, 0], DOWN.rotation[:, 0], atol=1e-12)
        assert pose.position == DOWN.position
    sideways = sorted(math.atan2(pose.rotation[1, 1], pose.rotation[0, 1]) for pose in poses)
    assert max(np.diff(sideways)) < 2 * math.pi / 4, "spread around"


def test_a_plan_ends_within_the_room_of_its_goal(arm: PlannerService) -> None:
    goal = PoseGoal(DOWN, 0.01, 0.1, APPROACH)
    path, _ = arm.plan(PlanRequest(arm.robot.home, goal, time_limit=None)).unwrap()
    reached = Pose.from_matrix(arm.robot.tool_pose(path.waypoints[-1]))
    assert math.dist(reached.position, DOWN.position) <= 0.01 + 1e-6
    assert math.acos(min(1.0, float(reached.rotation[:, 0] @ DOWN.rotation[:, 0]))) <= 0.1 + 1e-6


def test_where_the_pose_itself_is_blocked_another_turn_of_the_tool_is_found(arm: PlannerService) -> None:
    blocked: PlannerService | None = None
    for x, y in ((0.055, 0.0), (0.0, 0.055), (-0.055, 0.0), (0.0, -0.055)):
        post = Obstacle("post", Box((0.03, 0.03, 0.12)), Pose((0.25 + x, -0.20 + y, 0.07)))
        service = arm.with_scene(load_scene("table").with_obstacle(post))
        if not service.plan(PlanRequest(service.robot.home, DOWN, time_limit=None)).ok:
            blocked = service
            break
    assert blocked is not None, "or this tests nothing"
    turned = blocked.plan(PlanRequest(blocked.robot.home, PoseGoal(DOWN, free_axis=APPROACH), time_limit=None))
    assert turned.ok


def test_impossible_room_is_refused() -> None:
    values: Any
    for values, told in [
        ({"pose": "down"}, "pose: got 'down'"),
        ({"position_tolerance": -0.1}, "position_tolerance: got -0.1"),
        ({"orientation_tolerance": 4.0}, "orientation_tolerance: got 4.0"),
        ({"free_axis": (0.0, 0.0, 0.0)}, "free_axis: got"),
        ({"free_axis": (1.0, 0.0)}, "free_axis: got"),
        ({"candidates": 0}, "candidates: got 0"),
    ]:
        with pytest.raises(InvalidRequest, match=told):
            PoseGoal(**{"pose": DOWN, **values})
