"""Compiled inverse kinematics and straight tool lines have the bits of the Python code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from planner_service import Pose, Robot, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import cartesian_waypoints, inverse
from planner_service.kinematics import tool_arm as compiled_arm
from planner_service.kinematics.cartesian_waypoints import thinned
from planner_service.kinematics.inverse import ToolLine, inverse_kinematics, straight_tool_line
from planner_service.kinematics.tool_arm import tool_arm
from tests.support.optional import present

ROBOTS = ("wxai", "panda_mbm", "ur5", "planar2")


@contextmanager
def in_python() -> Iterator[None]:
    """Without the compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (inverse, cartesian_waypoints, compiled_arm):
            patch.setattr(module, "tool_arm", lambda robot, **_: None)
        yield


def lines(robot: Robot, count: int) -> Iterator[tuple[FloatArray, Pose]]:
    """Starts and ends of tool lines; some end early, some do not turn the tool, and some turn it by a little."""
    rng = np.random.default_rng(1)
    for k in range(count):
        q = rng.uniform(robot.limits.lower, robot.limits.upper)
        turn = rng.normal(size=3) * (0.0, 1e-9, 0.1, 0.5)[k % 4]
        yield (
            q,
            Pose.from_matrix(robot.tool_pose(q)) @ Pose.from_rpy((rng.normal(size=3) * 0.05).tolist(), turn.tolist()),
        )


def told(line: ToolLine) -> tuple[bytes, float, str]:
    return line.waypoints.tobytes(), line.fraction, str(line.stopped)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_straight_line_and_what_is_left_of_it_have_the_bits_of_python(name: str) -> None:
    robot, whole = load_robot(name), 0
    for q, to in lines(robot, 12):
        found = straight_tool_line(robot, q, to)
        kept = thinned(robot, found.waypoints, keep=(len(found.waypoints) // 3,))
        with in_python():
            assert told(found) == told(straight_tool_line(robot, q, to))
            assert kept.tobytes() == thinned(robot, found.waypoints, keep=(len(found.waypoints) // 3,)).tobytes()
        whole += found.stopped is None
    assert whole > 3 or name == "planar2"


@pytest.mark.parametrize("name", ["panda_mbm", "ur5"])
def test_inverse_kinematics_from_many_starts_has_the_bits_of_python(name: str) -> None:
    robot, found = load_robot(name), 0
    for q, pose in lines(robot, 8):
        solutions = inverse_kinematics(robot, pose, seeds=[q])
        with in_python():
            assert solutions.tobytes() == inverse_kinematics(robot, pose, seeds=[q]).tobytes()
        found += len(solutions)
    assert found > 8


@pytest.mark.parametrize("name", ROBOTS)
def test_an_ordinary_line_is_walked_by_the_compiled_code(name: str) -> None:
    robot = load_robot(name)
    found = [line for line in (straight_tool_line(robot, *ends) for ends in lines(robot, 12)) if line.stopped is None]
    for line in found:
        begin, end = (Pose.from_matrix(robot.tool_pose(q)) for q in (line.waypoints[0], line.waypoints[-1]))
        first, last = ([*pose.position, *pose.quaternion] for pose in (begin, end))
        assert (
            present(tool_arm(robot, closed_form=robot.inverse == "wxai")).walk(first, last, line.waypoints[0], 60)
            is not None
        )


def test_a_robot_is_turned_into_compiled_form_once(wxai: Robot) -> None:
    assert tool_arm(wxai) is tool_arm(wxai)


@pytest.mark.parametrize("points", [0, 1])
def test_a_line_of_fewer_than_two_points_is_refused(points: int, wxai: Robot) -> None:
    pose = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="at least two points"):
        present(tool_arm(wxai)).walk(pose, pose, wxai.home, points)
