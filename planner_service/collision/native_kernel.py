"""The compiled kernel: finds pairs that are not proven apart, for a state, for many or for a whole edge in one call.

A pair is proven apart by more than ``MARGIN`` in exact arithmetic, beyond the micrometre in which FCL's own answer is
undefined and far beyond rounding (1e-15), so that FCL would say the same. Nor is FCL asked about a pair that is proven
to overlap by a hundred times that micrometre.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from planner_service.collision.bounds import centres_of, doubt_of
from planner_service.collision.edge_sampling import EdgeStep, FinestStep, JointStep, MotionStep, coarse_segments_of
from planner_service.collision.pairs import Parts
from planner_service.geometry.arrays import FloatArray, IntArray, read_only
from planner_service.native.loading import load_core
from planner_service.robot.model import Robot

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["FCL", "MARGIN", "build_kernel", "configure_edges", "instruction_sets"]

MARGIN = 2e-6
"""Metres: pairs proven farther apart are not given to FCL; ``doubt_of`` small solids comes on top."""

FCL = "fcl"
"""A variant that proves nothing, so that FCL decides every pair in order."""

SLIDES = 1.0


def instruction_sets() -> tuple[str, ...]:
    """Those the kernel can use on this processor, the fastest last."""
    return tuple(load_core().instruction_sets())


def build_kernel(robot: Robot, parts: Parts, variant: str = "", *, margin: float = MARGIN) -> _core.CollisionKernel:
    """The kernel for a robot and the numbered list of its parts and the scene's.

    Args:
        variant: One of ``instruction_sets()`` or ``FCL``; the fastest if empty.
        margin: Metres by which a pair must be proven apart, ``doubt_of`` small solids apart.
    """
    solids, standing = parts.solids, parts.standing
    runs = np.array(standing.runs, dtype=np.int64).reshape(-1, 2)
    rows = np.column_stack([solids.half, solids.ball, solids.disc, solids.hulls])
    hulls = [np.ascontiguousarray(corners.T) for corners in solids.corners]
    kernel: _core.CollisionKernel = load_core().CollisionKernel(
        _joints(robot), rows, hulls, _riders(parts), standing.rotations.reshape(-1, 9), *_standers(parts),
        runs, parts.pairs.table, len(parts.pairs), margin + doubt_of(solids), variant
    )  # fmt: skip
    return kernel


def configure_edges(
    kernel: _core.CollisionKernel,
    bounds: tuple[list[float], list[float]],
    tables: tuple[list[float], list[float]],
    reach: list[float],
    step: EdgeStep,
) -> bool:
    """Have the kernel check states and edges itself; False if it cannot split edges, as the step is a rule of a user's.

    Args:
        bounds: Between which joint values it takes states and edges, lower and upper.
        tables: Between which it keeps what is proven of pairs of links.
    """
    rules = _simple_rules(step)
    kernel.configure(
        *bounds,
        *tables,
        reach,
        motion_steps=[rule.distance for rule in rules if isinstance(rule, MotionStep)],
        joint_steps=[rule.angle for rule in rules if isinstance(rule, JointStep)],
        coarse_segments=coarse_segments_of(step),
    )
    return bool(rules) and all(type(rule) in (MotionStep, JointStep) for rule in rules)


def _simple_rules(step: EdgeStep) -> list[EdgeStep]:
    """The rules that a step takes the finest of."""
    if type(step) is not FinestStep:
        return [step]
    return [simple for rule in step.rules for simple in _simple_rules(rule)]


@lru_cache(maxsize=16)
def _joints(robot: Robot) -> FloatArray:
    """Each body but the base: parent, entry of q, whether it slides, axis, its placement by rows, multiplier."""
    rows = [
        [
            float(body.parent),
            float(body.q_index),
            SLIDES if body.prismatic else 0.0,
            *body.axis.tolist(),
            *body.placement[:3, :3].ravel().tolist(),
            *body.placement[:3, 3].tolist(),
            body.multiplier,
        ]
        for body in robot.bodies[1:]
    ]
    return read_only(np.array(rows, dtype=np.float64).reshape(-1, 19))


def _riders(parts: Parts) -> FloatArray:
    """Of each part that rides its body, then rotation and centre in it."""
    T = np.array([part.T for part in parts.parts[: parts.riding]]).reshape(-1, 4, 4)
    R = T[:, :3, :3]
    t = T[:, :3, 3] + (R @ centres_of(parts.shapes[: parts.riding])[..., None])[..., 0]
    return np.column_stack([parts.bodies, R.reshape(-1, 9), t])


def _standers(parts: Parts) -> tuple[IntArray, FloatArray]:
    """Of each part that stands its kind and its rotation, and where its centre is."""
    standing = parts.standing
    numbers, positions = np.column_stack([standing.numbers + parts.riding, standing.turns]), standing.positions
    centres = centres_of(parts.kinds)[parts.riding :]
    moved = np.flatnonzero((centres != 0.0).any(axis=1)[standing.numbers])
    if len(moved):
        R = standing.rotations[standing.turns[moved]]
        positions = positions.copy()
        positions[moved] += (R @ centres[standing.numbers[moved], :, None])[..., 0]
    return numbers, positions
