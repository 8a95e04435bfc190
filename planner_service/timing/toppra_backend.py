"""TOPP-RA along one segment of a path, by the toppra library; the only module that imports it."""

from __future__ import annotations

import logging
import math
from functools import lru_cache
from typing import Any

import numpy as np

from planner_service.concurrency.library_import import loaded
from planner_service.geometry.arrays import FloatArray
from planner_service.timing.segments import PathSegment

__all__ = ["NoSolution", "path_speeds"]

MAX_TOPPRA_SPEED = 1e4
"""Stands for an infinite speed, which toppra does not accept; speeds are scaled to about 1."""


class NoSolution(Exception):
    """TOPP-RA found no speeds; the message is toppra's return code."""


def path_speeds(segment: PathSegment, points: FloatArray, unit: float, entry: float) -> FloatArray:
    """ds/dt at the grid points of a segment that ends at a stop, shape as ``points``.

    Args:
        points: Shares of the segment's length, increasing from 0 to 1.
        unit: About its duration in seconds, which scales toppra's numbers to about 1.
        entry: ds/dt at its start.

    Raises:
        NoSolution: toppra found none.
    """
    solver = _algorithm()(_constraint(segment, points, unit, entry), points)
    _, speeds, _ = solver.compute_parameterization(entry * (unit / segment.length), 0.0)
    if speeds is None or not np.all(np.isfinite(speeds)):
        raise NoSolution(solver.problem_data.return_code.name)
    return np.asarray(speeds * (segment.length / unit), dtype=np.float64)


class _UnitInterval:
    """A path as toppra expects it, over the parameter [0, 1]; its derivatives come with the constraint."""

    path_interval = (0.0, 1.0)


def _constraint(segment: PathSegment, points: FloatArray, unit: float, entry: float) -> Any:
    """All limits at the grid points as one constraint of toppra.

    toppra's tolerances are absolute; in units of the segment's length and about its duration they suit every move.
    Accelerations are bounded at both ends of each interval (toppra calls this interpolation).
    """
    toppra = loaded(_toppra)
    joints, length = segment.moving, segment.length
    velocity, acceleration = segment.limits.velocity[joints] * unit, segment.limits.acceleration[joints] * (unit * unit)
    s = segment.start + points * length
    first, second = (segment.derivative(s, order)[:, joints] * math.pow(length, order) for order in (1, 2))
    with np.errstate(divide="ignore", over="ignore"):
        speeds = np.where(first != 0.0, velocity / np.abs(first), math.inf).min(axis=1)
    if segment.speed_limit is not None:
        speeds = np.minimum(speeds, segment.speed_limits_at(s) * (unit / length))
    if segment.blend_share < 1.0:
        shares = segment.limit_shares(s)[:, None]
        first, second, speeds = first / shares, second / shares, speeds * shares[:, 0]
        speeds[0] = max(speeds[0], entry * (unit / length))
    squares = np.minimum(speeds, MAX_TOPPRA_SPEED) ** 2
    signs = np.concatenate([np.eye(len(joints)), -np.eye(len(joints))])
    linear = (first, second, np.zeros_like(first), signs, np.tile(acceleration, 2), None, None)
    rows = toppra.constraint.canlinear_colloc_to_interpolate(*linear, points, identical=True)[:-2]
    constraint = toppra.constraint.LinearConstraint()
    constraint.identical = True
    columns = np.stack([np.zeros(len(squares)), squares], axis=1)
    constraint.compute_constraint_params = lambda *_: (*rows, None, columns)
    return constraint


@lru_cache(maxsize=1)
def _algorithm() -> Any:
    """toppra's algorithm with a shorter backward pass, which solves one linear program per grid point instead of two.

    A robot's limits are symmetric: standing still is always possible, so the lowest controllable speed is 0.
    """
    toppra = loaded(_toppra)
    algorithm: Any = toppra.algorithm
    seidel = toppra.solverwrapper.seidelWrapper

    class TwoPasses(algorithm.TOPPRA):  # type: ignore[misc]
        def __init__(self, constraint: Any, points: FloatArray) -> None:
            path = _UnitInterval()
            parametrizer = "ParametrizeConstAccel"
            algorithm.ParameterizationAlgorithm.__init__(self, [constraint], path, points, parametrizer)
            self.solver_wrapper = seidel([constraint], path, points, solve_lp1d=True)
            self._steps = (-2.0 * (points[1:] - points[:-1])).tolist()

        def compute_controllable_sets(self, sdmin: float, sdmax: float) -> FloatArray:
            solve, objective = self.solver_wrapper.solve_stagewise_optim, np.array([1e-9, -1.0])
            squares, high = [sdmax * sdmax], sdmax * sdmax
            for i in range(len(self._steps) - 1, -1, -1):
                if not math.isnan(high):  # nan: not controllable, nor any point before
                    high = solve(i, None, objective, math.nan, math.nan, 0.0, high)[1]
                squares.append(high)
            return np.stack([np.zeros(len(squares)), squares[::-1]], axis=1)

        def _forward_step(self, i: int, x: float, K_next: FloatArray) -> Any:
            objective = np.array([self._steps[i], -1.0])
            return self.solver_wrapper.solve_stagewise_optim(i, None, objective, x, x, 0.0, K_next[1])

    return TwoPasses


def _toppra() -> Any:
    """The toppra library, which imports matplotlib to draw its plots; importing them logs nothing."""
    plotting = logging.getLogger("matplotlib")
    level = plotting.level
    plotting.setLevel(logging.ERROR)  # it would complain of a home folder without a cache
    try:
        import toppra  # 0.5 s, half of it for matplotlib
        import toppra.algorithm
        import toppra.constraint
        import toppra.solverwrapper
    finally:
        plotting.setLevel(level)
    own = logging.getLogger("toppra")
    if own.level == logging.NOTSET:
        own.setLevel(logging.CRITICAL)  # a failure is returned, not logged
    return toppra
