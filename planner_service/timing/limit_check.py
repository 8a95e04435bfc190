"""How close a trajectory comes to its limits, computed exactly: samples would miss what lies between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.validation import instance
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import JointLimits

__all__ = ["MIN_SHARE", "ORDERS", "TOLERANCE", "LimitPeaks", "Peak", "peaks", "reference_peaks", "require_limits"]

TOLERANCE = 1e-9
"""How far a ratio to a limit may exceed 1 by rounding: six orders of magnitude below what an encoder resolves."""

MIN_SHARE = 1e-12
"""A joint whose share of a direction, abs(dq_i/ds), is smaller stands still: its limits are ignored."""

EXACT = 1e-12
"""Relative error of a peak on a blend: a thousandth of ``TOLERANCE``."""

MAX_ROUNDS, INTERVALS_PER_MAX = 300, 1_200
"""Rounds of splitting intervals of time, and as many more for every so many intervals at the start. Every fifth round
halves them, and after 60 halvings both ends are one number. For intervals that are then still open the bound counts."""

BATCH = 24
"""Intervals split per round: those with the highest bounds, since a peak found there rules out most of the others."""


class Peak(NamedTuple):
    """Where a motion comes closest to a limit: its ratio to the limit, the joint's index, and the time in seconds."""

    ratio: float
    joint: int
    time: float


NONE = Peak(0.0, 0, 0.0)

ORDERS = ("velocity", "acceleration", "jerk")
"""Names of the limits, by the order of the derivative."""


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


def require_limits(path: JointPath, limits: JointLimits, *, jerk: bool) -> None:
    """Refuse limits that are not positive and finite for each joint that moves on the path.

    Raises:
        InvalidRequest: such a limit, limits of another length than the path's, or something that is no path.
    """
    instance("path", path, JointPath, "a JointPath")
    share = np.abs(path(path.breaks, 1)).max(axis=0)
    for name in ORDERS if jerk else ORDERS[:2]:
        row: FloatArray | None = getattr(limits, name, None)
        if not isinstance(row, np.ndarray):
            raise InvalidRequest("limits", limits, "JointLimits")
        if row.shape != (path.n,):
            raise InvalidRequest(f"limits.{name}", row.shape, f"one number for each of the path's {path.n} joints")
        bad = np.flatnonzero((share > MIN_SHARE) & ~((row > 0.0) & np.isfinite(row)))
        if len(bad):
            joint = int(bad[0])
            expected = f"a positive, finite number: joint {joint} moves on this path"
            raise InvalidRequest(f"limits.{name}[{joint}]", float(row[joint]), expected)
    if limits.jerk.shape != (path.n,):
        raise InvalidRequest("limits.jerk", limits.jerk.shape, f"one number for each of the path's {path.n} joints")


def peaks(trajectory: Trajectory, limits: JointLimits) -> LimitPeaks:
    """The largest velocity, acceleration and jerk of any joint relative to its limit.

    Exact on straight pieces, where the extrema of the cubic s(t) are at its ends and at the roots of its derivatives.
    On a blend the joint's motion is a polynomial of time too; it lies between its smallest and largest Bernstein
    coefficients, and splitting its interval brings these together. The result is exact to a relative 1e-12, or too
    high if that takes too many splits. The jerk ratio is infinite where acceleration jumps, as it does under a
    trapezoidal law. All ratios are 0 if nothing moves.

    Raises:
        InvalidRequest: limits of another length than the trajectory's joints, or a velocity or acceleration limit
            that is not positive and finite for a joint that moves.
    """
    require_limits(trajectory.path, limits, jerk=False)
    core = load_core()
    if core is None:
        return reference_peaks(trajectory, limits)
    rows = map(np.ascontiguousarray, (limits.velocity, limits.acceleration, limits.jerk))
    velocity, acceleration, jerk = map(Peak._make, core.TrajectoryTables(*trajectory.tables).peaks(*rows))
    return LimitPeaks(velocity, acceleration, jerk)


