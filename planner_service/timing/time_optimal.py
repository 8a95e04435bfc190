"""TOPP-RA along one segment of a path (Pham & Pham, IEEE T-RO 34(3), 2018).

At each point of a grid, the path's acceleration u and its squared speed x obey ``abs(a u + b x + c) <= limit`` for
the acceleration of every joint (c = 0) and, if asked for, its torque (c is gravity's), here and at the next point: a
linear program in two unknowns. A backward pass finds the squared speeds from which the rest of the path can be
travelled, a forward pass the fastest motion among these. Both passes are compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planner_service.geometry.arrays import FloatArray, cosines_and_sines
from planner_service.native.loading import load_core
from planner_service.timing.profiles import Phase, Section, TimingFailed
from planner_service.timing.segments import PathSegment

__all__ = [
    "GridLimits",
    "constant_accelerations",
    "grid_limits",
    "grid_of",
    "optimal_speeds",
    "two_passes",
]

MAX_SPEED = 1e4
"""Stands for an infinite speed; speeds are scaled to about 1."""

BLEND_GRIDPOINTS = 24
"""Intervals on a blend: with 24 limits are exceeded between grid points by 0.3 % (p50), with 16 by twice that."""

MIN_GRIDPOINTS = 4
"""Intervals on a straight section between blends."""

SPEED_SPACING = 0.1
"""Radians between grid points under a speed limit, on average: it may change along straight sections too."""

TORQUE_SPACING = 0.05
"""The same under torque limits, which change with the configuration: motions take 0.1 % longer than with half of it."""


@dataclass(frozen=True, eq=False)
class GridLimits:
    """A segment at N + 1 grid points, in units of its length and of about its duration.

    Attributes:
        points: s, increasing from 0 to 1, (N + 1,).
        first, second, constant: a, b and c of each of k limits, (N + 1, k): dq/ds, d2q/ds2 and 0 of the joints that
            move, then those of torques.
        limit: The limit of each, (k,).
        squares: The largest squared ds/dt at each point, (N + 1,).
    """

    points: FloatArray
    first: FloatArray
    second: FloatArray
    constant: FloatArray
    limit: FloatArray
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
    constant, limit = np.zeros_like(first), acceleration
    if segment.torque is not None:
        q, tangent, bend = (segment.derivative(s, order) for order in range(3))
        a, b, c = segment.torque.rows(q, tangent * length, bend * (length * length))
        first, second = np.concatenate([first, a], axis=1), np.concatenate([second, b], axis=1)
        constant = np.concatenate([constant, c * (unit * unit)], axis=1)
        limit = np.concatenate([acceleration, np.full(c.shape[1], unit * unit)])
    return GridLimits(points, first, second, constant, limit, np.minimum(speeds, MAX_SPEED) ** 2)


def two_passes(grid: GridLimits, entry: float) -> FloatArray | None:
    """The largest ds/dt at the grid points, shape (N + 1,), from ``entry`` to rest; None if there is no solution."""
    rows = (grid.first, grid.second, grid.constant, grid.limit, grid.squares, grid.points)
    speeds: FloatArray = load_core().two_passes(*map(np.ascontiguousarray, rows), entry)
    return speeds if len(speeds) else None


def grid_of(section: Section, segment: PathSegment, gridpoints: int) -> FloatArray:
    """The grid points of a section, as shares of it from 0 to 1."""
    if section.blended:
        return np.arange(BLEND_GRIDPOINTS + 1) / BLEND_GRIDPOINTS
    count = max(min(gridpoints, MIN_GRIDPOINTS), math.ceil(gridpoints * (section.length / segment.length)))
    if segment.speed_limit is not None:
        count = max(count, math.ceil(section.length / SPEED_SPACING))
    if segment.torque is not None:
        count = max(count, math.ceil(section.length / TORQUE_SPACING))
    # denser at both ends, where speed changes fastest: 0.06 % above the optimum with 50, 3 % with equal steps
    sines = cosines_and_sines(math.pi / 2 * np.arange(count + 1) / count)[1]
    return sines * sines


def constant_accelerations(
    sections: Sequence[Section], grids: Sequence[FloatArray], speeds: Sequence[FloatArray]
) -> list[Phase]:
    """The motion with the given speed at each grid point and constant acceleration in between."""
    phases = []
    for section, grid, speed in zip(sections, grids, speeds, strict=True):
        steps = zip(pairwise((grid * section.length).tolist()), pairwise(speed.tolist()), strict=False)
        for (before, after), (v0, v1) in steps:
            if not v0 + v1 > 0.0:
                s = section.start + before, section.start + after
                raise TimingFailed(f"TOPP-RA: speed 0 from s = {s[0]:.6g} to {s[1]:.6g}")
            duration = 2.0 * (after - before) / (v0 + v1)
            phases.append(Phase(duration, section.start + before, v0, (v1 - v0) / duration, 0.0))
    return phases


def optimal_speeds(
    passes: Callable[[GridLimits, float], FloatArray | None],
    segment: PathSegment,
    sections: Sequence[Section],
    grids: Sequence[FloatArray],
    unit: float,
    entry: float,
) -> list[FloatArray]:
    """ds/dt at each grid point of each section, by TOPP-RA; ``unit`` is about the motion's duration in seconds."""
    length = segment.length
    shares = [
        (section.start - segment.start) / length + grid[:-1] * (section.length / length)
        for section, grid in zip(sections, grids, strict=True)
    ]
    points = np.concatenate([*shares, [1.0]])
    if not np.all(points[1:] > points[:-1]):
        raise TimingFailed(f"TOPP-RA on the segment from s = {segment.start:.6g}: grid points of a tiny blend coincide")
    scaled = entry * (unit / length)
    speeds = passes(grid_limits(segment, points, unit, scaled), scaled)
    if speeds is None or not np.all(np.isfinite(speeds)):
        start = f"s = {segment.start:.6g} at ds/dt = {entry:.6g}"
        raise TimingFailed(f"TOPP-RA: no motion from {start} to rest keeps the limits")
    speeds = speeds * (length / unit)
    speeds[0] = entry
    ends = np.cumsum([0, *(len(grid) - 1 for grid in grids)])
    return [speeds[a : b + 1] for a, b in pairwise(ends.tolist())]
