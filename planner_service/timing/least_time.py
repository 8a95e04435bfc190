"""The least time that any motion between two configurations can take: a joint alone is never slower than all together.

Lemma. Let x be a joint's motion over [0, T] from rest to rest with abs(x') <= v, abs(x'') <= a and, if jerk is limited,
x''(0) = x''(T) = 0 and abs(x''') <= j; and let d = abs(x(T) - x(0)). Then T is at least the duration of the trapezoid
(with jerk: the seven-phase S-curve) over d.

Proof. Let x(T) >= x(0), u = x', and replace u by (u(t) + u(T - t)) / 2: it keeps all limits and the distance, and is
symmetric about T/2. Let V <= v be its largest value.

*Without jerk.* u(t) <= min(V, a t) on [0, T/2]. The integral of twice that is what a trapezoid with the peak V
travels in T, so d is at most the longest distance that a trapezoid travels in T. That grows with T, so T is at least
the time of the trapezoid over d.

*With jerk.* Let R be the fastest ramp from 0 to V: acceleration rises with j, to a at most, and falls with j to 0,
which it reaches with V. Then u <= R as long as the ramp lasts. While R's acceleration rises or stays at a, it is the
largest there can be, so u <= R. While it falls, R' = sqrt(2 j (V - R)); if u > R somewhere there, then u' <= sqrt(2 j
(V - u)) < R': with more it would rise above V, as u' falls to 0, which it is where u is largest, no faster than with
j. So u - R falls wherever it is positive, and as it is at most 0 where R's acceleration begins to fall, it never is.
From u <= min(R, V) follows, as above, that d is at most what an S-curve with the peak V travels in T. QED

All joints of a motion move in the same T, so T is at least the largest of these times. Which path the motion takes,
through what, and whether it pauses on the way, does not matter.
"""

from __future__ import annotations

import math

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance, numbers
from planner_service.robot.model import TURN, JointLimits, Robot
from planner_service.timing.laws import SCurve, Timing

__all__ = ["least_times", "rest_to_rest_times"]

EXCESS = 2e-9
"""By how much, relative, a trajectory may exceed its limits (``limit_check.TOLERANCE``), doubled: it is faster by no
more."""

SHORTER = 1e-9
"""Radians (or metres) by which a path may end beside a configuration: rounding, and more."""


def least_times(robot: Robot, limits: JointLimits, timing: Timing, starts: object, goals: object) -> FloatArray:
    """Seconds that a motion from each start to each goal takes at least, whatever its path: (k, n) and (m, n) give
    (k, m).

    No plan whose timing law keeps the limits is faster. Jerk counts with ``SCurve`` only. Of a continuous joint it is
    the shorter way round.

    Args:
        limits: Those that the motions keep, such as ``request.pace.limits(robot)``.

    Raises:
        InvalidRequest: starts or goals are not rows of n finite numbers.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("limits", limits, JointLimits, "JointLimits")
    Q, P = (_rows(name, rows, robot.n) for name, rows in (("starts", starts), ("goals", goals)))
    longest = np.zeros((len(Q), len(P)))
    for joint in range(robot.n):
        distance = np.abs(Q[:, joint, None] - P[None, :, joint])
        if robot.continuous and robot.continuous[joint]:
            distance = np.abs(distance - TURN * np.round(distance / TURN))
        of_joint = [float(row[joint]) for row in (limits.velocity, limits.acceleration, limits.jerk)]
        if not isinstance(timing, SCurve):
            of_joint[2] = math.inf
        np.maximum(longest, rest_to_rest_times(np.maximum(distance - SHORTER, 0.0), *of_joint), out=longest)
    return longest * (1.0 - EXCESS)


def rest_to_rest_times(
    distance: FloatArray, speed: FloatArray | float, acceleration: FloatArray | float, jerk: FloatArray | float
) -> FloatArray:
    """Seconds that one joint takes for distances, from rest to rest, at its fastest; all broadcast to one shape.

    The sums of the phases of ``profiles.trapezoid`` and ``profiles.s_curve``. A jerk of ``math.inf`` is unbounded.
    """
    cruising = distance / speed + speed / acceleration
    if np.all(np.isinf(jerk)):
        short = 2.0 * np.sqrt(distance / acceleration)
        return np.where(distance * acceleration >= np.square(speed), cruising, short)
    rise = acceleration / jerk
    smooth = speed / acceleration < rise  # the speed is reached before the acceleration is
    ramp = np.where(smooth, 2.0 * np.sqrt(speed / jerk), rise + speed / acceleration)
    flat = rise + np.hypot(rise, 2.0 * np.sqrt(distance / acceleration))  # two ramps that reach the acceleration
    short = np.where(flat >= 4.0 * rise, flat, 4.0 * np.cbrt(distance / (2.0 * jerk)))
    return np.where(distance / speed >= ramp, distance / speed + ramp, short)


def _rows(name: str, rows: object, n: int) -> FloatArray:
    expected = f"rows of {n} finite numbers"
    array = numbers(name, rows, expected)
    if array.ndim != 2 or array.shape[1] != n or not np.all(np.isfinite(array)):
        raise InvalidRequest(name, rows, expected)
    return array