@np.errstate(over="ignore")  # a rate that overflows exceeds every limit
def reference_peaks(trajectory: Trajectory, limits: JointLimits) -> LimitPeaks:
    """``peaks`` in Python: the same bits."""
    if not len(trajectory.durations):
        return LimitPeaks(NONE, NONE, NONE)
    jump = _jump(trajectory)
    orders = [getattr(limits, name) for name in (ORDERS if jump is None else ORDERS[:2])]
    blended = trajectory.path.blended[trajectory.geometry]
    highest = _straight_peaks(trajectory, orders, np.flatnonzero(~blended))
    if blended.any():
        highest = _blend_peaks(trajectory, orders, np.flatnonzero(blended), highest)
    velocity, acceleration, jerk = highest if jump is None else (*highest, jump)
    return LimitPeaks(velocity, acceleration, jerk)


def _straight_peaks(trajectory: Trajectory, limits: Sequence[FloatArray], rows: IntArray) -> list[Peak]:
    """The peaks on straight pieces, one for each of the given limits: velocity, acceleration and, if given, jerk."""
    if not len(rows):
        return [NONE] * len(limits)
    path, geometry = trajectory.path, trajectory.geometry[rows]
    share = np.abs(path.on_pieces(geometry, path.breaks[geometry], 1))
    share = np.where(share > MIN_SHARE, share, 0.0)
    h, starts = trajectory.durations[rows], trajectory.knots[rows]
    _, c1, c2, c3 = trajectory.coefficients[rows].T
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = np.minimum(np.maximum(np.where(c3 != 0.0, -c2 / (3.0 * c3), 0.0), 0.0), h)
    at = np.stack([np.zeros_like(h), turning, h], axis=1)
    speed = np.abs(c1[:, None] + at * (2.0 * c2[:, None] + 3.0 * c3[:, None] * at))
    rate = np.abs(2.0 * c2[:, None] + 6.0 * c3[:, None] * at)
    times = starts[:, None] + at
    orders = ((speed, times), (rate, times), (np.abs(6.0 * c3)[:, None], starts[:, None]))
    return [_peak(rates, share, limit, when) for limit, (rates, when) in zip(limits, orders, strict=False)]


def _peak(rates: FloatArray, share: FloatArray, limit: FloatArray, times: FloatArray) -> Peak:
    """The largest rate x share / limit; rates and times have a row per piece of time, share a column per joint."""
    with np.errstate(divide="ignore", invalid="ignore"):
        per_joint = np.where(share > 0.0, share / limit, 0.0)
        ratios = rates.max(axis=1)[:, None] * per_joint
    highest = ratios.max()
    if not highest < math.inf:
        ratios = np.where(per_joint > 0.0, np.nan_to_num(ratios, nan=math.inf, posinf=math.inf), 0.0)
    piece, joint = divmod(int(ratios.argmax()), ratios.shape[1])
    return Peak(float(ratios[piece, joint]), joint, float(times[piece, int(rates[piece].argmax())]))


def _jump(trajectory: Trajectory) -> Peak | None:
    """The largest jump of acceleration as a peak with an infinite ratio, or None if acceleration never jumps.

    The arm is at rest before and after; a start at speed continues another motion and is no jump. The path's own
    curvature adds nothing: it is zero where blends meet straight pieces, and where the path is passed at speed it is
    smooth.
    """
    path, geometry = trajectory.path, trajectory.geometry
    c0, c1, c2, c3 = trajectory.coefficients.T
    first = path.on_pieces(geometry, c0, 1)
    last = path.on_pieces(geometry, np.append(c0[1:], trajectory.end), 1)
    passing = c1[1:] > TOLERANCE * c1.max()
    last[:-1][passing] = first[1:][passing]  # equal but for the rounding of short pieces
    rest = np.zeros((1, path.n))
    begins = np.concatenate([first * (2.0 * c2)[:, None], rest])
    ends = np.concatenate([rest, last * (2.0 * c2 + 6.0 * c3 * trajectory.durations)[:, None]])
    jumps = np.abs(begins - ends)
    if c1[0] > TOLERANCE * c1.max():
        jumps[0] = 0.0
    knot, joint = np.unravel_index(int(jumps.argmax()), jumps.shape)
    if jumps[knot, joint] <= TOLERANCE * max(np.abs(begins).max(), np.abs(ends).max()):
        return None
    return Peak(math.inf, int(joint), float(trajectory.knots[knot]))


