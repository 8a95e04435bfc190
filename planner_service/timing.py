"""Timing laws: how fast to travel along a path, all joints on one s(t), so that a straight line stays exactly straight.

A corner of a polyline is a stop, since only infinite acceleration passes it at speed. Between stops the joints'
limits become limits of the path parameter, ds/dt <= min v_i / abs(dq_i/ds) and likewise for acceleration and jerk.
No law is trusted: the limits are verified on its result, and time is stretched should it break one.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from planner_service.errors import InvalidRequest, PlannerServiceError
from planner_service.geometry import FloatArray, number
from planner_service.path import JointPath, Trajectory
from planner_service.profiles import Phase, s_curve, trapezoid

if TYPE_CHECKING:
    from planner_service.robot import JointLimits

__all__ = [
    "LimitPeaks",
    "Peak",
    "SCurve",
    "Timing",
    "TimingFailed",
    "ToppRa",
    "Trapezoidal",
    "peaks",
    "within_limits",
]

TOLERANCE = 1e-9
"""How far a ratio to a limit may exceed 1: rounding, six orders below what an encoder resolves."""

STANDING = 1e-12
"""A joint with a smaller share of a direction stands still; its limits are not asked."""

SHORT_MOVE = 1e-3
"""Below this length (rad) TOPP-RA is badly conditioned (it fails at 1e-6 rad, not at 1e-9): the closed form is used."""

MAX_GRIDPOINTS = 10_000

MIN_JERK, MAX_JERK = 1e-6, 1e6
"""rad/s^3. No arm is slower, and none feels more: at 1e9 a phase of jerk is so short that rounding is a jump."""


class TimingFailed(PlannerServiceError):
    """No time law was found along a path, for a reason that is not a mistake of the caller."""


class Timing(Protocol):
    """A timing law: its settings are its fields."""

    @property
    def name(self) -> str:
        """Short name for tables."""

    def time_path(self, path: JointPath, limits: JointLimits) -> Trajectory:
        """The path travelled from rest to rest, stopping at its corners, with velocity and acceleration within limits.

        Raises:
            InvalidRequest: limits of another length than the path's, or one that is not positive and finite for a
                joint that moves (a joint that stands still may have any).
            TimingFailed: the law found no solution.
        """


@dataclass(frozen=True)
class Trapezoidal:
    """Trapezoids and triangles: the fastest law under velocity and acceleration limits; jerk is unbounded."""

    name = "trapezoidal"

    def time_path(self, path: JointPath, limits: JointLimits) -> Trajectory:
        _require_usable(path, limits, jerk=False)

        def law(stretch: _Stretch) -> Sequence[Phase]:
            return trapezoid(stretch.length, *stretch.bounds(limits)[:2])

        return within_limits(_timed(path, law), limits)


@dataclass(frozen=True)
class SCurve:
    """Seven-phase S-curves: the fastest rest-to-rest law when jerk is limited too.

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

    def time_path(self, path: JointPath, limits: JointLimits) -> Trajectory:
        if self.jerk is not None:
            limits = replace(limits, jerk=np.full(path.n, float(self.jerk)))
        _require_usable(path, limits, jerk=True)

        def law(stretch: _Stretch) -> Sequence[Phase]:
            return s_curve(stretch.length, *stretch.bounds(limits))

        return within_limits(_timed(path, law), limits, jerk=True)


