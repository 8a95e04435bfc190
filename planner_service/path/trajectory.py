"""Trajectories: a path with a timing law s(t), q(t) = path(s(t)); and how close one comes to limits.

A trajectory only evaluates its path, so it cannot leave the certified curve. Time is in seconds.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, as_sent, read_only, set_fields
from planner_service.geometry.validation import finite_numbers, instance, number, numbers
from planner_service.native.loading import load_core
from planner_service.path.joint_path import OVERSHOOT, JointPath, require_order, within

__all__ = ["LimitPeaks", "Peak", "Samples", "Trajectory"]

MAX_SAMPLES = 1_000_000
"""About 17 minutes at 1 kHz; a longer list is probably a wrong unit of ``dt``."""

ROUNDING = 1e-14
"""Relative rounding error of arc length at each piece of s(t): some tens of units in the last place."""

MAX_DILATION = 1e9
"""The cube of a larger factor would leave no digits of a sensible trajectory; it is probably a wrong unit."""


class Peak(NamedTuple):
    """Where a motion comes closest to a limit: its ratio to the limit, the joint's index, and the time in seconds."""

    ratio: float
    joint: int
    time: float


@dataclass(frozen=True)
class LimitPeaks:
    """How close a trajectory comes to each kind of limit; a ratio above 1 exceeds it.

    Attributes:
        torques: For each joint where its torque comes closest to its limit, known to ``torque_limits.BETWEEN`` of that;
            empty where no torque limits are kept.
    """

    velocity: Peak
    acceleration: Peak
    jerk: Peak
    torques: tuple[Peak, ...] = ()

    @property
    def highest(self) -> float:
        """The larger of the velocity and acceleration ratios."""
        return max(self.velocity.ratio, self.acceleration.ratio)

    def dilated(self, factor: float) -> LimitPeaks:
        """The peaks of the same motion ``factor`` times slower, without those of torques, which do not scale."""
        by_order = enumerate((self.velocity, self.acceleration, self.jerk), start=1)
        velocity, acceleration, jerk = (
            Peak(p.ratio / math.pow(factor, k), p.joint, p.time * factor) for k, p in by_order
        )
        return LimitPeaks(velocity, acceleration, jerk)


class Samples(NamedTuple):
    """A trajectory at m instants: ``t`` (m,), ``q``, ``qd`` and ``qdd`` (m, n)."""

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


