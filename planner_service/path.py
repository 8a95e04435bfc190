"""A path is a curve q(s) through joint space; a trajectory is that same curve with a time law s(t).

Because a trajectory only ever evaluates its path, it cannot leave what was certified.
Angles in radians (metres for prismatic joints), arc length ``s`` in the L2 norm of joint space, time in seconds.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray, number, numbers, read_only

__all__ = ["COLLINEAR", "JointPath", "Samples", "Trajectory"]

OVERSHOOT = 1e-9
"""An argument that far outside its interval is a rounding of the interval's end, and taken as such."""

MERGE = 1e-12
"""Waypoints closer than this (rad) are one point: their direction would be made of rounding."""

COLLINEAR = 1e-12
"""A tangent of which any component changes by more is a corner; less is what rounding does to points on a line."""

MAX_SAMPLES = 1_000_000
"""About 17 minutes at 1 kHz; a longer list is a wrong unit of ``dt``."""

MAX_DILATION = 1e9
"""Up to there the cube of a factor leaves any sensible trajectory its digits; beyond, a unit is wrong."""

ORDERS = range(4)


def _distances(points: FloatArray) -> FloatArray:
    """L2 distance between successive rows, summed joint by joint (equal bits on every processor)."""
    steps = points[1:] - points[:-1]
    total = np.zeros(len(steps))
    for i in range(points.shape[1]):
        total += steps[:, i] * steps[:, i]
    return np.sqrt(total)


def _within(name: str, value: ArrayLike, end: float) -> FloatArray:
    """``value`` as an array inside [0, end], forgiving an overshoot of rounding size."""
    x = numbers(name, value, f"numbers in [0, {end:.9g}]")
    if not np.all((x >= -OVERSHOOT) & (x <= end + OVERSHOOT)):  # also False for NaN
        raise InvalidRequest(name, value, f"numbers in [0, {end:.9g}]")
    return np.clip(x, 0.0, end)


def _order(order: int) -> int:
    if not isinstance(order, int) or isinstance(order, bool) or order not in ORDERS:
        raise InvalidRequest("order", order, "0, 1, 2 or 3")
    return order


def _waypoints(values: Any) -> FloatArray:
    points = numbers("waypoints", values, "rows of equally many numbers, shape (N, n)")
    if points.ndim != 2 or 0 in points.shape:
        raise InvalidRequest("waypoints", points.shape, "shape (N, n) with N >= 1 waypoints of n >= 1 joints")
    if not np.all(np.isfinite(points)):
        row, joint = np.argwhere(~np.isfinite(points))[0]
        raise InvalidRequest(f"waypoints[{row}][{joint}]", float(points[row, joint]), "a finite number")
    return points


def _merged(points: FloatArray) -> FloatArray:
    """The points without those that coincide with the one before; the first and the last stay bit for bit."""
    steps = _distances(points)
    total = sum(steps.tolist())
    if not math.isfinite(total):
        raise InvalidRequest("waypoints", float(np.abs(points).max()), "joint values whose path has a finite length")
    near = max(MERGE, 2e-15 * total)  # so that arc length grows with every waypoint in spite of rounding
    if not np.any(steps <= near):
        return points
    kept = [0]
    for k in range(1, len(points)):
        if _distances(points[[kept[-1], k]])[0] > near:
            kept.append(k)
    last = len(points) - 1
    if kept[-1] != last:
        while len(kept) > 1 and _distances(points[[kept[-1], last]])[0] <= near:
            kept.pop()
        if _distances(points[[kept[-1], last]])[0] > 0.0:
            kept.append(last)
    return points[kept]


