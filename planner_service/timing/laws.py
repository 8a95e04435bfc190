"""Timing laws: how fast to travel along a path, all joints on one s(t), so that a straight line stays exactly straight.

A corner that is not blended is a stop, since only infinite acceleration passes it at speed. Between stops the joints'
limits become limits of the path parameter: on straight parts ds/dt <= min v_i / abs(dq_i/ds) and likewise for
acceleration and jerk, on blends by the chain rule. No law is trusted: the limits are verified on its result, between
the points it looked at too, and time is stretched should it break one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner_service.errors import InvalidRequest, PlannerServiceError
from planner_service.geometry.shapes import FloatArray, cosines_and_sines, number, whole
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.timing.limit_check import TOLERANCE, LimitPeaks, peaks, require_usable
from planner_service.timing.profiles import Part, Phase, TooFast, chained, trapezoid
from planner_service.timing.segments import SpeedLimit, Stretch, straight_parts, stretches
from planner_service.timing.toppra_backend import two_passes

if TYPE_CHECKING:
    from planner_service.robot.model import JointLimits

__all__ = [
    "SCurve",
    "Timing",
    "TimingFailed",
    "ToppRa",
    "Trapezoidal",
    "held_limits",
    "measured",
    "stop_duration",
    "within_limits",
]

SHORT_MOVE = 1e-3
"""Below this length (rad) TOPP-RA is badly conditioned (it fails at 1e-6 rad, not at 1e-9): the closed form is used."""

MAX_GRIDPOINTS = 10_000

BLEND_GRIDPOINTS = 24
"""Intervals on a blend: with 24 limits are exceeded between grid points by 0.3 % (p50), with 16 by twice that."""

MIN_GRIDPOINTS = 4
"""Intervals on a straight part between blends."""

RUN_UP = 1e-6
"""Of a blend's length. With less between it and a stop a constant speed on it would take thousands of seconds."""

SPEED_SPACING = 0.1
"""Radians between grid points under a speed limit, on average: it may change along straight parts too."""

TAYLOR = np.array([1.0, 1.0, 2.0, 6.0])
"""What turns position, speed, acceleration and jerk into coefficients of a cubic."""

Measured = tuple[Trajectory, LimitPeaks]

MIN_JERK, MAX_JERK = 1e-6, 1e6
"""rad/s^3. No arm is slower, and none feels more: at 1e9 a phase of jerk is so short that rounding is a jump."""


class TimingFailed(PlannerServiceError):
    """No time law was found along a path, for a reason that is not a mistake of the caller."""


class Timing(Protocol):
    """A timing law: its settings are its fields."""

    @property
    def name(self) -> str:
        """Short name for tables."""

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest, stopping at its corners, with velocity and acceleration within limits.

        Args:
            speed_limit: Bounds ds/dt along the path too. It is asked for at many points, and not verified between them.

        Raises:
            InvalidRequest: limits of another length than the path's, or one that is not positive and finite for a
                joint that moves (a joint that stands still may have any); a speed limit that is not positive.
            TimingFailed: the law found no solution.
        """


@dataclass(frozen=True)
class Trapezoidal:
    """Trapezoids and triangles: the fastest law for a straight line if velocity and acceleration have limits.

    Jerk is unbounded. A blend is passed at constant speed, the largest that all joints and its neighbours allow.
    """

    name = "trapezoidal"

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest; see ``Timing``."""
        return self.measured(path, limits, speed_limit)[0]

    def measured(self, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None) -> Measured:
        """The same with its peaks, which were measured to hold the limits."""
        require_usable(path, limits, jerk=False)
        return _held(_timed(path, stretches(path, limits, speed_limit), _trapezoids), limits)


