"""As few waypoints of a straight tool line as keep the tool on it: every corner of a polyline is a stop."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planner_service.geometry import FloatArray, Pose
from planner_service.kinematics import LINE_METRES, LINE_RADIANS, interpolate, rotation_distance
from planner_service.robot import Robot

__all__ = ["thinned"]

_SHARE = 0.9
"""What the sampled deviation may use of the line's tolerance: between samples it can be a little larger."""

_FRACTIONS = tuple(k / 8 for k in range(1, 8))


def thinned(robot: Robot, waypoints: FloatArray, *, keep: Sequence[int] = ()) -> FloatArray:
    """The rows of ``waypoints`` (N, n) that are needed, in order: with joints going straight from each to the next the
    tool stays within 1 mm and 5 mrad of the straight line between its poses there.

    Args:
        waypoints: A straight tool line, each piece of which keeps that tolerance itself.
        keep: Rows that must stay, beside the first and the last.
    """
    poses = [Pose.from_matrix(robot.tool_pose(q)) for q in waypoints]
    kept = [0]
    for stop in sorted({*keep, len(waypoints) - 1} - {0}):
        while kept[-1] < stop:
            here, span = kept[-1], stop - kept[-1]
            while span > 1 and not _fits(
                robot, waypoints[[here, here + span]].tolist(), poses[here], poses[here + span]
            ):
                span = max(1, span * 3 // 4)
            kept.append(here + span)
    return waypoints[kept]


def _fits(robot: Robot, ends: list[list[float]], first: Pose, last: Pose) -> bool:
    """Whether the tool stays near its line while the joints go straight from one end to the other."""
    for u in _FRACTIONS:
        tool = Pose.from_matrix(robot.tool_pose([a + (b - a) * u for a, b in zip(*ends, strict=True)]))
        if _aside(tool, first, last) > _SHARE * LINE_METRES:
            return False
        if rotation_distance(tool, interpolate(first, last, u)) > _SHARE * LINE_RADIANS:
            return False
    return True


def _aside(tool: Pose, first: Pose, last: Pose) -> float:
    """Distance in metres of the tool from the line through two positions."""
    ax, ay, az = (p - q for p, q in zip(tool.position, first.position, strict=True))
    bx, by, bz = (p - q for p, q in zip(last.position, first.position, strict=True))
    length = math.hypot(bx, by, bz)
    if length == 0.0:
        return math.hypot(ax, ay, az)
    return math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx) / length
