"""The gap between two convex solids, one pair at a time: for hulls, whose nearest points have no closed form.

The nearest point of the difference set b - a to the origin is walked to over its support points (Gilbert, Johnson &
Keerthi, IEEE J. Robotics and Automation 4(2), 1988). Each step suggests a direction; the bound is the separation of
both solids along it, so a step that went wrong can cost tightness, never soundness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from planner_service.geometry.arrays import FloatArray, Vector, cross_of, dot, minus, vector

__all__ = ["Solid", "gap_of"]

STEPS = 60
"""Two hulls take ten or so; near a rim steps grow short."""

CLOSE_ENOUGH = 1e-9
"""Metres between the bound and the nearest point so far at which another step is not worth taking."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid in the world: a hull, or the sum of a box and a disc about local z; and a ball on top of either.

    Attributes:
        corners: Of a hull, about its centre in its own axes, (3, v).
    """

    corners: FloatArray | None
    half: Vector
    disc: float
    ball: float
    R: tuple[Vector, Vector, Vector]
    t: Vector

    @classmethod
    def of(
        cls, corners: FloatArray | None, half: Sequence[float], disc: float, ball: float, R: FloatArray, t: FloatArray
    ) -> Solid:
        """A solid turned by R (3, 3), its centre at t (3,)."""
        a, b, c = map(vector, R.tolist())
        return cls(corners, vector(half), disc, ball, (a, b, c), vector(t.tolist()))

    def farthest(self, d: Vector) -> Vector:
        """A point of the solid without its ball that is farthest along d."""
        a, b, c = self.R
        u, v, w = (a[k] * d[0] + b[k] * d[1] + c[k] * d[2] for k in range(3))
        if self.corners is not None:
            k = int((self.corners[0] * u + self.corners[1] * v + self.corners[2] * w).argmax())
            local = vector(self.corners[:, k].tolist())
        else:
            across = self.disc / max(math.hypot(u, v), 1e-300)
            x, y, z = self.half
            local = (math.copysign(x, u) + across * u, math.copysign(y, v) + across * v, math.copysign(z, w))
        x, y, z = (dot(row, local) + centre for row, centre in zip(self.R, self.t, strict=True))
        return (x, y, z)


def gap_of(a: Solid, b: Solid) -> float:
    """A lower bound in metres of the gap between two solids, exact up to rounding where they are apart.

    Where they overlap it says at most by how much, roughly.
    """
    balls = a.ball + b.ball
    best = -math.inf
    way: Vector = minus(b.t, a.t)
    simplex: list[Vector] = []
    nearest = math.inf
    for _ in range(STEPS):
        length = math.sqrt(dot(way, way))
        if not length > 0.0:
            way, length = (1.0, 0.0, 0.0), 1.0
        d = (way[0] / length, way[1] / length, way[2] / length)
        point = minus(b.farthest((-d[0], -d[1], -d[2])), a.farthest(d))
        best = max(best, dot(d, point))
        if nearest - best <= CLOSE_ENOUGH or point in simplex:
            break
        closest = _nearest([*simplex, point])
        if closest is None:  # the origin is inside: they overlap
            break
        way, simplex = closest
        nearest = min(nearest, math.sqrt(dot(way, way)))
    return best - balls


def _nearest(points: list[Vector]) -> tuple[Vector, list[Vector]] | None:
    """The point nearest to the origin of the hull of one to four points, and those that span it; None if inside."""
    if len(points) == 1:
        return points[0], points
    if len(points) == 2:
        return _on_segment(points[0], points[1])
    if len(points) == 3:
        return _on_triangle(points[0], points[1], points[2])
    a, b, c, d = points
    faces = [(a, b, d, c), (a, c, d, b), (b, c, d, a)]  # the face without d was the nearest before, from outside
    outside = [face[:3] for face in faces if not _same_side(*face)]
    if not outside:
        return None
    return min((_on_triangle(*face) for face in outside), key=lambda candidate: dot(candidate[0], candidate[0]))


def _same_side(a: Vector, b: Vector, c: Vector, inner: Vector) -> bool:
    """Whether the origin lies on the same side of the plane through a, b and c as ``inner``."""
    n = cross_of(minus(b, a), minus(c, a))
    return dot(n, minus(inner, a)) * -dot(n, a) > 0.0


def _on_segment(a: Vector, b: Vector) -> tuple[Vector, list[Vector]]:
    edge = minus(b, a)
    square = dot(edge, edge)
    share = -dot(a, edge) / square if square > 0.0 else 0.0
    if share <= 0.0:
        return a, [a]
    if share >= 1.0:
        return b, [b]
    return (a[0] + share * edge[0], a[1] + share * edge[1], a[2] + share * edge[2]), [a, b]


def _on_triangle(a: Vector, b: Vector, c: Vector) -> tuple[Vector, list[Vector]]:
    n = cross_of(minus(b, a), minus(c, a))
    square = dot(n, n)
    within = all(dot(cross_of(minus(q, p), n), p) >= 0.0 for p, q in ((a, b), (b, c), (c, a)))
    if square > 0.0 and within:
        share = dot(n, a) / square
        return (share * n[0], share * n[1], share * n[2]), [a, b, c]
    edges = (_on_segment(a, b), _on_segment(b, c), _on_segment(c, a))
    return min(edges, key=lambda candidate: dot(candidate[0], candidate[0]))