def _blend_peaks(
    trajectory: Trajectory, limits: Sequence[FloatArray], rows: IntArray, floor: Sequence[Peak]
) -> list[Peak]:
    """For each of the limits the peak on blends, or ``floor`` if that is higher."""
    path, pieces, h = trajectory.path, trajectory.geometry[rows], trajectory.durations[rows]
    before = path.on_pieces(pieces, path.breaks[pieces], 1)
    turn = path.on_pieces(pieces, path.breaks[pieces + 1], 1) - before
    rates = _rates(trajectory, rows)
    highest = list(floor)
    for order, limit in enumerate(limits):
        plain, turning = np.moveaxis(_bernstein(rates), 1, 0)[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            moving = before * plain + turn * turning
            ratios = moving / limit
        if not np.isfinite(ratios).all():
            ratios[moving == 0.0] = 0.0  # a joint that stands still may have any limit
            ratios = np.nan_to_num(ratios, nan=math.inf, posinf=math.inf, neginf=-math.inf)
        highest[order] = _highest(ratios, highest[order], trajectory.knots[rows], h)
        rates = _slope(rates) / h
    return highest


def _rates(trajectory: Trajectory, rows: IntArray) -> FloatArray:
    """ds/dt and f(y(s)) ds/dt as polynomials on each row's piece of time, shape (degree + 1, 2, rows).

    Time runs from 0 to 1 on each piece. With u and v the tangents before and after the corner, the velocity is
    u ds/dt + (v - u) f ds/dt.
    """
    path, h = trajectory.path, trajectory.durations[rows]
    corners = np.flatnonzero(path.blends > 0.0)[np.cumsum(path.blended)[trajectory.geometry[rows]] - 1]
    width, c = path.blends[corners], trajectory.coefficients[rows].T
    y0 = (c[0] - path.knots[corners]) / width
    terms = 1 + int(np.flatnonzero(np.any(c[1:] != 0.0, axis=1)).max(initial=0))  # fewer where s(t) has no jerk
    travel = c[1 : terms + 1] * np.multiply.accumulate(np.broadcast_to(h, (terms, len(h))), axis=0)
    y = travel / width  # from the start of the piece, where f is expanded; its constant term is 0
    cube = y0 * y0 * y0
    share = np.stack([-0.125 * np.ones_like(h)])
    for term in (
        -0.625 * y0,
        -1.25 * y0 * y0,
        -1.25 * cube,
        0.625 * (1.0 - cube * y0),
        0.5 + y0 * (5.0 - cube * y0) / 8.0,
    ):
        share = np.concatenate([term[None], _product(share, y)])
    speed = travel * np.arange(1.0, terms + 1.0)[:, None] / h
    turning = _product(share, speed)
    rates = np.zeros((len(turning), 2, len(h)))
    rates[:terms, 0], rates[:, 1] = speed, turning
    return rates


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """The products of polynomials, column by column."""
    out = np.zeros((len(a) + len(b) - 1, a.shape[1]))
    for i, row in enumerate(b):
        out[i : i + len(a)] += a * row
    return out


def _slope(a: FloatArray) -> FloatArray:
    """The derivatives of polynomials, column by column."""
    return np.asarray(a[1:] * np.arange(1.0, len(a))[:, None, None])


def _bernstein(a: FloatArray) -> FloatArray:
    """The Bernstein coefficients of polynomials over [0, 1], column by column; they enclose the polynomial's values.

    Power coefficient i over binomial (n, i) is the i-th difference of the Bernstein coefficients, hence the sums.
    """
    n = len(a) - 1
    out: FloatArray = a / np.array([float(math.comb(n, i)) for i in range(n + 1)])[:, None, None]
    for i in range(n - 1, -1, -1):
        np.add.accumulate(out[i:], axis=0, out=out[i:])
    return out


def _highest(ratios: FloatArray, floor: Peak, starts: FloatArray, durations: FloatArray) -> Peak:
    """The largest absolute value of polynomials, as a peak, or ``floor`` if that is higher.

    Intervals that cannot exceed the best value so far are dropped, the others split (de Casteljau), until none is
    left. If some are left after ``MAX_ROUNDS``, or overflow, their bound is taken for the peak.

    Args:
        ratios: Bernstein coefficients for each piece of time and joint, shape (degree + 1, pieces, joints).
    """
    joints = ratios.shape[2]
    b: FloatArray = ratios.reshape(len(ratios), -1)
    best = floor

    def better(values: FloatArray, row: IntArray, at: FloatArray) -> Peak:
        k = int(values.argmax())
        if not values[k] > best.ratio:
            return best
        piece, joint = divmod(int(row[k]), joints)
        return Peak(float(values[k]), joint, float(starts[piece] + at[k] * durations[piece]))

    size = np.abs(b)
    row: IntArray = np.arange(b.shape[1])
    for values, end in ((size[0], np.zeros(len(row))), (size[-1], np.ones(len(row)))):
        best = better(values, row, end)
    bound, low, high = size.max(axis=0), np.zeros(len(row)), np.ones(len(row))
    rounds = MAX_ROUNDS * (1 + len(row) // INTERVALS_PER_MAX)
    for count in range(rounds + 1):
        (open_,) = (bound > best.ratio * (1.0 + EXACT)).nonzero()
        if not len(open_):
            break
        if count == rounds or bound[open_].max() == math.inf:
            best = better(bound[open_], row[open_], low[open_])
            break
        if len(open_) > BATCH:
            open_ = open_[np.argsort(-bound[open_], kind="stable")]
        now, later = open_[:BATCH], open_[BATCH:]
        share = np.full(len(now), 0.5) if count % 5 == 4 else _where_to_split(b[:, now])
        middle = low[now] + share * (high[now] - low[now])
        first, second = _split(b[:, now], share)
        best = better(np.abs(second[0]), row[now], middle)
        low = np.concatenate([low[now], middle, low[later]])
        high = np.concatenate([middle, high[now], high[later]])
        row = np.concatenate([row[now], row[now], row[later]])
        halves = np.concatenate([first, second], axis=1)
        bound = np.concatenate([np.abs(halves).max(axis=0), bound[later]])
        b = np.concatenate([halves, b[:, later]], axis=1)
    return best


def _where_to_split(b: FloatArray) -> FloatArray:
    """Where to split each interval, as a share of it: near the polynomial's extremum, if its slope changes sign.

    The Bernstein coefficients of both halves then fall from there and leave no room for a higher peak.
    """
    n = len(b) - 1
    first, last = b[1] - b[0], b[-1] - b[-2]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = first / (first - last)
        if n > 1:  # Newton's step from the end where the slope is smaller
            after, before = first / (2.0 * b[1] - b[0] - b[2]), last / (2.0 * b[-2] - b[-1] - b[-3])
            near = np.where(np.abs(first) < np.abs(last), after, (n - 1) + before) / (n - 1)
            share = np.where((near > 0.0) & (near < 1.0), near, share)
        share = np.where(first * last < 0.0, share, 0.5)
    return np.asarray(np.minimum(np.maximum(share, EXACT), 1.0 - EXACT))


def _split(b: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The Bernstein coefficients of both parts of intervals that are split at a share of each."""
    first, second = np.empty_like(b), b.copy()
    first[0] = b[0]
    for k in range(1, len(b)):
        second[:-k] += share * (second[1 : len(b) - k + 1] - second[:-k])
        first[k] = second[0]
    return first, second
