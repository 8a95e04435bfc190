"""Proven gaps between convex solids, for many pairs at once, without FCL.

Every solid here is the Minkowski sum of a box, a ball and a disc about local z, so it is
centrally symmetric and its support function has a closed form. For any unit direction d the
value ``|d . (b - a)| - h_a(d) - h_b(d)`` is a lower bound of the signed gap between two solids at
a and b; whatever suggests the direction, the bound holds (separating axis theorem). A positive
bound proves a pair apart; a negative one bounds its overlap from above.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import BrokenInvariant
from planner_service.geometry import Box, Capsule, Cylinder, FloatArray, Shape, Sphere

__all__ = ["Placed", "Solids", "box_of", "gaps_along", "refined_gaps", "rough_gaps"]

_PROJECTIONS = 60
"""Alternating projections converge slowly near contact; this many find the gap to micrometres elsewhere."""

IntArray = NDArray[np.intp]

_TINY = 1e-12
"""Directions shorter than this are no directions (parallel edges have no cross product)."""


@dataclass(frozen=True, eq=False)
class Solids:
    """Shapes as arrays: box half lengths (p, 3), ball radii (p,) and disc radii (p,)."""

    half: FloatArray
    ball: FloatArray
    disc: FloatArray

    @classmethod
    def of(cls, shapes: Sequence[Shape]) -> Solids:
        """The solids of shapes, in their order."""
        half = np.zeros((len(shapes), 3))
        ball, disc = np.zeros(len(shapes)), np.zeros(len(shapes))
        for k, shape in enumerate(shapes):
            if isinstance(shape, Box):
                half[k] = shape.half
            elif isinstance(shape, Sphere):
                ball[k] = shape.radius
            elif isinstance(shape, Capsule):
                half[k, 2], ball[k] = shape.length / 2, shape.radius
            elif isinstance(shape, Cylinder):
                half[k, 2], disc[k] = shape.length / 2, shape.radius
            else:
                raise BrokenInvariant(f"no bound for a {type(shape).__name__}")
        return cls(half, ball, disc)

    def take(self, rows: IntArray) -> Solids:
        """The solids at ``rows``."""
        return Solids(self.half[rows], self.ball[rows], self.disc[rows])

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
    v = b.R.transpose(2, 0, 1)[None]
    cross = np.stack(
        [
            u[..., 1] * v[..., 2] - u[..., 2] * v[..., 1],
            u[..., 2] * v[..., 0] - u[..., 0] * v[..., 2],
            u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0],
        ],
        axis=-1,
    )
    return cross.reshape(9, len(a.t), 3)


def rough_gaps(a: Placed, b: Placed) -> FloatArray:
    """Quick lower bounds of the gaps between pairs of solids, (p,): the line of centres and the face normals."""
    return np.asarray(gaps_along(a, b, _axes(a, b)).max(axis=0))


def refined_gaps(a: Placed, b: Placed) -> FloatArray:
    """The tightest lower bounds this module can prove, (p,): every separating axis, then alternating projections.

    Exact for two boxes that overlap.
    """
    every = np.concatenate([_axes(a, b), _edge_crosses(a, b)])
    return np.asarray(np.maximum(gaps_along(a, b, every).max(axis=0), _projected(a, b)))


def _projected(a: Placed, b: Placed) -> FloatArray:
    """Gaps along lines between nearest points, found by projecting onto a and b in turn (Cheney & Goldstein 1959)."""
    best = np.full(len(a.t), -np.inf)
    on_a = a.t
    for _ in range(_PROJECTIONS):
        on_b = b.nearest(on_a)
        on_a = a.nearest(on_b)
        best = np.maximum(best, gaps_along(a, b, on_b - on_a))
    return np.asarray(best)
