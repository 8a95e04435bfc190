"""Lines with rounded corners, circular arcs, and the joint values that follow them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from planner_service import InvalidRequest, Pose, Robot, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import LineStopReason, straight_tool_line
from planner_service.kinematics.cartesian_waypoints import thinned_along
from planner_service.kinematics.tool_line import rotation_distance
from planner_service.kinematics.tool_path import ToolPath, circular_arc, rounded_lines, walk_tool_path
from planner_service.path.joint_path import JointPath

A, B, C = Pose((0.0, 0.0, 0.0)), Pose((0.2, 0.0, 0.0)), Pose((0.2, 0.1, 0.0))
YAW = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def positions(path: ToolPath) -> FloatArray:
    return np.array([pose.position for pose in path.poses])


def tool(robot: Robot, q: FloatArray) -> Pose:
    return Pose.from_matrix(robot.tool_pose(q))


def displaced(pose: Pose, x: float, y: float, z: float) -> Pose:
    a, b, c = pose.position
    return Pose((a + x, b + y, c + z), pose.quaternion)


# --- arcs


def test_an_arc_lies_on_the_circle_through_its_three_points() -> None:
    path = circular_arc(Pose((0.1, 0.0, 0.3)), (0.0, 0.1, 0.3), Pose((-0.1, 0.0, 0.3)))
    away = positions(path) - [0.0, 0.0, 0.3]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 0.1, atol=1e-12)
    assert np.abs(away[:, 2]).max() < 1e-12
    assert away[:, 1].min() > -1e-12
    assert path.length == pytest.approx(0.1 * math.pi, rel=1e-4)


def test_an_arc_passes_its_middle_point_even_the_long_way_round() -> None:
    path = circular_arc(Pose((0.1, 0.0, 0.0)), (-0.1, 0.0, 0.0), Pose((0.0, -0.1, 0.0)))
    assert path.length == pytest.approx(0.1 * 1.5 * math.pi, rel=1e-4)
    assert np.linalg.norm(positions(path) - [-0.1, 0.0, 0.0], axis=1).min() < 0.0025
    other = circular_arc(Pose((0.1, 0.0, 0.0)), (math.sqrt(0.005), -math.sqrt(0.005), 0.0), Pose((0.0, -0.1, 0.0)))
    assert other.length == pytest.approx(0.1 * 0.5 * math.pi, rel=1e-4)


def test_points_that_define_no_circle_are_refused() -> None:
    for via, goal, message in [
        ((0.1, 0.00005, 0.0), (0.2, 0.0, 0.0), r"via: got .*; expected a point at least 0.1 mm off the line"),
        ((0.0, 0.0, 0.0), (0.2, 0.0, 0.0), r"via: got .*; expected a point at least 0.1 mm off the line"),
        ((0.2, 0.0, 0.0), (0.2, 0.0, 0.0), r"via: got .*; expected a point at least 0.1 mm off the line"),
        ((0.1, 0.1, 0.0), (0.00005, 0.0, 0.0), r"goal: got .*; expected a position other than the start's; two arcs"),
    ]:
        with pytest.raises(InvalidRequest, match=message):
            circular_arc(Pose(), via, Pose(goal))


# --- rounded corners


def test_a_rounded_corner_leaves_the_lines_only_within_its_zone_and_stays_inside() -> None:
    path = rounded_lines([A, B, C], 0.02)
    points = positions(path)
    sharp = (np.abs(points[:, 1]) < 1e-12) | (np.abs(points[:, 0] - 0.2) < 1e-12)
    from_corner = np.linalg.norm(points - B.position, axis=1)
    assert from_corner[~sharp].max() <= 0.02
    assert from_corner.min() == pytest.approx(0.02 * 5 / 24 * math.sqrt(2.0), rel=1e-6)
    assert points[:, 0].max() <= 0.2 + 1e-12
    assert points[:, 1].min() >= -1e-12
    assert path.stops == (0, len(path.poses) - 1)


def test_direction_and_orientation_change_smoothly_through_a_corner() -> None:
    path = rounded_lines([A, replace(B, quaternion=YAW), replace(C, quaternion=YAW)], 0.04)
    steps = [minus / np.linalg.norm(minus) for minus in np.diff(positions(path), axis=0)]
    assert max(float(np.linalg.norm(v - u)) for u, v in pairwise(steps)) < 0.2
    rates = [
        rotation_distance(a, b) / math.dist(a.position, b.position) for a, b in pairwise(path.poses)
    ]  # rad/m: from 7.9 on the first line to 0 on the second
    assert max(abs(b - a) for a, b in pairwise(rates)) < 1.2
    assert rates[0] == pytest.approx(math.pi / 2 / 0.2)
    assert rates[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("middle", [A, replace(B, quaternion=YAW)], ids=["straight back", "on the spot"])
def test_the_tool_stops_where_no_corner_can_be_rounded(middle: Pose) -> None:
    path = rounded_lines([A, B, middle, C], 0.02)
    assert any(math.dist(path.poses[row].position, B.position) < 1e-12 for row in path.stops)


# --- following them


def test_following_a_path_with_corners_keeps_the_tool_on_it_however_widely_corners_are_blended(wxai: Robot) -> None:
    begin = tool(wxai, wxai.home)
    path = rounded_lines([begin, displaced(begin, 0.0, 0.1, 0.0), displaced(begin, 0.05, 0.1, -0.06)], 0.01)
    line = walk_tool_path(wxai, wxai.home, path, max_joint_rate=100.0)
    assert line.stopped is None
    points, _ = thinned_along(wxai, line.waypoints, line.fractions * path.length, path)
    at, _ = path.poses_at(np.linspace(0.0, path.length, 4000, dtype=np.float64))
    for share in (0.0, 0.25, 0.499):
        knots = JointPath(points).knots
        widths = share * np.minimum(np.diff(knots)[1:], np.diff(knots)[:-1])
        curve = JointPath(points, np.array([0.0, *widths, 0.0]))
        tips = np.array([wxai.tool_pose(q)[:3, 3] for q in curve(np.linspace(0.0, curve.length, 300))])
        off = max(float(np.linalg.norm(at - tip, axis=1).min()) for tip in tips)
        assert off < 1e-3


@pytest.mark.parametrize("rate", [3.0, 1000.0])
def test_no_joint_moves_farther_per_metre_than_allowed(wxai: Robot, rate: float) -> None:
    begin = tool(wxai, wxai.home)
    path = rounded_lines([begin, displaced(begin, -0.05, 0.08, 0.0), displaced(begin, -0.05, 0.08, -0.05)], 0.01)
    line = walk_tool_path(wxai, wxai.home, path, max_joint_rate=rate)
    moves = np.abs(np.diff(line.waypoints, axis=0)).max(axis=1)
    assert (moves <= rate * path.length * np.diff(line.fractions) + 1e-6).all()
    assert (line.stopped is None) == (rate > 100.0)
    if line.stopped is not None:
        assert line.stopped.reason is LineStopReason.JOINT_RATE


@pytest.mark.parametrize("name", ["wxai", "panda_mbm"])
def test_the_fractions_of_a_line_are_where_its_waypoints_are(name: str) -> None:
    robot = load_robot(name)
    shift = np.array([0.02, 0.06, -0.03])
    for points in (2, 60):  # with 2, pieces are halved
        line = straight_tool_line(robot, robot.home, shift, points=points)
        begin = robot.tool_pose(robot.home)[:3, 3]
        tips = np.array([robot.tool_pose(q)[:3, 3] for q in line.waypoints])
        np.testing.assert_allclose(tips, begin + line.fractions[:, None] * shift, atol=1e-6)


def test_a_zone_takes_at_most_half_of_each_line() -> None:
    points = positions(rounded_lines([A, B, C], 1.0))
    off = points[(points[:, 1] > 1e-9) & (points[:, 0] < 0.2 - 1e-9)]
    assert np.linalg.norm(off - B.position, axis=1).max() == pytest.approx(0.05, abs=0.005)
