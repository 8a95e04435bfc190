"""Thins the waypoints of a straight tool line while the tool stays on it, and says how wide their blends may be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose, Sphere
from planner_service.kinematics.inverse import LINE_METRES, LINE_RADIANS, interpolate, rotation_distance
from planner_service.kinematics.tool_arm import tool_arm
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot

__all__ = ["line_blends", "thinned"]

_SHARE = 0.6
"""Share of the line's tolerance for straight pieces."""

_BLEND_SHARE = 0.3
"""Share of it for blends. The rest allows for deviations that are slightly larger between samples than at them."""

_POINT = 1e-6
"""Metres: the radius of a sphere that stands for the tool frame's origin."""

_CORNER_DISTANCE = 5 / 24
"""A blend of width d passes its corner at this times ``d (v - u)``, with the tangents u before and v after it."""

_FRACTIONS = tuple(k / 8 for k in range(1, 8))


def thinned(robot: Robot, waypoints: FloatArray, *, keep: Sequence[int] = ()) -> FloatArray:
    """The rows of ``waypoints`` (N, n) that keep the tool on its line, in order.

    While the joints go straight from each row to the next, the tool stays within 1 mm and 5 mrad of the straight line
    between its poses at both.

    Args:
        waypoints: A straight tool line, each piece of which is within that tolerance.
        keep: Rows that must stay, in addition to the first and last.
    """
    arm, stops = tool_arm(robot), sorted({*keep, len(waypoints) - 1} - {0})
    if arm is None:
        return waypoints[_thinned(robot, waypoints, stops)]
    return waypoints[arm.thinned(np.ascontiguousarray(waypoints, dtype=np.float64), stops)]


def _thinned(robot: Robot, waypoints: FloatArray, stops: Sequence[int]) -> list[int]:
    """The rows that are kept: the reference of ``ToolArm.thinned``."""
    poses = [Pose.from_matrix(robot.tool_pose(q)) for q in waypoints]
    kept = [0]
    for stop in stops:
        while kept[-1] < stop:
            first, span = kept[-1], stop - kept[-1]
            while span > 1 and not _fits(
                robot, waypoints[[first, first + span]].tolist(), poses[first], poses[first + span]
            ):
                span = max(1, span * 3 // 4)
            kept.append(first + span)
    return kept


def line_blends(robot: Robot, waypoints: FloatArray) -> FloatArray:
    """The widest blend (rad) at each corner of a thinned tool line (N, n) within the line's tolerance, (N,)."""
    path, reach = JointPath(waypoints), _tool_reach(robot)
    widths = np.zeros(len(waypoints))
    if len(path.waypoints) < len(waypoints):
        return widths
    for k in path.corners:
        turn = np.abs(path(path.knots[k], 1) - path(path.knots[k - 1], 1)).tolist()
        metres = math.fsum(r * t for r, t in zip(reach, turn, strict=True))
        widths[k] = _BLEND_SHARE / _CORNER_DISTANCE / max(metres / LINE_METRES, math.fsum(turn) / LINE_RADIANS)
    return widths


@lru_cache(maxsize=16)
def _tool_reach(robot: Robot) -> list[float]:
    """Metres that the tool frame's origin moves per unit of each joint at most."""
    reach: list[float] = robot.reach(
        [(robot.tool_body, Sphere(_POINT), Pose.from_matrix(robot.tool_placement))]
    ).tolist()
    return reach


def _fits(robot: Robot, ends: list[list[float]], first: Pose, last: Pose) -> bool:
    """Whether the tool stays near its line while the joints go straight from one end to the other."""
    for u in _FRACTIONS:
        tool = Pose.from_matrix(robot.tool_pose([a + (b - a) * u for a, b in zip(*ends, strict=True)]))
        if _distance_from_line(tool, first, last) > _SHARE * LINE_METRES:
            return False
        if rotation_distance(tool, interpolate(first, last, u)) > _SHARE * LINE_RADIANS:
            return False
    return True


def _distance_from_line(tool: Pose, first: Pose, last: Pose) -> float:
    """The distance (m) of the tool from the line through two positions."""
    ax, ay, az = (p - q for p, q in zip(tool.position, first.position, strict=True))
    bx, by, bz = (p - q for p, q in zip(last.position, first.position, strict=True))
    length = math.hypot(bx, by, bz)
    if length == 0.0:
        return math.hypot(ax, ay, az)
    return math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx) / length
