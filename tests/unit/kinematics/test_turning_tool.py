"""Lines whose tool may turn about an axis: the axis keeps its way, no line is lost, and proofs hold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planner_service import PlannerService, Pose, Robot, Scene, load_robot, move_linear
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import line_branches, straight_tool_line
from planner_service.kinematics.tool_line import LINE_METRES, LINE_RADIANS
from planner_service.tasks import MoveLinear, Task, move_circular

AXIS = (0.6, 0.0, 0.8)
SO_101 = "example-robot-data:so101"
DOWN = Pose.from_rpy((0.25, -0.1, 0.05), (math.pi, 0.0, 0.0))


def drawn(robot: Robot, rng: np.random.Generator) -> tuple[Pose, Pose]:
    """The ends of a line of 0.1 to 0.3 m, the tool turned by up to half a radian on it."""
    begin = Pose.from_matrix(robot.tool_pose(rng.uniform(robot.limits.lower, robot.limits.upper)))
    way, turn = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
    x, y, z = (np.array(begin.position) + way * rng.uniform(0.1, 0.3) / math.sqrt(float(way @ way))).tolist()
    turned = Pose.from_rpy((0.0, 0.0, 0.0), tuple(turn.tolist())) @ Pose(quaternion=begin.quaternion)
    return begin, Pose((x, y, z), turned.quaternion)


def place(begin: Pose, end: Pose, u: float) -> tuple[FloatArray, FloatArray]:
    """Where the tool and its axis are after a share of the line: the axis on the great circle, evenly."""
    a, b = begin.rotation @ AXIS, end.rotation @ AXIS
    angle = math.acos(min(1.0, float(a @ b)))
    axis = (math.sin((1.0 - u) * angle) * a + math.sin(u * angle) * b) / math.sin(angle)
    return (1.0 - u) * np.array(begin.position) + u * np.array(end.position), axis


@pytest.mark.parametrize("name", ["ur5", SO_101])
def test_the_axis_goes_along_the_line(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(3)
    longest = list[float]()
    for _ in range(4):
        begin, end = drawn(robot, rng)
        found = line_branches(robot, begin, end, free_axis=AXIS)
        for line in found.lines[:3]:
            assert np.abs(np.diff(line.waypoints, axis=0)).max(initial=0.0) < 0.3
            first = robot.tool_pose(line.waypoints[0])[:3, :3]
            for row, u, turn in zip(line.waypoints, line.fractions, line.turns, strict=True):
                T, (position, axis) = robot.tool_pose(row), place(begin, end, float(u))
                np.testing.assert_allclose(T[:3, 3], position, atol=1e-6)
                np.testing.assert_allclose(T[:3, :3] @ AXIS, axis, atol=1.5e-4)
                swing, at = (T[:3, :3] @ first.T), first @ AXIS
                back = np.trace(swing @ _about(at, -turn))  # what is left is the shortest rotation of the axis
                assert abs((back - 1.0) / 2.0 - at @ axis) < 1e-4
        longest.append(max((line.fraction for line in found.lines), default=0.0))
        assert found.ends is None or longest[-1] <= found.ends
    assert max(longest) > 0.5


def _about(axis: FloatArray, angle: float) -> FloatArray:
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K)


def test_freeing_an_axis_loses_no_line_and_wins_some() -> None:
    robot, rng = load_robot("wxai"), np.random.default_rng(3)
    more = 0
    for _ in range(6):
        begin, end = drawn(robot, rng)
        fixed, free = line_branches(robot, begin, end), line_branches(robot, begin, end, free_axis=AXIS)
        assert not fixed.whole or free.whole
        assert not free.proven or fixed.whole is None
        more += free.whole is not None and fixed.whole is None
    assert more >= 1


def test_nothing_follows_a_line_beyond_where_it_is_proven_to_end() -> None:
    """Steps with the axis within 0.9 of the tolerance of its way, from configurations near its start."""
    robot, rng, own = load_robot(SO_101), np.random.default_rng(3), np.random.default_rng(2)
    proven = 0
    for _ in range(4):
        begin, end = drawn(robot, rng)
        found = line_branches(robot, begin, end, free_axis=AXIS)
        if found.ends is not None:
            proven += 1
            assert all(furthest(robot, line.waypoints[0], begin, end, own) <= found.ends for line in found.lines)
    assert proven >= 2


def furthest(robot: Robot, q: FloatArray, begin: Pose, end: Pose, rng: np.random.Generator) -> float:
    """How far small steps of damped least squares come that may leave the line by nearly as much as is allowed."""
    off, lean = (rng.normal(size=3) for _ in range(2))
    off *= 0.9 * LINE_METRES / math.sqrt(float(off @ off))
    lean *= 0.9 * LINE_RADIANS / math.sqrt(float(lean @ lean))
    for k in range(1, 101):
        (position, axis), share, before = place(begin, end, k / 100), min(1.0, k / 20), q
        wanted = axis + share * lean
        for _ in range(6):
            T, J = robot.tool_pose(q), robot.tool_jacobian(q)
            have = T[:3, :3] @ AXIS
            error = np.concatenate([position + share * off - T[:3, 3], np.cross(have, wanted)])
            rows = np.concatenate([J[:3], (np.eye(3) - np.outer(have, have)) @ J[3:]])
            step = rows.T @ np.linalg.solve(rows @ rows.T + 1e-7 * np.eye(6), error)
            q = np.clip(q + step, robot.limits.lower, robot.limits.upper)
        T = robot.tool_pose(q)
        apart = float(np.abs(q - before).max()) > 0.2 or math.dist(T[:3, 3], position) > LINE_METRES
        if apart or math.acos(min(1.0, float(T[:3, :3] @ AXIS @ axis))) > LINE_RADIANS:
            return (k - 1) / 100
    return 1.0


def test_an_arm_of_five_joints_draws_with_an_upright_pen() -> None:
    """Which its URDF, rounded to six digits, does not allow exactly."""
    arm = load_robot(SO_101)
    service, ways = PlannerService(arm, Scene()), [(0.0, 0.15, 0.0), (-0.03, 0.0, 0.0), (0.0, -0.1, 0.0)]
    fixed = move_linear(service, DOWN, ways[0])
    assert fixed.failure is not None
    assert fixed.failure.proven
    for goal in (ways[0], ways):
        result = move_linear(service, DOWN, goal, zone=0.01, free_axis=(0.0, 0.0, 1.0))
        path, _ = result.unwrap()
        tools = np.array([arm.tool_pose(q) for q in path(np.linspace(0.0, path.length, 200))])
        assert np.abs(tools[:, 2, 3] - 0.05).max() < LINE_METRES
        assert np.arccos(np.minimum(-tools[:, 2, 2], 1.0)).max() < LINE_RADIANS
        np.testing.assert_allclose(tools[0, :3, 3], DOWN.position, atol=1e-6)
    again = move_linear(service, path(0.0), ways[0], free_axis=(0.0, 0.0, 2.0))
    assert again.fraction == 1.0
    arc = move_circular(service, path(0.0), (-0.05, 0.05, 0.0), (0.0, 0.1, 0.0), free_axis=(0.0, 0.0, 1.0))
    round_path, _ = arc.unwrap()
    tips = np.array([arm.tool_pose(q)[:3, 3] for q in round_path(np.linspace(0.0, round_path.length, 100))])
    centre = np.add(DOWN.position, (0.0, 0.05, 0.0))
    assert np.abs(np.sqrt(((tips - centre) ** 2).sum(axis=1)) - 0.05).max() < LINE_METRES
    np.testing.assert_allclose(tips[-1], np.add(DOWN.position, (0.0, 0.1, 0.0)), atol=1e-6)
    steps = (MoveLinear(ways[0], free_axis=(0.0, 0.0, 1.0)), MoveLinear((0.0, -0.15, 0.0)))
    task = service.solve(Task(steps), path(0.0))
    assert [segment.name for segment in task.segments] == ["line"]  # the second has no free axis
    tilted = replace(DOWN, quaternion=Pose.from_rpy((0.0, 0.0, 0.0), (2.8, 0.0, 0.0)).quaternion)
    blocked = straight_tool_line(arm, path(0.0), tilted, free_axis=(0.0, 0.0, 1.0))
    assert "no joint turns the tool's axis as the line does" in str(blocked.stopped)


def test_what_is_no_axis_is_refused() -> None:
    robot = load_robot("wxai")
    for axis in ((0.0, 0.0, 0.0), (1.0, 0.0), "z", 3.0, (math.nan, 0.0, 1.0)):
        with pytest.raises(InvalidRequest, match="free_axis"):
            straight_tool_line(robot, robot.home, (0.0, 0.0, 0.01), free_axis=axis)  # type: ignore[arg-type]
        with pytest.raises(InvalidRequest, match="free_axis"):
            move_linear(PlannerService(robot, Scene()), robot.home, (0.0, 0.0, 0.01), free_axis=axis)  # type: ignore[arg-type]
