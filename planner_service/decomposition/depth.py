"""How deep two convex solids overlap, at least: by balls that lie inside of them.

A ball of radius r about a point c of one solid, and a point c whose distance to the outside of the other is s, give an
overlap of at least r + s in every direction: so large is the sum of the support values of the one and, turned round,
the other. Where no point of one moves by more than m against the other, they still overlap if r + s > m. ``s`` may be
negative, minus the distance to the other solid; then the bound is the same. Of a mesh, s is what the balls inside of
it say. In a box, a cylinder or a capsule the ball may be anywhere in its core, the points that are r inside, so it is
put where the core is nearest to that of the other solid; a smaller one comes farther into a corner.

All arithmetic is elementwise, in one fixed order: equal bits on every processor.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, along, blocks
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere

__all__ = ["Inside", "inside_of"]

MOST = 32
"""Balls in a solid."""

DRAWN = 16
"""Points along the longest side of the box around a mesh, at which balls may begin."""

APART = 0.5
"""Of the radius of a ball: how far the centre of another has to be outside of those before it."""

Depth = Callable[[FloatArray], FloatArray]
ToCore = Callable[[FloatArray, float], FloatArray]


class Inside:
    """What is known of the inside of a solid.

    Attributes:
        centres, radii: Balls inside of it, (b, 3) in its own frame and (b,).
        exact: Whether ``depth`` is the signed distance, not only a bound.
        to_core: Moves points (3, ...) to the nearest of the core, the centres of balls of a share of the largest
            radius; None of a mesh.
        gap: Metres that a point of the core may be from the nearest of the centres, about; 0 if all are centres.
        corner: Times a radius that a corner is away from a ball in it.
    """

    def __init__(
        self,
        centres: FloatArray,
        radii: FloatArray,
        depth: Depth | None = None,
        to_core: ToCore | None = None,
        corner: float = 0.0,
    ) -> None:
        self.centres, self.radii, self.to_core, self.corner = centres, radii, to_core, corner
        self.exact = depth is not None
        self.gap = _norm([float(np.diff(np.unique(row)).max(initial=0.0)) for row in centres.T])
        self._depth = depth

    def depth(self, points: FloatArray) -> FloatArray:
        """At least how far points (3, m, b) are from the outside; outside, minus at least the distance to it."""
        if self._depth is not None:
            return self._depth(points)
        best = np.full(points.shape[1:], -math.inf)
        for centre, radius in zip(self.centres, self.radii.tolist(), strict=True):
            np.maximum(best, radius - _length(points - centre[:, None, None]), out=best)
        return best


def inside_of(shape: Shape) -> Inside:
    """Balls inside a shape, and how deep points are inside of it."""
    if isinstance(shape, Sphere):
        return _of(np.zeros((1, 3)), shape.radius, lambda p: shape.radius - _length(p), lambda p, share: 0.0 * p)
    if isinstance(shape, Capsule):
        half = shape.length / 2.0
        line = _line(half, shape.radius)
        return _of(
            line, shape.radius, lambda p: shape.radius - _to_segment(p, half), lambda p, share: _on_disc(p, 0.0, half)
        )
    if isinstance(shape, Cylinder):
        radius, half = shape.radius, shape.length / 2.0
        ball = min(radius, half)
        flat = _grid(np.array([radius - ball, radius - ball, half - ball]), ball)
        within = flat[_length((flat * (1.0, 1.0, 0.0)).T) <= radius - ball]

        def to_core(p: FloatArray, share: float) -> FloatArray:
            return _on_disc(p, radius - share * ball, half - share * ball)

        return _of(within, ball, lambda p: _in_cylinder(p, radius, half), to_core, math.sqrt(2.0) - 1.0)
    if isinstance(shape, Box):
        sides = np.array(shape.half)
        ball = float(sides.min())

        def to_core(p: FloatArray, share: float) -> FloatArray:
            return _on_box(p, sides - share * ball)

        return _of(_grid(sides - ball, ball), ball, lambda p: _in_box(p, sides), to_core, math.sqrt(3.0) - 1.0)
    if isinstance(shape, Mesh):
        return _in_mesh(shape)
    raise BrokenInvariant(f"a {type(shape).__name__} has no inside here")


def _of(centres: FloatArray, radius: float, depth: Depth, to_core: ToCore, corner: float = 0.0) -> Inside:
    return Inside(centres, np.full(len(centres), radius), depth, to_core, corner)


def _line(half: float, step: float) -> FloatArray:
    count = min(2 * math.ceil(half / step), MOST - 1) + 1
    z = half * (2.0 * np.arange(count) / max(count - 1, 1) - 1.0) if count > 1 else np.zeros(1)
    return np.stack([np.zeros(count), np.zeros(count), z], axis=-1)


def _grid(half: FloatArray, step: float) -> FloatArray:
    """Points (k, 3) of a box about zero, about ``step`` apart, but no more than ``MOST``."""
    while True:
        counts = [2 * math.ceil(side / (2.0 * step) - 1e-9) + 1 for side in half.tolist()]
        if math.prod(counts) <= MOST:
            break
        step *= 1.25
    lines = [
        side * (np.arange(count) / max(count // 2, 1) - (1.0 if count > 1 else 0.0))
        for side, count in zip(half.tolist(), counts, strict=True)
    ]
    return np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=-1)


@lru_cache(maxsize=1024)
def _in_mesh(mesh: Mesh) -> Inside:
    """Of points on a grid in the hull those that are deepest, and far enough from the balls before them."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    step = float((high - low).max()) / DRAWN
    counts = [max(3, math.ceil(side / step)) for side in (high - low).tolist()]
    lines = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*lines, indexing="ij")], axis=-1)
    rows = [(mesh.offsets - along(mesh.normals, points[k])).min(axis=-1) for k in blocks(len(points), len(mesh.faces))]
    deep = np.concatenate(rows)
    centres, radii = [mesh.vertices.mean(axis=0)], []
    radii.append(float((mesh.offsets - along(mesh.normals, centres[0][None])[0]).min()))
    left = deep > 0.0
    while len(radii) < MOST and left.any():
        k = int(np.where(left, deep, -math.inf).argmax())
        centres.append(points[k])
        radii.append(float(deep[k]))
        left &= _length((points - points[k]).T) > APART * deep[k]
        left[k] = False
    kept = [k for k, radius in enumerate(radii) if radius > 0.0]
    balls = np.array([centres[k] for k in kept]).reshape(-1, 3), np.array([radii[k] for k in kept])
    return Inside(*balls)


