"""As few waypoints of a straight tool line as keep the tool on it, and how widely their corners may be blended."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner_service.geometry.shapes import FloatArray, Pose, Sphere
from planner_service.kinematics.inverse import LINE_METRES, LINE_RADIANS, interpolate, rotation_distance
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot

__all__ = ["line_blends", "thinned"]

_SHARE = 0.6
"""What straight pieces may use of the line's tolerance."""

_BLEND_SHARE = 0.3
"""What blends may use of it. The rest is for deviations that are a little larger between samples than at them."""

_POINT = 1e-6
"""Metres: the tool frame's origin as a shape that its reach can be asked of."""

_DEEPEST = 5 / 24
"""A blend of width d passes its corner at ``d (v - u)`` times this, u and v the tangents before and after it."""

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


def line_blends(robot: Robot, waypoints: FloatArray) -> FloatArray:
    """How widely (rad) each corner of a thinned tool line (N, n) may be blended within the line's tolerance, (N,)."""
    path, tool = JointPath(waypoints), Pose.from_matrix(robot.tool_placement)
    reach = robot.reach([(robot.tool_body, Sphere(_POINT), tool)])
    widths = np.zeros(len(waypoints))
    if len(path.waypoints) < len(waypoints):
        return widths
    for k in path.corners:
        turn = np.abs(path(path.knots[k], 1) - path(path.knots[k - 1], 1)).tolist()
        metres = math.fsum(r * t for r, t in zip(reach.tolist(), turn, strict=True))
        widths[k] = _BLEND_SHARE / _DEEPEST / max(metres / LINE_METRES, math.fsum(turn) / LINE_RADIANS)
    return widths


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
