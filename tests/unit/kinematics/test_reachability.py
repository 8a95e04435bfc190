"""Why a pose cannot be reached, on poses of which that is known because of how they are made."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service import PlannerService, PlanRequest, Pose, Reason, Robot, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import (
    Cause,
    Slip,
    Unreachable,
    inverse_kinematics,
    why_unreachable,
)
from planner_service.kinematics.tool_line import rotation_distance
from tests.support.optional import present

ROBOTS = Path(__file__).parents[3] / "robots"
NAMES = ("wxai", "panda")


def configurations(robot: Robot, count: int) -> FloatArray:
    return np.random.default_rng(4).uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def tool(robot: Robot, q: FloatArray) -> Pose:
    return Pose.from_matrix(robot.tool_pose(q))


def moved(pose: Pose, scale: float) -> Pose:
    x, y, z = (scale * value for value in pose.position)
    return Pose((x, y, z), pose.quaternion)


def swapped(pose: Pose) -> Pose:
    """The pose as one writes it who takes the quaternion's order for x y z w."""
    w, x, y, z = pose.quaternion
    return Pose(pose.position, (x, y, z, w))


def unreached(robot: Robot, poses: Iterator[Pose], count: int) -> list[Pose]:
    found = [pose for pose in poses if not len(inverse_kinematics(robot, pose))][:count]
    assert len(found) == count, "or this tests less than it says"
    return found


def beyond_the_limit(robot: Robot, joint: int, by: float) -> Iterator[Pose]:
    for q in configurations(robot, 300):
        q[joint] = robot.limits.upper[joint] + by
        yield tool(robot, q)


@pytest.mark.parametrize(("x", "y", "z"), [(-1.0, 0.5, 0.4), (0.1, -0.2, 0.0)])
def test_out_of_reach_is_said_by_how_much_in_the_plane(x: float, y: float, z: float) -> None:
    """Links of 1 m and 0.5 m: the tip comes to a ring from 0.5 to 1.5 m."""
    robot = load_robot("planar2")
    why, away = why_unreachable(robot, Pose((x, y, z))), math.hypot(x, y)
    gap = math.hypot(max(away - 1.5, 0.5 - away, 0.0), z)
    assert why.cause is Cause.OUT_OF_REACH
    assert why.gap == pytest.approx(gap, abs=1e-6)
    assert math.dist(why.position, (x, y, z)) == pytest.approx(gap, abs=1e-6)
    assert f"out of reach by {gap * 1e3:.1f} mm" in str(why)


@pytest.mark.parametrize("yaw", [2.5, 0.9])
def test_the_nearest_turn_is_that_of_the_better_elbow(yaw: float) -> None:
    robot, (x, y) = load_robot("planar2"), (0.9, 0.6)
    elbow = math.acos((x * x + y * y - 1.25) / 1.0)
    turns = [math.atan2(y, x) - math.atan2(0.5 * math.sin(e), 1.0 + 0.5 * math.cos(e)) + e for e in (elbow, -elbow)]
    why = why_unreachable(robot, Pose.from_rpy((x, y, 0.0), (0.0, 0.0, yaw)))
    assert why.cause is Cause.ORIENTATION
    assert why.turn == pytest.approx(min(abs(math.remainder(yaw - turn, math.tau)) for turn in turns), abs=1e-6)
    assert f"turned by {why.turn:.3f} rad" in str(why)


def test_a_single_joint_in_the_way_is_named_with_how_far_beyond_it_would_have_to_go() -> None:
    robot = load_robot("planar2")
    short = replace(
        robot, limits=replace(robot.limits, lower=np.array([-math.pi, -0.5]), upper=np.array([math.pi, 1.0]))
    )
    why = why_unreachable(short, tool(robot, np.array([0.3, 1.25])))
    beyond = present(why.beyond)
    assert (why.cause, beyond.joint, beyond.limit) == (Cause.JOINT_LIMIT, "elbow", 1.0)
    assert beyond.excess == pytest.approx(0.25, abs=1e-6)
    assert "elbow = 1.2500, 0.2500 beyond its limit of 1.0000" in str(why)
    assert "out of reach by" in str(why)  # within the limits


