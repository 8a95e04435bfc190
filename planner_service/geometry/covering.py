"""Growing convex pieces until they contain a mesh: its surface by triangles, proven; its inside along lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle

import numpy as np

from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, along, blocks
from planner_service.geometry.mesh import Mesh

__all__ = ["SLACK", "covering", "longest_gap", "slack"]

SLACK = 1e-4
"""Relative to the size of a mesh; coacd moves points by up to half of this."""

ROUNDING = 1e-12
"""Relative to the size of a mesh: how far a piece reaches beyond a point, so that rounding does not exclude it."""

LANKY = 10.0
"""Length over thickness up to which a piece is scaled by one factor in every direction."""

MAX_WORK = 500_000
"""Parts of triangles that are divided; pieces cut by planes need about ten for each triangle that a plane crosses."""

MOST_LINES, LEAST_LINES = 100, 5
CROSSINGS = 20_000_000
"""Lines along each axis, and pairs of a line and a triangle that are tested for a crossing."""


def slack(vertices: FloatArray) -> float:
    """Metres that are negligible on a mesh: a ten-thousandth of the longest edge of its bounding box."""
    return SLACK * float((vertices.max(axis=0) - vertices.min(axis=0)).max())


def covering(pieces: Sequence[Mesh], vertices: FloatArray, faces: IntArray) -> tuple[Mesh, ...]:
    """The pieces, grown just enough that together they contain every triangle.

    A convex piece that contains the corners of a triangle contains the triangle. A triangle whose corners are in
    different pieces is divided where it leaves one of them, and so on. Points at most ``slack`` above the faces of a
    piece count as inside; at the end each piece grows by the largest such height. A corner that is in no piece is added
    to the nearest one, and so are the corners of a part that is smaller than ``slack`` and not inside one piece.

    A piece grows by less than 11 times ``slack``, a thousandth of the size of the mesh, plus the distance of the
    farthest corner that was added to it.

    Args:
        pieces: At least one.
        faces: Triangles (t, 3) as rows of ``vertices`` (n, 3).

    Raises:
        InvalidRequest: a piece would have too many corners.
    """
    return _Cover(pieces, vertices, faces).pieces()


class _Cover:
    """Triangles not yet known to be inside, as rows of ``points``; column k of ``heights`` belongs to piece k."""

    def __init__(self, pieces: Sequence[Mesh], vertices: FloatArray, faces: IntArray) -> None:
        self._given, self._pieces = tuple(pieces), list(pieces)
        self._slack = slack(vertices)
        self._short = np.full(len(pieces), self._slack * ROUNDING / SLACK)
        used, rows = np.unique(faces, return_inverse=True)
        self._points = vertices[used]
        self._rest = rows.reshape(-1, 3)
        self._heights = self._all_heights(self._points)

    def pieces(self) -> tuple[Mesh, ...]:
        work = 0
        for halving in cycle((False, True)):  # else cuts might creep along a triangle in ever smaller steps
            self._add_lost_corners()
            above = self._heights[self._rest].max(axis=1)
            nearest, least = above.argmin(axis=1), above.min(axis=1)
            held = least <= self._slack
            np.maximum.at(self._short, nearest[held], least[held] + self._slack * ROUNDING / SLACK)
            rest, nearest = self._rest[~held], nearest[~held]
            if len(rest) == 0:
                return tuple(_larger(piece, short) for piece, short in zip(self._pieces, self._short, strict=True))
            work += len(rest)
            whole = (self._edge_lengths(rest).max(axis=1) <= self._slack) | (work > MAX_WORK)
            self._add(rest[whole], nearest[whole])
            self._divide(rest[~whole], halving)
        raise BrokenInvariant("parts of triangles without end")

    def _all_heights(self, points: FloatArray) -> FloatArray:
        return np.stack([_heights(piece, points, self._slack) for piece in self._pieces], axis=-1)

    def _edge_lengths(self, triangles: IntArray) -> FloatArray:
        """Of the edges from each corner to the next, (m, 3)."""
        edges = self._points[np.roll(triangles, -1, axis=1)] - self._points[triangles]
        x, y, z = (edges[..., k] for k in range(3))
        return np.asarray(np.sqrt(x * x + y * y + z * z))

    def _add_lost_corners(self) -> None:
        lost = np.flatnonzero((self._heights > self._slack).all(axis=1))
        if len(lost):  # to the piece that was nearest at the start, so that none grows farther than that
            away = np.stack([piece.distance(self._points[lost]) for piece in self._given], axis=-1)
            self._add(lost, away.argmin(axis=1))

    def _add(self, rows: IntArray, where: IntArray) -> None:
        """Add the points ``rows[i]`` to piece ``where[i]``."""
        for k in np.unique(where).tolist():
            more = self._points[np.unique(rows[where == k])]
            self._pieces[k] = Mesh(np.concatenate([self._pieces[k].vertices, more]))
            self._heights[:, k] = _heights(self._pieces[k], self._points, self._slack)

    def _divide(self, triangles: IntArray, halving: bool) -> None:
        """Cut each triangle in two: where an edge leaves the piece with most corners, or at half the longest edge."""
        inside = self._heights[triangles] <= self._slack
        piece = inside.sum(axis=1).argmax(axis=1)
        within = np.take_along_axis(inside, piece[:, None, None], axis=2)[..., 0]
        lengths = self._edge_lengths(triangles)
        leaves = within != np.roll(within, -1, axis=1)
        edge = np.where(leaves, lengths, -1.0).argmax(axis=1)
        share = self._exits(triangles, edge, piece, within)
        length = np.take_along_axis(lengths, edge[:, None], axis=1)[:, 0]
        useless = halving | (np.minimum(share, 1.0 - share) * length < self._slack / 4.0)
        edge = np.where(useless, lengths.argmax(axis=1), edge)
        share = np.where(useless, 0.5, share)
        start, end, other = (np.take_along_axis(triangles, (edge[:, None] + k) % 3, axis=1)[:, 0] for k in range(3))
        a, b = self._points[start], self._points[end]
        cuts = a + share[:, None] * (b - a)
        fresh = len(self._points) + np.arange(len(cuts))
        halves = np.concatenate([np.stack([start, fresh, other], axis=1), np.stack([fresh, end, other], axis=1)])
        points = np.concatenate([self._points, cuts])
        heights = np.concatenate([self._heights, self._all_heights(cuts)])
        used, rows = np.unique(halves, return_inverse=True)
        self._points, self._heights, self._rest = points[used], heights[used], rows.reshape(-1, 3)

    def _exits(self, triangles: IntArray, edge: IntArray, piece: IntArray, within: BoolArray) -> FloatArray:
        """Where each edge leaves the piece that contains only one of its ends, as a share of its length."""
        ends = np.stack([np.take_along_axis(triangles, (edge[:, None] + k) % 3, axis=1)[:, 0] for k in (0, 1)], axis=1)
        forwards = np.take_along_axis(within, edge[:, None], axis=1)[:, 0]
        share = np.zeros(len(edge))
        for k in np.unique(piece).tolist():
            mine = piece == k
            outwards = np.where(forwards[mine][:, None], ends[mine], ends[mine][:, ::-1])
            share[mine] = _exit(self._pieces[k], *self._points[outwards.T])
        return np.where(forwards, share, 1.0 - share)


def _larger(piece: Mesh, margin: float) -> Mesh:
    """A piece that contains all points up to ``margin`` above the faces of this one, and none beyond 10 times that.

    With c inside and r above none of the faces, scaling about c by 1 + margin / r moves each face out by the margin or
    more, and no corner R from c by more than margin R / r. Unless R / r is large this keeps the number of corners.
    """
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    centre = 0.5 * (low + high)
    out = piece.vertices - centre
    inner = -float(_above(piece, centre[None]).max())
    outer = math.sqrt(float((out[:, 0] * out[:, 0] + out[:, 1] * out[:, 1] + out[:, 2] * out[:, 2]).max()))
    if inner <= 0.0 or outer > LANKY * inner:
        return piece.grown(margin)
    return Mesh(centre + out * (1.0 + margin / inner))


def _heights(piece: Mesh, points: FloatArray, most: float) -> FloatArray:
    """How far each point is above the faces; beyond ``most`` a lower bound of its distance."""
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    heights = np.maximum(low - points, points - high).max(axis=1)
    near = np.flatnonzero(heights <= most)
    for rows in blocks(len(near), len(piece.normals)):
        heights[near[rows]] = _above(piece, points[near[rows]]).max(axis=1)
    return np.asarray(heights)


def _above(piece: Mesh, points: FloatArray) -> FloatArray:
    """Heights of points (n, 3) above the faces, (n, f)."""
    return along(piece.normals, points) - piece.offsets


def _exit(piece: Mesh, inner: FloatArray, outer: FloatArray) -> FloatArray:
    """The share of each segment, from its inner end, that lies in the piece."""
    share = np.ones(len(inner))
    for rows in blocks(len(inner), len(piece.normals)):
        low, high = _above(piece, inner[rows]), _above(piece, outer[rows])
        rises = (high > 0.0) & (high > low)
        gone = np.maximum(-low, 0.0) / np.where(rises, high - low, 1.0)
        share[rows] = np.minimum(np.where(rises, gone, 1.0).min(axis=1), 1.0)
    return share


def longest_gap(pieces: Sequence[Mesh], vertices: FloatArray, faces: IntArray) -> float:
    """Metres of the longest stretch inside a closed mesh but in no piece, on up to 100 lines along each axis.

    Inside is where the triangles wind around a point, in either sense. The lines are spread evenly and are the same
    for equal meshes; a line that meets an edge is skipped.
    """
    many = max(LEAST_LINES, min(MOST_LINES, CROSSINGS // (3 * len(faces))))
    low, size = vertices.min(axis=0), vertices.max(axis=0) - vertices.min(axis=0)
    gap = 0.0
    for axis in range(3):
        turned = [(axis + 1) % 3, (axis + 2) % 3, axis]
        corners = vertices[:, turned][faces]
        planes = [(piece.normals[:, turned], piece.offsets) for piece in pieces]
        for k in range(1, many + 1):  # the plastic number spreads points over a square (Roberts, 2018)
            x, y = (
                float(low[turned[i]] + size[turned[i]] * (k * step % 1.0))
                for i, step in enumerate((0.7548776662466927, 0.5698402909980532))
            )
            solid = _solid_stretches(corners, x, y)
            held = sorted(filter(None, (_held_stretch(normals, offsets, x, y) for normals, offsets in planes)))
            gap = max([gap, *(_gap(start, end, held) for start, end in solid)])
    return gap


def _solid_stretches(corners: FloatArray, x: float, y: float) -> list[tuple[float, float]]:
    """Where the line along z at (x, y) is inside the triangles (t, 3, 3); none if it meets an edge."""
    near = (corners[..., :2].min(axis=1) <= (x, y)).all(axis=1) & (corners[..., :2].max(axis=1) >= (x, y)).all(axis=1)
    px, py, pz = (corners[near][..., k] for k in range(3))
    qx, qy = (np.roll(p, -1, axis=1) for p in (px, py))
    turn = (px - x) * (qy - y) - (py - y) * (qx - x)  # twice the area left of each edge: the weight of the third corner
    sense = np.where((turn > 0.0).all(axis=1), 1, 0) - np.where((turn < 0.0).all(axis=1), 1, 0)
    if np.any((sense == 0) & ((turn >= 0.0).all(axis=1) | (turn <= 0.0).all(axis=1))):
        return []
    hit = sense != 0
    t, z = turn[hit], pz[hit]
    heights = (t[:, 1] * z[:, 0] + t[:, 2] * z[:, 1] + t[:, 0] * z[:, 2]) / (t[:, 0] + t[:, 1] + t[:, 2])
    order = np.argsort(heights, kind="stable")
    levels, winding = heights[order], np.cumsum(sense[hit][order])
    return [(float(levels[k]), float(levels[k + 1])) for k in np.flatnonzero(winding[:-1]).tolist()]


def _held_stretch(normals: FloatArray, offsets: FloatArray, x: float, y: float) -> tuple[float, float] | None:
    """Where the line along z at (x, y) is in a piece."""
    room = offsets - normals[:, 0] * x - normals[:, 1] * y
    up = normals[:, 2]
    if np.any((up == 0.0) & (room < 0.0)):
        return None
    level = room / np.where(up == 0.0, 1.0, up)
    start = float(np.where(up < 0.0, level, -np.inf).max())
    end = float(np.where(up > 0.0, level, np.inf).min())
    return (start, end) if start <= end else None


def _gap(start: float, end: float, held: Sequence[tuple[float, float]]) -> float:
    """The longest part of a stretch that is outside the sorted stretches ``held``."""
    gap, at = 0.0, start
    for low, high in held:
        gap = max(gap, min(low, end) - at)
        at = max(at, min(high, end))
    return max(gap, end - at)
