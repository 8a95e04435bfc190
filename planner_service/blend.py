"""The blend that replaces a corner of a polyline: a quartic that meets both straight pieces with equal curvature.

At a waypoint W, with unit tangents u before and v after it, the corner from d before to d after it is replaced by

    dq/ds = u + (v - u) f(x),   f(x) = 3 x^2 - 2 x^3,   x = (s - s_W + d) / (2 d) in [0, 1].

Its integral runs from ``W - d u`` to ``W + d v``. f has slope 0 at both ends, so the second derivative is zero there:
the curve is C2 and its third derivative bounded. As f grows from 0 to 1, the blend is no longer than the corner
(abs(dq/ds) <= 1), turns each joint back at most once, and stays in the triangle of the corner, hence inside every
joint limit. Functions here take k blends at once, and one x for each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry import FloatArray, read_only

__all__ = ["Blends"]

IntArray = NDArray[np.intp]


def _share(x: FloatArray) -> FloatArray:
    """How far the tangent has turned from u to v at x."""
    return np.asarray(x * x * (3.0 - 2.0 * x))


def _integral(x: FloatArray) -> FloatArray:
    return np.asarray(x * x * x * (1.0 - 0.5 * x))


@dataclass(frozen=True, eq=False)
class Blends:
    """The blends of a path, in order: where they start in s, d, W - d u, and u and v; shapes (k,) and (k, n)."""

    start: FloatArray
    width: FloatArray
    origin: FloatArray
    before: FloatArray
    after: FloatArray
    turning: FloatArray
    """x at which each joint turns back, shape (k, n); 1 where it does not."""

    @classmethod
    def at(
        cls, s: FloatArray, width: FloatArray, corner: FloatArray, tangents: tuple[FloatArray, FloatArray]
    ) -> Blends:
        """Blends of half width ``width`` around corners at arc length s, with the tangents before and after them."""
        before, after = tangents
        origin = corner - before * width[:, None]
        parts = (s - width, width, origin, before, after, _turning(before, after))
        return cls(*(read_only(part) for part in parts))

    def position(self, row: IntArray, s: FloatArray) -> FloatArray:
        """Configurations, shape (k, n); never outside the box of the corner's three points."""
        corner = self.origin[row] + self.before[row] * self.width[row, None]
        end = corner + self.after[row] * self.width[row, None]
        q = self.origin[row] + self._moved(row, self._x(row, s)[:, None])
        low = np.minimum(np.minimum(self.origin[row], corner), end)
        high = np.maximum(np.maximum(self.origin[row], corner), end)
        return np.asarray(np.minimum(np.maximum(q, low), high))

    def derivative(self, row: IntArray, s: FloatArray, order: int) -> FloatArray:
        """dq/ds (order 1) and its derivatives (2, 3), shape (k, n)."""
        x = self._x(row, s)[:, None]
        before, turn = self.before[row], self.after[row] - self.before[row]
        if order == 1:
            return np.asarray(before + turn * _share(x))
        length = 2.0 * self.width[row, None]
        if order == 2:
            return np.asarray(turn * (6.0 * x * (1.0 - x)) / length)
        return np.asarray(turn * (6.0 - 12.0 * x) / (length * length))

    def travel(self, row: IntArray, s: FloatArray) -> FloatArray:
        """What each joint has moved in total since the start of its blend, there and back, shape (k, n)."""
        x = self._x(row, s)[:, None]
        halfway = np.minimum(x, self.turning[row])
        there = self._moved(row, halfway)
        return np.asarray(np.abs(there) + np.abs(self._moved(row, x) - there))

    def _x(self, row: IntArray, s: FloatArray) -> FloatArray:
        x = (s - self.start[row]) / (2.0 * self.width[row])
        return np.asarray(np.minimum(np.maximum(x, 0.0), 1.0))

    def _moved(self, row: IntArray, x: FloatArray) -> FloatArray:
        """q - origin at x, of shape (k, 1) or (k, n)."""
        turned = _integral(x)
        along = self.before[row] * (x - turned) + self.after[row] * turned
        return np.asarray(along * (2.0 * self.width[row, None]))


def _turning(before: FloatArray, after: FloatArray) -> FloatArray:
    """x at which u + (v - u) f(x) is zero where u and v have different signs, else 1."""
    out = np.ones_like(before)
    for row, joint in zip(*np.nonzero(before * after < 0.0), strict=True):
        share = before[row, joint] / (before[row, joint] - after[row, joint])
        # the root of 3 x^2 - 2 x^3 = share in [0, 1], by the cubic's trigonometric solution
        out[row, joint] = 0.5 - math.sin(math.asin(1.0 - 2.0 * share) / 3.0)
    return out
