"""How close a trajectory comes to its limits, exactly: not by samples, which miss what lies between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray
from planner_service.path import JointPath
from planner_service.trajectory import Trajectory

if TYPE_CHECKING:
    from planner_service.robot import JointLimits

__all__ = ["STANDING", "TOLERANCE", "LimitPeaks", "Peak", "peaks", "require_usable"]

TOLERANCE = 1e-9
"""How far a ratio to a limit may exceed 1: rounding, six orders below what an encoder resolves."""

STANDING = 1e-12
"""A joint with a smaller share of a direction stands still; its limits are not asked."""

EXACT = 1e-12
"""A peak on a blend is found to this relative error, a thousandth of the tolerance."""

MAX_SPLITS = 60
"""Of an interval of time in two: beyond, its ends are the same number."""


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


def require_usable(path: JointPath, limits: JointLimits, *, jerk: bool) -> None:
    """Raise unless every joint that moves on the path has positive, finite limits."""
    share = np.abs(path(path.breaks, 1)).max(axis=0)
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


@np.errstate(over="ignore")  # what is too large for a float is too large for a limit
def peaks(trajectory: Trajectory, limits: JointLimits) -> LimitPeaks:
    """The largest velocity, acceleration and jerk of any joint relative to its limit.

    Exact: on a straight piece the extrema of a cubic s(t) are at its ends and at the roots of its derivatives; on a
    blend the joint's motion is a polynomial of time too, between the least and the largest of its Bernstein
    coefficients, which halving its interval brings as close together as wanted. The jerk's ratio is infinite where
    acceleration jumps, as it does under a trapezoidal law. All are 0 when nothing moves.

    Raises:
        InvalidRequest: limits of another length than the trajectory's joints, or a velocity or acceleration limit
            that is not positive and finite for a joint that moves.
    """
    require_usable(trajectory.path, limits, jerk=False)
    if not len(trajectory.durations):
        return LimitPeaks(Peak(0.0, 0, 0.0), Peak(0.0, 0, 0.0), Peak(0.0, 0, 0.0))
    straight = _straight_peaks(trajectory, limits)
    velocity, acceleration, jerk = _blend_peaks(trajectory, limits, straight)
    return LimitPeaks(velocity, acceleration, _jump(trajectory) or jerk)


def _straight_peaks(trajectory: Trajectory, limits: JointLimits) -> tuple[Peak, Peak, Peak]:
    path, geometry = trajectory.path, trajectory.geometry
    share = np.abs(path.on_pieces(geometry, path.breaks[geometry], 1))
    share = np.where((share > STANDING) & ~path.blended[geometry][:, None], share, 0.0)
    h, starts = trajectory.durations, trajectory.knots[:-1]
    _, c1, c2, c3 = trajectory.coefficients.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        turning = np.clip(np.where(c3 != 0.0, -c2 / (3.0 * c3), 0.0), 0.0, h)
    at = np.stack([np.zeros_like(h), turning, h], axis=1)
    speed = np.abs(c1[:, None] + at * (2.0 * c2[:, None] + 3.0 * c3[:, None] * at))
    rate = np.abs(2.0 * c2[:, None] + 6.0 * c3[:, None] * at)
    velocity = _peak(speed, share, limits.velocity, starts[:, None] + at)
    acceleration = _peak(rate, share, limits.acceleration, starts[:, None] + at)
    return velocity, acceleration, _peak(np.abs(6.0 * c3)[:, None], share, limits.jerk, starts[:, None])


def _peak(rates: FloatArray, share: FloatArray, limit: FloatArray, times: FloatArray) -> Peak:
    """The largest of rate x share / limit; rates and times have a row per piece of time, share a column per joint."""
    with np.errstate(divide="ignore", invalid="ignore"):
        per_joint = np.where(share > 0.0, share / limit, 0.0)
        ratios = np.nan_to_num(rates.max(axis=1)[:, None] * per_joint, nan=0.0, posinf=math.inf)  # nan is 0 x inf
    piece, joint = np.unravel_index(int(ratios.argmax()), ratios.shape)
    return Peak(float(ratios[piece, joint]), int(joint), float(times[piece, int(rates[piece].argmax())]))


def _jump(trajectory: Trajectory) -> Peak | None:
    """The largest instantaneous change of acceleration, rest before and after included, or None where there is none.

    The path's own curvature has no part in it: it is zero where blends meet straight pieces, and the path is smooth
    where it is passed at speed.
    """
    path, geometry = trajectory.path, trajectory.geometry
    c0, c1, c2, c3 = trajectory.coefficients.T
    first = path.on_pieces(geometry, c0, 1)
    last = path.on_pieces(geometry, np.append(c0[1:], path.length), 1)
    passing = c1[1:] > TOLERANCE * c1.max()
    last[:-1][passing] = first[1:][passing]  # equal but for the rounding of short pieces
    rest = np.zeros((1, path.n))
    begins = np.concatenate([first * (2.0 * c2)[:, None], rest])
    ends = np.concatenate([rest, last * (2.0 * c2 + 6.0 * c3 * trajectory.durations)[:, None]])
    jumps = np.abs(begins - ends)
    knot, joint = np.unravel_index(int(jumps.argmax()), jumps.shape)
    if jumps[knot, joint] <= TOLERANCE * max(np.abs(begins).max(), np.abs(ends).max()):
        return None
    return Peak(math.inf, int(joint), float(trajectory.knots[knot]))


def _blend_peaks(
    trajectory: Trajectory, limits: JointLimits, floor: tuple[Peak, Peak, Peak]
) -> tuple[Peak, Peak, Peak]:
    """The floor, or what blends have above it."""
    path, rows = trajectory.path, np.flatnonzero(trajectory.path.blended[trajectory.geometry])
    if not len(rows):
        return floor
    pieces, h = trajectory.geometry[rows], trajectory.durations[rows]
    before = path.on_pieces(pieces, path.breaks[pieces], 1)
    turn = path.on_pieces(pieces, path.breaks[pieces + 1], 1) - before
    plain, turning = _rates(trajectory, rows)
    found = list(floor)
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk)):
        a, b = _bernstein(plain), _bernstein(turning)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = before[:, :, None] * a[:, None, :] + turn[:, :, None] * b[:, None, :]
            ratios = np.nan_to_num(ratios / limit[:, None], nan=0.0, posinf=math.inf, neginf=-math.inf)
        found[order] = _highest(ratios, found[order], trajectory.knots[rows], h)
        plain, turning = (_slope(rate) / h[:, None] for rate in (plain, turning))
    return found[0], found[1], found[2]


def _rates(trajectory: Trajectory, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """ds/dt, and the same times f(y(s)), on each row's piece of time.

    Polynomials of time as its share of the piece, a row of coefficients each. With u and v the tangents before and
    after the corner, u ds/dt + (v - u) f ds/dt is the velocity.
    """
    path, h = trajectory.path, trajectory.durations[rows, None]
    corners = np.flatnonzero(path.blends > 0.0)[np.cumsum(path.blended)[trajectory.geometry[rows]] - 1]
    width = path.blends[corners, None]
    c = trajectory.coefficients[rows]
    y0 = (c[:, :1] - path.knots[corners, None]) / width
    way = np.concatenate([np.zeros_like(h), c[:, 1:2] * h, c[:, 2:3] * h * h, c[:, 3:4] * h * h * h], axis=1)
    speed = _slope(way) / h
    y = way / width  # since the piece began; f = 1/2 + (5 y - y^5) / 8 is expanded there
    square = _product(y, y)
    share = -_product(_product(square, square), y) / 8.0
    share[:, :13] -= 0.625 * y0 * _product(square, square)
    share[:, :10] -= 1.25 * y0 * y0 * _product(square, y)
    share[:, :7] -= 1.25 * y0 * y0 * y0 * square
    share[:, :4] += 0.625 * (1.0 - y0 * y0 * y0 * y0) * y
    share[:, :1] += 0.5 + y0 * (5.0 - y0 * y0 * y0 * y0) / 8.0
    turning = _product(share, speed)
    degree = int(np.flatnonzero(np.any(turning != 0.0, axis=0)).max(initial=2))  # lower where s(t) has no jerk
    turning = turning[:, : degree + 1]
    return np.pad(speed, ((0, 0), (0, turning.shape[1] - speed.shape[1]))), turning


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of polynomials, row by row."""
    out = np.zeros((len(a), a.shape[1] + b.shape[1] - 1))
    for i in range(b.shape[1]):
        out[:, i : i + a.shape[1]] += a * b[:, i : i + 1]
    return out


