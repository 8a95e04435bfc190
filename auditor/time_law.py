"""Checks that time runs along a curve as a motion may: s(t) is cubics that follow each other.

Positions and speeds are continuous, s(t) never turns back, it rests at the ends and at corners that are not rounded,
and each joint keeps its limits of velocity and acceleration, scaled as the request says.

On a straight piece of the curve q is linear in s, so that a joint's velocity and acceleration are polynomials of degree
2 and 1 in time. On a blend, ``dq/ds = u + (v - u) f(y)`` with ``f = 1/2 + (5 y - y^5) / 8`` and y linear in s, so that
the velocity ``q' s'`` is one of degree 17 and the acceleration ``q' s'' + q'' s'^2`` of degree 16. A polynomial on
[0, 1] lies between the least and the largest of its coefficients in the basis of Bernstein, since its values are
averages of these; halving the interval until they are close decides.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from auditor.trails import SLACK, Curve, require

Array = Any
Json = Any

OVER = 1e-5  # share by which a limit may be exceeded: rounding, and where halving ends
HALVINGS = 12
SHARP = 1e-6  # radians of a blend that no joint can follow at speed
# Rounding turns the tangent of a short piece by DIGITS times its share of the length, and by FLAT at most.
DIGITS, FLAT = 2e-15, 1e-6


def in_time(robot: Json, result: Json, request: Json, curve: Curve) -> list[str]:
    """What s(t) shows, line by line; Invalid where it is no motion, or exceeds a limit."""
    law, limits = result["trajectory"], robot["limits"]
    h, c = np.array(law["durations"], float), np.array(law["coefficients"], float).reshape(-1, 4)
    begin, end = law["part"] or (0.0, curve.length)
    require(0 <= begin <= end <= curve.length + SLACK, "a part of the curve that is not there")
    require(len(h) == len(c) and (h > 0).all(), "s(t) of other pieces")
    total = float(h.sum())
    length = result["path"]["length"]
    require(abs(length - curve.length) <= SLACK * (1 + length), f"a length of {length}, which is {curve.length}")
    near = abs(total - law["duration"]) <= SLACK * (1 + total) >= abs(result["motion"]["duration"] - total)
    require(near, f"{law['duration']} s are claimed, s(t) takes {total}")
    if end - begin <= SLACK and not len(h):
        return ["s(t): it stays where it is"]
    require(len(h), "no s(t)")
    x = np.stack([h**0, h, h**2, h**3])
    reached, speed = (c.T * x).sum(0), c[:, 1] + 2 * c[:, 2] * h + 3 * c[:, 3] * h**2
    fast = max(1.0, np.abs(c[:, 1]).max())
    joins = np.abs(np.append(c[1:, 0], end) - reached).max() <= 1e-8 and abs(c[0, 0] - begin) <= SLACK
    require(joins, "s(t) jumps, or does not run from the one end to the other")
    first = 0.0 if law["part"] is None else c[0, 1]
    speeds = np.abs(np.append(c[1:, 1], 0.0) - speed).max() <= 1e-8 * fast and abs(c[0, 1] - first) <= 1e-8 * fast
    require(speeds, "ds/dt jumps, or s(t) does not rest at an end")
    turn = np.clip(-c[:, 2] / np.where(c[:, 3] == 0, 1.0, 3 * c[:, 3]), 0, h)
    slowest = np.minimum(np.minimum(c[:, 1], speed), c[:, 1] + 2 * c[:, 2] * turn + 3 * c[:, 3] * turn**2)
    require(slowest.min() >= -1e-8 * fast, "s(t) turns back")
    rests = np.append(c[c[:, 1] <= 1e-8 * fast, 0], end)
    turns = np.abs(np.diff(curve.tangents, axis=0)).max(axis=1, initial=0.0)
    short = np.maximum(curve.steps, 1e-300)
    straight = turns <= np.minimum(SLACK + DIGITS * np.abs(curve.points).max() * (1 / short[1:] + 1 / short[:-1]), FLAT)
    require(turns[straight].sum() <= 100 * FLAT, "a turn in many small ones")
    for s in curve.corners[(curve.d <= SHARP) & ~straight]:
        stops = not begin + SLACK < s < end - SLACK or np.abs(rests - s).min() <= 1e-8
        require(stops, f"s(t) does not rest at the corner at s = {s:.9g}")
    scales, moving = (1.0, 1.0), law["part"] is not None and c[0, 1] > 0
    if request is not None and not moving:  # who begins at speed may need all that the robot has to stop
        scales = request["velocity_scale"], request["acceleration_scale"]
        require(min(scales) > 0 and max(scales) <= 1, "shares of the limits that are none")
    for name, scale, over in zip(
        ("velocity", "acceleration"), scales, peaks(curve, h, c, reached, straight), strict=True
    ):
        most = scale * np.array(limits[name], float)
        require(len(most) == curve.points.shape[1] and (most > 0).all(), f"no limits of {name}")
        joint = exceeded(over, most * (1 + OVER))
        require(joint is None, f"joint {joint} exceeds its {name}")
    rest = "from speed to rest" if moving else "from rest to rest"
    share = "within the limits" + f", of which it may use {scales[0]:.0%} and {scales[1]:.0%}" * (scales != (1.0, 1.0))
    return [f"s(t): {total:.4f} s, {rest}; velocities and accelerations {share}"]


def peaks(curve: Curve, h: Array, c: Array, reached: Array, straight: Array) -> tuple[list[Array], list[Array]]:
    """Velocities and accelerations of the joints in each piece of s(t), as coefficients of Bernstein (k, n)."""
    found = list[Array](), list[Array]()
    starts, ends = curve.corners - curve.d, curve.corners + curve.d
    joints = np.concatenate([edges[~straight | (curve.d > 0)] for edges in (curve.corners, starts, ends)])
    for seconds, row, stop in zip(h, c, reached, strict=True):
        a, b = row[0], max(stop, row[0])
        middle = (a + b) / 2
        on = np.flatnonzero((curve.d > 0) & (starts < middle) & (middle < ends))
        scaled = row * seconds ** np.arange(4)
        s = bernstein(scaled)
        ds, dds = bernstein(scaled[1:] * [1, 2, 3]) / seconds, bernstein(scaled[2:] * [2, 6]) / seconds**2
        edges = joints if not len(on) else np.append(starts[on], ends[on])
        torn = ((edges > a + 1e-8) & (edges < b - 1e-8)).any()
        require(not torn, f"a piece of s(t) from {a:.9g} to {b:.9g} that crosses a corner or the edge of a blend")
        k = int(np.searchsorted(curve.corners, middle))
        u = curve.tangents[min(k, len(curve.tangents) - 1)]
        if not len(on):
            found[0].append(ds[:, None] * u)
            found[1].append(dds[:, None] * u)
            continue
        k, d = int(on[0]), curve.d[on[0]]
        u, w = curve.tangents[k], curve.tangents[k + 1] - curve.tangents[k]
        y = (s - curve.corners[k]) / d
        y4 = times(times(y, y), times(y, y))
        f = 0.5 + (5 * raised(y, 12) - times(y4, y)) / 8
        slope = 5 / 8 * (1 - y4) / d
        along = u + f[:, None] * w  # degree 15
        found[0].append(np.column_stack([times(column, ds) for column in along.T]))
        swing = times(slope, times(ds, ds))  # degree 16
        found[1].append(np.column_stack([times(column, dds) for column in along.T]) + swing[:, None] * w)
    return found


def bernstein(powers: Array) -> Array:
    """Coefficients of Bernstein of a polynomial on [0, 1] from those of its powers."""
    n = len(powers) - 1
    share = [[math.comb(k, j) / math.comb(n, j) for j in range(n + 1)] for k in range(n + 1)]
    return np.array(share) @ powers


def times(a: Array, b: Array) -> Array:
    """The product of two polynomials in the basis of Bernstein."""
    m, n = len(a) - 1, len(b) - 1
    weights = [np.array([math.comb(k, j) for j in range(k + 1)], float) for k in (m, n, m + n)]
    return np.convolve(a * weights[0], b * weights[1]) / weights[2]


def raised(a: Array, by: int) -> Array:
    """The same polynomial, of a degree that is higher."""
    return times(a, np.ones(by + 1))


def exceeded(pieces: list[Array], most: Array) -> int | None:
    """The number of a joint that may exceed a limit (n,), None if none does."""
    left = [(piece, 0) for piece in pieces]
    while left:
        piece, halved = left.pop()
        over = np.abs(piece) > most
        if not over.any():
            continue
        joint = int(np.flatnonzero(over.any(axis=0))[0])
        if (np.abs(piece[[0, -1]]) > most).any() or halved == HALVINGS:
            return joint
        rows, lower, upper = piece, [piece[0]], [piece[-1]]
        while len(rows) > 1:
            rows = (rows[1:] + rows[:-1]) / 2
            lower.append(rows[0])
            upper.append(rows[-1])
        left += [(np.array(lower), halved + 1), (np.array(upper[::-1]), halved + 1)]
    return None
