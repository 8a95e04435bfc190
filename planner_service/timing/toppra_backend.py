"""TOPP-RA's two passes over the grid points of a stretch of a path, by the toppra library; its only import."""

from __future__ import annotations

import logging
import math
from functools import lru_cache
from typing import Any

import numpy as np

from planner_service.concurrency.library_import import loaded
from planner_service.geometry.shapes import FloatArray
from planner_service.timing.segments import Stretch

__all__ = ["two_passes"]

MAX_TOPPRA_SPEED = 1e4
"""In units of about 1, for toppra, which takes no infinite speed."""


def two_passes(stretch: Stretch, points: FloatArray, unit: float, rate: float = 0.0) -> FloatArray | str:
    """ds/dt at grid points along a stretch, to a stop; toppra's word for it if there is none.

    Args:
        points: Shares of the stretch, growing from 0 to 1.
        unit: About as many seconds as it takes.
        rate: ds/dt where it begins.
    """
    solver = _algorithm()(_bounds(stretch, points, unit, rate), points)
    _, speeds, _ = solver.compute_parameterization(rate * (unit / stretch.length), 0.0)
    if speeds is None or not np.all(np.isfinite(speeds)):
        return str(solver.problem_data.return_code.name)
    return np.asarray(speeds * (stretch.length / unit), dtype=np.float64)


class _UnitInterval:
    """A path as toppra asks for one, over the parameter [0, 1]; what it bounds comes with the constraint."""

    path_interval = (0.0, 1.0)


def _bounds(stretch: Stretch, points: FloatArray, unit: float, rate: float) -> Any:
    """All limits at the grid points as one constraint of toppra.

    Its tolerances are absolute: in units of the stretch and of about its time they suit every move. Accelerations
    are bounded at both ends of each interval (what toppra calls interpolation).
    """
    toppra = loaded(_toppra)
    joints, length = stretch.moving, stretch.length
    velocity, acceleration = stretch.limits.velocity[joints] * unit, stretch.limits.acceleration[joints] * (unit * unit)
    s = stretch.start + points * length
    first, second = (stretch.derivative(s, order)[:, joints] * math.pow(length, order) for order in (1, 2))
    with np.errstate(divide="ignore", over="ignore"):
        speeds = np.where(first != 0.0, velocity / np.abs(first), math.inf).min(axis=1)
    if stretch.speed_limit is not None:
        speeds = np.minimum(speeds, stretch.allowed(s) * (unit / length))
    if stretch.blend_share < 1.0:
        shares = stretch.shares(s)[:, None]
        first, second, speeds = first / shares, second / shares, speeds * shares[:, 0]
        speeds[0] = max(speeds[0], rate * (unit / length))
    squares = np.minimum(speeds, MAX_TOPPRA_SPEED) ** 2
    both_ways = np.concatenate([np.eye(len(joints)), -np.eye(len(joints))])
    linear = (first, second, np.zeros_like(first), both_ways, np.tile(acceleration, 2), None, None)
    rows = toppra.constraint.canlinear_colloc_to_interpolate(*linear, points, identical=True)[:-2]
    bound = toppra.constraint.LinearConstraint()
    bound.identical = True
    columns = np.stack([np.zeros(len(squares)), squares], axis=1)
    bound.compute_constraint_params = lambda *_: (*rows, None, columns)
    return bound


@lru_cache(maxsize=1)
def _algorithm() -> Any:
    """toppra's algorithm and its solver, asked no more than the limits of a robot need.

    They are symmetric: standing still is always possible, so the least controllable speed is 0 everywhere.
    """
    toppra = loaded(_toppra)
    algorithm: Any = toppra.algorithm
    seidel = toppra.solverwrapper.seidelWrapper

    class TwoPasses(algorithm.TOPPRA):  # type: ignore[misc]
        def __init__(self, bound: Any, points: FloatArray) -> None:
            path = _UnitInterval()
            parametrizer = "ParametrizeConstAccel"
            algorithm.ParameterizationAlgorithm.__init__(self, [bound], path, points, parametrizer)
            self.solver_wrapper = seidel([bound], path, points, solve_lp1d=True)
            self._steps = (-2.0 * (points[1:] - points[:-1])).tolist()

        def compute_controllable_sets(self, sdmin: float, sdmax: float) -> FloatArray:
            solve, objective = self.solver_wrapper.solve_stagewise_optim, np.array([1e-9, -1.0])
            squares, high = [sdmax * sdmax], sdmax * sdmax
            for i in range(len(self._steps) - 1, -1, -1):
                if not math.isnan(high):  # nan is none, and stays none
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