def _norm(vector: list[float]) -> float:
    return math.sqrt(sum(entry * entry for entry in vector))


def _length(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _to_segment(p: FloatArray, half: float) -> FloatArray:
    x, y, z = p
    beyond = z - np.clip(z, -half, half)
    return np.asarray(np.sqrt(x * x + y * y + beyond * beyond))


def _in_cylinder(p: FloatArray, radius: float, half: float) -> FloatArray:
    x, y, z = p
    side, end = radius - np.sqrt(x * x + y * y), half - np.abs(z)
    a, b = np.minimum(side, 0.0), np.minimum(end, 0.0)
    inner = np.minimum(side, end)
    return np.where(inner >= 0.0, inner, -np.sqrt(a * a + b * b))


def _on_disc(p: FloatArray, radius: float, half: float) -> FloatArray:
    """The nearest points of a cylinder; a disc or a segment where it has no height or no radius."""
    x, y, z = p
    out = np.sqrt(x * x + y * y)
    nearer = np.minimum(1.0, radius / np.where(out > 0.0, out, 1.0))
    return np.stack([x * nearer, y * nearer, np.clip(z, -half, half)])


def _on_box(p: FloatArray, half: FloatArray) -> FloatArray:
    return np.stack([np.clip(row, -side, side) for row, side in zip(p, half.tolist(), strict=True)])


def _in_box(p: FloatArray, half: FloatArray) -> FloatArray:
    gap = half[:, None, None] - np.abs(p)
    inner = gap.min(axis=0)
    return np.where(inner >= 0.0, inner, -_length(np.minimum(gap, 0.0)))