@dataclass(frozen=True)
class ToppRa:
    """TOPP-RA (Pham & Pham, IEEE T-RO 34(3), 2018): time-optimal under velocity and acceleration limits.

    Its path speeds are used as they are, with constant acceleration between them, so the result stays on the path; a
    parametrizer that fits a spline would not. Between two stops of a polyline the optimum is the trapezoid's.

    Args:
        gridpoints: Intervals per stretch between stops.

    Raises:
        InvalidRequest: gridpoints is not an integer in [2, 10000].
    """

    gridpoints: int = 50

    name = "toppra"

    def __post_init__(self) -> None:
        count = self.gridpoints
        if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_GRIDPOINTS:
            raise InvalidRequest("gridpoints", count, f"an integer in [2, {MAX_GRIDPOINTS}]")

    def time_path(self, path: JointPath, limits: JointLimits) -> Trajectory:
        _require_usable(path, limits, jerk=False)

        def law(stretch: _Stretch) -> Sequence[Phase]:
            if stretch.length < SHORT_MOVE:
                return trapezoid(stretch.length, *stretch.bounds(limits)[:2])
            # denser at both stops, where speed changes fastest: 0.06 % above the optimum with 50, 3 % with equal steps
            grid = np.array([math.sin(math.pi / 2 * i / self.gridpoints) ** 2 for i in range(self.gridpoints + 1)])
            return _constant_accelerations(grid * stretch.length, _toppra_speeds(stretch, limits, grid))

        return within_limits(_timed(path, law), limits)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A straight part of a path between two stops."""

    path: JointPath
    first: int
    last: int

    @property
    def start(self) -> float:
        return float(self.path.knots[self.first])

    @property
    def length(self) -> float:
        return float(self.path.knots[self.last]) - self.start

    @property
    def direction(self) -> FloatArray:
        """dq/ds, with exact zeros for joints that stand still."""
        tangent = self.path(self.start, 1)
        return np.where(np.abs(tangent) > STANDING, tangent, 0.0)

    def bounds(self, limits: JointLimits) -> tuple[float, float, float]:
        """Largest ds/dt and its first two derivatives that no joint's limit forbids."""
        share = np.abs(self.direction)
        moving = share > 0.0
        rows = (limits.velocity, limits.acceleration, limits.jerk)
        with np.errstate(over="ignore"):  # a law may not use that limit
            v, a, j = (float((row[moving] / share[moving]).min()) for row in rows)
        return v, a, j


def _stretches(path: JointPath) -> Iterator[_Stretch]:
    stops = [0, *path.corners, len(path.waypoints) - 1]
    if path.length > 0.0:
        for first, last in pairwise(stops):
            yield _Stretch(path, first, last)


def _timed(path: JointPath, law: Callable[[_Stretch], Sequence[Phase]]) -> Trajectory:
    durations: list[float] = []
    coefficients: list[tuple[float, float, float, float]] = []
    try:
        with np.errstate(over="raise"):
            for stretch in _stretches(path):
                for phase in law(stretch):
                    durations.append(phase.duration)
                    start = stretch.start + phase.position
                    coefficients.append((start, phase.speed, phase.acceleration / 2.0, phase.jerk / 6.0))
            return Trajectory(path, np.array(durations), np.array(coefficients).reshape(-1, 4))
    except (ArithmeticError, InvalidRequest) as error:  # overflow, or a law of which rounding left nothing
        raise TimingFailed(f"limits too extreme to compute with ({error})") from error


def _require_usable(path: JointPath, limits: JointLimits, *, jerk: bool) -> None:
    """Raise unless every joint that moves on the path has positive, finite limits."""
    share = np.abs(path(path.knots, 1)).max(axis=0)
    for name in ("velocity", "acceleration", "jerk")[: 3 if jerk else 2]:
        row: FloatArray = getattr(limits, name)
        if row.shape != (path.n,):
            raise InvalidRequest(f"limits.{name}", row.shape, f"one number for each of the path's {path.n} joints")
        bad = np.flatnonzero((share > STANDING) & ~((row > 0.0) & np.isfinite(row)))
        if len(bad):
            joint = int(bad[0])
            expected = f"a positive, finite number: joint {joint} moves on this path"
            raise InvalidRequest(f"limits.{name}[{joint}]", float(row[joint]), expected)
    if limits.jerk.shape != (path.n,):
        raise InvalidRequest("limits.jerk", limits.jerk.shape, f"one number for each of the path's {path.n} joints")


class Peak(NamedTuple):
    """The closest a motion comes to a limit: its share of it, the joint's index, and when (seconds)."""

    ratio: float
    joint: int
    time: float


