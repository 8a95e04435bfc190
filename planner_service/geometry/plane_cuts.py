"""Cutting a solid by planes, and hulls of its parts that together contain it by construction.

Let S be the solid: its surface, and all points around which the triangles of one of its bodies wind. A body is what
shared edges connect, its triangles turned alike; so bodies that overlap do not cancel each other, nor does a triangle
that a file has the wrong way round, and a cavity counts as solid. Planes cut space into convex cells. The
part of S in a cell C lies in the hull of two kinds of points: those of the surface in C, and the corners of C that are
in S. For the part of S in C is closed and bounded, so it lies in the hull of its extreme points (Minkowski). Such a
point that is not on the surface has a neighbourhood in S; if it were not a corner of C, a segment around it would lie
in C and in S, and it would be no extreme point. A triangle in C is in turn the hull of its corners, and of the points
where its sides cross the planes. So nothing has to be sampled, and no choice of planes makes the hulls too small: only
how tight they are depends on it.

Computed crossings are within rounding of the true ones (1e-15 of the size of the mesh, of which ``Mesh`` itself allows
1e-9).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, along, blocks, cross

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

__all__ = ["Cut", "CutPlan", "parts_of", "plan_cuts", "signed_volume"]

R = math.sqrt(0.5)
DIRECTIONS = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [R, R, 0], [R, -R, 0], [R, 0, R], [R, 0, -R], [0, R, R], [0, R, -R]],
    dtype=np.float64,
)
"""Normals of cutting planes: links are drawn along the axes of their frames, and bend at half right angles."""

OFFSETS, SHOULDERS = 12, 3
"""Planes tried along each direction: evenly spread, and beside where most of the surface is at a right angle to it."""
LEVEL, BESIDE = 1e-3, 1e-4
"""Relative to the size of a mesh: triangles are at a right angle to a direction if they are no higher than the first;
planes are tried that far on both sides, as what lies in a plane is in both of the parts."""
POINTS, FEW = 400, 100
"""Of the surface of a part, about, with which planes are tried: first with few, then with more, at last with all."""
PROMISING, RETRIED = 48, 6
"""How many planes are tried with more points, and with all, the most promising ones."""
MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)
"""Odd numbers that look like drawn ones."""
LINES = 24
"""Lines along the longest side of a mesh, on which its inside is looked for."""

GAIN = 0.02
"""Part of the hull's volume that a cut has to free, and that joining two parts may fill again."""
SPARE = 2
"""How many times as many parts are cut as are wanted, and then joined: cuts that help little help the next ones."""

NEAR = 1e-9
"""Relative to the size of a mesh, far above rounding: a corner that near to the surface counts as inside."""
WOUND = 0.25
"""Turns around a point from which on it counts as inside: 1 or more in a closed solid, 0 outside."""


@dataclass(frozen=True)
class Cut:
    """A plane through one part: what is above it becomes a new part, the last one.

    Attributes:
        part: Which of the parts so far.
        direction: The row of ``DIRECTIONS`` that is its normal.
        offset: Its points are at this height along the normal, in metres.
    """

    part: int
    direction: int
    offset: float


@dataclass(frozen=True)
class CutPlan:
    """How a mesh is cut: first by planes, then some parts are joined again.

    Attributes:
        groups: Each part in one of them; the hull of a group is a piece.
    """

    cuts: tuple[Cut, ...] = ()
    groups: tuple[tuple[int, ...], ...] = ((0,),)


def parts_of(vertices: FloatArray, faces: IntArray, plan: CutPlan) -> list[FloatArray]:
    """Points (k, 3) for each group of a plan, whose hulls together contain the mesh, inside included; some twice.

    Args:
        faces: Triangles (t, 3) as rows of ``vertices`` (n, 3).
    """
    faces, bodies = _turned_alike(faces)
    corners = vertices[faces]
    size = _size(vertices)
    parts = [_Part(corners)]
    for cut in plan.cuts:
        below, above = parts[cut.part].cut(cut.direction, cut.offset)
        parts[cut.part] = below
        parts.append(above)
    points = [np.concatenate([part.triangles.reshape(-1, 3), _inner(part, corners, bodies, size)]) for part in parts]
    return [np.concatenate([points[k] for k in group]) for group in plan.groups]


