"""Compiled straight tool lines have the bits of the Python code that walks those that end early."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from planner_service import Pose, Robot, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import inverse
from planner_service.kinematics.inverse import ToolLine, straight_tool_line

ROBOTS = ("wxai", "panda_mbm", "planar2")


class Lazy:
    """A compiled arm that leaves every line to Python."""

    def walk(self, *_: object) -> None:
        return None


@contextmanager
def in_python() -> Iterator[None]:
    """Every line as one that ends early is walked."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inverse, "tool_arm", lambda robot, **_: Lazy())
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
        with in_python():
            assert told(found) == told(straight_tool_line(robot, q, to))
        whole += found.stopped is None
    assert whole > 3 or name == "planar2"
