"""Thins the waypoints of a tool path while the tool stays on it, and says how wide their blends may be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from planner_service.geometry.arrays import FloatArray, Vector
from planner_service.geometry.shapes import Pose, Sphere
from planner_service.kinematics.tool_arm import tool_arm
from planner_service.kinematics.tool_line import LINE_METRES, LINE_RADIANS
from planner_service.kinematics.tool_path import ToolPath
from planner_service.kinematics.turning_tool import with_turns
from planner_service.path.corner_blend import BLEND_SHARE
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot

__all__ = ["line_blends", "stop_rows", "thinned", "thinned_along"]

_SHARE = 0.6
"""Share of the line's tolerance for straight pieces."""

_BLEND_SHARE = 0.3
"""Share of it for blends. The rest allows for deviations that are slightly larger between samples than at them."""

_POINT = 1e-6
"""Metres: the radius of a sphere that stands for the tool frame's origin."""

_CORNER_DISTANCE = 5 / 24
"""A blend of width d passes its corner at this times ``d (v - u)``, with the tangents u before and v after it."""

FIRST_SPAN, SPAN_FACTORS = 8, (3.0, 1.6, 1.2, 1.0, 0.8, 0.6, 0.4, 0.2)
"""Rows that a span is tried with first, and spans tried at once, as factors of the last one."""

CORNER_STEPS = 12
"""Each at least halves how far a blend misses its row."""

WIDEST = 1.0
"""Radians. Pieces are shorter, and a blend takes at most half of one."""

PROBE = 1e-3
"""Metres along a path over which its tangent is measured; the nearest place is looked for within ten times that."""

NO_TURNS: FloatArray = np.zeros(0)

_FRACTIONS = tuple(k / 8 for k in range(1, 8))


def thinned(robot: Robot, waypoints: FloatArray, *, keep: Sequence[int] = ()) -> FloatArray:
    """The rows of ``waypoints`` (N, n) that keep the tool on its line, in order.

    While the joints go straight from each row to the next, the tool stays within 1 mm and 5 mrad of the straight line
    between its poses at both.

    Args:
        waypoints: A straight tool line, each piece of which is within that tolerance.
        keep: Rows that must stay, in addition to the first and last.
    """
    arm, stops = tool_arm(robot, numeric=True), sorted({*keep, len(waypoints) - 1} - {0})
    return waypoints[arm.thinned(np.ascontiguousarray(waypoints, dtype=np.float64), stops)]


def thinned_along(
    robot: Robot,
    waypoints: FloatArray,
    at: FloatArray,
    path: ToolPath,
    turns: FloatArray = NO_TURNS,
    free_axis: Vector | None = None,
) -> tuple[FloatArray, FloatArray]:
    """A polyline (K, n) that keeps the tool on a path, and how wide its corners may be blended (rad), (K,).

    However widely they are blended, a pose of the path is within 1 mm and 5 mrad of the tool everywhere. Blended as
    widely as they may be, the corners pass through rows of ``waypoints``: a blend cuts its corner, so the corner is
    moved outwards by as much, at most 0.3 mm and 1.5 mrad of the tool. The path's stops are rows, and not blended.

    Args:
        waypoints: Configurations (N, n). Each piece between two is within that tolerance.
        at: Metres travelled along the path up to each, (N,).
        turns: As in ``ToolLine``, with the tool's ``free_axis`` if it has one.
    """
    stops = stop_rows(at, path)
    arm, rows = with_turns(robot, waypoints, turns, free_axis)
    kept = _kept_along(arm, rows, at, path, sorted({*stops, len(at) - 1} - {0}))
    free = np.array([row not in stops and row != len(at) - 1 for row in kept])
    points = waypoints[kept]
    corners, widths = _moved_corners(robot, points, np.where(free, WIDEST, 0.0))
    (before, turn_before), (after, turn_after) = _tools(robot, points), _tools(robot, corners)
    metres = np.sqrt(_sum_squares(after - before))
    radians = np.sqrt(_sum_squares((turn_after - turn_before).reshape(-1, 9)) / 2.0)
    share = np.maximum(metres / LINE_METRES, radians / LINE_RADIANS) / _BLEND_SHARE
    return _moved_corners(robot, points, widths / np.maximum(share, 1.0))


def stop_rows(at: FloatArray, path: ToolPath) -> list[int]:
    """The rows at which the tool stops; ``at`` (N,) as in ``thinned_along``."""
    return [row for row in np.searchsorted(at, [path.knots[k] for k in path.stops]).tolist() if row < len(at)]


