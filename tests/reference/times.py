"""The least time along a path under limits of velocity and acceleration, by the definition of TOPP-RA on a fine grid.

At each place the squares x of ds/dt from which the next place can be reached within its own such set are an interval
[0, K]; K is the largest x for which some u = d2s/dt2 keeps ``|q' u + q'' x| <= a`` and ``0 <= x + 2 u ds <= K'``.
From the start on, the largest u that keeps the limits and K is the fastest. (Pham and Pham, IEEE T-RO 34(3), 2018.)
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import JointLimits

__all__ = ["least_time"]

TINY = 1e-9


def least_time(path: JointPath, limits: JointLimits, points: int = 400) -> float:
    """Seconds from rest to rest, with a stop at each corner that is not blended."""
    stops = [k for k in path.corners if not path.blends[k]]
    places = [0.0, *path.knots[stops].tolist(), path.length]
    return math.fsum(_between(path, limits, start, end, points) for start, end in pairwise(places))


def _between(path: JointPath, limits: JointLimits, start: float, end: float, points: int) -> float:
    """From stop to stop; the grid is denser at both, and each curve lies between two of its places."""
    inner = path.breaks[(path.breaks > start) & (path.breaks < end)]
    s = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, points))) * (end - start) + start
    s = np.unique(np.concatenate([s, *(np.linspace(*ends, 60) for ends in pairwise([start, *inner, end])), inner]))
    ds = np.diff(s)
    middle = 0.5 * (s[1:] + s[:-1])
    q1, q2 = path(middle, 1), path(middle, 2)
    steep = np.maximum(np.abs(q1), np.abs(path(s[:-1], 1)))
    with np.errstate(divide="ignore"):
        fastest = (limits.velocity / steep).min(axis=1) ** 2
    reach = np.zeros(len(s))
    for k in range(len(ds) - 1, -1, -1):
        reach[k] = min(fastest[k], _largest(*_rows(q1[k], q2[k], limits.acceleration, ds[k], reach[k + 1])))
    x = np.zeros(len(s))
    for k in range(len(ds)):
        push, pull, room = _rows(q1[k], q2[k], limits.acceleration, ds[k], reach[k + 1])
        up = push > TINY
        x[k + 1] = max(0.0, x[k] + 2.0 * ds[k] * float(((room - pull * x[k])[up] / push[up]).min()))
    speeds = np.sqrt(x)
    return float((2.0 * ds / (speeds[1:] + speeds[:-1])).sum())


def _rows(q1: FloatArray, q2: FloatArray, most: FloatArray, ds: float, after: float) -> tuple[FloatArray, ...]:
    """Rows ``push u + pull x <= room``: of accelerations, and of the next square of ds/dt."""
    push = np.concatenate([q1, -q1, [2.0 * ds, -2.0 * ds]])
    pull = np.concatenate([q2, -q2, [1.0, -1.0]])
    return push, pull, np.concatenate([most, most, [after, 0.0]])


def _largest(push: FloatArray, pull: FloatArray, room: FloatArray) -> float:
    """The largest x for which a u keeps all rows: each row that bounds u above meets each that bounds it below."""
    up, down, flat = push > TINY, push < -TINY, np.abs(push) <= TINY
    slope = (pull[up] / push[up])[:, None] - pull[down] / push[down]
    gap = (room[up] / push[up])[:, None] - room[down] / push[down]
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.where(slope > 0.0, gap / slope, math.inf)
        still = np.where(pull[flat] > 0.0, room[flat] / pull[flat], math.inf)
    return float(min(bounds.min(), still.min(initial=math.inf)))
