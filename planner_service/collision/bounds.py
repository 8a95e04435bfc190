"""Proven gaps between convex solids, for many pairs at once, without FCL.

Every solid here is the Minkowski sum of a box, a ball and a disc about local z, so it is
centrally symmetric and its support function has a closed form. For any unit direction d the
value ``|d . (b - a)| - h_a(d) - h_b(d)`` is a lower bound of the signed gap between two solids at
a and b; whatever suggests the direction, the bound holds (separating axis theorem). A positive
bound proves a pair apart; a negative one bounds its overlap from above.

The hull of a mesh is first taken for the box around it, which can only be too careful; only where that leaves a pair in
doubt does ``refined_gaps`` look at its corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner_service.collision.gjk import Solid, gap_of
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, IntArray, cross, read_only
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere

__all__ = [
    "Placed",
    "Solids",
    "box_of",
    "centres_of",
    "doubt_of",
    "gaps_along",
    "refined_gaps",
    "rough_gaps",
]

_PROJECTIONS = 60
"""Alternating projections converge slowly near contact; this many find the gap to micrometres elsewhere."""

SMALL, DOUBT = 1e-3, 5e-4
"""Metres. Where a solid fits in a box of twice SMALL each way, FCL may call it touching what is apart: by 72 um in the
worst of 560,000 pairs of which one was so small, and in none of 360,000 others. Up to DOUBT it is asked."""


_TINY = 1e-12
"""Directions shorter than this are no directions (parallel edges have no cross product)."""


_ACROSS = np.array([1.0, 1.0, 0.0])
"""Where a disc about local z reaches."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Shapes as arrays: box half lengths (p, 3), ball radii (p,) and disc radii (p,), about ``centres_of`` them.

    Attributes:
        hulls: Of a hull, which stands here as the box around it, the number in ``corners``; -1 of others, (p,).
        corners: The corners of each hull about the centre of its box, (3, v).
    """

    half: FloatArray
    ball: FloatArray
    disc: FloatArray
    hulls: IntArray
    corners: tuple[FloatArray, ...]

    @classmethod
    def of(cls, shapes: Sequence[Shape]) -> Solids:
        """The solids of shapes, in their order."""
        hulls = np.full(len(shapes), -1, dtype=np.intp)
        corners: list[FloatArray] = []
        rows: list[tuple[float, float, float, float, float]] = []
        for k, shape in enumerate(shapes):
            if isinstance(shape, Box):
                rows.append((*shape.half, 0.0, 0.0))
            elif isinstance(shape, Sphere):
                rows.append((0.0, 0.0, 0.0, shape.radius, 0.0))
            elif isinstance(shape, Capsule):
                rows.append((0.0, 0.0, shape.length / 2, shape.radius, 0.0))
            elif isinstance(shape, Cylinder):
                rows.append((0.0, 0.0, shape.length / 2, 0.0, shape.radius))
            elif isinstance(shape, Mesh):
                hulls[k] = len(corners)
                corners.append(np.ascontiguousarray((shape.vertices - _centre_of(shape)).T))
                x, y, z = np.abs(corners[-1]).max(axis=1).tolist()
                rows.append((x, y, z, 0.0, 0.0))
            else:
                raise BrokenInvariant(f"no bound for a {type(shape).__name__}")
        table = np.array(rows, dtype=np.float64).reshape(-1, 5)
        half, ball, disc = (np.ascontiguousarray(part) for part in (table[:, :3], table[:, 3], table[:, 4]))
        return cls(half, ball, disc, hulls, tuple(corners))

    def joined(self, others: Solids) -> Solids:
        """These solids and then others."""
        half, ball, disc = (
            np.concatenate([getattr(self, name), getattr(others, name)]) for name in ("half", "ball", "disc")
        )
        hulls = np.where(others.hulls < 0, others.hulls, others.hulls + len(self.corners))
        return Solids(half, ball, disc, np.concatenate([self.hulls, hulls]), self.corners + others.corners)

    def take(self, rows: IntArray | slice) -> Solids:
        """The solids at ``rows``."""
        return Solids(self.half[rows], self.ball[rows], self.disc[rows], self.hulls[rows], self.corners)

    @property
    def box(self) -> FloatArray:
        """Half lengths of the boxes around the solids along their own axes, (p, 3)."""
        return np.asarray(self.half + self.ball[:, None] + self.disc[:, None] * _ACROSS)

    def one(self, row: int, R: FloatArray, t: FloatArray) -> Solid:
        """The solid at ``row``, a hull with its own corners, turned by R (3, 3) and with its centre at t (3,)."""
        hull = int(self.hulls[row])
        corners = self.corners[hull] if hull >= 0 else None
        return Solid.of(corners, self.half[row].tolist(), float(self.disc[row]), float(self.ball[row]), R, t)

    def extent(self, d: FloatArray) -> FloatArray:
        """Support values along unit directions d in local axes; d (..., p, 3) in, (..., p) out."""
        a = np.abs(d)
        flat = a[..., 0] * self.half[..., 0] + a[..., 1] * self.half[..., 1] + a[..., 2] * self.half[..., 2]
        return np.asarray(flat + self.ball + self.disc * np.sqrt(a[..., 0] ** 2 + a[..., 1] ** 2))

    def nearest(self, x: FloatArray) -> FloatArray:
        """The point of each solid nearest to a point x in its own axes; (p, 3) in and out."""
        core = np.minimum(np.maximum(x, -self.half), self.half)
        rest = x - core
        away = np.sqrt((rest * rest).sum(axis=-1))
        onto_ball = rest * np.minimum(1.0, self.ball / np.maximum(away, _TINY))[:, None]
        radial = np.sqrt(rest[:, 0] ** 2 + rest[:, 1] ** 2)
        onto_disc = rest * np.minimum(1.0, self.disc / np.maximum(radial, _TINY))[:, None]
        onto_disc[:, 2] = 0.0
        return np.asarray(core + np.where((self.disc > 0.0)[:, None], onto_disc, onto_ball))


def centres_of(shapes: Sequence[Shape]) -> FloatArray:
    """Where the solids of shapes have their centres, in the shapes' own frames, (p, 3): not 0 for a hull only."""
    out = np.zeros((len(shapes), 3))
    for k, shape in enumerate(shapes):
        if isinstance(shape, Mesh):
            out[k] = _centre_of(shape)
    return out


