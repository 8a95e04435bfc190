"""Hulls of corners, many at once: how far they extend, and the steps of the walk to the nearest points of two.

All arithmetic is elementwise and in one fixed order; of several corners equally far the first one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from planner_service.certify.native.loading import load_proof
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from planner_service.certify.native import _proof

__all__ = ["Corners", "dot", "nearest_of"]


AT_ONCE = 50_000
"""Numbers in a temporary array, so that it stays in a processor's cache."""

GAIN = 1e-8
"""Metres between a bound and the nearest point found so far at which the walk ends."""

SHARE = 1e-3
"""Of the gap: so much tightness is not worth another step, for the proof or its report."""

THIN = 1e-12
"""Squared sine of an angle between two edges: equal or aligned points span no face."""

TINY = 1e-30
"""Squared metres: a shorter vector is none."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Which of p solids are hulls, and of what.

    Attributes:
        rows: For each solid the number of its hull, or -1, (p,).
        table: The corners of each hull about its centre, (3, hulls, v), the first repeated where there are fewer.
        radii: The distance of the farthest corner from the centre, for each hull.
        compiled: What says how far they extend.
    """

    rows: IntArray
    table: FloatArray
    radii: FloatArray
    compiled: _proof.Hulls

    @classmethod
    def of(cls, clouds: Sequence[FloatArray | None]) -> Corners | None:
        """From the corners (3, v) of each solid, None for one that is no hull; None if none is."""
        hulls = [cloud for cloud in clouds if cloud is not None]
        if not hulls:
            return None
        is_hull = np.array([cloud is not None for cloud in clouds])
        rows = np.where(is_hull, np.cumsum(is_hull) - 1, -1)
        most = max(cloud.shape[1] for cloud in hulls)
        padded = [np.concatenate([cloud, np.repeat(cloud[:, :1], most - cloud.shape[1], axis=1)], 1) for cloud in hulls]
        x, y, z = table = np.stack(padded, axis=1)
        own = [np.ascontiguousarray(cloud.T) for cloud in hulls]
        return cls(rows, table, np.sqrt((x * x + y * y + z * z).max(axis=-1)), load_proof().Hulls(own))

    def take(self, rows: IntArray) -> Corners:
        """The solids at ``rows``."""
        return replace(self, rows=self.rows[rows])

    def clouds(self) -> list[FloatArray]:
        """The corners (v, 3) of each hull, each once."""
        hulls = []
        for cloud in self.table.transpose(1, 2, 0):
            other = np.flatnonzero((cloud != cloud[0]).any(axis=1))
            hulls.append(np.ascontiguousarray(cloud[: 1 + other.max(initial=0)]))
        return hulls

    def extended(self, n: FloatArray, values: FloatArray) -> FloatArray:
        """Support values along n (..., 3, p) in local axes, (..., p): those of hulls put into ``values``."""
        if values.size == 0:  # how many directions there were cannot be told from that
            return values
        heights = np.array(values.reshape(-1, values.shape[-1]), order="C")
        self.compiled.extend(np.ascontiguousarray(n.reshape(-1, *n.shape[-2:])), self.rows, heights)
        return heights.reshape(values.shape)

    def farthest(self, n: FloatArray, points: FloatArray) -> FloatArray:
        """Corners farthest along n (3, p), (3, p): those of hulls put into ``points``."""
        columns = np.flatnonzero(self.rows >= 0)
        step = max(1, AT_ONCE // self.table.shape[2])
        for some in (columns[k : k + step] for k in range(0, len(columns), step)):
            d, cloud = n[:, some, None], self.table[:, self.rows[some]]
            best = (d[0] * cloud[0] + d[1] * cloud[1] + d[2] * cloud[2]).argmax(axis=-1)
            points[:, some] = self.table[:, self.rows[some], best]
        return points

    def reaching(self, distances: FloatArray) -> FloatArray:
        """Distances of the farthest points from the centres, (p,): those of hulls put into ``distances``."""
        return np.where(self.rows >= 0, self.radii[self.rows], distances)


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products of vectors (..., 3, p), (..., p)."""
    return np.asarray(a[..., 0, :] * b[..., 0, :] + a[..., 1, :] * b[..., 1, :] + a[..., 2, :] * b[..., 2, :])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    (x, y, z), (u, v, w) = (np.moveaxis(item, -2, 0) for item in (a, b))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-2)


def nearest_of(kept: FloatArray, new: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The point nearest to the origin of the hull of ``kept`` (3, 3, p) and ``new`` (3, p), on a face with ``new``.

    Returns:
        The point (3, p), three points whose hull has it (some of them equal), and whether the origin is outside.
    """
    news = np.broadcast_to(new, kept.shape)
    one, two, third = kept, kept[[1, 2, 0]], kept[[2, 0, 1]]
    e = one - new
    f = e[[1, 2, 0]]
    square = dot(e, e)
    share = np.minimum(np.maximum(-dot(e, new) / np.maximum(square, TINY), 0.0), 1.0)
    on_edge = new + share[:, None] * e
    normal = _cross(e, f)
    area, height = dot(normal, normal), dot(normal, new)
    on_face = (height / np.maximum(area, TINY * TINY))[:, None] * normal
    within = (dot(_cross(e, normal), new) >= 0.0) & (dot(_cross(normal, f), new) >= 0.0)
    within &= dot(_cross(two - one, normal), one) >= 0.0
    within &= area > THIN * square * square[[1, 2, 0]]
    far = np.concatenate([dot(on_edge, on_edge), np.where(within, dot(on_face, on_face), np.inf)])
    outside = (dot(normal, third - new) * -height <= 0.0).any(axis=0)  # of a face with ``new``
    base = _cross(kept[1] - kept[0], kept[2] - kept[0])
    outside |= dot(base, new - kept[0]) * -dot(base, kept[0]) <= 0.0
    best, columns = far.argmin(axis=0), np.arange(new.shape[1])
    points = np.concatenate([on_edge, on_face])
    spans = np.concatenate([np.stack([news, news, one], axis=1), np.stack([news, one, two], axis=1)])
    return points[best, :, columns].T, spans[best, :, :, columns].transpose(1, 2, 0), outside