@dataclass(frozen=True)
class SCurve:
    """Seven-phase S-curves: the fastest rest-to-rest law for a straight line when jerk is limited too.

    A blend is passed at constant speed, and without acceleration where it meets a straight part.

    Args:
        jerk: One limit for all joints (rad/s^3); None takes each joint's own from the robot.

    Raises:
        InvalidRequest: jerk is not a number from 1e-6 to 1e6.
    """

    jerk: float | None = None

    name = "s-curve"

    def __post_init__(self) -> None:
        if self.jerk is not None:
            expected = f"a number of rad/s^3 from {MIN_JERK:g} to {MAX_JERK:g}, or None for the robot's own"
            object.__setattr__(self, "jerk", number("jerk", self.jerk, expected, MIN_JERK, MAX_JERK))

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest; see ``Timing``."""
        return self.measured(path, limits, speed_limit)[0]

    def measured(self, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None) -> Measured:
        """The same with its peaks, which were measured to hold the limits."""
        limits = held_limits(self, limits)
        require_usable(path, limits, jerk=True)
        return _held(_timed(path, stretches(path, limits, speed_limit), _s_curves), limits, jerk=True)


@dataclass(frozen=True)
class ToppRa:
    """TOPP-RA (Pham & Pham, IEEE T-RO 34(3), 2018): time-optimal under velocity and acceleration limits.

    Its path speeds are used as they are, with constant acceleration between them, so the result stays on the path; a
    parametrizer that fits a spline would not. Limits hold at the grid points, and are exceeded between them by some
    0.3 % on blends, which dilation takes back. Between two stops on a straight line the optimum is the trapezoid, in
    closed form, and that is taken. Where TOPP-RA fails on blends, or is slower than trapezoids, as with blends below
    1e-4 rad, trapezoids it is, too.

    Args:
        gridpoints: Intervals between two stops, shared by the straight parts; blends have 24 each.

    Raises:
        InvalidRequest: gridpoints is not an integer in [2, 10000].
    """

    gridpoints: int = 50

    name = "toppra"

    def __post_init__(self) -> None:
        object.__setattr__(self, "gridpoints", whole("gridpoints", self.gridpoints, 2, MAX_GRIDPOINTS))

    def time_path(self, path: JointPath, limits: JointLimits, *, speed_limit: SpeedLimit | None = None) -> Trajectory:
        """The path travelled from rest to rest; see ``Timing``."""
        return self.measured(path, limits, speed_limit)[0]

    def measured(self, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None) -> Measured:
        """The same with its peaks, which were measured to hold the limits."""
        require_usable(path, limits, jerk=False)
        return _held(_timed(path, stretches(path, limits, speed_limit), self._between_stops), limits)

    def onward(
        self,
        path: JointPath,
        limits: JointLimits,
        moving: tuple[float, float],
        *,
        speed_limit: SpeedLimit | None = None,
        blend_share: float = 1.0,
    ) -> list[Phase]:
        """The law along what is left of a path, at whose end it rests, as phases; their limits are not verified.

        Args:
            moving: Where it begins in s, and ds/dt there.
            blend_share: The part of the limits that may be used on blends, between whose grid points they are exceeded
                a little.

        Raises:
            InvalidRequest: as ``time_path``.
            TimingFailed: the speed is too high to slow down in time, or there is no solution.
        """
        require_usable(path, limits, jerk=False)
        since, rate = moving
        phases: list[Phase] = []
        with _failing():
            for whole in stretches(path, limits, speed_limit, since):
                stretch = replace(whole, blend_share=blend_share)
                phases += self._to_stop(stretch, 0.0 if phases else rate)
        return phases

    def _between_stops(self, stretch: Stretch) -> list[Phase]:
        return self._to_stop(stretch, 0.0)

    def _to_stop(self, stretch: Stretch, rate: float) -> list[Phase]:
        parts = stretch.parts(jerk=False)
        steady: list[Phase] | None = None
        if not _blend_at_stop(parts, rate):
            with suppress(TooFast):
                steady = chained(parts, rate)
        straight = len(parts) == 1 and stretch.speed_limit is None
        if steady is not None and (straight or stretch.length < SHORT_MOVE):
            return steady
        unit = min(_seconds(phases) for phases in (steady, _slowest(parts)) if phases is not None)
        try:
            quick = _topp_ra(stretch, parts, self.gridpoints, unit, rate)
        except TimingFailed:
            if steady is None:
                raise
            return steady
        return quick if steady is None else min(quick, steady, key=_seconds)


def held_limits(timing: Timing, limits: JointLimits) -> JointLimits:
    """The limits that a law holds, given a robot's: an S-curve may have a jerk limit of its own."""
    if isinstance(timing, SCurve) and timing.jerk is not None:
        return replace(limits, jerk=np.full(len(limits.jerk), timing.jerk))
    return limits