class _Located(NamedTuple):
    """Times, their pieces of s(t), the time since the start of each piece, and the coefficients (..., 4)."""

    times: FloatArray
    piece: IntArray
    x: FloatArray
    c: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """A path with a timing law, ``trajectory(t)`` for t in [0, ``duration``]; at rest at both ends and at corners.

    It may cover only a ``part`` of its path, continuing another motion; then it may start at speed, and ends at rest.

    Args:
        path: The curve; every configuration of the trajectory is one of its own.
        durations: Seconds of each of the m pieces of s(t), shape (m,): differences of knots would lose digits.
        coefficients: c0 to c3 of each piece, s(t) = c0 + c1 x + c2 x^2 + c3 x^3 with x the time since its start,
            shape (m, 4).
        dilation: The factor by which time was stretched to keep the limits; 1.0 if it was not.
        part: s where it starts and where it ends; None for the whole path, from rest.

    Raises:
        InvalidRequest: s(t) does not run from 0 to ``path.length``, or along its part, jumps, turns back, does not
            rest at an end, passes a corner of the path at speed, or has a piece that lies partly on a blend.
    """

    path: JointPath
    durations: FloatArray
    coefficients: FloatArray
    dilation: float = 1.0
    part: tuple[float, float] | None = None
    knots: FloatArray = field(init=False)
    geometry: IntArray = field(init=False)
    _ends: FloatArray = field(init=False)
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        instance("path", self.path, JointPath, "a JointPath")
        h = numbers("durations", self.durations, "seconds of each piece, shape (m,)")
        c = numbers("coefficients", self.coefficients, "four numbers for each piece, shape (m, 4)")
        if h.ndim != 1 or c.shape != (len(h), 4) or not (np.all(np.isfinite(h)) and np.all(np.isfinite(c))):
            raise InvalidRequest("coefficients", c.shape, f"finite numbers, shape ({h.size}, 4), one row per duration")
        if not np.all(h > 0.0):
            raise InvalidRequest("durations", float(h.min()), "positive numbers")
        if self.part is not None:
            set_fields(self, part=_checked_part(self.part, self.path.length))
        positive = number("dilation", self.dilation, "a positive number", sys.float_info.min, sys.float_info.max)
        set_fields(self, dilation=positive)
        knots, ends, geometry = self._lawful(h, c)
        set_fields(self, durations=h, coefficients=c, knots=knots, geometry=geometry, _ends=ends)

    def _lawful(self, h: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Knots, s where each piece ends, and the piece of the path that each is on. What is only nearly a motion is
        judged, and refused, in Python."""
        path = self.path
        if type(path) is JointPath:
            span = self.begin, self.end, self.part is None
            motion = load_core().lawful_motion(*path.tables, path.corners, h, c, *span)
            if motion is not None:
                _, _, knots, ends, geometry, _ = motion
                return knots, ends, geometry
        ends = read_only([*c[1:, 0], self.end][: len(h)])
        with np.errstate(over="ignore", invalid="ignore"):  # numbers too large are refused, not warned of
            _check_law(self, h, c, ends)
        return read_only(list(accumulate(h.tolist(), initial=0.0))), ends, _geometry(path, c, ends)

    @classmethod
    def checked(
        cls,
        path: JointPath,
        durations: FloatArray,
        coefficients: FloatArray,
        knots: FloatArray,
        ends: FloatArray,
        geometry: IntArray,
        dilation: float,
    ) -> Trajectory:
        """A trajectory from arrays of compiled code, which has checked and computed what ``Trajectory`` does."""
        trajectory = object.__new__(cls)
        trajectory.__dict__.update(
            path=path,
            durations=durations,
            coefficients=coefficients,
            dilation=dilation,
            part=None,
            knots=knots,
            geometry=geometry,
            _ends=ends,
            duration=float(knots[-1]),
        )
        return trajectory

    def __repr__(self) -> str:
        return f"Trajectory({self.path!r}, <{self.duration:.6g} s in {len(self.durations)} pieces>)"

    @property
    def tables(self) -> tuple[FloatArray | IntArray, ...]:
        """The path's tables and those of s(t), for compiled code that computes the same bits.

        As ``JointPath.tables``; then durations (m,), coefficients (m, 4), knots (m + 1,), where each piece ends (m,),
        and the piece of the path on which it runs (m,).
        """
        return (*self.path.tables, self.durations, self.coefficients, self.knots, self._ends, self.geometry)

    @property
    def begin(self) -> float:
        """s where it starts."""
        return 0.0 if self.part is None else self.part[0]

    @property
    def end(self) -> float:
        """s where it ends."""
        return self.path.length if self.part is None else self.part[1]

    @cached_property
    def duration(self) -> float:
        """Seconds from start to end; 0 for a path of one point."""
        return float(self.knots[-1])

    def s(self, t: ArrayLike, order: int = 0) -> FloatArray:
        """Arc length at time t (order 0) or its derivatives (1, 2, 3), shaped like t; right-sided except at the end.

        Raises:
            InvalidRequest: ``t`` is outside [0, duration] by more than 1e-9, or ``order`` is not 0, 1, 2 or 3.
        """
        require_order(order)
        return self._law(self._located(t), order)

    def __call__(self, t: ArrayLike, order: int = 0) -> FloatArray:
        """Positions (order 0), velocities (1), accelerations (2), jerks (3) at t, shape (..., n) for t of shape (...).

        By the chain rule: q' s', then q' s'' + q'' s'^2, then q' s''' + 3 q'' s' s'' + q''' s'^3. Where two pieces
        of s(t) meet, the later one counts.

        Raises:
            InvalidRequest: ``t`` is outside [0, duration] by more than 1e-9, or ``order`` is not 0, 1, 2 or 3.
        """
        require_order(order)
        return self._derivative(self._located(t), order)

    def moving(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities at t, as calls with order 0 and 1 return them.

        Raises:
            InvalidRequest: ``t`` is outside [0, duration] by more than 1e-9.
        """
        where = self._located(t)
        return self._derivative(where, 0), self._derivative(where, 1)

    def _derivative(self, where: _Located, order: int) -> FloatArray:
        at = self._law(where, 0)
        if order == 0:
            return self.path(at)
        shape = (*at.shape, self.path.n)
        if not len(self.durations):
            return np.zeros(shape)
        geometry, at = self.geometry[where.piece].reshape(-1), at.reshape(-1)
        v, a, j = (self._law(where, k).reshape(-1, 1) if k <= order else np.zeros(0) for k in (1, 2, 3))
        q1, q2, q3 = (self.path.on_pieces(geometry, at, k) if k <= order else np.zeros(0) for k in (1, 2, 3))
        if order == 1:
            return (q1 * v).reshape(shape)
        if order == 2:
            return (q1 * a + q2 * v * v).reshape(shape)
        return (q1 * j + (3.0 * q2 * v * a + q3 * v * v * v)).reshape(shape)

    def _located(self, t: ArrayLike) -> _Located:
        times = within("t", t, self.duration)
        if not len(self.durations):
            none = np.zeros(times.shape)
            return _Located(times, none.astype(np.intp), none, np.zeros((*times.shape, 4)))
        piece = np.asarray(np.minimum(self.knots.searchsorted(times, side="right"), len(self.durations)) - 1)
        x = np.minimum(np.maximum(times - self.knots[piece], 0.0), self.durations[piece])
        x = np.where(times == self.duration, self.durations[-1], x)
        return _Located(times, piece, x, self.coefficients[piece])

    def _law(self, where: _Located, order: int) -> FloatArray:
        """s or one of its derivatives."""
        times, piece, x, c = where
        if not len(self.durations):
            return np.full(times.shape, 0.0 if order else self.end)
        value = _derivative(c, x, order)
        if order == 0:
            value = np.minimum(np.maximum(value, c[..., 0]), self._ends[piece])
            value = np.where(times == self.duration, self.end, value)
        elif order == 1:
            value = np.where(times == self.duration, 0.0, np.maximum(value, 0.0))
        return value

    def sample(self, dt: float) -> Samples:
        """Time, position, velocity and acceleration every ``dt`` seconds from 0, and at the exact end.

        Raises:
            InvalidRequest: ``dt`` is not positive, or so small that there would be more than a million samples.
        """
        expected = f"a positive number of seconds, at least {self.duration / MAX_SAMPLES:.3g}"
        dt = number("dt", dt, expected, sys.float_info.min, sys.float_info.max)
        if not self.duration / dt < MAX_SAMPLES:
            raise InvalidRequest("dt", dt, expected)
        steps = np.arange(math.ceil(self.duration / dt)) * dt
        t = np.append(steps[steps < self.duration - 1e-9 * dt], self.duration)
        where = self._located(t)
        return Samples(t, *(self._derivative(where, order) for order in (0, 1, 2)))

    def dilated(self, factor: float) -> Trajectory:
        """The same motion ``factor`` times slower: velocities are divided by it, accelerations by its square.

        Raises:
            InvalidRequest: ``factor`` is not a number from 1e-9 to 1e9.
        """
        expected = f"a number from {1 / MAX_DILATION:g} to {MAX_DILATION:g}"
        factor = number("factor", factor, expected, 1 / MAX_DILATION, MAX_DILATION)
        powers = np.array([1.0, factor, factor * factor, factor * factor * factor])
        with np.errstate(over="ignore"):  # the trajectory refuses numbers that are not finite
            slower = self.durations * factor, self.coefficients / powers
            return Trajectory(self.path, *slower, self.dilation * factor, self.part)


def _derivative(c: FloatArray, x: FloatArray, order: int) -> FloatArray:
    """The value or a derivative of cubics with coefficients (..., 4) at x (...)."""
    c0, c1, c2, c3 = c[..., 0], c[..., 1], c[..., 2], c[..., 3]
    if order == 0:
        return np.asarray(c0 + x * (c1 + x * (c2 + x * c3)))
    if order == 1:
        return np.asarray(c1 + x * (2.0 * c2 + 3.0 * c3 * x))
    if order == 2:
        return np.asarray(2.0 * c2 + 6.0 * c3 * x)
    return np.asarray(6.0 * c3 * np.ones_like(x))


def _geometry(path: JointPath, c: FloatArray, ends: FloatArray) -> IntArray:
    """The piece of the path on which each piece of s(t) runs."""
    # found by its middle, kept below its end: the start and end of a very short piece may be one number
    middle = np.minimum(c[:, 0] + (ends - c[:, 0]) / 2.0, np.nextafter(ends, 0.0))
    piece = path.pieces_at(middle)
    if np.any(path.blended):
        gap = OVERSHOOT + ROUNDING * path.length
        after = path.pieces_at(np.minimum(c[:, 0] + gap, middle))
        before = path.pieces_at(np.maximum(ends - gap, middle))
        torn = (after != before) & (path.blended[after] | path.blended[before] | path.blended[piece])
        if np.any(torn):
            k = int(torn.argmax())
            raise InvalidRequest(f"coefficients[{k}]", [float(c[k, 0]), float(ends[k])], "s inside or outside a blend")
    return piece


def _checked_part(part: object, length: float) -> tuple[float, float]:
    begin, end = finite_numbers("part", part, 2).tolist()
    if not 0.0 <= begin <= end <= length:
        raise InvalidRequest("part", (begin, end), f"0 <= begin <= end <= {length:.9g}")
    return begin, end


def _check_law(trajectory: Trajectory, h: FloatArray, c: FloatArray, ends: FloatArray) -> None:
    """Raise unless s(t) runs along its part of the path without a jump, turn or passed corner."""
    path, begin, end = trajectory.path, trajectory.begin, trajectory.end
    if len(h) == 0 or end == begin:
        if len(h) or end > begin:
            raise InvalidRequest("durations", len(h), "pieces for a path with a length, none for a single point")
        return
    reached, arrivals, bends = (_derivative(c, h, order) for order in range(3))
    if not all(np.isfinite(values).all() for values in (reached, arrivals, 2.0 * c[:, 2], bends)):
        expected = "numbers whose speeds and accelerations are finite"
        raise InvalidRequest("coefficients", float(np.abs(c).max()), expected)
    jumps = np.abs(reached - ends)
    if c[0, 0] != begin or not jumps.sum() <= OVERSHOOT + ROUNDING * path.length * len(h):  # many add up
        raise InvalidRequest("coefficients", float(c[0, 0]), f"s(t) from {begin:.9g} to {end:.9g} without a jump")
    speeds = c[:, 1]
    slack = OVERSHOOT * max(speeds.max(), arrivals.max())
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        turning = np.where(c[:, 3] != 0.0, -c[:, 2] / (3.0 * c[:, 3]), 0.0)
    slowest = np.minimum(np.minimum(speeds, arrivals), _derivative(c, np.clip(turning, 0.0, h), 1))
    if np.any(slowest < -slack) or np.any(ends < c[:, 0]):
        raise InvalidRequest("coefficients", float(slowest.min()), "s(t) that never turns back")
    departure = speeds[0] if trajectory.part is None else 0.0
    if np.any(np.abs(arrivals[:-1] - speeds[1:]) > slack) or max(departure, arrivals[-1]) > slack:
        raise InvalidRequest("coefficients", float(speeds[0]), "a speed ds/dt without jumps, 0 at both ends")
    corners = path.corners
    stops = set(c[speeds <= slack, 0].tolist()) if corners else set()
    for s in path.knots[list(corners)].tolist():
        if begin < s < end and s not in stops:
            raise InvalidRequest("coefficients", s, f"a stop at the path's corner at s = {s:.9g}")
