"""Getting out of a collision: the nearest free configuration, and a motion to it.

A plan never moves its start by itself: these are suggestions, and the user decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import JointLimits

__all__ = ["WayOut", "near", "nearest_free", "way_out"]

_SHELLS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Radii in joint space (rad) searched in turn; beyond the last a person has to find the way out."""

_DIRECTIONS = 32
_BISECTIONS = 8


@dataclass(frozen=True, eq=False)
class WayOut:
    """A motion out of a collision.

    Attributes:
        path: A straight line from the colliding configuration to a free one. Only pairs that touch at its start touch
            on it, and a pair that has come apart stays apart.
        pairs: The pairs that touch at its start.
    """

    path: JointPath
    pairs: tuple[tuple[str, str], ...]


def nearest_free(checker: CollisionChecker, q: FloatArray, rng: np.random.Generator) -> FloatArray | None:
    """A free configuration near q (n,), None if none was found.

    Random directions on growing shells inside the joint limits, then bisection back towards q;
    every state is counted.
    """
    nearby = near(q, checker.robot.limits, rng)
    free = next((candidate for candidate in nearby if checker.state_is_free(candidate)), None)
    return None if free is None else read_only(_pulled_back(checker, q, free))


def near(q: FloatArray, limits: JointLimits, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Configurations around q (n,) inside the limits, in random directions on growing shells."""
    for radius in _SHELLS:
        for direction in rng.standard_normal((_DIRECTIONS, len(q))).tolist():
            norm = math.sqrt(math.fsum(x * x for x in direction))
            yield np.clip(q + np.array(direction) * (radius / norm), limits.lower, limits.upper)


def _pulled_back(checker: CollisionChecker, q: FloatArray, free: FloatArray) -> FloatArray:
    """A free point on the line from a colliding q to ``free``, close to where the collision ends."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if checker.state_is_free(q + (free - q) * middle):
            high = middle
        else:
            low = middle
    return q + (free - q) * high if high < 1.0 else free


def way_out(checker: CollisionChecker, q: FloatArray, rng: np.random.Generator) -> WayOut | None:
    """A straight line from a colliding q (n,) to the nearest free configuration found, None if none is safe.

    Safe means that along it, at the checker's edge step, only pairs that touch at q touch, and that
    a pair that has come apart stays apart.
    """
    pairs = {(c.a, c.b) for c in checker.contacts(q)}
    if not pairs:
        return WayOut(JointPath(np.array([q])), ())
    free = nearest_free(checker, q, rng)
    if free is None:
        return None
    touching = set(pairs)
    parts = max(2, checker.segments(q, free))
    for k in range(1, parts + 1):
        now = {(c.a, c.b) for c in checker.contacts(q + (free - q) * (k / parts))}
        if not now <= touching:
            return None
        touching = now
    return WayOut(JointPath(np.array([q, free])), tuple(sorted(pairs)))