@dataclass(frozen=True, eq=False, repr=False)
class JointPath:
    """A polyline through joint space, ``path(s)`` for s in [0, ``path.length``].

    Waypoints within 1e-12 rad of the one before them are dropped (the first and the last always stay), so that
    every piece has a length and a direction; all other waypoints are kept as they are.

    Args:
        waypoints: Shape (N, n), N >= 1; copied.

    Attributes:
        waypoints: Shape (N, n), read-only.
        knots: Arc length at each waypoint, shape (N,), from 0 to ``length``.

    Raises:
        InvalidRequest: another shape, or a number that is not finite.
    """

    waypoints: FloatArray
    knots: FloatArray = field(init=False)
    _tangents: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        points = _merged(_waypoints(self.waypoints))
        steps = _distances(points)
        object.__setattr__(self, "waypoints", read_only(points))
        object.__setattr__(self, "knots", read_only(list(accumulate(steps.tolist(), initial=0.0))))
        object.__setattr__(self, "_tangents", read_only((points[1:] - points[:-1]) / steps[:, np.newaxis]))

    def __repr__(self) -> str:
        return f"JointPath(<{len(self.waypoints)} waypoints, {self.n} joints, length {self.length:.6g}>)"

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.waypoints.shape[1])

    @property
    def length(self) -> float:
        """L2 joint arc length."""
        return float(self.knots[-1])

    @property
    def corners(self) -> tuple[int, ...]:
        """Indices of the inner waypoints where the direction changes: no finite acceleration passes them at speed."""
        turns = np.abs(self._tangents[1:] - self._tangents[:-1]).max(axis=1, initial=0.0)
        return tuple(int(k) + 1 for k in np.flatnonzero(turns > COLLINEAR))

    def __call__(self, s: ArrayLike, order: int = 0) -> FloatArray:
        """Configurations (order 0), unit tangents dq/ds (1), or zeros (2, 3), shape (..., n) for s of shape (...).

        At a waypoint the tangent is that of the piece after it, at the end that of the last piece.

        Raises:
            InvalidRequest: s outside [0, length] by more than 1e-9, or another order.
        """
        at = _within("s", s, self.length)
        if _order(order) >= 2 or (order == 1 and len(self.waypoints) == 1):
            return np.zeros((*at.shape, self.n))
        if len(self.waypoints) == 1:
            return np.broadcast_to(self.waypoints[0], (*at.shape, self.n)).copy()
        piece = np.minimum(np.searchsorted(self.knots, at, side="right") - 1, len(self._tangents) - 1)
        if order == 0:
            return self._between(piece, at)
        tangents: FloatArray = self._tangents[piece]
        return tangents

    def _between(self, piece: NDArray[np.intp], at: FloatArray) -> FloatArray:
        a, b = self.waypoints[piece], self.waypoints[piece + 1]
        start, end = self.knots[piece], self.knots[piece + 1]
        share = ((at - start) / (end - start))[..., np.newaxis]
        # share < 1 keeps the rounded product below b - a, so no joint passes its waypoint, which may be a limit
        return np.where(share < 1.0, a + (b - a) * share, b)

    def reversed(self) -> JointPath:
        """The same polyline from its end to its start."""
        return JointPath(self.waypoints[::-1])

    def __add__(self, other: JointPath) -> JointPath:
        """This path and then the other, which must start exactly where this one ends.

        Raises:
            InvalidRequest: it starts elsewhere.
        """
        if self.n != other.n or not np.array_equal(self.waypoints[-1], other.waypoints[0]):
            expected = f"a path from {self.waypoints[-1].tolist()}"
            raise InvalidRequest("path", other.waypoints[0].tolist(), expected)
        return JointPath(np.concatenate([self.waypoints, other.waypoints]))