@dataclass(frozen=True, eq=False)
class _Part:
    """The triangles (m, 3, 3) of a mesh in a cell, and the planes that bound this, as (direction, sign, offset)."""

    triangles: FloatArray
    planes: tuple[tuple[int, float, float], ...] = ()
    inner: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    """Points inside the mesh, to try planes with."""

    @cached_property
    def points(self) -> FloatArray:
        """Its inner points and the corners of its triangles, about each of them once: its hull is theirs."""
        corners = np.ascontiguousarray(self.triangles.reshape(-1, 3))
        bits = corners.view(np.uint64)
        keys = ((bits ^ (bits >> 29)) * MIXED).sum(axis=1)  # of equal rows equal, and hardly of others
        return np.concatenate([corners[np.unique(keys, return_index=True)[1]], self.inner])

    @cached_property
    def volume(self) -> float:
        """Of the hull of its points."""
        return _volume(self.points)

    def cut(self, direction: int, offset: float) -> tuple[_Part, _Part]:
        """What is below a plane, and what is above it; what is on it is in both."""
        heights = _along(self.triangles, direction) - offset
        inside = _along(self.inner, direction) - offset
        sides = []
        for sign in (1.0, -1.0):
            triangles = _clipped(self.triangles, sign * heights)
            planes = (*self.planes, (direction, sign, sign * offset))
            sides.append(_Part(triangles, planes, self.inner[sign * inside <= 0.0]))
        return sides[0], sides[1]


def _along(points: FloatArray, direction: int) -> FloatArray:
    """Heights (...) of points (..., 3), with the same bits on every machine."""
    x, y, z = DIRECTIONS[direction].tolist()
    return np.asarray(points[..., 0] * x + points[..., 1] * y + points[..., 2] * z)


def _clipped(triangles: FloatArray, heights: FloatArray) -> FloatArray:
    """What of triangles (m, 3, 3) is where ``heights`` (m, 3) are not positive: triangles, or two for a quadrangle."""
    below = heights <= 0.0
    many = below.sum(axis=1)
    found = [triangles[many == 3]]
    for one in (True, False):
        crossing = many == (1 if one else 2)
        lone = (below[crossing] == one).argmax(axis=1)
        order = (lone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(triangles[crossing], order[..., None], axis=1), 1, 0)
        h, i, j = np.take_along_axis(heights[crossing], order, axis=1).T
        ab, ac = a + (h / (h - i))[:, None] * (b - a), a + (h / (h - j))[:, None] * (c - a)
        found += [np.stack(each, axis=1) for each in ([(a, ab, ac)] if one else [(ab, b, c), (ab, c, ac)])]
    return np.concatenate(found)


def _inner(part: _Part, corners: FloatArray, bodies: IntArray, size: float) -> FloatArray:
    """The corners of a part's cell that are inside the bodies (t,) of triangles (t, 3, 3), (k, 3)."""
    normals = np.array([sign * DIRECTIONS[direction] for direction, sign, _ in part.planes]).reshape(-1, 3)
    offsets = np.array([offset for _, _, offset in part.planes])
    triples = np.array(list(combinations(range(len(offsets)), 3)), dtype=np.intp).reshape(-1, 3)
    N = normals[triples]
    determinants = (N[:, 0] * cross(N[:, 1], N[:, 2])).sum(axis=-1)
    meeting = np.abs(determinants) > 0.1  # of these directions it is 0, or more than 0.3
    N, s, determinants = N[meeting], offsets[triples[meeting]], determinants[meeting]
    products = [cross(N[:, k - 2], N[:, k - 1]) * s[:, k, None] for k in range(3)]
    points = (products[0] + products[1] + products[2]) / determinants[:, None]
    points = points[(along(points, normals) - offsets[:, None] <= NEAR * size).all(axis=0)] if len(points) else points
    points = np.unique(points, axis=0)
    return np.asarray(points[_are_inside(points, corners, bodies, NEAR * size)])


