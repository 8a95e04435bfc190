"""Inverse kinematics and straight tool lines, on the WidowX AI, the planar two-link arm and an arm on a rail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.tool_arm import descended
from planner_service.kinematics.tool_line import (
    LineStopReason,
    ToolLine,
    interpolate,
    rotation_distance,
    straight_tool_line,
)
from planner_service.robot.model import Body, JointLimits, Robot
from planner_service.robot_setup.loading import load_robot
from tests.support.optional import present

DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
TOP_DOWN_CEILING = 0.1747
"""Closed form: joints 1 and 2 at 90 degrees, joint 3 at its limit of -90."""


@pytest.fixture(scope="module")
def numeric_wxai(wxai: Robot) -> Robot:
    return replace(wxai, inverse="numeric")


@pytest.fixture(scope="module")
def rail(wxai: Robot) -> Robot:
    """The WidowX AI on a rail of 0.6 m along x: seven joints, one of them prismatic."""
    sleeper = Body("rail", 0, np.eye(4), np.array([1.0, 0.0, 0.0]), True, 0)
    moved = [replace(b, parent=b.parent + 1, q_index=b.q_index + 1) for b in wxai.bodies[1:]]
    own = wxai.limits
    first = {"lower": -0.3, "upper": 0.3, "velocity": 1.0, "acceleration": 1.0, "jerk": 10.0}
    return replace(
        wxai,
        name="rail",
        joint_names=("rail", *wxai.joint_names),
        limits=JointLimits(**{key: np.array([value, *getattr(own, key)]) for key, value in first.items()}),
        named_poses=tuple((name, np.array([0.0, *q])) for name, q in wxai.named_poses),
        bodies=(wxai.bodies[0], sleeper, *moved),
        tool_body=wxai.tool_body + 1,
        shapes=(),
        gripper=None,
        retreats=(),
        inverse="numeric",
    )


def random_configurations(robot: Robot, count: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def tool(robot: Robot, q: FloatArray) -> Pose:
    return Pose.from_matrix(robot.tool_pose(q))


def top_down(x: float, y: float, z: float, yaw: float = 0.0) -> Pose:
    return Pose((x, y, z), (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))) @ Pose(quaternion=DOWN)


def without_limits(robot: Robot) -> Robot:
    wide = replace(robot.limits, lower=np.full(robot.n, -math.pi), upper=np.full(robot.n, math.pi))
    return replace(robot, limits=wide)


def dense_deviation(robot: Robot, line: ToolLine, begin: Pose, end: Pose) -> tuple[float, float]:
    """Largest distance (m) of the tool from the segment and of its turn (rad) from the nearest orientation on it."""
    a, b = np.array(begin.position), np.array(end.position)
    turns = np.array([interpolate(begin, end, u).rotation for u in np.linspace(0.0, 1.0, 401)])
    metres = radians = 0.0
    for q1, q2 in zip(line.waypoints[:-1], line.waypoints[1:], strict=True):
        for u in np.linspace(0.0, 1.0, 21):
            T = robot.tool_pose(q1 + u * (q2 - q1))
            along = min(1.0, max(0.0, float((T[:3, 3] - a) @ (b - a) / ((b - a) @ (b - a)))))
            metres = max(metres, float(np.linalg.norm(T[:3, 3] - a - along * (b - a))))
            cosine = (np.einsum("kij,ij->k", turns, T[:3, :3]).max() - 1) / 2
            radians = max(radians, math.acos(min(1.0, cosine)))
    return metres, radians


# --- orientations


def test_rotation_distance_is_the_angle_between_orientations_whatever_the_quaternions_sign() -> None:
    a = Pose.from_rpy((0, 0, 0), (0.3, -0.2, 0.5))
    turn = Pose.from_rpy((0, 0, 0), (0.0, 0.0, 0.7))
    b = a @ turn
    w, x, y, z = b.quaternion
    assert rotation_distance(a, b) == pytest.approx(0.7, abs=1e-12)
    assert rotation_distance(a, Pose(quaternion=(-w, -x, -y, -z))) == pytest.approx(0.7, abs=1e-12)


# --- closed form


@pytest.mark.slow
def test_closed_form_finds_every_configuration_back_and_never_more_than_two(wxai: Robot) -> None:
    counts = []
    for q in random_configurations(wxai, 2000, seed=1):
        pose = tool(wxai, q)
        found = inverse_kinematics(wxai, pose)
        assert np.abs(found - q).max(axis=1).min() < 1e-7
        assert all(np.abs(wxai.tool_pose(other) - pose.matrix).max() < 1e-7 for other in found)
        counts.append(len(found))
    assert set(counts) == {1, 2}


def test_an_unreachable_pose_has_no_solutions_of_n_joints(wxai: Robot, numeric_wxai: Robot) -> None:
    far = Pose((0.9, 0.0, 0.3))
    assert inverse_kinematics(wxai, far).shape == (0, 6)
    assert inverse_kinematics(numeric_wxai, far).shape == (0, 6)


def test_closed_form_takes_a_pose_on_the_limits_as_reachable(wxai: Robot) -> None:
    for corner in (wxai.pose("sleep"), wxai.limits.lower, wxai.limits.upper):
        q = np.where(np.arange(6) == 4, 0.5 * corner, corner)  # joint 4 at 90 degrees leaves an angle free
        found = inverse_kinematics(wxai, tool(wxai, q))
        assert np.abs(found - q).max(axis=1).min() < 1e-7
        assert ((found >= wxai.limits.lower) & (found <= wxai.limits.upper)).all()


def test_closed_form_reads_its_lengths_and_frames_from_the_robot(wxai: Robot) -> None:
    longer = [replace(b, placement=np.array(b.placement)) for b in wxai.bodies]
    for body, shift in ((2, 0.03), (3, -0.02), (4, 0.1), (5, 0.01), (6, 0.02)):
        placement = np.array(longer[body].placement)
        placement[:3, 3] += (shift, 0.0, shift / 2)
        longer[body] = replace(longer[body], placement=placement)
    base = Pose.from_rpy((0.2, -0.1, 0.4), (0.1, 0.2, 0.3)).matrix @ wxai.bodies[1].placement
    longer[1] = replace(longer[1], placement=base)
    grip = Pose.from_rpy((0.1, 0.02, -0.03), (0.4, -0.5, 0.6)).matrix
    other = replace(wxai, bodies=tuple(longer), tool_placement=grip)
    for q in random_configurations(other, 50, seed=4):
        assert np.abs(inverse_kinematics(other, tool(other, q)) - q).max(axis=1).min() < 1e-7


def test_closed_form_refuses_a_robot_of_another_structure(wxai: Robot) -> None:
    shifted = np.array(wxai.bodies[3].placement)
    shifted[1, 3] = 0.01
    bodies = (*wxai.bodies[:3], replace(wxai.bodies[3], placement=shifted), *wxai.bodies[4:])
    bent = replace(wxai, bodies=bodies)
    with pytest.raises(InvalidRequest, match=r"'numeric' for robot 'wxai'.*joint_2 placed without turn or sideways"):
        inverse_kinematics(bent, Pose())
    with pytest.raises(InvalidRequest, match="a chain of six joints"):
        inverse_kinematics(replace(load_robot("planar2"), inverse="wxai"), Pose())


# --- numeric


@pytest.mark.slow
def test_numeric_search_solves_at_least_99_of_100_reachable_poses_of_the_arm(wxai: Robot, numeric_wxai: Robot) -> None:
    solved = 0
    for q in random_configurations(wxai, 100, seed=5):
        pose = tool(wxai, q)
        found = inverse_kinematics(numeric_wxai, pose)
        assert all(np.abs(numeric_wxai.tool_pose(other) - pose.matrix).max() < 1e-7 for other in found)
        assert ((found >= wxai.limits.lower) & (found <= wxai.limits.upper)).all()
        solved += len(found) > 0
    assert solved >= 99


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_joint_at_its_limit_leaves_the_way_to_the_others(rail: Robot, side: float) -> None:
    q = np.array([side * 0.3, *rail.pose("ready")[1:]])
    x, y, z = tool(rail, q).position
    ahead = Pose((x + side * 0.15, y, z), tool(rail, q).quaternion)  # the rail alone would do, but is at its end
    assert descended(rail, ahead, q[np.newaxis]).arrived.all()


def test_a_pose_that_is_none_and_seeds_of_another_shape_are_refused(wxai: Robot) -> None:
    with pytest.raises(InvalidRequest, match=r"pose: got 'up'; expected a Pose"):
        inverse_kinematics(wxai, "up")  # type: ignore[call-overload]
    with pytest.raises(InvalidRequest, match=r"seeds\[1\]: .* expected 6 finite numbers"):
        inverse_kinematics(wxai, Pose(), seeds=[np.zeros(6), np.zeros(5)])
    with pytest.raises(InvalidRequest, match="finite numbers"):
        Pose((math.nan, 0.0, 0.0))


# --- straight tool lines


@pytest.mark.parametrize("kind", ["wxai", "numeric"])
def test_a_descent_of_nine_centimetres_stays_on_its_line(wxai: Robot, kind: str) -> None:
    robot = replace(wxai, inverse=kind)
    begin, end = top_down(0.3, 0.05, 0.12), top_down(0.3, 0.05, 0.03)
    q = inverse_kinematics(wxai, begin)[0]
    line = straight_tool_line(robot, q, (0.0, 0.0, -0.09))
    assert (line.stopped, line.fraction, len(line.waypoints)) == (None, 1.0, 60)
    assert line.waypoints[0].tolist() == q.tolist()
    assert np.abs(robot.tool_pose(line.waypoints[-1]) - end.matrix).max() < 1e-7
    metres, radians = dense_deviation(robot, line, begin, end)
    assert metres <= 1e-3
    assert radians <= 5e-3


def test_a_line_that_turns_the_tool_keeps_both_bounds_and_ends_at_its_pose(wxai: Robot) -> None:
    q = wxai.pose("ready")
    begin, end = tool(wxai, q), Pose.from_rpy((0.1, 0.4, 0.25), (0.0, 0.0, 1.6))
    line = straight_tool_line(wxai, q, end)
    assert line.stopped is None
    assert np.abs(wxai.tool_pose(line.waypoints[-1]) - end.matrix).max() < 1e-7
    metres, radians = dense_deviation(wxai, line, begin, end)
    assert metres <= 1e-3
    assert radians <= 5e-3


@pytest.mark.parametrize("kind", ["wxai", "numeric"])
def test_a_line_above_the_ceiling_of_a_vertical_tool_stops_at_joint_3s_limit(wxai: Robot, kind: str) -> None:
    robot = replace(wxai, inverse=kind)
    q = inverse_kinematics(wxai, top_down(0.265, 0.0, 0.10))[0]
    line = straight_tool_line(robot, q, (0.0, 0.0, 0.15))
    assert line.stopped is not None
    assert (line.stopped.reason, line.stopped.joint) == (LineStopReason.LIMIT, "joint_3")
    assert line.fraction == line.stopped.fraction == pytest.approx((TOP_DOWN_CEILING - 0.10) / 0.15, abs=1e-3)
    assert wxai.tool_pose(line.waypoints[-1])[2, 3] == pytest.approx(0.10 + 0.15 * line.fraction, abs=1e-6)
    assert str(line.stopped) == "the straight tool line ends after 49.8 %: joint_3 is at its limit"


@pytest.mark.parametrize("kind", ["wxai", "numeric"])
def test_a_line_out_of_a_stretched_arms_reach_stops_singular(wxai: Robot, kind: str) -> None:
    robot = replace(without_limits(wxai), inverse=kind)
    q = robot.pose("ready")
    line = straight_tool_line(robot, q, (0.6, 0.0, 0.0))
    assert present(line.stopped).reason is LineStopReason.SINGULARITY
    assert present(line.stopped).joint in ("joint_1", "joint_2", "joint_3")
    T = robot.tool_pose(line.waypoints[-1])
    forearm = T[:3, 3] - (0.06775 + 0.02895 + 0.156062) * T[:3, 0] - np.array([0.02, 0.0, 0.1035])
    assert np.linalg.norm(forearm) == pytest.approx(0.264 + math.hypot(0.245, 0.06), abs=1e-4)


def test_consecutive_waypoints_never_jump(wxai: Robot) -> None:
    rng = np.random.default_rng(10)
    for q in random_configurations(wxai, 40, seed=10):
        line = straight_tool_line(wxai, q, rng.uniform(-0.15, 0.15, 3))
        steps = np.abs(np.diff(line.waypoints, axis=0))
        assert steps.size == 0 or steps.max() <= 0.2
        assert (line.stopped is None) == (line.fraction == 1.0)


def test_a_line_refuses_what_is_no_configuration_pose_or_count(wxai: Robot) -> None:
    q = wxai.pose("ready")
    with pytest.raises(InvalidRequest, match=r"q_start: .* expected 6 finite numbers"):
        straight_tool_line(wxai, [0.0] * 5, (0.0, 0.0, 0.1))
    with pytest.raises(InvalidRequest, match=r"q_start: joint_2: got 3.0; expected within \[0.0000, 2.3562\]"):
        straight_tool_line(wxai, [0.0, 0.5, 3.0, 0.0, 0.0, 0.0], (0.0, 0.0, 0.1))
    with pytest.raises(InvalidRequest, match=r"to: .* a shift of 3 finite numbers"):
        straight_tool_line(wxai, q, (0.0, 0.0, math.nan))
    with pytest.raises(InvalidRequest, match="points: got 1; expected a whole number from 2"):
        straight_tool_line(wxai, q, (0.0, 0.0, 0.1), points=1)
