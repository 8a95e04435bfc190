"""Checks that time runs along a curve as a motion may: s(t) is cubics that follow each other.

Positions and speeds are continuous, s(t) never turns back, it rests at the ends and at corners that are not rounded,
and each joint keeps its limits of velocity and acceleration, scaled as the request says.

On a straight piece of the curve q is linear in s; on a blend ``dq/ds = u + (v - u) f(y)``, where y is linear in s and
``f = 1/2 + (5 y - y^5) / 8``. So in time a joint's velocity ``q' s'`` and acceleration ``q' s'' + q'' s'^2`` are
polynomials of degree 17 at most, which 18 values determine. A polynomial on [0, 1] lies between the least and the
largest of its coefficients in the basis of Bernstein, since its values are averages of these; halving the interval
until they are close decides.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from auditor.schema import require
from auditor.trails import SLACK, Curve

Array = Any
Json = Any

OVER = 1e-5  # share by which a limit may be exceeded: rounding, and where halving ends
HALVINGS = 12
NEAR = 1e-8  # of places and speeds: rounding
SHARP = 1e-6  # radians of a blend that no joint can follow at speed
# Rounding turns the tangent of a short piece by DIGITS times its share of the length, and by FLAT at most.
DIGITS, FLAT = 2e-15, 1e-6

PLACES = (1 - np.cos(math.pi * (np.arange(18) + 0.5) / 18)) / 2  # of Chebyshev, on [0, 1]
BERNSTEIN = np.linalg.inv([[math.comb(17, k) * t**k * (1 - t) ** (17 - k) for k in range(18)] for t in PLACES.tolist()])
FIRST_HALF = np.array([[math.comb(i, k) / 2**i for k in range(18)] for i in range(18)])  # de Casteljau
HALVES = np.stack([FIRST_HALF, FIRST_HALF[::-1, ::-1]])


def in_time(robot: Json, result: Json, request: Json, curve: Curve) -> list[str]:
    """What s(t) shows, line by line; Invalid where it is no motion, or exceeds a limit."""
    law, limits, length = result["trajectory"], robot["limits"], result["path"]["length"]
    h, c = np.array(law["durations"], float), np.array(law["coefficients"], float).reshape(-1, 4)
    begin, end = law["part"] or (0.0, curve.length)
    require(0 <= begin <= end <= curve.length + SLACK, "a part of the curve that is not there")
    require(len(h) == len(c) and (h > 0).all(), "s(t) of other pieces")
    total = float(h.sum())
    require(abs(length - curve.length) <= SLACK * (1 + length), f"a length of {length}, which is {curve.length}")
    off = max(abs(total - claimed) for claimed in (law["duration"], result["motion"]["duration"]))
    require(off <= SLACK * (1 + total), f"{law['duration']} s are claimed, s(t) takes {total}")
    if end - begin <= SLACK and not len(h):
        return ["s(t): it stays where it is"]
    require(len(h), "no s(t)")
    reached, speed = cubic(c, h), cubic(c, h, 1)
    near = NEAR * max(1.0, np.abs(c[:, 1]).max())
    joins = np.abs(np.append(c[1:, 0], end) - reached).max() <= NEAR and abs(c[0, 0] - begin) <= SLACK
    require(joins, "s(t) jumps, or does not run from the one end to the other")
    speeds = np.abs(np.append(c[1:, 1], 0.0) - speed).max() <= near
    rested = law["part"] is not None or abs(c[0, 1]) <= near
    require(speeds and rested, "ds/dt jumps, or s(t) does not rest at an end")
    turn = np.clip(-c[:, 2] / np.where(c[:, 3] == 0, 1.0, 3 * c[:, 3]), 0, h)
    require(min(c[:, 1].min(), speed.min(), cubic(c, turn, 1).min()) >= -near, "s(t) turns back")
    rests = np.append(c[c[:, 1] <= near, 0], end)
    turns, short = np.abs(np.diff(curve.tangents, axis=0)).max(axis=1, initial=0.0), np.maximum(curve.steps, 1e-300)
    straight = turns <= np.minimum(SLACK + DIGITS * np.abs(curve.points).max() * (1 / short[1:] + 1 / short[:-1]), FLAT)
    require(turns[straight].sum() <= 100 * FLAT, "a turn in many small ones")
    for s in curve.corners[(curve.d <= SHARP) & ~straight]:
        stops = not begin + SLACK < s < end - SLACK or np.abs(rests - s).min() <= NEAR
        require(stops, f"s(t) does not rest at the corner at s = {s:.9g}")
    scales, moving = (1.0, 1.0), law["part"] is not None and c[0, 1] > 0
    if request is not None and not moving:  # who begins at speed may need all that the robot has to stop
        scales = request["velocity_scale"], request["acceleration_scale"]
        require(min(scales) > 0 and max(scales) <= 1, "shares of the limits that are none")
    driven = zip(("velocity", "acceleration"), scales, peaks(curve, h, c, reached, straight), strict=True)
    for name, scale, over in driven:
        most = scale * np.array(limits[name], float)
        require(len(most) == curve.points.shape[1] and (most > 0).all(), f"no limits of {name}")
        joint = exceeded(over, most * (1 + OVER))
        require(joint is None, f"joint {joint} exceeds its {name}")
    rest = "from speed to rest" if moving else "from rest to rest"
    share = "within the limits" + f", of which it may use {scales[0]:.0%} and {scales[1]:.0%}" * (scales != (1.0, 1.0))
    return [f"s(t): {total:.4f} s, {rest}; velocities and accelerations {share}"]


def cubic(c: Array, t: Array, order: int = 0) -> Array:
    """Values, or derivatives of an order, of cubics (k, 4) at times of their own (k,)."""
    return sum(math.perm(p, order) * c[:, p] * t ** (p - order) for p in range(order, 4))


def peaks(curve: Curve, h: Array, c: Array, reached: Array, straight: Array) -> tuple[Array, Array]:
    """Velocities and accelerations of the joints in each piece of s(t), as coefficients of Bernstein (k, 18, n)."""
    starts, ends, last = curve.corners - curve.d, curve.corners + curve.d, len(curve.tangents) - 1
    edges = np.sort(np.concatenate([each[~straight | (curve.d > 0)] for each in (starts, ends)]))
    a, b = c[:, 0], np.maximum(reached, c[:, 0])
    torn = np.searchsorted(edges, a + NEAR, "right") < np.searchsorted(edges, b - NEAR)
    require(~torn, "a piece of s(t) that crosses a corner or the edge of a blend")
    middle = (a + b) / 2
    k = np.searchsorted(starts, middle) - 1  # the blend that began last; -1 takes the row that is added
    corner, d, after = (np.append(each, 0.0)[k] for each in (curve.corners, curve.d, ends))
    on = (d > 0) & (middle < after)
    u = curve.tangents[np.where(on, k, np.searchsorted(curve.corners, middle))]
    w = np.where(on, (curve.tangents[np.minimum(k + 1, last)] - curve.tangents[k]).T, 0.0).T
    s, ds, dds = (np.stack([cubic(c, h * place, order) for place in PLACES], axis=1) for order in range(3))
    d = np.where(on, d, 1.0)[:, None]
    y = np.where(on[:, None], s - corner[:, None], 0.0) / d
    along = u[:, None] + (0.5 + (5 * y - y**5) / 8)[..., None] * w[:, None]
    swing = (5 / 8 * (1 - y**4) / d * ds**2)[..., None] * w[:, None]
    return BERNSTEIN @ (ds[..., None] * along), BERNSTEIN @ (dds[..., None] * along + swing)


def exceeded(pieces: Array, most: Array) -> int | None:
    """The number of a joint that may exceed a limit (n,) in one of the pieces (k, 18, n), None if none does."""
    for halved in range(HALVINGS + 1):
        over = ~(np.abs(pieces) <= most)  # nor is it shown of what is no number
        pieces = pieces[over.any(axis=(1, 2))]
        if not len(pieces):
            return None
        sure = over if halved == HALVINGS else over[:, [0, -1]]
        if sure.any():
            break
        pieces = np.concatenate(HALVES[:, None] @ pieces)
    return int(sure.any(axis=(0, 1)).argmax())