def _turned_alike(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles (t, 3) turned so that neighbours go along their common edge in opposite ways, and their bodies (t,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    count = len(faces)
    ways = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    owners = np.tile(np.arange(count), 3)
    _, edge, many = np.unique(np.sort(ways, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.reshape(-1), kind="stable")
    pairs = order[np.cumsum(many)[many == 2][:, None] - np.array([2, 1])]
    one, two = owners[pairs].T
    against = (ways[pairs[:, 0]] == ways[pairs[:, 1]]).all(axis=1)
    graph = coo_array((np.ones(len(one)), (one, two)), (count, count)).tocsr()
    bodies = connected_components(graph, directed=False)[1]
    if not against.any():
        return faces, bodies
    turns = {(a, b): turn for a, b, turn in zip(one.tolist(), two.tolist(), against.tolist(), strict=True)}
    turned = np.zeros(count, dtype=np.bool_)
    for start in np.unique(bodies, return_index=True)[1].tolist():
        nodes, before = breadth_first_order(graph, start, directed=False)
        for node in nodes[1:].tolist():
            last = int(before[node])
            turned[node] = turned[last] ^ (turns.get((node, last), False) or turns.get((last, node), False))
    return np.where(turned[:, None], faces[:, ::-1], faces), bodies


def _are_inside(points: FloatArray, corners: FloatArray, bodies: IntArray, near: float) -> BoolArray:
    """Whether bodies (t,) of triangles (t, 3, 3) wind around each point (k, 3), or one of these may be near it.

    The solid angle of a triangle is that of van Oosterom & Strackee (IEEE Trans. Biomed. Eng. 30(2), 1983).
    """
    inside = np.zeros(len(points), dtype=np.bool_)
    for k, point in enumerate(points):
        turns, close = np.zeros(int(bodies.max(initial=-1)) + 1), False
        for rows in blocks(len(corners), 30):
            a, b, c = np.moveaxis(corners[rows] - point, 1, 0)
            la, lb, lc = (np.sqrt((e * e).sum(axis=-1)) for e in (a, b, c))
            volume = (a * cross(b, c)).sum(axis=-1)
            rest = la * lb * lc + (a * b).sum(axis=-1) * lc + (b * c).sum(axis=-1) * la + (c * a).sum(axis=-1) * lb
            turns += np.bincount(bodies[rows], np.arctan2(volume, rest), len(turns)) / (2.0 * math.pi)
            low, high = corners[rows].min(axis=1) - near, corners[rows].max(axis=1) + near
            boxed = ((low <= point) & (point <= high)).all(axis=-1)
            normal = cross(b - a, c - a)
            close |= bool((boxed & (np.abs(volume) <= near * np.sqrt((normal * normal).sum(axis=-1)))).any())
        inside[k] = close or float(np.abs(turns).sum()) >= WOUND
    return inside


def signed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """The enclosed volume, negative if triangles face inwards: tetrahedra from one corner, added up exactly."""
    (a, b, c), (d, e, f), (g, h, i) = (vertices[faces[:, k]].T - vertices[0][:, None] for k in range(3))
    return math.fsum((a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)).tolist()) / 6.0


def plan_cuts(vertices: FloatArray, faces: IntArray, most: int) -> CutPlan:
    """Cuts after which the hulls of at most ``most`` groups of parts have little volume together.

    The part whose best cut frees most is cut, until there are enough parts or none frees ``GAIN`` of the hull; then
    parts are joined whose common hull fills least, while that is less than ``GAIN`` or there are too many.
    """
    corners, size = vertices[faces], _size(vertices)
    parts = [_Part(corners, inner=_points_inside(corners, size))]
    least = GAIN * parts[0].volume
    best = [_best_split(parts[0], least, size)]
    cuts: list[Cut] = []
    while len(parts) < SPARE * most:
        k = max(range(len(parts)), key=lambda k: best[k].gain)
        split = best[k]
        if split.gain < least:
            break
        cuts.append(Cut(k, split.direction, split.offset))
        parts[k], more = split.sides
        parts.append(more)
        best[k] = _best_split(parts[k], least, size)
        best.append(_best_split(more, least, size))
    groups = _joined([part.points for part in parts], most, least)
    return CutPlan(tuple(cuts), tuple(groups))


def _joined(points: Sequence[FloatArray], most: int, least: float) -> list[tuple[int, ...]]:
    """Groups of parts, of which two are joined as long as that fills little or there are too many."""
    groups: list[tuple[int, ...]] = [(k,) for k in range(len(points))]
    hulls = [_hull(each) for each in points]
    losses: dict[tuple[tuple[int, ...], tuple[int, ...]], float] = {}
    while len(groups) > 1:
        for i, j in combinations(range(len(groups)), 2):
            if (groups[i], groups[j]) not in losses:
                both = _hull(np.concatenate([hulls[i][1], hulls[j][1]]))
                losses[groups[i], groups[j]] = both[0] - hulls[i][0] - hulls[j][0]
        i, j = min(combinations(range(len(groups)), 2), key=lambda pair: losses[groups[pair[0]], groups[pair[1]]])
        if len(groups) <= most and losses[groups[i], groups[j]] > least:
            break
        both = _hull(np.concatenate([hulls[i][1], hulls[j][1]]))
        groups[i], hulls[i] = (*groups[i], *groups[j]), both
        del groups[j], hulls[j]
    return groups


@dataclass(frozen=True, eq=False)
class _Split:
    """A plane through a part, what is below it and above, and how much smaller their hulls are together."""

    gain: float
    direction: int
    offset: float
    sides: tuple[_Part, _Part]


def _best_split(part: _Part, least: float, size: float) -> _Split:
    """The cut of a part that frees most; one that frees nothing if there is none, or if all of the part is less."""
    best = _Split(0.0, 0, 0.0, (part, part))
    if part.volume < least:
        return best
    thinned, step = _thinned(part)
    few = _apart(thinned, math.sqrt(POINTS / FEW) * step)
    tried = []
    for direction in range(len(DIRECTIONS)):
        heights = _along(thinned, direction)
        low, high = float(heights.min(initial=np.inf)), float(heights.max(initial=-np.inf))
        spread = [low + (high - low) * k / (OFFSETS + 1) for k in range(1, OFFSETS + 1)]
        tried += [(direction, offset) for offset in (*spread, *_shoulders(part, direction, size))]
    for points, left in ((few, PROMISING), (thinned, RETRIED)):
        sums = list[tuple[float, int, float]]()
        for direction, offset in tried:
            lower = _along(points, direction) < offset
            sides = [_volume(points[lower]), _volume(points[~lower])]
            if min(sides) > 0.0:
                sums.append((sum(sides), direction, offset))
        tried = [(direction, offset) for _, direction, offset in sorted(sums)[:left]]
    for direction, offset in tried:
        below, above = part.cut(direction, offset)
        gain = part.volume - (below.volume + above.volume)
        if min(below.volume, above.volume) > 0.0 and gain > best.gain:
            best = _Split(gain, direction, offset, (below, above))
    return best


def _shoulders(part: _Part, direction: int, size: float) -> list[float]:
    """Heights along a direction beside large parts of the surface that are at a right angle to it."""
    heights = _along(part.triangles, direction)
    flat = np.ptp(heights, axis=1) <= LEVEL * size
    a, b, c = np.moveaxis(part.triangles[flat], 1, 0)
    normal = cross(b - a, c - a)
    numbers, first, group = np.unique(
        np.round(heights[flat][:, 0] / (2.0 * LEVEL * size)), return_index=True, return_inverse=True
    )
    areas = np.bincount(group, np.sqrt((normal * normal).sum(axis=-1)), len(numbers))
    middles = heights[flat][first[np.argsort(-areas, kind="stable")[:SHOULDERS]], 0].tolist()
    return [middle + side * BESIDE * size for middle in middles for side in (-1.0, 1.0)]


def _volume(points: FloatArray) -> float:
    """The volume of the hull of points, 0 if it is flat."""
    hull = _hull_of(points)
    return 0.0 if hull is None else float(hull.volume)


def _hull(points: FloatArray) -> tuple[float, FloatArray]:
    """The volume of the hull of points, 0 if it is flat, and its corners."""
    hull = _hull_of(points)
    return (0.0, points) if hull is None else (float(hull.volume), points[hull.vertices])


def _hull_of(points: FloatArray) -> ConvexHull | None:
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return None
    try:
        return ConvexHull(points)
    except QhullError:
        return None


def _size(vertices: FloatArray) -> float:
    return float((vertices.max(axis=0) - vertices.min(axis=0)).max())


def _thinned(part: _Part) -> tuple[FloatArray, float]:
    """Points on the sides of triangles and inside, about as far from each other everywhere, and how far."""
    a, b = part.triangles, np.roll(part.triangles, -1, axis=1)
    normal = cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0])
    area = 0.5 * float(np.sqrt((normal * normal).sum(axis=-1)).sum())
    if area == 0.0:
        return part.inner, 1.0
    step = math.sqrt(area / POINTS)
    side = (b - a).reshape(-1, 3)
    many = np.ceil(np.sqrt((side * side).sum(axis=-1)) / step).clip(1, None).astype(np.intp)
    rows = np.repeat(np.arange(len(side)), many)
    share = (np.arange(len(rows)) - np.repeat(np.cumsum(many) - many, many)) / many[rows]
    points = np.concatenate([a.reshape(-1, 3)[rows] + share[:, None] * side[rows], part.inner])
    return _apart(points, step), step