@pytest.mark.parametrize("name", NAMES)
def test_what_is_said_to_be_nearest_is_there_and_nothing_sampled_is_nearer(name: str) -> None:
    robot = load_robot(name)
    audited = IndependentChecker(ROBOTS / name, {})
    sampled = robot.body_poses_batch(configurations(robot, 20_000))
    tips = sampled[0][:, robot.tool_body] @ robot.tool_placement[:3, 3] + sampled[1][:, robot.tool_body]
    rng = np.random.default_rng(2)
    far = (Pose(tuple(rng.uniform(-1.6, 1.6, 3).tolist())) for _ in range(60))
    for pose in unreached(robot, far, 6):
        why = why_unreachable(robot, pose)
        T = audited.tool_pose(why.nearest)
        assert np.all((robot.limits.lower <= why.nearest) & (why.nearest <= robot.limits.upper))
        assert math.dist(T[:3, 3], pose.position) == pytest.approx(why.gap, abs=1e-9)
        assert rotation_distance(Pose.from_matrix(T), pose) == pytest.approx(why.turn, abs=1e-7)
        assert why.gap <= np.linalg.norm(tips - np.array(pose.position), axis=1).min() + 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_a_reachable_pose_turned_too_far_is_reached_by_turning_back_at_most_that_far(name: str) -> None:
    robot = load_robot(name)
    turned = (tool(robot, q) @ Pose.from_rpy((0, 0, 0), (0.0, 1.2, 0.0)) for q in configurations(robot, 200))
    for pose in unreached(robot, turned, 4):
        why = why_unreachable(robot, pose)
        assert why.cause in {Cause.ORIENTATION, Cause.JOINT_LIMIT}
        assert why.gap < 1e-5
        assert 1e-3 < why.turn <= 1.2 + 1e-6


@pytest.mark.parametrize(("name", "joint"), [("wxai", 2), ("panda", 5)])
def test_a_pose_behind_a_limit_needs_no_more_than_it_was_made_with(name: str, joint: int) -> None:
    robot = load_robot(name)
    told = [why_unreachable(robot, pose) for pose in unreached(robot, beyond_the_limit(robot, joint, 0.15), 4)]
    assert [why.cause for why in told] == [Cause.JOINT_LIMIT] * 4
    assert all(0.0 < present(why.beyond).excess <= 0.151 for why in told)
    assert robot.joint_names[joint] in {present(why.beyond).joint for why in told}


@pytest.mark.parametrize("name", NAMES)
def test_common_mistakes_are_suggested_where_the_corrected_pose_can_be_reached(name: str) -> None:
    robot = load_robot(name)
    poses = [tool(robot, q) for q in configurations(robot, 5)]
    for pose in poses:
        why = why_unreachable(robot, moved(pose, 1000.0))
        meant = present(why.suggestion)
        assert meant.slips in {(Slip.MILLIMETRES,), (Slip.MILLIMETRES, Slip.XYZW)}
        assert len(inverse_kinematics(robot, meant.pose))
        assert math.dist(meant.pose.position, pose.position) < 1e-12
    for wrong in unreached(robot, (swapped(tool(robot, q)) for q in configurations(robot, 300)), 3):
        meant = present(why_unreachable(robot, wrong).suggestion)
        assert meant.slips == (Slip.XYZW,)
        assert swapped(meant.pose).quaternion == pytest.approx(wrong.quaternion)


def facts(why: Unreachable) -> tuple[object, ...]:
    return why.cause, why.nearest.tobytes(), why.gap, why.turn, why.beyond, why.suggestion


# --- in a plan


def test_a_plan_says_why_the_first_goal_is_unreachable(bin_: PlannerService) -> None:
    asked = PlanRequest(bin_.robot.home, [Pose((0.9, 0.0, 0.2)), Pose((3.0, 0.0, 0.2))], seed=3)
    failure = present(bin_.plan(asked).failure)
    why = present(failure.unreachable)
    assert failure.reason is Reason.NO_IK_SOLUTION
    assert failure.detail.startswith("goal[0]: the arm cannot reach")
    assert failure.detail.endswith(str(why))
    assert facts(why) == facts(why_unreachable(bin_.robot, Pose((0.9, 0.0, 0.2)), seed=3))


def test_a_pose_that_is_suggested_is_free(bin_: PlannerService) -> None:
    reached = tool(bin_.robot, bin_.robot.pose("ready"))
    inside = Pose((0.25, 0.0, -0.03), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))  # pointing down into the table
    assert len(inverse_kinematics(bin_.robot, inside))
    told = [present(bin_.plan(PlanRequest(bin_.robot.home, moved(p, 1000.0))).failure) for p in (reached, inside)]
    suggested = [present(failure.unreachable).suggestion for failure in told]
    assert present(suggested[0]).slips == (Slip.MILLIMETRES,)
    assert suggested[1] is None
    assert "position in millimetres" in told[0].detail
