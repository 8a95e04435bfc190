"""Whether a pair is apart, overlaps, or neither can be proven: the search behind the verdict on an edge.

Two pieces overlap, and by more than rounding can do, where a tetrahedron of points of their difference has the origin
inside, farther from its faces than any of its corners can be wrong; or where a point of the difference is nearer to the
origin than the balls are large (Gilbert, Johnson & Keerthi, IEEE J. Robotics and Automation 4(2), 1988).
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from planner_service.certify.hulls import GAIN, SHARE, THIN, nearest_of
from planner_service.certify.separation import Facing
from planner_service.geometry.arrays import FloatArray

__all__ = ["CERTAIN", "STEPS", "Contact", "settled"]

STEPS = 60
"""Of one walk towards an overlap; a box against a box needs about six."""

CERTAIN = 1e-9
"""Metres: far above what rounding does to a point of the difference (1e-15) or to its distance from a face (1e-10)."""


class Contact(Enum):
    """What is proven of a pair."""

    APART = 0
    OVERLAP = 1
    UNCLEAR = 2


def settled(
    facing: Facing, gap: float, n: FloatArray, enough: float, nearer: float
) -> tuple[float, FloatArray, Contact]:
    """Whether one pair is farther apart than ``enough`` or nearer than ``nearer`` metres; before that a better bound.

    Args:
        gap, n: A bound and its direction (3,), with which to begin.
    """
    for start in (n.copy(), *np.eye(3)):
        overlaps, gap, n = _walk_inside(facing, start, nearer, gap, n)
        if overlaps:
            return gap, n, Contact.OVERLAP
        if gap > enough:
            return gap, n, Contact.APART
    return gap, n, Contact.UNCLEAR


def _walk_inside(
    facing: Facing, start: FloatArray, nearer: float, gap: float, n: FloatArray
) -> tuple[bool, float, FloatArray]:
    """Whether one walk shows an overlap; the bound and its direction are improved on the way."""
    balls = float(facing.balls[0])
    within = balls + nearer
    point = facing.difference(start[:, None])
    kept = np.repeat(point[None], 3, axis=0)
    for _ in range(STEPS):
        nearest, following, outside = nearest_of(kept, point)
        x, y, z = nearest[:, 0].tolist()
        length = math.sqrt(x * x + y * y + z * z)
        if length + CERTAIN < within:
            return True, gap, n
        if not outside[0]:
            depth = _depth_in([*kept[:, :, 0].tolist(), point[:, 0].tolist()])
            return depth > 0.0 and depth + within > 0.0, gap, n
        kept = following
        if not length > GAIN:
            break
        way = nearest / length
        point = facing.difference(way)
        (x, y, z), (u, v, w) = way[:, 0].tolist(), point[:, 0].tolist()
        bound = x * u + y * v + z * w - balls
        if bound > gap:
            gap, n = bound, way[:, 0]
        most = length - balls
        if not bound < most - GAIN - SHARE * max(most, 0.0):
            break
    return False, gap, n


def _depth_in(corners: list[list[float]]) -> float:
    """How far the origin is inside a tetrahedron that has it, beyond what rounding can do; 0 if that cannot be said."""
    depth = math.inf
    for k in range(4):
        a, b, c = (corners[(k + i) % 4] for i in range(3))
        (x, y, z), (u, v, w) = ([q - p for p, q in zip(a, other, strict=True)] for other in (b, c))
        i, j, m = y * w - z * v, z * u - x * w, x * v - y * u
        area = i * i + j * j + m * m
        if not area > THIN * (x * x + y * y + z * z) * (u * u + v * v + w * w):
            return 0.0
        depth = min(depth, abs(i * a[0] + j * a[1] + m * a[2]) / math.sqrt(area))
    return depth - CERTAIN