def _apart(points: FloatArray, step: float) -> FloatArray:
    """The first of the points (n, 3) in each cell of a grid of cubes."""
    cells = np.floor(points / step).astype(np.int64)
    low = cells.min(axis=0, initial=0)
    i, j, k = (cells - low).T
    _, many, deep = (cells.max(axis=0, initial=0) - low + 1).tolist()
    _, first = np.unique((i * many + j) * deep + k, return_index=True)
    return np.asarray(points[np.sort(first)])


def _points_inside(corners: FloatArray, size: float) -> FloatArray:
    """Points around which triangles (t, 3, 3) wind, on a grid of lines along z."""
    step = size / LINES
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    x, y = (np.arange(low[k] + 0.37 * step, high[k], step).tolist() for k in range(2))
    found: list[FloatArray] = [np.empty((0, 3))]
    for u in x:
        near = (corners[:, :, 0].min(axis=1) <= u) & (corners[:, :, 0].max(axis=1) >= u)
        row = corners[near]
        for v in y:
            for start, end in _stretches(row, u, v):
                z = np.linspace(start, end, 2 + int((end - start) / step))
                found.append(np.stack([np.full(len(z), u), np.full(len(z), v), z], axis=-1))
    return np.concatenate(found)


def _stretches(corners: FloatArray, x: float, y: float) -> Iterator[tuple[float, float]]:
    """Where the line along z at (x, y) is inside triangles (t, 3, 3)."""
    near = (corners[..., 1].min(axis=1) <= y) & (corners[..., 1].max(axis=1) >= y)
    px, py, pz = (corners[near][..., k] for k in range(3))
    qx, qy = (np.roll(p, -1, axis=1) for p in (px, py))
    turn = (px - x) * (qy - y) - (py - y) * (qx - x)  # twice the area left of each edge: the weight of the third corner
    sense = np.where((turn > 0.0).all(axis=1), 1, 0) - np.where((turn < 0.0).all(axis=1), 1, 0)
    t, z = turn[sense != 0], pz[sense != 0]
    heights = (t[:, 1] * z[:, 0] + t[:, 2] * z[:, 1] + t[:, 0] * z[:, 2]) / (t[:, 0] + t[:, 1] + t[:, 2])
    order = np.argsort(heights, kind="stable")
    levels, winding = heights[order].tolist(), np.cumsum(sense[sense != 0][order])
    for k in np.flatnonzero(winding[:-1]).tolist():
        yield levels[k], levels[k + 1]
