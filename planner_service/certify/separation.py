"""Proven gaps between convex solids, many pairs at once: the arithmetic of the certificate, and of nothing else.

Every solid is the hull of its corners, or the Minkowski sum of a box, a disc across local z and a ball, whose support
function has a closed form. For any unit direction n from b towards a, ``n . (c_a - c_b) - h_a(-n) - h_b(n)`` is a lower
bound of the signed gap (separating axis theorem; all but hulls are centrally symmetric). Whatever suggests the
direction, the bound holds; good suggestions only make it tight. Arrays have the component first: vectors are (3, p),
rotations (3, 3, p).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from planner_service.certify.hulls import GAIN, SHARE, Corners, dot, nearest_of
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, read_only
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere

__all__ = ["Bounds", "Facing", "Solids", "centre_of", "refined_gaps", "rough_gaps", "walked"]


FEW = 200
"""Shapes: the solids of more are made anew each time."""

TINY = 1e-12
"""Metres: a shorter vector has no direction worth trying."""

SHIFT = 0.06
"""Metres by which close solids are drawn apart while a direction is sought; about their size, see ``_ascended``."""

STEPS_PER_ROUND = 3
"""Steps of the walk between hulls in the place of one round of the ascent."""

DRAWS = 20
"""Times that two hulls are drawn apart to find a better direction of their overlap."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Half lengths of the boxes (3, p), radii of the discs (p,) and of the balls (p,), about ``centre_of`` each shape.

    Attributes:
        hulls: Those that are hulls, None if none is; in the other arrays these are zero.
    """

    half: FloatArray
    disc: FloatArray
    ball: FloatArray
    hulls: Corners | None = None

    @classmethod
    def of(cls, shapes: Sequence[Shape]) -> Solids:
        """The solids of ``shapes``, those of the scenes before among them, which mostly have the same."""
        return (_solids if len(shapes) <= FEW else _solids.__wrapped__)(tuple(shapes))

    def take(self, rows: IntArray) -> Solids:
        """The solids at ``rows``."""
        hulls = None if self.hulls is None else self.hulls.take(rows)
        return Solids(self.half[:, rows], self.disc[rows], self.ball[rows], hulls)

    def extent(self, n: FloatArray) -> FloatArray:
        """Support values along unit directions in local axes; n (..., 3, p) in, (..., p) out."""
        u, v, w = n[..., 0, :], n[..., 1, :], n[..., 2, :]
        flat = np.abs(u) * self.half[0] + np.abs(v) * self.half[1] + np.abs(w) * self.half[2]
        values = np.asarray(flat + self.disc * np.sqrt(u * u + v * v) + self.ball)
        return values if self.hulls is None else self.hulls.extended(n, values)

    def radius(self) -> FloatArray:
        """Distance of each solid's farthest point from its centre, (p,)."""
        x, y, z = self.half
        across = np.sqrt(x * x + y * y) + self.disc
        distances = np.asarray(np.sqrt(across * across + z * z) + self.ball)
        return distances if self.hulls is None else self.hulls.reaching(distances)

    def farthest(self, n: FloatArray) -> FloatArray:
        """A point of each solid without its ball that is farthest along a direction in local axes; (3, p) in, out."""
        u, v = n[0], n[1]
        out = np.where(n < 0.0, -self.half, self.half)
        share = self.disc / np.maximum(np.sqrt(u * u + v * v), TINY)
        out[0] += u * share
        out[1] += v * share
        return out if self.hulls is None else self.hulls.farthest(n, out)

    def nearest(self, x: FloatArray) -> FloatArray:
        """The point of box and disc, without the ball, nearest to a point in local axes; (3, p) in and out."""
        core: FloatArray = np.minimum(np.maximum(x, -self.half), self.half)
        u, v = x[0] - core[0], x[1] - core[1]
        share = np.minimum(1.0, self.disc / np.maximum(np.sqrt(u * u + v * v), TINY))
        core[0] += u * share
        core[1] += v * share
        return core


@lru_cache(maxsize=128)
def _solids(shapes: tuple[Shape, ...]) -> Solids:
    rows = [_row(shape) for shape in shapes]
    table = read_only(np.array(rows, dtype=np.float64).reshape(-1, 5).T)
    return Solids(table[:3], table[3], table[4], Corners.of([_corners(shape) for shape in shapes]))


def centre_of(shape: Shape) -> tuple[float, float, float]:
    """Where a shape's solid has its centre, in the shape's own frame: 0 but for a hull, the mean of its corners."""
    return _mean(shape) if isinstance(shape, Mesh) else (0.0, 0.0, 0.0)


@lru_cache(maxsize=1024)
def _mean(mesh: Mesh) -> tuple[float, float, float]:
    x, y, z = (math.fsum(column) / len(column) for column in mesh.vertices.T.tolist())
    return (x, y, z)


def _corners(shape: Shape) -> FloatArray | None:
    """The corners of a hull about its centre, (3, v)."""
    return (shape.vertices - np.array(centre_of(shape))).T if isinstance(shape, Mesh) else None


