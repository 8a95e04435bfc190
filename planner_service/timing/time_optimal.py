"""TOPP-RA along one segment of a path (Pham & Pham, IEEE T-RO 34(3), 2018).

At each point of a grid, the path's acceleration u and its squared speed x obey ``abs(a u + b x) <= limit`` for every
joint, here and at the next point: a linear program in two unknowns. A backward pass finds the squared speeds from which
the rest of the path can be travelled, a forward pass the fastest motion among these. Both passes are compiled; the
Python below is their reference, to the last bit, and takes over where nothing was built.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.native.loading import load_core
from planner_service.timing.segments import PathSegment

__all__ = ["GridLimits", "grid_limits", "reference_passes", "two_passes"]

MAX_SPEED = 1e4
"""Stands for an infinite speed; speeds are scaled to about 1."""

NOWHERE = 1e-12
"""A smaller coefficient of u leaves a bound of x alone."""

ROUNDING, SLACK = 1e-13, 1e-9
"""Relative to 1 plus the acceleration: a gap this small is none, and one that rounding may explain."""

MAX_STEPS = 200


@dataclass(frozen=True, eq=False)
class GridLimits:
    """A segment at N + 1 grid points, in units of its length and of about its duration.

    Attributes:
        points: s, increasing from 0 to 1, (N + 1,).
        first, second: dq/ds and d2q/ds2 of the joints that move, (N + 1, k).
        acceleration: The limit of each, (k,).
        squares: The largest squared ds/dt at each point, (N + 1,).
    """

    points: FloatArray
    first: FloatArray
    second: FloatArray
    acceleration: FloatArray
    squares: FloatArray


def grid_limits(segment: PathSegment, points: FloatArray, unit: float, entry: float) -> GridLimits:
    """The limits of a segment at grid points.

    Args:
        points: Shares of the segment's length, increasing from 0 to 1.
        unit: About its duration in seconds.
        entry: Its speed at the start, in the units of the result; allowed even where it is limited to less.
    """
    joints, length = segment.moving, segment.length
    velocity, acceleration = segment.limits.velocity[joints] * unit, segment.limits.acceleration[joints] * (unit * unit)
    s = segment.start + points * length
    scales = (length, length * length)
    first, second = (segment.derivative(s, k + 1)[:, joints] * scale for k, scale in enumerate(scales))
    with np.errstate(divide="ignore", over="ignore"):
        speeds = np.where(first != 0.0, velocity / np.abs(first), math.inf).min(axis=1)
    if segment.speed_limit is not None:
        speeds = np.minimum(speeds, segment.speed_limits_at(s) * (unit / length))
    if segment.blend_share < 1.0:
        shares = segment.limit_shares(s)[:, None]
        first, second, speeds = first / shares, second / shares, speeds * shares[:, 0]
        speeds[0] = max(speeds[0], entry)
    return GridLimits(points, first, second, acceleration, np.minimum(speeds, MAX_SPEED) ** 2)


def two_passes(grid: GridLimits, entry: float) -> FloatArray | None:
    """The largest ds/dt at the grid points, shape (N + 1,), from ``entry`` to rest; None if there is no solution."""
    core = load_core()
    if core is None:
        return reference_passes(grid, entry)
    rows = (grid.first, grid.second, grid.acceleration, grid.squares, grid.points)
    speeds: FloatArray = core.two_passes(*map(np.ascontiguousarray, rows), entry)
    return speeds if len(speeds) else None


@dataclass(frozen=True)
class _Line:
    offset: float
    slope: float

    def at(self, x: float) -> float:
        return self.offset + self.slope * x


@dataclass(frozen=True)
class _Program:
    """What bounds u and x at one point: lower(x) <= u <= upper(x) for all lines, and x <= most."""

    lower: Sequence[_Line]
    upper: Sequence[_Line]
    most: float

    @classmethod
    def at(cls, grid: GridLimits, i: int, next_square: float) -> _Program:
        """The limits at point i, those at the next as they will be, and the speeds from which that can be left."""
        step = 2.0 * float(grid.points[i + 1] - grid.points[i])
        here = zip(grid.first[i].tolist(), grid.second[i].tolist(), strict=True)
        after = zip((grid.first[i + 1] + step * grid.second[i + 1]).tolist(), grid.second[i + 1].tolist(), strict=True)
        lower, upper, most = [], [], float(grid.squares[i])
        for rows in (here, after):
            for (a, b), limit in zip(rows, grid.acceleration.tolist(), strict=True):
                if abs(a) < NOWHERE:
                    if abs(b) > NOWHERE and limit / abs(b) < most:
                        most = limit / abs(b)
                else:
                    lower.append(_Line(-(limit / abs(a)), -b / a))
                    upper.append(_Line(limit / abs(a), -b / a))
        lower.append(_Line(0.0, -1.0 / step))
        upper.append(_Line(next_square / step, -1.0 / step))
        return cls(lower, upper, most)

    def largest_square(self) -> float:
        """The largest x that leaves room for u, by Newton's method from above: the gap is convex in x."""
        x = self.most
        for _ in range(MAX_STEPS):
            low, high = max(self.lower, key=lambda line: line.at(x)), min(self.upper, key=lambda line: line.at(x))
            bottom = low.at(x)
            gap = bottom - high.at(x)
            if gap <= ROUNDING * (1.0 + abs(bottom)):
                return x
            slope = low.slope - high.slope
            if not slope > 0.0:
                return x if gap <= SLACK * (1.0 + abs(bottom)) else math.nan
            before, x = x, x - gap / slope
            if x >= before:
                return before
            if x < 0.0:
                return 0.0 if x > -SLACK * (1.0 + self.most) else math.nan
        return math.nan


def reference_passes(grid: GridLimits, entry: float) -> FloatArray | None:
    """``two_passes`` in Python."""
    last = len(grid.points) - 1
    reachable = [0.0] * (last + 1)
    for i in range(last - 1, -1, -1):  # backward: the squared speeds from which the rest can be travelled
        reachable[i] = _Program.at(grid, i, reachable[i + 1]).largest_square()
        if not reachable[i] >= 0.0:
            return None
    x, speeds = entry * entry, [entry]
    if not x <= reachable[0] + 1e-5:
        return None
    for i in range(last):  # forward: as fast as possible
        program = _Program.at(grid, i, reachable[i + 1])
        bottom, top = max(line.at(x) for line in program.lower), min(line.at(x) for line in program.upper)
        if not bottom <= top + SLACK * (1.0 + abs(bottom)):
            return None
        after = x + 2.0 * float(grid.points[i + 1] - grid.points[i]) * top
        after = max(after - 1e-8, 0.9999 * after)  # as toppra does, so that rounding cannot exceed a limit
        x = min(after, reachable[i + 1]) if after > 0.0 else 0.0
        speeds.append(math.sqrt(x))
    return np.array(speeds)
