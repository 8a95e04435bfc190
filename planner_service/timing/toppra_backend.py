"""TOPP-RA's two passes by the toppra library: what our own are compared with. The only module that imports it."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from planner_service.concurrency.library_import import loaded
from planner_service.geometry.arrays import FloatArray
from planner_service.timing.time_optimal import GridLimits

__all__ = ["toppra_passes"]


def toppra_passes(grid: GridLimits, entry: float) -> FloatArray | None:
    """``time_optimal.two_passes`` by toppra."""
    solver = loaded(_imported).algorithm.TOPPRA([_constraint(grid)], _UnitInterval(), gridpoints=grid.points)
    _, speeds, _ = solver.compute_parameterization(entry, 0.0)
    return None if speeds is None else np.asarray(speeds, dtype=np.float64)


class _UnitInterval:
    """A path as toppra expects it, over the parameter [0, 1]; its derivatives come with the constraint."""

    path_interval = (0.0, 1.0)


def _constraint(grid: GridLimits) -> Any:
    """All limits at the grid points as one constraint of toppra.

    Accelerations and torques are bounded at both ends of each interval (toppra calls this interpolation).
    """
    toppra, n = loaded(_imported), len(grid.limit)
    signs = np.concatenate([np.eye(n), -np.eye(n)])
    linear = (grid.first, grid.second, grid.constant, signs, np.tile(grid.limit, 2), None, None)
    rows = toppra.constraint.canlinear_colloc_to_interpolate(*linear, grid.points, identical=True)[:-2]
    constraint = toppra.constraint.LinearConstraint()
    constraint.identical = True
    columns = np.stack([np.zeros(len(grid.squares)), grid.squares], axis=1)
    constraint.compute_constraint_params = lambda *_: (*rows, None, columns)
    return constraint


def _imported() -> Any:
    """The toppra library, which imports matplotlib to draw its plots; importing them logs nothing."""
    plotting = logging.getLogger("matplotlib")
    level = plotting.level
    plotting.setLevel(logging.ERROR)  # it would complain of a home folder without a cache
    try:
        import toppra  # 0.5 s, half of it for matplotlib
        import toppra.algorithm
        import toppra.constraint
    finally:
        plotting.setLevel(level)
    own = logging.getLogger("toppra")
    if own.level == logging.NOTSET:
        own.setLevel(logging.CRITICAL)  # a failure is returned, not logged
    return toppra