class Samples(NamedTuple):
    """A trajectory at m instants: ``t`` (m,), ``q``, ``qd`` and ``qdd`` (m, n)."""

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """A path with a time law, ``trajectory(t)`` for t in [0, ``duration``]; at rest at both ends and at corners.

    Args:
        path: The curve; every configuration of the trajectory is one of its own.
        durations: Seconds of each of the m pieces of s(t), shape (m,). They are kept rather than the knots, because a
            difference of knots has lost the digits that a short piece needs.
        coefficients: s(t) of each piece as c0 + c1 x + c2 x^2 + c3 x^3, x the time since its start, shape (m, 4).
        dilation: By how much time was stretched to hold the limits; 1.0 when nothing had to be.

    Raises:
        InvalidRequest: s(t) does not run from 0 to ``path.length``, jumps, turns back, does not rest at an end,
            or passes a corner of the path at speed.
    """

    path: JointPath
    durations: FloatArray
    coefficients: FloatArray
    dilation: float = 1.0
    knots: FloatArray = field(init=False)
    directions: FloatArray = field(init=False)
    _ends: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        h = numbers("durations", self.durations, "seconds of each piece, shape (m,)")
        c = numbers("coefficients", self.coefficients, "four numbers for each piece, shape (m, 4)")
        if h.ndim != 1 or c.shape != (len(h), 4) or not (np.all(np.isfinite(h)) and np.all(np.isfinite(c))):
            raise InvalidRequest("coefficients", c.shape, f"finite numbers, shape ({h.size}, 4), one row per duration")
        if not np.all(h > 0.0):
            raise InvalidRequest("durations", float(h.min()), "positive numbers")
        ends = read_only([*c[1:, 0], self.path.length][: len(h)])
        _check_law(self.path, h, c, ends)
        # below the end of its piece, so that a piece too short for its start to differ from its end finds its own line
        inside = np.minimum(c[:, 0], np.nextafter(ends, 0.0))
        object.__setattr__(self, "durations", h)
        object.__setattr__(self, "coefficients", c)
        object.__setattr__(self, "knots", read_only(list(accumulate(h.tolist(), initial=0.0))))
        object.__setattr__(self, "directions", read_only(self.path(inside, 1)))
        object.__setattr__(self, "_ends", ends)

    def __repr__(self) -> str:
        return f"Trajectory({self.path!r}, <{self.duration:.6g} s in {len(self.durations)} pieces>)"

    @property
    def duration(self) -> float:
        """Seconds from start to end; 0 for a path of one point."""
        return float(self.knots[-1])

    def s(self, t: ArrayLike, order: int = 0) -> FloatArray:
        """Arc length at time t (order 0) or its derivatives (1, 2, 3), the shape of t; right-sided except at the end.

        Raises:
            InvalidRequest: t outside [0, duration] by more than 1e-9, or another order.
        """
        return self._evaluate(t, order)[1]

    def __call__(self, t: ArrayLike, order: int = 0) -> FloatArray:
        """Positions (order 0), velocities (1), accelerations (2), jerks (3) at t, shape (..., n) for t of shape (...).

        Pieces are straight, so each derivative is the path's direction times that of s(t); where two pieces meet it is
        that of the later one, at the end that of the last.

        Raises:
            InvalidRequest: t outside [0, duration] by more than 1e-9, or another order.
        """
        piece, value = self._evaluate(t, order)
        if order == 0:
            return self.path(value)
        if not len(self.durations):
            return np.zeros((*value.shape, self.path.n))
        return self.directions[piece] * value[..., np.newaxis]

    def _evaluate(self, t: ArrayLike, order: int) -> tuple[NDArray[np.intp], FloatArray]:
        times = _within("t", t, self.duration)
        _order(order)
        if not len(self.durations):
            return np.zeros(times.shape, dtype=np.intp), np.zeros(times.shape)
        piece = np.asarray(np.minimum(np.searchsorted(self.knots, times, side="right"), len(self.durations)) - 1)
        x = np.clip(times - self.knots[piece], 0.0, self.durations[piece])
        x = np.where(times == self.duration, self.durations[-1], x)
        value = _derivative(self.coefficients[piece], x, order)
        if order == 0:
            value = np.clip(value, self.coefficients[piece, 0], self._ends[piece])
            value = np.where(times == self.duration, self.path.length, value)
        elif order == 1:
            value = np.where(times == self.duration, 0.0, np.maximum(value, 0.0))
        return piece, value

    def sample(self, dt: float) -> Samples:
        """Time, position, velocity and acceleration every ``dt`` seconds from 0, and at the exact end.

        Raises:
            InvalidRequest: dt is not positive, or so small that there would be more than a million samples.
        """
        expected = f"a positive number of seconds, at least {self.duration / MAX_SAMPLES:.3g}"
        dt = number("dt", dt, expected, sys.float_info.min, sys.float_info.max)
        if not self.duration / dt < MAX_SAMPLES:
            raise InvalidRequest("dt", dt, expected)
        steps = np.arange(math.ceil(self.duration / dt)) * dt
        t = np.append(steps[steps < self.duration - 1e-9 * dt], self.duration)
        return Samples(t, self(t), self(t, 1), self(t, 2))

    def dilated(self, factor: float) -> Trajectory:
        """The same motion ``factor`` times slower: velocities fall by it, accelerations by its square.

        Raises:
            InvalidRequest: factor is not a number from 1e-9 to 1e9.
        """
        expected = f"a number from {1 / MAX_DILATION:g} to {MAX_DILATION:g}"
        factor = number("factor", factor, expected, 1 / MAX_DILATION, MAX_DILATION)
        powers = np.array([1.0, factor, factor * factor, factor * factor * factor])
        with np.errstate(over="ignore"):  # a trajectory refuses what is not finite
            return Trajectory(self.path, self.durations * factor, self.coefficients / powers, self.dilation * factor)