def _row(shape: Shape) -> tuple[float, float, float, float, float]:
    """Half lengths, disc, ball."""
    if isinstance(shape, Mesh):
        return (0.0, 0.0, 0.0, 0.0, 0.0)
    if isinstance(shape, Box):
        return (*shape.half, 0.0, 0.0)
    if isinstance(shape, Sphere):
        return (0.0, 0.0, 0.0, 0.0, shape.radius)
    if isinstance(shape, Capsule):
        return (0.0, 0.0, shape.length / 2, 0.0, shape.radius)
    if isinstance(shape, Cylinder):
        return (0.0, 0.0, shape.length / 2, shape.radius, 0.0)
    raise BrokenInvariant(f"no support function is known for {type(shape).__name__}")


@dataclass(frozen=True, eq=False)
class Facing:
    """Pairs of solids, seen from the second: ``R`` (3, 3, p) turns a's axes into b's, ``x`` (3, p) is a's centre."""

    a: Solids
    b: Solids
    R: FloatArray
    x: FloatArray

    @classmethod
    def of(cls, a: Solids, b: Solids, pose_a: FloatArray, pose_b: FloatArray) -> Facing:
        """Pairs from world poses (3, 4, p), the first three rows of homogeneous matrices."""
        A, B = pose_a[:, :3], pose_b[:, :3]
        delta = pose_a[:, 3] - pose_b[:, 3]
        R = B[0][:, None] * A[0] + B[1][:, None] * A[1] + B[2][:, None] * A[2]
        return cls(a, b, R, B[0] * delta[0] + B[1] * delta[1] + B[2] * delta[2])

    def take(self, rows: IntArray) -> Facing:
        """The pairs at ``rows``."""
        return Facing(self.a.take(rows), self.b.take(rows), self.R[:, :, rows], self.x[:, rows])

    def into_a(self, v: FloatArray) -> FloatArray:
        """Vectors in b's axes turned into a's; (..., 3, p) in and out."""
        R = self.R
        return np.asarray(v[..., 0, None, :] * R[0] + v[..., 1, None, :] * R[1] + v[..., 2, None, :] * R[2])

    def out_of_a(self, v: FloatArray) -> FloatArray:
        """Vectors in a's axes turned into b's; (3, p) in and out."""
        return np.asarray(v[0] * self.R[:, 0] + v[1] * self.R[:, 1] + v[2] * self.R[:, 2])

    def along(self, n: FloatArray) -> FloatArray:
        """The bound of each pair along unit directions in b's axes; (..., 3, p) in, (..., p) out."""
        apart = n[..., 0, :] * self.x[0] + n[..., 1, :] * self.x[1] + n[..., 2, :] * self.x[2]
        return np.asarray(apart - self.b.extent(n) - self.a.extent(self.into_a(-n)))

    def without_hulls(self) -> Facing:
        """The same pairs, known to have no hull among them."""
        return Facing(replace(self.a, hulls=None), replace(self.b, hulls=None), self.R, self.x)

    @property
    def with_hull(self) -> BoolArray | None:
        """Which pairs have a hull, (p,); None if there is none at all."""
        rows = [solids.hulls.rows >= 0 for solids in (self.a, self.b) if solids.hulls is not None]
        return None if not rows else np.asarray(rows[0] | rows[-1])

    @property
    def balls(self) -> FloatArray:
        """What the two balls of each pair take off a gap between the cores, (p,)."""
        return np.asarray(self.a.ball + self.b.ball)

    def difference(self, n: FloatArray) -> FloatArray:
        """The point of a's core minus b's that is nearest along unit directions from b to a; (3, p) in and out.

        A core is a solid without its ball.
        """
        on_a = self.x + self.out_of_a(self.a.farthest(self.into_a(-n)))
        return np.asarray(on_a - self.b.farthest(n))


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of the gaps of some pairs (k,), and the directions of these (3, k)."""

    gaps: FloatArray
    n: FloatArray


def _unit(v: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Directions of vectors (..., 3, p), and which of them have one, (..., p)."""
    u, w, z = v[..., 0, :], v[..., 1, :], v[..., 2, :]
    length = np.sqrt(u * u + w * w + z * z)
    return v / np.maximum(length, TINY)[..., None, :], length > TINY


