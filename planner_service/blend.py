"""The blend that replaces a corner of a polyline: a curve that meets both straight pieces with equal curvature.

At a waypoint W, with unit tangents u before and v after it, the corner from d before to d after it is replaced by

    dq/ds = u + (v - u) f(y),   f(y) = 1/2 + (5 y - y^5) / 8,   y = (s - s_W) / d in [-1, 1].

Its integral, of degree six, runs from ``W - d u`` to ``W + d v``. f has slope 0 at both ends, so the second derivative
is zero there: the curve is C2 and its third derivative bounded. In between the slope is flat, at most 5/8 where that of
a cubic f is 3/4, so that joints may pass the corner faster. As f grows from 0 to 1, the blend is no longer than the
corner (abs(dq/ds) <= 1), turns each joint back at most once, and stays in the triangle of the corner, hence inside
every joint limit. Functions here take k blends at once, and one s for each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry import FloatArray, read_only

__all__ = ["STEEPEST", "STEEPEST_SLOPE", "Blends"]

IntArray = NDArray[np.intp]

STEEPEST, STEEPEST_SLOPE = 0.625, 2.5
"""Largest df/dy, at y = 0, and largest abs of its own slope, at y = -1 and 1."""

BISECTIONS = 60
"""An interval of length 2 is then shorter than the rounding of its ends."""


def _share(y: FloatArray) -> FloatArray:
    """How far the tangent has turned from u to v at y."""
    square = y * y
    return np.asarray(0.5 + y * (5.0 - square * square) / 8.0)


def _integral(y: FloatArray) -> FloatArray:
    """Of f from -1 to y; 1 at y = 1."""
    square = y * y
    return np.asarray((y + 1.0) / 2.0 + (square - 1.0) * 0.3125 - (square * square * square - 1.0) / 48.0)


@dataclass(frozen=True, eq=False)
class Blends:
    """The blends of a path in order: s of the corners and d, (k,); the corners, u and v, (k, n).

    ``turning`` is y where each joint turns back, shape (k, n); 1 where it does not.
    """

    s: FloatArray
    width: FloatArray
    corner: FloatArray
    before: FloatArray
    after: FloatArray
    turning: FloatArray

    @classmethod
    def at(
        cls, s: FloatArray, width: FloatArray, corner: FloatArray, tangents: tuple[FloatArray, FloatArray]
    ) -> Blends:
        """Blends around corners at arc length s, with the tangents before and after them."""
        parts = (s, width, corner, *tangents, _turning(*tangents))
        return cls(*(read_only(part) for part in parts))

    def position(self, row: IntArray, s: FloatArray) -> FloatArray:
        """Configurations, shape (k, n); never outside the box of the corner's three points."""
        width, corner = self.width[row, None], self.corner[row]
        start, end = corner - self.before[row] * width, corner + self.after[row] * width
        q = start + self._moved(row, self._y(row, s)[:, None])
        low, high = np.minimum(np.minimum(start, corner), end), np.maximum(np.maximum(start, corner), end)
        return np.asarray(np.minimum(np.maximum(q, low), high))

    def derivative(self, row: IntArray, s: FloatArray, order: int) -> FloatArray:
        """dq/ds (order 1) and its derivatives (2, 3), shape (k, n)."""
        y = self._y(row, s)[:, None]
        before, turn, width = self.before[row], self.after[row] - self.before[row], self.width[row, None]
        if order == 1:
            return np.asarray(before + turn * _share(y))
        if order == 2:
            return np.asarray(turn * (STEEPEST * (1.0 - y * y * y * y)) / width)
        return np.asarray(turn * (-STEEPEST_SLOPE * y * y * y) / (width * width))

    def travel(self, row: IntArray, s: FloatArray) -> FloatArray:
        """What each joint has moved in total since the start of its blend, there and back, shape (k, n)."""
        y = self._y(row, s)[:, None]
        there = self._moved(row, np.minimum(y, self.turning[row]))
        return np.asarray(np.abs(there) + np.abs(self._moved(row, y) - there))

    def _y(self, row: IntArray, s: FloatArray) -> FloatArray:
        y = (s - self.s[row]) / self.width[row]
        return np.asarray(np.minimum(np.maximum(y, -1.0), 1.0))

    def _moved(self, row: IntArray, y: FloatArray) -> FloatArray:
        """q at y, of shape (k, 1) or (k, n), less q at -1."""
        turned = _integral(y)
        along = self.before[row] * (y + 1.0 - turned) + self.after[row] * turned
        return np.asarray(along * self.width[row, None])


def _turning(before: FloatArray, after: FloatArray) -> FloatArray:
    """y at which u + (v - u) f(y) is zero where u and v have different signs, else 1."""
    out = np.ones_like(before)
    turns = np.nonzero(before * after < 0.0)
    share = before[turns] / (before[turns] - after[turns])
    low: FloatArray = np.full(len(share), -1.0)
    high: FloatArray = np.ones(len(share))
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        before_it = _share(middle) < share
        low, high = np.where(before_it, middle, low), np.where(before_it, high, middle)
    out[turns] = low
    return out