@lru_cache(maxsize=1024)
def _centre_of(mesh: Mesh) -> FloatArray:
    """The centre of the box around a hull, (3,)."""
    return read_only(0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)))


def doubt_of(solids: Solids) -> float:
    """Metres beyond the micrometre of all solids within which FCL may say that some of these touch."""
    return DOUBT if bool((solids.box.max(axis=1, initial=0.0) < SMALL).any()) else 0.0


def box_of(solids: Solids, R: FloatArray) -> FloatArray:
    """Half lengths of the world-aligned boxes around solids turned by R; (..., p, 3, 3) in, (..., p, 3) out."""
    flat = (np.abs(R) @ solids.half[..., None])[..., 0] + solids.ball[:, None]
    across = R[..., 0] ** 2 + R[..., 1] ** 2
    return np.asarray(flat + np.sqrt(across) * solids.disc[:, None])


def _into(R: FloatArray, d: FloatArray) -> FloatArray:
    """World directions in the axes of frames R, R^T d; (p, 3, 3) and (..., p, 3) in, (..., p, 3) out."""
    return np.asarray(d[..., 0, None] * R[:, 0] + d[..., 1, None] * R[:, 1] + d[..., 2, None] * R[:, 2])


def _out_of(R: FloatArray, x: FloatArray) -> FloatArray:
    """Local vectors in world axes, R x; (p, 3, 3) and (p, 3) in, (p, 3) out."""
    return np.asarray(x[:, 0, None] * R[:, :, 0] + x[:, 1, None] * R[:, :, 1] + x[:, 2, None] * R[:, :, 2])