@dataclass(frozen=True)
class LimitPeaks:
    """How close a trajectory comes to each kind of limit; a ratio above 1 breaks it."""

    velocity: Peak
    acceleration: Peak
    jerk: Peak


@np.errstate(over="ignore")  # what is too large for a float is too large for a limit
def peaks(trajectory: Trajectory, limits: JointLimits) -> LimitPeaks:
    """The largest velocity, acceleration and jerk of any joint relative to its limit.

    Exact: the extrema of a piecewise cubic s(t) are at the ends of its pieces and at the roots of its derivatives.
    The jerk's ratio is infinite where acceleration jumps, as it does under a trapezoidal law. All are 0 when nothing
    moves.

    Raises:
        InvalidRequest: limits of another length than the trajectory's joints, or a velocity or acceleration limit
            that is not positive and finite for a joint that moves.
    """
    _require_usable(trajectory.path, limits, jerk=False)
    if not len(trajectory.durations):
        return LimitPeaks(Peak(0.0, 0, 0.0), Peak(0.0, 0, 0.0), Peak(0.0, 0, 0.0))
    share = np.abs(trajectory.directions)
    share = np.where(share > STANDING, share, 0.0)
    h, starts = trajectory.durations, trajectory.knots[:-1]
    _, c1, c2, c3 = trajectory.coefficients.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        turning = np.clip(np.where(c3 != 0.0, -c2 / (3.0 * c3), 0.0), 0.0, h)
    at = np.stack([np.zeros_like(h), turning, h], axis=1)
    speed = np.abs(c1[:, None] + at * (2.0 * c2[:, None] + 3.0 * c3[:, None] * at))
    rate = np.abs(2.0 * c2[:, None] + 6.0 * c3[:, None] * at)
    velocity = _peak(speed, share, limits.velocity, starts[:, None] + at)
    acceleration = _peak(rate, share, limits.acceleration, starts[:, None] + at)
    jerk = _jump(trajectory) or _peak(np.abs(6.0 * c3)[:, None], share, limits.jerk, starts[:, None])
    return LimitPeaks(velocity, acceleration, jerk)


def _peak(rates: FloatArray, share: FloatArray, limit: FloatArray, times: FloatArray) -> Peak:
    """The largest of rate x share / limit; rates and times have a row per piece of time, share a column per joint."""
    with np.errstate(divide="ignore", invalid="ignore"):
        per_joint = np.where(share > 0.0, share / limit, 0.0)
        ratios = np.nan_to_num(rates.max(axis=1)[:, None] * per_joint, nan=0.0, posinf=math.inf)  # nan is 0 x inf
    piece, joint = np.unravel_index(int(ratios.argmax()), ratios.shape)
    return Peak(float(ratios[piece, joint]), int(joint), float(times[piece, int(rates[piece].argmax())]))


def _jump(trajectory: Trajectory) -> Peak | None:
    """The largest instantaneous change of acceleration, rest before and after included, or None where there is none."""
    _, _, c2, c3 = trajectory.coefficients.T
    rest = np.zeros((1, trajectory.path.n))
    begins = np.concatenate([trajectory.directions * (2.0 * c2)[:, None], rest])
    ends = np.concatenate([rest, trajectory.directions * (2.0 * c2 + 6.0 * c3 * trajectory.durations)[:, None]])
    jumps = np.abs(begins - ends)
    knot, joint = np.unravel_index(int(jumps.argmax()), jumps.shape)
    if jumps[knot, joint] <= TOLERANCE * max(np.abs(begins).max(), np.abs(ends).max()):
        return None
    return Peak(math.inf, int(joint), float(trajectory.knots[knot]))


