"""Lines of the tool from every branch: none that one search finds is missing, and proofs that there is none hold."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner_service import Pose, Robot, load_robot
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import LineBranches, ToolLine, line_branches, straight_tool_line
from planner_service.kinematics.tool_line import LINE_METRES, LINE_RADIANS, interpolate, rotation_distance, shifted


def drawn(robot: Robot, rng: np.random.Generator) -> tuple[FloatArray, Pose, FloatArray]:
    """A configuration, its pose and a way of 0.1 to 0.3 m."""
    q = rng.uniform(robot.limits.lower, robot.limits.upper)
    way = rng.normal(size=3)
    return q, Pose.from_matrix(robot.tool_pose(q)), way * rng.uniform(0.1, 0.3) / math.sqrt(float(way @ way))


@pytest.mark.parametrize(("name", "least"), [("wxai", 4), ("ur5", 8)])
def test_a_line_of_one_branch_is_among_those_of_all(name: str, least: int) -> None:
    robot, rng = load_robot(name), np.random.default_rng(5)
    more = 0
    for _ in range(12):
        q, begin, way = drawn(robot, rng)
        found, own = line_branches(robot, begin, way, still=q), straight_tool_line(robot, q, way)
        assert found.complete
        assert max(line.fraction for line in found.lines) >= own.fraction - 1e-9
        assert [line.fraction for line in found.lines] == sorted((li.fraction for li in found.lines), reverse=True)
        assert found.ends is None or (found.whole is None and found.ends >= max(li.fraction for li in found.lines))
        more += found.whole is not None
    assert more >= least


def test_joints_do_not_jump_and_the_tool_is_on_the_line() -> None:
    robot, rng = load_robot("ur5"), np.random.default_rng(9)
    for _ in range(6):
        q, begin, way = drawn(robot, rng)
        line = line_branches(robot, begin, way, still=q).whole
        if line is None:
            continue
        end = shifted(begin, way)
        assert np.abs(np.diff(line.waypoints, axis=0)).max() < 0.3
        for row, u in zip(line.waypoints, line.fractions, strict=True):
            here, wanted = Pose.from_matrix(robot.tool_pose(row)), interpolate(begin, end, float(u))
            assert math.dist(here.position, wanted.position) < 1e-6
            assert rotation_distance(here, wanted) < 1e-6


def test_nothing_follows_a_line_beyond_where_it_is_proven_to_end() -> None:
    """Steps from near all configurations at the start, within 0.9 of the tolerance, as far as they lead."""
    robot, rng, own = load_robot("ur5"), np.random.default_rng(1), np.random.default_rng(2)
    proven = 0
    for _ in range(14):
        q, begin, way = drawn(robot, rng)
        found, end = line_branches(robot, begin, way, still=q), shifted(begin, way)
        if found.ends is None:
            continue
        proven += 1
        for line in found.lines[:4]:
            for _ in range(2):
                assert furthest(robot, line.waypoints[0], begin, end, own) <= found.ends
    assert proven >= 3


def furthest(robot: Robot, q: FloatArray, begin: Pose, end: Pose, rng: np.random.Generator) -> float:
    """How far small steps of damped least squares come that may leave the line by nearly as much as is allowed."""
    off = rng.normal(size=3)
    off *= 0.9 * LINE_METRES / math.sqrt(float(off @ off))
    turn = rng.normal(size=3)
    turn *= 0.9 * LINE_RADIANS / math.sqrt(float(turn @ turn))
    for k in range(1, 201):
        u = k / 200
        wanted = interpolate(begin, end, u)
        share = min(1.0, k / 20)  # by and by from the line to beside it
        T = Pose.from_rpy((0.0, 0.0, 0.0), tuple(share * turn)) @ Pose((0.0, 0.0, 0.0), wanted.quaternion)
        before = q
        for _ in range(4):
            here = Pose.from_matrix(robot.tool_pose(q))
            R = T.rotation @ here.rotation.T
            spin = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
            error = np.concatenate([np.array(wanted.position) + share * off - np.array(here.position), spin])
            J = robot.tool_jacobian(q)
            q = np.clip(
                q + J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), error), robot.limits.lower, robot.limits.upper
            )
        here = Pose.from_matrix(robot.tool_pose(q))
        if float(np.abs(q - before).max()) > 0.2:  # a jump
            return (k - 1) / 200
        if math.dist(here.position, wanted.position) > LINE_METRES or rotation_distance(here, wanted) > LINE_RADIANS:
            return (k - 1) / 200
    return 1.0


def test_a_line_out_of_reach_is_proven_to_end() -> None:
    robot = load_robot("wxai")
    found = line_branches(robot, Pose.from_matrix(robot.tool_pose(robot.home)), (2.0, 0.0, 0.0))
    assert found.whole is None
    assert found.proven
    assert found.ends is not None
    assert max(line.fraction for line in found.lines) <= found.ends <= 0.5
    assert str(found).startswith("no motion follows the line beyond")


def test_an_arm_of_seven_joints_has_lines_from_several_starts() -> None:
    panda = load_robot("panda")
    found = line_branches(panda, Pose.from_matrix(panda.tool_pose(panda.home)), (0.0, 0.1, 0.0))
    assert found.whole is not None
    assert not found.complete
    out = line_branches(panda, Pose.from_matrix(panda.tool_pose(panda.home)), (0.0, 0.0, 3.0))
    assert out.whole is None


def test_a_start_that_cannot_be_reached_has_no_lines() -> None:
    robot = load_robot("ur5")
    found = line_branches(robot, Pose((3.0, 0.0, 0.0)), (0.1, 0.0, 0.0))
    assert (found.lines, found.complete, found.ends) == ((), True, 0.0)


def test_what_is_no_line_is_refused() -> None:
    robot = load_robot("wxai")
    pose = Pose.from_matrix(robot.tool_pose(robot.home))
    for given, words in (
        ({"to": (0.0, 1.0)}, "to"),
        ({"begin": (0.0, 0.0, 0.0)}, "begin"),
        ({"still": [0.0]}, "still"),
        ({"points": 1}, "points"),
        ({"max_joint_rate": -1.0}, "max_joint_rate"),
        ({"robot": "wxai"}, "robot"),
    ):
        with pytest.raises(InvalidRequest, match=words):
            line_branches(**({"robot": robot, "begin": pose, "to": (0.0, 0.0, 0.1)} | given))  # type: ignore[arg-type]
    lines = [ToolLine(np.zeros((1, 6)), 0.0)]
    made = LineBranches(lines, True)  # type: ignore[arg-type]
    lines.clear()
    assert len(made.lines) == 1
    with pytest.raises(InvalidRequest, match="ends"):
        LineBranches((), True, 1.5)
