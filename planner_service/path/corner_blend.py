"""The blend that replaces a corner of a polyline: a curve that meets both straight pieces with equal curvature.

At a waypoint W, with unit tangents u before and v after it, the corner from d before to d after it is replaced by

    dq/ds = u + (v - u) f(y),   f(y) = 1/2 + (5 y - y^5) / 8,   y = (s - s_W) / d in [-1, 1].

Its integral, of degree six, runs from ``W - d u`` to ``W + d v``. f has slope 0 at both ends, so the second derivative
is zero there: the curve is C2, with a bounded third derivative. The slope of f is at most 5/8 (a cubic's reaches 3/4),
so joints may pass the corner faster. Because f grows from 0 to 1, the blend is no longer than the corner
(abs(dq/ds) <= 1), turns each joint back at most once, and stays in the triangle of the corner, hence within the joint
limits. The functions take k blends at once, and one s for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["BLEND_SHARE", "STEEPEST", "STEEPEST_SLOPE", "Blends", "integral"]

BLEND_SHARE = 0.499
"""Share of a piece that the blends at its ends may each take, which leaves a run-up for the closed-form timing laws."""


STEEPEST, STEEPEST_SLOPE = 0.625, 2.5
"""The largest df/dy, at y = 0, and the largest abs of d2f/dy2, at y = -1 and 1."""

NEWTON_STEPS = 6
"""Five are enough to converge to rounding from the initial value used."""


def _share(y: FloatArray) -> FloatArray:
    """f(y): how far the tangent has turned from u to v."""
    square = y * y
    return np.asarray(0.5 + y * (5.0 - square * square) / 8.0)


def integral(y: FloatArray) -> FloatArray:
    """The integral of f from -1 to y; 1 at y = 1."""
    square = y * y
    return np.asarray((y + 1.0) / 2.0 + (square - 1.0) * 0.3125 - (square * square * square - 1.0) / 48.0)


@dataclass(frozen=True, eq=False)
class Blends:
    """The blends of a path, in order.

    Attributes:
        s: Arc length at each corner, (k,).
        width: d of each blend, (k,).
        start: Where each blend starts, (k, n).
        low, high: The box around each corner and the ends of its blend, (k, n).
        before, after: The unit tangents u and v, (k, n).
    """

    s: FloatArray
    width: FloatArray
    start: FloatArray
    low: FloatArray
    high: FloatArray
    before: FloatArray
    after: FloatArray

    @classmethod
    def at(
        cls, s: FloatArray, width: FloatArray, corner: FloatArray, tangents: tuple[FloatArray, FloatArray]
    ) -> Blends:
        """The blends of corners at arc length s, with the tangents before and after them."""
        before, after = tangents
        start, end = corner - before * width[:, None], corner + after * width[:, None]
        low, high = np.minimum(np.minimum(start, corner), end), np.maximum(np.maximum(start, corner), end)
        return cls(s, width, start, low, high, before, after)

    @cached_property
    def turning(self) -> FloatArray:
        """y where each joint turns back, shape (k, n); 1 if it does not."""
        return _turning(self.before, self.after)

    def position(self, row: IntArray, s: FloatArray) -> FloatArray:
        """Configurations, shape (k, n); never outside the box of the corner's three points."""
        q = self.start.take(row, axis=0) + self._moved(row, self._y(row, s)[:, None])
        return np.asarray(np.minimum(np.maximum(q, self.low.take(row, axis=0)), self.high.take(row, axis=0)))

    def derivative(self, row: IntArray, s: FloatArray, order: int) -> FloatArray:
        """dq/ds (order 1) and its derivatives (2, 3), shape (k, n)."""
        y, before = self._y(row, s)[:, None], self.before.take(row, axis=0)
        turn = self.after.take(row, axis=0) - before
        if order == 1:
            return np.asarray(before + turn * _share(y))
        width = self.width.take(row)[:, None]
        if order == 2:
            return np.asarray(turn * (STEEPEST * (1.0 - y * y * y * y)) / width)
        return np.asarray(turn * (-STEEPEST_SLOPE * y * y * y) / (width * width))

    def travel(self, row: IntArray, s: FloatArray) -> FloatArray:
        """The total distance that each joint has moved since the start of its blend, back and forth, shape (k, n)."""
        y = self._y(row, s)[:, None]
        furthest = self._moved(row, np.minimum(y, self.turning.take(row, axis=0)))
        return np.asarray(np.abs(furthest) + np.abs(self._moved(row, y) - furthest))

    def _y(self, row: IntArray, s: FloatArray) -> FloatArray:
        y = (s - self.s.take(row)) / self.width.take(row)
        return np.asarray(np.minimum(np.maximum(y, -1.0), 1.0))

    def _moved(self, row: IntArray, y: FloatArray) -> FloatArray:
        """q at y minus q at -1, for y of shape (k, 1) or (k, n)."""
        turned = integral(y)
        along = self.before.take(row, axis=0) * (y + 1.0 - turned) + self.after.take(row, axis=0) * turned
        return np.asarray(along * self.width.take(row)[:, None])


def _turning(before: FloatArray, after: FloatArray) -> FloatArray:
    """y at which u + (v - u) f(y) is zero where u and v have different signs, else 1.

    f(-y) = 1 - f(y), so y <= 0 is enough. There, with y = z - 1, f is z^2 times a positive polynomial. Newton's method
    solves for the square root of f, because f itself has a double root at z = 0; the polynomial's constant term gives
    the initial value.
    """
    out = np.ones_like(before)
    turns = np.nonzero(before * after < 0.0)
    share = before[turns] / (before[turns] - after[turns])
    wanted = np.sqrt(np.minimum(share, 1.0 - share))
    z = np.minimum(wanted / np.sqrt(1.25), 1.0)
    for _ in range(NEWTON_STEPS):
        rest = 1.25 + z * (-1.25 + z * (0.625 - 0.125 * z))
        slope = rest + z * (-0.625 + z * (0.625 - 0.1875 * z))
        root = np.sqrt(rest)
        z = np.minimum(z + (wanted - z * root) * root / slope, 1.0)
    out[turns] = np.where(share > 0.5, 1.0 - z, z - 1.0)
    return out
