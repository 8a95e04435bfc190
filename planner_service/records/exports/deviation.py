"""How far a motion that is rebuilt from its samples can be from the proven curve.

Other programs get a motion as points in time and fill in what lies between. What they fill in is theirs, so how far it
is from the curve that was proven is worked out here, for the three ways that controllers use.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.path.trajectory import Samples, Trajectory
from planner_service.robot.model import JointLimits
from planner_service.timing.limit_check import peaks

__all__ = ["Between", "deviation"]

Between = Literal["linear", "cubic", "quintic"]
"""What is drawn between two points: a line; the cubic with their velocities; the quintic with accelerations as well."""

STEPS = 16
"""Instants of each interval at which the difference is measured."""


def deviation(trajectory: Trajectory, samples: Samples, between: Between = "linear") -> float:
    """An upper bound of the distance, in radians (or metres) of any joint, from the curve to one through its samples.

    Lemma: let e(t) be a joint's difference, and |e''| <= A. Between two instants d apart e is at most A d^2 / 8 from
    the line through its values there, and that line is nowhere above the larger of them. So |e| is at most the
    largest |e(t_k)| plus A d^2 / 8. Here A is the largest acceleration of the curve, which is exact, plus a bound of
    that of what is drawn: with local time x in [0, 1] and interval h, the sum of |k (k - 1) c_k| over its
    coefficients, divided by h^2.

    Args:
        samples: Of ``trajectory.sample``; the first and the last instant are its ends.
        between: What is drawn between the samples.
    """
    if len(samples.t) < 2:
        return 0.0
    ones, n = np.ones(trajectory.path.n), trajectory.path.n
    unit = JointLimits(-ones, ones, ones, ones, ones)
    fastest = peaks(trajectory, unit).acceleration.ratio
    h = np.diff(samples.t)[:, None]
    c = _coefficients(samples, h, between)
    powers = np.arange(len(c))
    drawn = np.abs(c * (powers * (powers - 1)).reshape(-1, 1, 1)).sum(axis=0) / (h * h)
    x = np.arange(1, STEPS) / STEPS
    times = samples.t[:-1, None] + h * x
    curve = trajectory(np.minimum(times, trajectory.duration)).reshape(len(h), STEPS - 1, n)
    through = sum(c[k][:, None, :] * (x**k)[None, :, None] for k in range(len(c)))
    measured = float(np.abs(curve - through).max())
    return measured + float(((fastest + drawn) * (h / STEPS) ** 2).max()) / 8.0


def _coefficients(samples: Samples, h: FloatArray, between: Between) -> FloatArray:
    """Of the polynomials in x in [0, 1] through both ends of each interval, lowest power first, shape (k, m - 1, n)."""
    q0, q1 = samples.q[:-1], samples.q[1:]
    rise = q1 - q0
    if between == "linear":
        return np.stack([q0, rise])
    v0, v1 = samples.qd[:-1] * h, samples.qd[1:] * h
    if between == "cubic":
        return np.stack([q0, v0, 3.0 * rise - 2.0 * v0 - v1, v0 + v1 - 2.0 * rise])
    a0, a1 = samples.qdd[:-1] * h * h, samples.qdd[1:] * h * h
    return np.stack(
        [
            q0,
            v0,
            0.5 * a0,
            10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1,
            -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1,
            6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1),
        ]
    )
