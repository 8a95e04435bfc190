"""What keeps searches on constraints, compiled (native/constraints/projector.cpp).

A configuration is projected by damped least squares on the shares of the tolerances that are used (CBiRRT2: Berenson,
Srinivasa & Kuffner, IJRR 30(12), 2011; damping: Wampler, IEEE SMC 16(1), 1986). Only quantities near their bound or
beyond it count, and they are moved well inside: what has room within its tolerance uses it.

This is the search's view; that a whole curve keeps its constraints is proven by code that shares nothing with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from planner_service.geometry.arrays import FloatArray, cosines_and_sines
from planner_service.kinematics.constraint_set import ConstraintSet, Placed
from planner_service.native.loading import load_core

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["projector_of"]


def projector_of(constraints: ConstraintSet) -> _core.Projector:
    """The projector onto some constraints."""
    robot, bodies = constraints.robot, _moved_by(constraints)
    numbers = {body: number for number, body in enumerate([0, *bodies])}
    table = robot.body_table[[body - 1 for body in bodies]]
    table[:, 0] = [numbers[robot.bodies[body].parent] for body in bodies]
    joints = [
        [parent, body.q_index, body.prismatic, *body.axis.tolist(), body.multiplier]
        for parent, body in zip(table[:, 0].tolist(), map(robot.bodies.__getitem__, bodies), strict=True)
    ]
    rows = [_row(placed, numbers) for placed in constraints.regions]
    projector: _core.Projector = load_core().Projector(
        table,
        np.array(joints, dtype=np.float64).reshape(-1, 7),
        constraints.lower,
        constraints.upper,
        np.array(rows, dtype=np.float64).reshape(-1, 37 + 2 * robot.n),
    )
    return projector


def _moved_by(constraints: ConstraintSet) -> list[int]:
    """The bodies that the frames of the regions depend on, parents first, without the base."""
    found: set[int] = set()
    for index in (index for placed in constraints.regions for index in (placed.body, placed.base)):
        while index > 0:
            found.add(index)
            index = constraints.robot.bodies[index].parent
    return sorted(found)


def _row(placed: Placed, numbers: Mapping[int, int]) -> list[float]:
    """A region as ``Region`` in native/constraints/projector.hpp."""
    region = placed.region
    frames = [number for pose in (placed.at, placed.frame) for number in _frame(pose.matrix)]
    bounds = [*region.lower, *region.upper, *placed.room, *_bounds(placed)]
    return [
        numbers[placed.body],
        numbers[placed.base],
        *frames,
        *bounds,
        *placed.reach.tolist(),
        *placed.turns.tolist(),
    ]


def _frame(T: FloatArray) -> list[float]:
    """The rotation by rows, then the position."""
    return [*T[:3, :3].ravel().tolist(), *T[:3, 3].tolist()]


def _bounds(placed: Placed) -> tuple[float, float]:
    """The chord of the tilt and the sine of half the turn; inf where there is no bound."""
    angles = [angle for angle in (placed.region.tilt, placed.region.turn) if angle is not None]
    _, sines = cosines_and_sines(np.array([angle / 2.0 for angle in angles]))
    tilt, turn = [*sines.tolist(), math.inf, math.inf][:2]
    return 2.0 * tilt if placed.region.tilt is not None else math.inf, turn