def _slope(a: FloatArray) -> FloatArray:
    """Derivatives of polynomials, row by row."""
    return a[:, 1:] * np.arange(1.0, a.shape[1])


def _bernstein(a: FloatArray) -> FloatArray:
    """Bernstein coefficients over [0, 1] of polynomials, row by row: their range holds the polynomial's."""
    n = a.shape[1] - 1
    columns = np.ascontiguousarray(a.T)
    out = np.zeros_like(columns)
    for j in range(n + 1):
        for i in range(j + 1):
            out[j] += (math.comb(j, i) / math.comb(n, i)) * columns[i]
    return np.ascontiguousarray(out.T)


def _highest(ratios: FloatArray, floor: Peak, starts: FloatArray, durations: FloatArray) -> Peak:
    """The floor, or the largest abs of polynomials if that is above it.

    Bernstein coefficients over each piece of time, of each joint, shape (pieces, joints, degree + 1). What cannot
    exceed the best value found is dropped, the rest halved (de Casteljau), until nothing is left.
    """
    joints, size = ratios.shape[1:]
    b: FloatArray = ratios.reshape(-1, size)
    row: NDArray[np.intp] = np.arange(len(b))
    at: FloatArray = np.zeros(len(b))
    width = 1.0
    best = floor
    for _ in range(MAX_SPLITS):
        for column, offset in ((0, 0.0), (size - 1, width)):
            k = int(np.abs(b[:, column]).argmax())
            if abs(b[k, column]) > best.ratio:
                piece, joint = divmod(int(row[k]), joints)
                time = float(starts[piece] + (at[k] + offset) * durations[piece])
                best = Peak(float(abs(b[k, column])), joint, time)
        open_ = np.flatnonzero(np.abs(b).max(axis=1) > best.ratio * (1.0 + EXACT))
        if not len(open_):
            break
        width /= 2.0
        row, at = np.tile(row[open_], 2), np.concatenate([at[open_], at[open_] + width])
        b = _halves(b[open_])
    return best


def _halves(b: FloatArray) -> FloatArray:
    """Bernstein coefficients over the first halves of the intervals, and then those over the second halves."""
    first, second = np.empty_like(b), b.copy()
    first[:, 0] = b[:, 0]
    for k in range(1, b.shape[1]):
        second[:, :-k] = (second[:, :-k] + second[:, 1 : b.shape[1] - k + 1]) / 2.0
        first[:, k] = second[:, 0]
    return np.concatenate([first, second])
