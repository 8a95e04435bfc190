"""How close a trajectory comes to its limits, computed exactly: samples would miss what lies between them."""

from __future__ import annotations

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Peak, Trajectory
from planner_service.robot.model import JointLimits

__all__ = ["MIN_SHARE", "ORDERS", "TOLERANCE", "peaks", "require_limits"]

TOLERANCE = 1e-9
"""How far a ratio to a limit may exceed 1 by rounding: six orders of magnitude below what an encoder resolves."""

MIN_SHARE = 1e-12
"""A joint whose share of a direction, abs(dq_i/ds), is smaller stands still: its limits are ignored."""


ORDERS = ("velocity", "acceleration", "jerk")
"""Names of the limits, by the order of the derivative."""


def require_limits(path: JointPath, limits: JointLimits, *, jerk: bool) -> None:
    """Refuse limits that are not positive and finite for each joint that moves on the path.

    Raises:
        InvalidRequest: such a limit, limits of another length than the path's, or something that is no path.
    """
    instance("path", path, JointPath, "a JointPath")
    for name in ORDERS if jerk else ORDERS[:2]:
        row: FloatArray | None = getattr(limits, name, None)
        if not isinstance(row, np.ndarray):
            raise InvalidRequest("limits", limits, "JointLimits")
        if row.shape != (path.n,):
            raise InvalidRequest(f"limits.{name}", row.shape, f"one number for each of the path's {path.n} joints")
        bad = ~((row > 0.0) & np.isfinite(row))
        if bad.any():
            bad &= np.abs(path(path.breaks, 1)).max(axis=0) > MIN_SHARE
        if bad.any():
            joint = int(bad.argmax())
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
    rows = map(np.ascontiguousarray, (limits.velocity, limits.acceleration, limits.jerk))
    velocity, acceleration, jerk = map(Peak._make, load_core().TrajectoryTables(*trajectory.tables).peaks(*rows))
    return LimitPeaks(velocity, acceleration, jerk)