@dataclass(frozen=True, eq=False)
class Placed:
    """Solids with their poses: rotations R (p, 3, 3) and centres t (p, 3)."""

    solids: Solids
    R: FloatArray
    t: FloatArray

    def take(self, rows: IntArray) -> Placed:
        """The placed solids at ``rows``."""
        return Placed(self.solids.take(rows), self.R[rows], self.t[rows])

    def nearest(self, points: FloatArray) -> FloatArray:
        """The point of each solid nearest to a world point; (p, 3) in and out."""
        return self.t + _out_of(self.R, self.solids.nearest(_into(self.R, points - self.t)))


def gaps_along(a: Placed, b: Placed, d: FloatArray) -> FloatArray:
    """Lower bounds of the gaps between a and b along directions d of any length, (..., p, 3) in, (..., p) out."""
    length = np.sqrt(d[..., 0] ** 2 + d[..., 1] ** 2 + d[..., 2] ** 2)
    unit = d / np.maximum(length, _TINY)[..., None]
    delta = b.t - a.t
    apart = np.abs(unit[..., 0] * delta[:, 0] + unit[..., 1] * delta[:, 1] + unit[..., 2] * delta[:, 2])
    bound = apart - a.solids.extent(_into(a.R, unit)) - b.solids.extent(_into(b.R, unit))
    return np.where(length > _TINY, bound, -np.inf)


def _axes(a: Placed, b: Placed) -> FloatArray:
    """The line of centres and the face normals of both solids, (7, p, 3)."""
    return np.concatenate([(b.t - a.t)[None], a.R.transpose(2, 0, 1), b.R.transpose(2, 0, 1)])


def _edge_crosses(a: Placed, b: Placed) -> FloatArray:
    """Cross products of the axes of both solids, (9, p, 3): with the face normals all that two boxes need."""
    u = a.R.transpose(2, 0, 1)[:, None]
    return cross(u, b.R.transpose(2, 0, 1)[None]).reshape(9, len(a.t), 3)


def rough_gaps(a: Placed, b: Placed) -> FloatArray:
    """Quick lower bounds of the gaps between pairs of solids, (p,): the line of centres and the face normals."""
    return np.asarray(gaps_along(a, b, _axes(a, b)).max(axis=0))


def refined_gaps(a: Placed, b: Placed) -> FloatArray:
    """The tightest lower bounds this module can prove, (p,): every separating axis, then alternating projections.

    Exact for two boxes that overlap. Pairs with a hull get the gap between nearest points instead.
    """
    every = np.concatenate([_axes(a, b), _edge_crosses(a, b)])
    gaps = gaps_along(a, b, every).max(axis=0)
    hulls = (a.solids.hulls >= 0) | (b.solids.hulls >= 0)
    if not hulls.any():
        return np.asarray(np.maximum(gaps, _projected(a, b)))
    plain = np.flatnonzero(~hulls)
    gaps[plain] = np.maximum(gaps[plain], _projected(a.take(plain), b.take(plain)))
    for row in np.flatnonzero(hulls).tolist():
        first = a.solids.one(row, a.R[row], a.t[row])
        second = b.solids.one(row, b.R[row], b.t[row])
        gaps[row] = max(float(gaps[row]), gap_of(first, second))
    return np.asarray(gaps)


def _projected(a: Placed, b: Placed) -> FloatArray:
    """Gaps along lines between nearest points, found by projecting onto a and b in turn (Cheney & Goldstein 1959)."""
    best = np.full(len(a.t), -np.inf)
    on_a = a.t
    for _ in range(_PROJECTIONS):
        on_b, before = b.nearest(on_a), on_a
        on_a = a.nearest(on_b)
        best = np.maximum(best, gaps_along(a, b, on_b - on_a))
        if np.array_equal(on_a, before):  # so are all that would follow: mostly solids that overlap
            break
    return np.asarray(best)