def stop_duration(path: JointPath, timing: Timing, limits: JointLimits) -> float:
    """Seconds that the law takes for the polyline itself, with a stop at each of its corners.

    For TOPP-RA they are those of trapezoids, its optimum between stops.

    Raises:
        InvalidRequest, TimingFailed: as ``Timing.time_path``.
    """
    sharp = path.with_blends(None)
    if type(timing) not in (ToppRa, Trapezoidal, SCurve):
        return timing.time_path(sharp, limits).duration
    limits, jerk = held_limits(timing, limits), isinstance(timing, SCurve)
    require_usable(sharp, limits, jerk=jerk)
    with _failing():
        phases = [phase for part in straight_parts(sharp, limits, jerk=jerk) for phase in chained([part])]
    seconds = _seconds(phases) if phases else 0.0
    if not math.isfinite(seconds):
        raise TimingFailed(f"limits too extreme to compute with ({seconds} s)")
    return seconds


def measured(
    timing: Timing, path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None
) -> tuple[Trajectory, LimitPeaks]:
    """What a law makes of a path, and how close to these limits that comes.

    Raises:
        InvalidRequest, TimingFailed: as ``Timing.time_path``.
    """
    if isinstance(timing, Trapezoidal | SCurve | ToppRa):
        return timing.measured(path, limits, speed_limit)
    trajectory = timing.time_path(path, limits, speed_limit=speed_limit)
    return trajectory, peaks(trajectory, limits)


@contextmanager
def _failing() -> Iterator[None]:
    """Within the block arithmetic that leaves the floats is a failure."""
    try:
        with np.errstate(over="raise"):
            yield
    except ArithmeticError as error:
        raise TimingFailed(f"limits too extreme to compute with, or path ({error})") from error


def _timed(path: JointPath, between_stops: Iterable[Stretch], law: Callable[[Stretch], list[Phase]]) -> Trajectory:
    with _failing():
        phases = [phase for stretch in between_stops for phase in law(stretch)]
    table = np.array(phases).reshape(-1, 5)
    try:
        return Trajectory(path, table[:, 0], table[:, 1:] / TAYLOR)
    except InvalidRequest as error:  # a law of which rounding left nothing
        raise TimingFailed(f"limits too extreme to compute with ({error})") from error


def _trapezoids(stretch: Stretch) -> list[Phase]:
    return _steady(stretch, stretch.parts(jerk=False))


def _s_curves(stretch: Stretch) -> list[Phase]:
    return _steady(stretch, stretch.parts(jerk=True))


def _steady(stretch: Stretch, parts: Sequence[Part]) -> list[Phase]:
    """The closed form, with constant speed on blends."""
    if _blend_at_stop(parts):
        raise TimingFailed(f"no constant speed on a blend that reaches a stop (stretch from s = {stretch.start:.6g})")
    return chained(parts)


def _blend_at_stop(parts: Sequence[Part], rate: float = 0.0) -> bool:
    """Whether there is no way worth the name to slow down after the last blend, or, from rest, to speed up before."""
    if len(parts) == 1:
        return parts[0].blended
    ends = ((parts[-1], parts[-2]), (parts[0], parts[1]))[: 1 if rate > 0.0 else 2]
    return any(end.blended or end.length < RUN_UP * inner.length for end, inner in ends)


def _slowest(parts: Sequence[Part]) -> Sequence[Phase]:
    """A motion as long as all parts together, under the least bounds of any."""
    speed, acceleration = (min(part.bounds[k] for part in parts) for k in range(2))
    return trapezoid(math.fsum(part.length for part in parts), speed, acceleration)


def _seconds(phases: Iterable[Phase]) -> float:
    return list(accumulate(phase.duration for phase in phases))[-1]