def _best(facing: Facing, candidates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The largest bound along candidate vectors (k, 3, p) of any length and either sign, (p,), and its direction."""
    n, good = _unit(candidates)
    x = facing.x
    apart = n[:, 0] * x[0] + n[:, 1] * x[1] + n[:, 2] * x[2]
    towards = n if facing.with_hull is None else np.where(apart < 0.0, -1.0, 1.0)[:, None] * n  # hulls have two sides
    extent = facing.b.extent(towards) + facing.a.extent(facing.into_a(-towards))
    bound = np.where(good, np.abs(apart) - extent, -np.inf)
    first = bound.argmax(axis=0)
    columns = np.arange(first.size)
    chosen = n[first, :, columns].T
    return bound[first, columns], np.where(apart[first, columns] < 0.0, -chosen, chosen)


def rough_gaps(facing: Facing, hints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Quick bounds (p,) and their directions (3, p): axes, lines across them, centres, and ``hints`` (k, 3, p)."""
    R, x = facing.R, facing.x
    y = facing.into_a(x)
    k = len(hints)
    tries = np.zeros((9 + k, 3, x.shape[1]))
    tries[0] = x
    tries[1, :2] = x[:2]
    tries[2] = R[:, 0] * y[0] + R[:, 1] * y[1]
    tries[3:6] = R.transpose(1, 0, 2)
    tries[6:9] = np.eye(3)[:, :, None]
    tries[9:] = hints
    return _best(facing, tries)


def _crosses(facing: Facing) -> FloatArray:
    """Cross products of b's axes and a's, (9, 3, p): with the axes all that two boxes need."""
    R = facing.R
    out = np.zeros((3, 3, *R.shape[1:]))  # b's axis, component, a's axis, pair
    out[0, 1], out[0, 2] = -R[2], R[1]
    out[1, 0], out[1, 2] = R[2], -R[0]
    out[2, 0], out[2, 1] = -R[1], R[0]
    return out.transpose(0, 2, 1, 3).reshape(9, 3, -1)


def refined_gaps(
    facing: Facing, gaps: FloatArray, directions: FloatArray, rounds: int
) -> tuple[FloatArray, FloatArray]:
    """Bounds no smaller than ``gaps`` (p,), and their directions (3, p): edges against edges, then an ascent.

    With a hull, which has more edges than are worth crossing, a walk to the nearest points instead.
    """
    hulled = facing.with_hull
    if hulled is None or not hulled.any():
        bounds, n = _best(facing, _crosses(facing))
        better = bounds > gaps
        return _ascended(facing, np.where(better, bounds, gaps), np.where(better, n, directions), rounds)
    gaps, directions = gaps.copy(), directions.copy()
    for rows, is_hull in ((np.flatnonzero(~hulled), False), (np.flatnonzero(hulled), True)):
        if len(rows):
            chosen, known, n = facing.take(rows), gaps[rows], directions[:, rows]
            if is_hull:
                known, n = walked(chosen, known, n, STEPS_PER_ROUND * rounds)
            else:
                known, n = refined_gaps(chosen.without_hulls(), known, n, rounds)
            gaps[rows], directions[:, rows] = known, n
    return gaps, directions


def walked(pairs: Facing, gaps: FloatArray, n: FloatArray, steps: int) -> tuple[FloatArray, FloatArray]:
    """Improve bounds (p,) and directions (3, p) by walking to the nearest point of a - b over its support points.

    (Gilbert, Johnson & Keerthi, IEEE J. Robotics and Automation 4(2), 1988.) Up to three support points are kept, whose
    hull has the nearest point so far; a fourth that would enclose the origin means an overlap and ends the walk.
    """
    gaps, n = gaps.copy(), n.copy()
    rows: IntArray = np.arange(len(gaps))
    point = pairs.difference(n)
    kept = np.repeat(point[None], 3, axis=0)
    for _ in range(steps):
        nearest, kept, going = nearest_of(kept, point)
        length = np.sqrt(dot(nearest, nearest))
        going &= length > GAIN
        way = np.where(going, nearest / np.where(going, length, 1.0), n[:, rows])
        point = pairs.difference(way)
        bounds = dot(way, point) - pairs.balls
        better = bounds > gaps[rows]
        gaps[rows] = np.where(better, bounds, gaps[rows])
        n[:, rows] = np.where(better, way, n[:, rows])
        most = length - pairs.balls  # no bound is larger
        going &= bounds < most - GAIN - SHARE * np.maximum(most, 0.0)
        left = np.flatnonzero(going)
        if not len(left):
            break
        if len(left) < len(rows):
            rows, pairs, point, kept = rows[left], pairs.take(left), point[:, left], kept[:, :, left]
    return gaps, n


def _ascended(facing: Facing, gaps: FloatArray, n: FloatArray, rounds: int) -> tuple[FloatArray, FloatArray]:
    """Improve directions by projecting onto a and b in turn (Cheney & Goldstein, Proc. AMS 10, 1959).

    The line between nearest points says little when they almost touch, so a is first drawn away from b along the best
    direction so far: the best direction of all maximises ``n . x - h(n)``, and also that plus ``shift n . n_best`` once
    ``n_best`` is it, so nothing else is a fixed point (proximal point method, Rockafellar 1976).
    """
    gaps, n = gaps.copy(), n.copy()
    x = facing.x + n * np.maximum(SHIFT - gaps, 0.0)
    on_b = facing.b.nearest(x)
    for _ in range(rounds):
        x = facing.x + n * np.maximum(SHIFT - gaps, 0.0)
        on_a = x + facing.out_of_a(facing.a.nearest(facing.into_a(on_b - x)))
        on_b = facing.b.nearest(on_a)
        line, good = _unit(on_a - on_b)
        bounds = facing.along(line)
        better = good & (bounds > gaps)
        gaps = np.where(better, bounds, gaps)
        n = np.where(better, line, n)
    return gaps, n
