"""A motion under way in Python: the same bits as native/timing/underway.cpp."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.replanning.splice import Underway
from planner_service.robot.model import JointLimits

__all__ = ["braked", "moved", "rest"]

MEETING, SLIVER, MIN_SHARE, INTERVALS = 5e-10, 1e-12, 1e-12, 24

Row = tuple[float, float, float, float, float]
"""A piece of s(t): seconds, and four coefficients."""


def moved(motion: Underway, s: float) -> float:
    """An arc length of the old path on what is left of it: of two breaks within reach the first."""
    first = len(motion.trajectory.path.waypoints) - len(motion.path.waypoints)
    left = min(max(s - float(motion.trajectory.path.knots[first]), 0.0), motion.path.length)
    return next((b for b in motion.path.breaks.tolist() if abs(b - left) <= MEETING), left)


def rows(motion: Underway, until: float) -> list[Row]:
    """The old law from the splice on."""
    law, out = motion.trajectory, list[Row]()
    pieces = zip(law.knots.tolist(), law.durations.tolist(), law.coefficients.tolist(), strict=False)
    for began, h, (c0, c1, c2, c3) in pieces:
        x, end = max(motion.splice - began, 0.0), min(until - began, h)
        if end - x > SLIVER:
            at = moved(motion, c0 + x * (c1 + x * (c2 + x * c3)))
            rate = max(c1 + x * (2.0 * c2 + 3.0 * c3 * x), 0.0)
            out.append((end - x, at, rate, c2 + 3.0 * c3 * x, c3))
    return out


def rest(motion: Underway) -> Trajectory:
    """The old motion from the splice on."""
    return along(motion, motion.path, rows(motion, motion.trajectory.duration), motion.end)


def along(motion: Underway, path: JointPath, table: Sequence[Row], end: float) -> Trajectory:
    """The motion that rows describe."""
    array = np.array(table)
    return Trajectory(path, array[:, 0], array[:, 1:], motion.trajectory.dilation, (table[0][1], end))


def braked(motion: Underway, since: float, limits: JointLimits, margin: float) -> tuple[list[Row], float] | None:
    """The rows of the stop that begins at an instant, and where it ends; None if the old law rests before."""
    s, rate = moved(motion, float(motion.trajectory.s(since))), float(motion.trajectory.s(since, 1))
    path, out, most = motion.path, list[Row](), limits.acceleration.tolist()
    end = min([k for k in path.knots[list(path.corners)].tolist() if k > s], default=motion.end)
    while s < min(end, motion.end):
        piece = path.pieces_at(np.array([s]))
        at = grid(path, s, int(piece[0]), min(end, motion.end))
        slopes, bends = (path.on_pieces(np.repeat(piece, len(at)), at, order).tolist() for order in (1, 2))
        for k, (a, b) in enumerate(pairwise(at.tolist())):
            square, length = rate * rate, b - a
            found = window(slopes[k : k + 2], bends[k : k + 2], square, length, most)
            if found is None:
                found = window(slopes[k : k + 1], bends[k : k + 1], square, length, most)
            if found is None:
                return None
            change = found[0] + margin * (found[1] - found[0])
            square += 2.0 * change * length
            if square <= 0.0:
                out.append((rate / -change, a, rate, change / 2.0, 0.0))
                return out, min(a + rate * rate / (-2.0 * change), b)
            after = math.sqrt(square)
            out.append((2.0 * (b - a) / (rate + after), a, rate, change / 2.0, 0.0))
            rate = after
        s = float(at[-1])
    return None


def grid(path: JointPath, s: float, piece: int, end: float) -> FloatArray:
    """Arc lengths from s to the end of its piece, or to ``end`` if that is nearer: in small steps on a blend."""
    begins, ends = path.breaks[piece : piece + 2].tolist()
    stop = min(ends, end)
    steps = max(1, math.ceil(INTERVALS * (stop - s) / (ends - begins))) if path.blended[piece] else 1
    return np.asarray(np.minimum(s + (stop - s) * (np.arange(steps + 1) / steps), stop))


def window(
    slopes: Sequence[Sequence[float]],
    bends: Sequence[Sequence[float]],
    square: float,
    length: float,
    acceleration: Sequence[float],
) -> tuple[float, float] | None:
    """The least and the largest d2s/dt2 within the limits at both ends of an interval, or at the first alone."""
    low, high = -math.inf, math.inf
    for twice, q1, q2 in zip((0.0, 2.0 * length), slopes, bends, strict=False):
        for slope, bend, most in zip(q1, q2, acceleration, strict=True):
            per_change = slope + twice * bend  # at the second end the square is square + 2 length u
            if abs(per_change) > MIN_SHARE:
                fixed = bend * square
                a, b = (-most - fixed) / per_change, (most - fixed) / per_change
                low, high = max(low, min(a, b)), min(high, max(a, b))
    return (low, high) if -math.inf < low <= high else None
