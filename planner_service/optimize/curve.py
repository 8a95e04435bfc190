"""The curve that is optimised: a few corners, each blended as widely as its pieces allow.

It is, to the last bit, the ``JointPath`` that is later proven and timed. While its corners hardly move, each of its
points is a weighted mean of three corners: costs and constraints on points are costs and constraints on corners.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray, joint_distance
from planner_service.path.corner_blend import BLEND_SHARE, integral
from planner_service.path.joint_path import JointPath

__all__ = ["IntArray", "Samples", "course_path", "evenly", "sampled", "squares", "summed"]


@dataclass(frozen=True, eq=False)
class Samples:
    """Points of a curve as means of three corners: corner ``first + j`` weighs ``weights[:, j]``; (m,), (m, 3)."""

    first: IntArray
    weights: FloatArray

    def of(self, corners: FloatArray) -> FloatArray:
        """The points (m, n) for corners (c, n)."""
        a, b, c = (corners[self.first + j] * self.weights[:, j, None] for j in range(3))
        return np.asarray(a + b + c)

    def matrix(self, count: int) -> FloatArray:
        """The weights of all ``count`` corners, (m, count)."""
        out = np.zeros((len(self.first), count))
        rows = np.arange(len(self.first))
        for j in range(3):
            out[rows, self.first + j] = self.weights[:, j]
        return out


def summed(terms: FloatArray) -> FloatArray:
    """The sum over the first axis, in order, for equal bits on every processor."""
    return np.asarray(np.add.accumulate(terms, axis=0)[-1]) if len(terms) else np.zeros(terms.shape[1:])


def evenly(waypoints: FloatArray, count: int) -> FloatArray:
    """``count`` points at equal arc lengths along a polyline (N, n), with its ends bit for bit."""
    lengths = [joint_distance(a, b) for a, b in pairwise(waypoints.tolist())]
    knots = np.array(list(accumulate(lengths, initial=0.0)))
    at = knots[-1] * (np.arange(count) / (count - 1))
    piece = np.minimum(knots.searchsorted(at, side="right") - 1, len(lengths) - 1)
    share = (at - knots[piece]) / np.maximum(knots[piece + 1] - knots[piece], 1e-300)
    out = waypoints[piece] + (waypoints[piece + 1] - waypoints[piece]) * np.clip(share, 0.0, 1.0)[:, None]
    out[0], out[-1] = waypoints[0], waypoints[-1]
    return np.asarray(out)


def _widths(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The lengths of the pieces, (c - 1,), and the blend width at each corner, (c,)."""
    lengths = np.array([joint_distance(a, b) for a, b in pairwise(corners.tolist())])
    widths = np.zeros(len(corners))
    path = JointPath(corners)
    if len(path.waypoints) == len(corners):
        widths[1:-1] = BLEND_SHARE * np.minimum(lengths[:-1], lengths[1:])
        widths[[k for k in range(1, len(corners) - 1) if path.turns_back(k)]] = 0.0
    return lengths, widths


def course_path(corners: FloatArray) -> JointPath:
    """The curve with these corners (c, n); a corner that almost turns back is a stop."""
    _, widths = _widths(corners)
    return JointPath(corners, widths) if widths.any() else JointPath(corners)


def sampled(corners: FloatArray, count: int) -> Samples:
    """``count`` points of the curve, equally many on each piece between its corners (c, n), c >= 3."""
    last = len(corners) - 1
    lengths, widths = _widths(corners)
    u = last * (np.arange(count) / (count - 1))
    piece = np.minimum(u.astype(np.intp), last - 1)
    share = u - piece
    near = np.clip(piece + (share > 0.5), 1, last - 1)  # the inner corner whose blend may reach here
    length = lengths[piece]
    along = np.where(piece < near, share - 1.0, share) * length  # from that corner
    width = widths[near]
    on = np.abs(along) < width
    y = np.where(on, along / np.where(width > 0.0, width, 1.0), 0.0)
    turned = integral(y)
    before = width / np.maximum(lengths[near - 1], 1e-300) * (turned - y)
    after = width / np.maximum(lengths[near], 1e-300) * turned
    weights = np.empty((count, 3))
    weights[:, 0] = np.where(on, before, np.where(piece < near, 1.0 - share, 0.0))
    weights[:, 2] = np.where(on, after, np.where(piece < near, 0.0, share))
    weights[:, 1] = 1.0 - weights[:, 0] - weights[:, 2]
    return Samples(near - 1, weights)


def squares(points: FloatArray) -> tuple[float, float]:
    """The sums of the squared first and second differences of points (N, n)."""
    first = points[1:] - points[:-1]
    second = first[1:] - first[:-1]
    return math.fsum((first * first).ravel().tolist()), math.fsum((second * second).ravel().tolist())