def _moved_corners(robot: Robot, points: FloatArray, widest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (K, n) whose blends pass through ``points`` (K, n), and the widths of these blends (rad), (K,)."""
    corners, widths, free = points.copy(), np.zeros(len(points)), widest > 0.0
    for _ in range(CORNER_STEPS if free.any() else 0):
        steps = corners[1:] - corners[:-1]
        lengths = np.sqrt(_sum_squares(steps))
        tangents = steps / lengths[:, None]
        widths[1:-1] = np.minimum(BLEND_SHARE * np.minimum(lengths[1:], lengths[:-1]), widest[1:-1])
        moved = points[1:-1] - _CORNER_DISTANCE * widths[1:-1, None] * (tangents[1:] - tangents[:-1])
        corners[1:-1][free[1:-1]] = moved[free[1:-1]]
        corners = np.minimum(np.maximum(corners, robot.limits.lower), robot.limits.upper)
    return corners, widths


def _kept_along(robot: Robot, waypoints: FloatArray, at: FloatArray, path: ToolPath, stops: Sequence[int]) -> list[int]:
    """Rows, the ``stops`` among them, between which the joints can go straight with the tool near the path."""
    kept, usual = [0], FIRST_SPAN
    for stop in stops:
        while kept[-1] < stop:
            first, most = kept[-1], stop - kept[-1]
            spans = sorted({min(most, max(1, round(usual * factor))) for factor in SPAN_FACTORS}, reverse=True)
            fits = _fits_along(robot, waypoints, at, path, first, spans)
            usual = next((span for span, fit in zip(spans, fits, strict=True) if fit), 1)
            if usual < most < 2 * usual:
                usual = (most + 1) // 2  # two equal pieces, rather than one that is as long as it may be and a rest
            kept.append(first + usual)
    return kept


def _fits_along(
    robot: Robot, waypoints: FloatArray, at: FloatArray, path: ToolPath, first: int, spans: list[int]
) -> list[bool]:
    """For each span whether the tool stays near the path while the joints go straight from row ``first`` that far.

    Each sample is compared with the path where it should be, and with where the path is nearest.
    """
    ends, u = [first + span for span in spans], np.array(_FRACTIONS)[:, None]
    Q = waypoints[first] + u * (waypoints[ends] - waypoints[first])[:, None]
    s = (at[first] + u[:, 0] * (at[ends] - at[first])[:, None]).ravel()
    tip, turn = _tools(robot, Q.reshape(-1, waypoints.shape[1]))
    due, due_turn = path.poses_at(s)
    tangent = path.poses_at(s + PROBE)[0] - path.poses_at(s - PROBE)[0]
    size = np.maximum(_sum_squares(tangent), 1e-30)
    shift = ((tip - due) * tangent).cumsum(axis=1)[:, -1] / size * (2.0 * PROBE)
    near, near_turn = path.poses_at(s + np.minimum(np.maximum(shift, -PROBE * 10.0), PROBE * 10.0))
    good = np.zeros(len(s), dtype=np.bool_)
    for position, rotation in ((due, due_turn), (near, near_turn)):
        metres, turns = _sum_squares(tip - position), _sum_squares((turn - rotation).reshape(-1, 9))
        good |= (metres <= (_SHARE * LINE_METRES) ** 2) & (turns <= 8.0 * math.sin(_SHARE * LINE_RADIANS / 2.0) ** 2)
    return [bool(samples.all()) for samples in good.reshape(len(spans), -1)]


def _tools(robot: Robot, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (m, 3) and rotation matrices (m, 3, 3) of the tool at configurations (m, n)."""
    R, t = robot.body_poses_batch(Q, portable=True)
    place, body = robot.tool_placement, R[:, robot.tool_body]
    return t[:, robot.tool_body] + _product(body, place[:3, 3:])[..., 0], _product(body, place[:3, :3])


def _product(A: FloatArray, B: FloatArray) -> FloatArray:
    """The products of matrices (k, 3, 3) with one matrix (3, m), (k, 3, m)."""
    return np.asarray(A[..., :1] * B[0] + A[..., 1:2] * B[1] + A[..., 2:] * B[2])


def _sum_squares(rows: FloatArray) -> FloatArray:
    """Of each row."""
    return np.asarray(np.add.accumulate(rows * rows, axis=1)[:, -1])


def line_blends(robot: Robot, waypoints: FloatArray) -> FloatArray:
    """The widest blend (rad) at each corner of a thinned tool line (N, n) within the line's tolerance, (N,)."""
    path, reach = JointPath(waypoints), _tool_reach(robot)
    widths = np.zeros(len(waypoints))
    if len(path.waypoints) < len(waypoints):
        return widths
    for k in path.corners:
        turn = np.abs(path.tangents[k] - path.tangents[k - 1]).tolist()
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
