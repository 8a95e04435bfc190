"""The gap between two convex solids, one pair at a time: for hulls, whose nearest points have no closed form.

The nearest point of the difference set b - a to the origin is walked to over its support points (Gilbert, Johnson &
Keerthi, IEEE J. Robotics and Automation 4(2), 1988). Each step suggests a direction; the bound is the separation of
both solids along it, so a step that went wrong can cost tightness, never soundness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from planner_service.geometry.arrays import FloatArray

__all__ = ["Solid", "gap_of"]

STEPS = 60
"""Two hulls take ten or so; near a rim steps grow short."""

CLOSE_ENOUGH = 1e-9
"""Metres between the bound and the nearest point so far at which another step is not worth taking."""

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid in the world: a hull, or the sum of a box and a disc about local z; and a ball on top of either.

    Attributes:
        corners: Of a hull, about its centre in its own axes, (3, v).
    """

    corners: FloatArray | None
    half: Point
    disc: float
    ball: float
    R: tuple[Point, Point, Point]
    t: Point

    @classmethod
    def of(
        cls, corners: FloatArray | None, half: Sequence[float], disc: float, ball: float, R: FloatArray, t: FloatArray
    ) -> Solid:
        """A solid turned by R (3, 3), its centre at t (3,)."""
        rows = R.tolist()
        return cls(corners, _point(half), disc, ball, (_point(rows[0]), _point(rows[1]), _point(rows[2])), _point(t))

    def farthest(self, d: Point) -> Point:
        """A point of the solid without its ball that is farthest along d."""
        a, b, c = self.R
        u, v, w = (a[k] * d[0] + b[k] * d[1] + c[k] * d[2] for k in range(3))
        if self.corners is not None:
            k = int((self.corners[0] * u + self.corners[1] * v + self.corners[2] * w).argmax())
            local = _point(self.corners[:, k].tolist())
        else:
            across = self.disc / max(math.hypot(u, v), 1e-300)
            x, y, z = self.half
            local = (math.copysign(x, u) + across * u, math.copysign(y, v) + across * v, math.copysign(z, w))
        x, y, z = (_dot(row, local) + centre for row, centre in zip(self.R, self.t, strict=True))
        return (x, y, z)


def gap_of(a: Solid, b: Solid) -> float:
    """A lower bound in metres of the gap between two solids, exact up to rounding where they are apart.

    Where they overlap it says at most by how much, roughly.
    """
    balls = a.ball + b.ball
    best = -math.inf
    way: Point = _minus(b.t, a.t)
    simplex: list[Point] = []
    nearest = math.inf
    for _ in range(STEPS):
        length = math.sqrt(_dot(way, way))
        if not length > 0.0:
            way, length = (1.0, 0.0, 0.0), 1.0
        d = (way[0] / length, way[1] / length, way[2] / length)
        point = _minus(b.farthest((-d[0], -d[1], -d[2])), a.farthest(d))
        best = max(best, _dot(d, point))
        if nearest - best <= CLOSE_ENOUGH or point in simplex:
            break
        closest = _nearest([*simplex, point])
        if closest is None:  # the origin is inside: they overlap
            break
        way, simplex = closest
        nearest = min(nearest, math.sqrt(_dot(way, way)))
    return best - balls


def _nearest(points: list[Point]) -> tuple[Point, list[Point]] | None:
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
    return min((_on_triangle(*face) for face in outside), key=lambda candidate: _dot(candidate[0], candidate[0]))


def _same_side(a: Point, b: Point, c: Point, inner: Point) -> bool:
    """Whether the origin lies on the same side of the plane through a, b and c as ``inner``."""
    n = _cross(_minus(b, a), _minus(c, a))
    return _dot(n, _minus(inner, a)) * -_dot(n, a) > 0.0


def _on_segment(a: Point, b: Point) -> tuple[Point, list[Point]]:
    edge = _minus(b, a)
    square = _dot(edge, edge)
    share = -_dot(a, edge) / square if square > 0.0 else 0.0
    if share <= 0.0:
        return a, [a]
    if share >= 1.0:
        return b, [b]
    return (a[0] + share * edge[0], a[1] + share * edge[1], a[2] + share * edge[2]), [a, b]


def _on_triangle(a: Point, b: Point, c: Point) -> tuple[Point, list[Point]]:
    n = _cross(_minus(b, a), _minus(c, a))
    square = _dot(n, n)
    within = all(_dot(_cross(_minus(q, p), n), p) >= 0.0 for p, q in ((a, b), (b, c), (c, a)))
    if square > 0.0 and within:
        share = _dot(n, a) / square
        return (share * n[0], share * n[1], share * n[2]), [a, b, c]
    edges = (_on_segment(a, b), _on_segment(b, c), _on_segment(c, a))
    return min(edges, key=lambda candidate: _dot(candidate[0], candidate[0]))


def _point(values: Sequence[float] | FloatArray) -> Point:
    x, y, z = values
    return (float(x), float(y), float(z))


def _minus(a: Point, b: Point) -> Point:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Point, b: Point) -> Point:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