def within_limits(trajectory: Trajectory, limits: JointLimits, *, jerk: bool = False) -> Trajectory:
    """The trajectory itself if it holds the limits (within 1e-9), else the same slowed down until it just does.

    ``dilation`` of the result says by how much. Jerk is looked at only when asked for.

    Raises:
        InvalidRequest: as ``peaks``.
        TimingFailed: jerk is asked for and acceleration jumps, which no slowing down mends.
    """
    return _held(trajectory, limits, jerk=jerk)[0]


def _held(trajectory: Trajectory, limits: JointLimits, *, jerk: bool = False) -> Measured:
    found = peaks(trajectory, limits)
    ratios = [found.velocity.ratio, found.acceleration.ratio, *([found.jerk.ratio] if jerk else [])]
    if max(ratios) <= 1.0 + TOLERANCE:
        return trajectory, found
    if not math.isfinite(max(ratios)):
        raise TimingFailed(f"acceleration of joint {found.jerk.joint} jumps at t = {found.jerk.time:.6g} s")
    factor = max(math.pow(ratio, 1.0 / power) for power, ratio in enumerate(ratios, start=1))
    return trajectory.dilated(factor), found.dilated(factor)


def _grid(part: Part, stretch: Stretch, gridpoints: int) -> FloatArray:
    """Where speeds are asked for along a part, as shares of it from 0 to 1."""
    if part.blended:
        return np.arange(BLEND_GRIDPOINTS + 1) / BLEND_GRIDPOINTS
    count = max(min(gridpoints, MIN_GRIDPOINTS), math.ceil(gridpoints * (part.length / stretch.length)))
    if stretch.speed_limit is not None:
        count = max(count, math.ceil(part.length / SPEED_SPACING))
    # denser at both ends, where speed changes fastest: 0.06 % above the optimum with 50, 3 % with equal steps
    sines = cosines_and_sines(math.pi / 2 * np.arange(count + 1) / count)[1]
    return sines * sines


def _topp_ra(stretch: Stretch, parts: Sequence[Part], gridpoints: int, unit: float, rate: float = 0.0) -> list[Phase]:
    """TOPP-RA's motion from ``rate``; ``unit`` is about as many seconds as it takes."""
    grids = [_grid(part, stretch, gridpoints) for part in parts]
    speeds = _toppra_speeds(stretch, parts, grids, (unit, rate))
    speeds[0][0] = rate
    return _constant_accelerations(parts, grids, speeds)


def _constant_accelerations(
    parts: Sequence[Part], grids: Sequence[FloatArray], speeds: Sequence[FloatArray]
) -> list[Phase]:
    """The motion with the given speed at each grid point and constant acceleration in between."""
    phases = []
    for part, grid, speed in zip(parts, grids, speeds, strict=True):
        steps = zip(pairwise((grid * part.length).tolist()), pairwise(speed.tolist()), strict=False)
        for (before, after), (v0, v1) in steps:
            if not v0 + v1 > 0.0:
                s = part.start + before, part.start + after
                raise TimingFailed(f"TOPP-RA: speed 0 from s = {s[0]:.6g} to {s[1]:.6g}")
            duration = 2.0 * (after - before) / (v0 + v1)
            phases.append(Phase(duration, part.start + before, v0, (v1 - v0) / duration, 0.0))
    return phases


def _toppra_speeds(
    stretch: Stretch, parts: Sequence[Part], grids: Sequence[FloatArray], known: tuple[float, float]
) -> list[FloatArray]:
    """ds/dt at each point of each part's grid by TOPP-RA; known are its unit and the first of these speeds."""
    length = stretch.length
    shares = [
        (part.start - stretch.start) / length + grid[:-1] * (part.length / length)
        for part, grid in zip(parts, grids, strict=True)
    ]
    points = np.concatenate([*shares, [1.0]])
    if not np.all(points[1:] > points[:-1]):
        raise TimingFailed(f"TOPP-RA on the piece from s = {stretch.start:.6g}: grid points of a tiny blend coincide")
    speeds = two_passes(stretch, points, *known)
    if isinstance(speeds, str):
        raise TimingFailed(f"TOPP-RA on the piece from s = {stretch.start:.6g}: {speeds}")
    ends = np.cumsum([0, *(len(grid) - 1 for grid in grids)])
    return [speeds[a : b + 1] for a, b in pairwise(ends.tolist())]