def _derivative(c: FloatArray, x: FloatArray, order: int) -> FloatArray:
    """Value or derivative of cubics with coefficients (..., 4) at x (...)."""
    c0, c1, c2, c3 = c[..., 0], c[..., 1], c[..., 2], c[..., 3]
    if order == 0:
        return np.asarray(c0 + x * (c1 + x * (c2 + x * c3)))
    if order == 1:
        return np.asarray(c1 + x * (2.0 * c2 + 3.0 * c3 * x))
    if order == 2:
        return np.asarray(2.0 * c2 + 6.0 * c3 * x)
    return np.asarray(6.0 * c3 * np.ones_like(x))


def _check_law(path: JointPath, h: FloatArray, c: FloatArray, ends: FloatArray) -> None:
    """Raise unless s(t) runs from 0 to the path's length without a jump, turn or passed corner."""
    if len(h) == 0 or path.length == 0.0:
        if len(h) or path.length > 0.0:
            raise InvalidRequest("durations", len(h), "pieces for a path with a length, none for a single point")
        return
    gap = OVERSHOOT * max(1.0, path.length)
    if c[0, 0] != 0.0 or np.any(np.abs(_derivative(c, h, 0) - ends) > gap):
        raise InvalidRequest("coefficients", float(c[0, 0]), f"s(t) from 0 to {path.length:.9g} without a jump")
    speeds, arrivals = c[:, 1], _derivative(c, h, 1)
    slack = OVERSHOOT * max(speeds.max(), arrivals.max())
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        turning = np.where(c[:, 3] != 0.0, -c[:, 2] / (3.0 * c[:, 3]), 0.0)
    slowest = np.minimum(np.minimum(speeds, arrivals), _derivative(c, np.clip(turning, 0.0, h), 1))
    if np.any(slowest < -slack) or np.any(ends < c[:, 0]):
        raise InvalidRequest("coefficients", float(slowest.min()), "s(t) that never turns back")
    if np.any(np.abs(arrivals[:-1] - speeds[1:]) > slack) or max(speeds[0], arrivals[-1]) > slack:
        raise InvalidRequest("coefficients", float(speeds[0]), "a speed ds/dt without jumps, 0 at both ends")
    stops = c[speeds <= slack, 0]
    passed = path.knots[list(path.corners)]
    passed = passed[~np.isin(passed, stops)]
    if len(passed):
        raise InvalidRequest("coefficients", float(passed[0]), f"a stop at the path's corner at s = {passed[0]:.9g}")