def within_limits(trajectory: Trajectory, limits: JointLimits, *, jerk: bool = False) -> Trajectory:
    """The trajectory itself if it holds the limits (within 1e-9), else the same slowed down until it just does.

    ``dilation`` of the result says by how much. Jerk is looked at only when asked for.

    Raises:
        InvalidRequest: as ``peaks``.
        TimingFailed: jerk is asked for and acceleration jumps, which no slowing down mends.
    """
    found = peaks(trajectory, limits)
    ratios = [found.velocity.ratio, found.acceleration.ratio, *([found.jerk.ratio] if jerk else [])]
    if max(ratios) <= 1.0 + TOLERANCE:
        return trajectory
    if not math.isfinite(max(ratios)):
        raise TimingFailed(f"acceleration of joint {found.jerk.joint} jumps at t = {found.jerk.time:.6g} s")
    factor = max(math.pow(ratio, 1.0 / power) for power, ratio in enumerate(ratios, start=1))
    return trajectory.dilated(factor)


def _constant_accelerations(grid: FloatArray, speeds: FloatArray) -> list[Phase]:
    """The motion with the given speed at each grid point and constant acceleration in between."""
    phases = []
    for i in range(len(grid) - 1):
        step, v0, v1 = float(grid[i + 1] - grid[i]), float(speeds[i]), float(speeds[i + 1])
        if not v0 + v1 > 0.0:
            raise TimingFailed(f"TOPP-RA: speed 0 from {grid[i]:.6g} to {grid[i + 1]:.6g} rad of a stretch")
        duration = 2.0 * step / (v0 + v1)
        phases.append(Phase(duration, float(grid[i]), v0, (v1 - v0) / duration, 0.0))
    return phases


@dataclass(frozen=True, eq=False)
class _UnitLine:
    """A straight stretch over the parameter [0, 1], as toppra asks for a path; only of the joints that move."""

    displacement: FloatArray

    @property
    def dof(self) -> int:
        return len(self.displacement)

    @property
    def path_interval(self) -> tuple[float, float]:
        return (0.0, 1.0)

    def __call__(self, positions: FloatArray, order: int = 0) -> FloatArray:
        at = np.asarray(positions, dtype=np.float64)[..., np.newaxis]
        if order == 0:
            return at * self.displacement
        return np.broadcast_to(self.displacement * (order == 1), (*at.shape[:-1], self.dof)).copy()


def _toppra_speeds(stretch: _Stretch, limits: JointLimits, grid: FloatArray) -> FloatArray:
    """ds/dt at each grid point (share of the stretch, 0 to 1) by TOPP-RA."""
    toppra = _toppra()
    moving = np.flatnonzero(stretch.direction)
    # toppra's tolerances are absolute: in units of the stretch and of its trapezoid's time they suit every move
    unit = sum(phase.duration for phase in trapezoid(stretch.length, *stretch.bounds(limits)[:2]))
    velocity, acceleration = limits.velocity[moving] * unit, limits.acceleration[moving] * (unit * unit)
    scheme = toppra.constraint.DiscretizationType.Interpolation
    bounds = [
        toppra.constraint.JointVelocityConstraint(velocity),
        toppra.constraint.JointAccelerationConstraint(acceleration, discretization_scheme=scheme),
    ]
    line = _UnitLine(stretch.direction[moving] * stretch.length)
    solver = toppra.algorithm.TOPPRA(
        bounds, line, gridpoints=grid, solver_wrapper="seidel", parametrizer="ParametrizeConstAccel"
    )
    _, speeds, _ = solver.compute_parameterization(0.0, 0.0)
    if speeds is None or not np.all(np.isfinite(speeds)):
        raise TimingFailed(f"TOPP-RA on the piece from s = {stretch.start:.6g}: {solver.problem_data.return_code.name}")
    return np.asarray(speeds * (stretch.length / unit), dtype=np.float64)


def _toppra() -> Any:
    """The toppra library, quiet: it imports matplotlib, whose complaints about its cache do not concern the caller."""
    plotting, own = logging.getLogger("matplotlib"), logging.getLogger("toppra")
    level = plotting.level
    plotting.setLevel(logging.ERROR)
    try:
        import toppra
        import toppra.algorithm
        import toppra.constraint
    finally:
        plotting.setLevel(level)
    if own.level == logging.NOTSET:  # a failure comes back as TimingFailed; its warnings would only repeat it
        own.setLevel(logging.CRITICAL)
    return toppra
