"""Convex meshes: a mesh counts as the solid convex hull of its vertices.

A mesh by itself is a surface, and a body that is wholly inside it touches nothing. Its hull is a solid that contains
it, so whatever stays clear of the hull stays clear of the mesh. The hull fills hollows: where that matters, cut the
mesh into convex pieces (``decomposition``).
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import (
    FloatArray,
    IntArray,
    along,
    blocks,
    cosines_and_sines,
    cross,
    frozen,
    read_only,
    set_fields,
)
from planner_service.geometry.mesh_formats import MAX_VERTICES, distinct, read_vertices
from planner_service.geometry.validation import MAX_LENGTH, cloud, in_file, margin_of, numbers, points_of, vectors
from planner_service.native.loading import load_core

__all__ = ["Mesh", "MeshFile", "checked_scale"]

MAX_HULL = 5_000
"""Most corners of a hull: every distance bound looks at each; a scanned ball of 50,000 vertices has fewer."""
SIMPLE_HULL = 600
"""Corners kept of a larger hull: it is then grown, and growing makes at most eight of one."""
AT_ONCE = 100
"""Points whose distance is computed together."""
DIRECTIONS = 100
"""In which the first of these corners are farthest."""

THINNEST = 1e-6
"""Metres: anything thinner is flat up to rounding, and collision libraries are undefined below this gap."""

ROUNDING = 1e-9
"""Relative to the size of a mesh: far above what rounding may cut off its hull (1e-15), far below what matters."""


@dataclass(frozen=True)
class MeshFile:
    """A mesh file, and the factors that turn its x, y and z into metres."""

    path: Path
    scale: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Mesh:
    """The solid convex hull of points (n, 3) in metres, in the mesh's own frame, which may lie outside the hull.

    Equal to another mesh whose hull has the same corners, to the last bit.

    Attributes:
        vertices: The corners of the hull (v, 3), each once, sorted; giving these again gives an equal mesh.
        faces: Triangles (t, 3) that bound the hull, as rows of ``vertices``, counter-clockwise seen from outside.
        normals: Their outward unit normals, (t, 3).
        offsets: The hull lies where ``normals . x <= offsets``, (t,).
        growth: Metres by which this hull extends at most beyond that of a file's vertices, which it contains; 0 but for
            files whose hulls have more than 5,000 corners.
        source: The file whose hull it is; None where only its points are known. Equal meshes may be of two files.

    Raises:
        InvalidRequest: not finite numbers of shape (n, 3), more than 500,000 points, beyond 1 km, flat (thinner than
            1 um: a solid of no thickness has no inside), or a hull of more than 5,000 corners.
    """

    vertices: FloatArray
    faces: IntArray = field(init=False)
    normals: FloatArray = field(init=False)
    offsets: FloatArray = field(init=False)
    growth: float = field(init=False, default=0.0)
    source: MeshFile | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self._become(_checked(self.vertices), MAX_HULL)

    def _become(self, points: FloatArray, most: int) -> None:
        """Be the hull of points (n, 3), each once, sorted."""
        corners, faces, normals = _hull(points, most)
        offsets = _farthest(corners, normals, (corners[faces[:, 0]] * normals).sum(axis=-1))
        few = corners[np.concatenate([corners.argmin(axis=0), corners.argmax(axis=0)])]
        depths = -along(few, normals).min(axis=-1)
        thin = offsets + depths < THINNEST  # as far as a few corners can tell
        if thin.any() and float((offsets[thin] + _farthest(corners, -normals[thin], depths[thin])).min()) < THINNEST:
            raise _flat(points)
        if len(corners) < len(points):
            _require_inside(points, normals, offsets)
        vertices, normals, offsets = map(read_only, (corners, normals, offsets))
        set_fields(self, vertices=vertices, faces=frozen(faces), normals=normals, offsets=offsets)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Mesh:
        """The solid hull of the vertices in an STL, OBJ, PLY or COLLADA (.dae) file, without those that no face uses.

        A hull of more than 5,000 corners is replaced by a simpler one around it; see ``growth``.

        Args:
            scale: Factors that turn the file's x, y and z into metres; a negative one mirrors.

        Raises:
            InvalidFile: not such a file, larger than 50 MB, malformed, flat, or with numbers that make no mesh.
            InvalidRequest: a scale that is zero or not finite.
        """
        file = as_path("path", path)
        source = MeshFile(file, checked_scale("scale", scale))
        points = read_vertices(file, source.scale, on_faces=True)
        mesh = in_file(file, lambda: cls.around(points))
        set_fields(mesh, source=source)
        return mesh

    @classmethod
    def around(cls, points: ArrayLike) -> Mesh:
        """The solid hull of points (n, 3); one of more than 5,000 corners is replaced by a simpler one around it.

        Raises:
            InvalidRequest: what ``Mesh`` refuses, but not too many corners.
        """
        return _simple(points)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the vertices, to the last bit, in hex."""
        return hashlib.sha256(self.vertices.astype("<f8").tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mesh) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        return f"Mesh({len(self.vertices)} vertices, sha256 {self.digest[:32]})"

    def support(self, direction: FloatArray) -> FloatArray:
        """A point of the solid farthest along each direction; (..., 3) in, (..., 3) out, any length of direction."""
        d = vectors("direction", direction)
        largest = np.abs(d).max(axis=-1, keepdims=True)
        flat = (d / np.where(largest > 0.0, largest, 1.0)).reshape(-1, 3)
        best = [along(self.vertices, flat[k]).argmax(axis=-1) for k in blocks(len(flat), len(self.vertices))]
        return np.asarray(self.vertices[np.concatenate(best)].reshape(d.shape))

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance from each point to the solid, 0 inside; (..., 3) in, (...) out; exact up to rounding."""
        p = points_of(points)
        flat = p.reshape(-1, 3)
        distances = [self._distances(flat[rows]) for rows in blocks(len(flat), 6 * len(self.faces))]
        return np.concatenate(distances).reshape(p.shape[:-1])

    def _distances(self, points: FloatArray) -> FloatArray:
        """Of points (k, 3): the nearest point lies on a face that the point is above, or on, or on an edge.

        A point on the surface may by rounding be below the face it is on and above the one beside it.
        """
        rounding = -ROUNDING * float((self.vertices.max(axis=0) - self.vertices.min(axis=0)).max())
        above = along(self.normals, points) - self.offsets
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        outside = np.full(above.shape, False)
        least = np.full(len(points), np.inf)
        for start, end in ((a, b), (b, c), (c, a)):
            edge = end - start
            inward = cross(self.normals, edge)
            outside |= along(inward, points) < (inward * start).sum(axis=-1)
            least = np.minimum(least, _to_segments(points, start, edge).min(axis=-1))
        onto = np.where(outside | (above < rounding), np.inf, np.maximum(above, 0.0)).min(axis=-1)
        return np.where((above <= 0.0).all(axis=-1), 0.0, np.minimum(onto, least))

    def distance_bound(self, points: FloatArray) -> FloatArray:
        """Upper bounds (k,) of the distances of points (k, 3), far faster than these: 0 inside, tight near a face."""
        return _outside(self, points, 0.0)[0]

    def grown(self, margin: float) -> Mesh:
        """A mesh that contains every point within ``margin`` of this one, and none farther than 1.74 times that.

        The links of a robot are grown again for every scene, so the last 1,024 results are kept.
        """
        margin = margin_of(margin)
        return self if margin == 0.0 else _grown(self, margin)


@lru_cache(maxsize=1024)
def _grown(mesh: Mesh, margin: float) -> Mesh:
    """See ``Mesh.grown``.

    A direction u to which a corner v is farthest is a sum of the normals of v's faces, with no negative weight.
    If v moves by w and ``n . w >= margin`` for each of these normals, the support value along u grows by at least
    that share of them: the margin. A corner too sharp for that becomes the eight corners of a cube around it.
    """
    reach = margin * (1.0 + ROUNDING) + 1e-15
    mean = np.zeros(mesh.vertices.shape)
    for k in range(3):
        np.add.at(mean, mesh.faces[:, k], mesh.normals)
    mean /= np.sqrt((mean * mean).sum(axis=-1, keepdims=True))
    least = np.ones(len(mean))
    for k in range(3):
        np.minimum.at(least, mesh.faces[:, k], (mean[mesh.faces[:, k]] * mesh.normals).sum(axis=-1))
    blunt = least >= 1.0 / np.sqrt(3.0)
    moved = mesh.vertices[blunt] + mean[blunt] * (reach / least[blunt])[:, None]
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * reach
    out = object.__new__(Mesh)  # of a hull with many sharp corners the grown one may have more than may be given
    points = np.unique(np.concatenate([moved, (mesh.vertices[~blunt, None] + cube).reshape(-1, 3)]), axis=0)
    out._become(points, len(points))
    return out


def _simple(vertices: ArrayLike) -> Mesh:
    """The hull of vertices (n, 3); one of more than ``MAX_HULL`` corners is replaced by a simpler one around it.

    Of its corners those are kept that are farthest in some direction, then those farthest from the hull of the kept
    ones. That hull is grown by as much as any other corner is outside of it.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = _checked(vertices)
    try:
        corners = points[np.sort(ConvexHull(points).vertices)]
    except (QhullError, ValueError):
        raise _flat(points) from None
    if len(corners) <= MAX_HULL:
        return Mesh(corners)
    kept = np.unique([int(along(corners, direction).argmax()) for direction in _directions(DIRECTIONS)])
    slack = ROUNDING * float((corners.max(axis=0) - corners.min(axis=0)).max())
    while True:
        inner = Mesh(corners[kept])
        outside, farthest = _outside(inner, corners, slack)
        if len(kept) == SIMPLE_HULL or not len(farthest):
            break
        kept = np.union1d(kept, farthest[: SIMPLE_HULL - len(kept)])
    outside[kept] = 0.0
    outer = Mesh(inner.grown(_largest(inner, corners, outside) + slack).vertices)
    if float(_heights(outer, corners).max()) > 0.0:
        raise BrokenInvariant("a hull was to be simplified, and sticks out of the simpler one")
    set_fields(outer, growth=float(inner.distance(outer.vertices).max()))
    return outer


def _directions(count: int) -> FloatArray:
    """Unit vectors (count, 3) along a spiral on the sphere, evenly spread: the same bits everywhere."""
    k = np.arange(count, dtype=np.float64)
    z = 1.0 - (2.0 * k + 1.0) / count
    c, s = cosines_and_sines(np.pi * (3.0 - np.sqrt(5.0)) * k)
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * c, across * s, z], axis=-1)


def _heights(mesh: Mesh, points: FloatArray) -> FloatArray:
    """How far points (k, 3) are above the highest of the planes through a mesh's faces, (k,)."""
    rows = [
        (along(mesh.normals, points[k]) - mesh.offsets).max(axis=-1) for k in blocks(len(points), len(mesh.normals))
    ]
    return np.concatenate(rows)


def _outside(mesh: Mesh, points: FloatArray, slack: float) -> tuple[FloatArray, IntArray]:
    """Upper bounds (k,) of the distances of points (k, 3) from a mesh, and which points are farthest above its faces.

    The bound is the distance from the face whose plane the point is highest above. The rows of points come with the
    highest first, one for each face that has a point more than ``slack`` above it.
    """
    face, height = np.zeros(len(points), dtype=np.intp), np.zeros(len(points))
    for k in blocks(len(points), len(mesh.normals)):
        above = along(mesh.normals, points[k]) - mesh.offsets
        face[k], height[k] = above.argmax(axis=-1), above.max(axis=-1)
    corners = mesh.vertices[mesh.faces[face]]
    foot = points - height[:, None] * mesh.normals[face]
    beside = np.full(len(points), False)
    least = np.full(len(points), np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start, edge = corners[:, a], corners[:, b] - corners[:, a]
        beside |= (cross(mesh.normals[face], edge) * (foot - start)).sum(axis=-1) < 0.0
        rest = points - start - edge * _share(points - start, edge)[:, None]
        least = np.minimum(least, np.sqrt((rest * rest).sum(axis=-1)))
    bound = np.where(height <= 0.0, 0.0, np.where(beside, least, height))
    order = np.lexsort((np.arange(len(points)), -height))
    _, first = np.unique(face[order], return_index=True)
    rows = order[np.sort(first)]
    return bound, rows[height[rows] > slack]


def _largest(mesh: Mesh, points: FloatArray, bounds: FloatArray) -> float:
    """The largest distance of points (k, 3) from a mesh; ``bounds`` are not below their distances."""
    order, largest = np.argsort(-bounds, kind="stable"), 0.0
    for k in range(0, len(order), AT_ONCE):
        if not bounds[order[k]] > largest:
            break
        largest = max(largest, float(mesh.distance(points[order[k : k + AT_ONCE]]).max()))
    return largest


def _share(x: FloatArray, edge: FloatArray) -> FloatArray:
    """Where the points of edges (k, 3) that are nearest to x (k, 3) are, 0 to 1."""
    return np.asarray(np.clip((x * edge).sum(axis=-1) / (edge * edge).sum(axis=-1), 0.0, 1.0))


def checked_scale(field_name: str, scale: Any) -> tuple[float, float, float]:
    """The scale of a mesh a caller gave.

    Raises:
        InvalidRequest: not three finite numbers, none of them zero.
    """
    expected = "three finite numbers, none of them 0"
    factors = numbers(field_name, scale, expected)
    if factors.shape != (3,) or not np.all(np.isfinite(factors)) or not np.all(factors != 0.0):
        raise InvalidRequest(field_name, scale, expected)
    x, y, z = factors.tolist()
    return (x, y, z)


def _checked(vertices: ArrayLike) -> FloatArray:
    """Points (n, 3), each once, sorted."""
    expected = f"4 to {MAX_VERTICES:,} points (x, y, z) in metres, at most {MAX_LENGTH:g} from 0 along each axis"
    points = cloud("vertices", vertices, expected, 4, MAX_VERTICES, MAX_LENGTH)
    return distinct(points + 0.0)[0]  # + 0.0 drops the sign of -0.0


def _hull(points: FloatArray, most: int) -> tuple[FloatArray, IntArray, FloatArray]:
    """Corners, triangles and their outward normals; the hull of the corners alone has the same corners.

    Raises:
        InvalidRequest: no solid, or one of more than ``most`` corners.
    """
    from scipy.spatial import ConvexHull, QhullError

    while True:
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            raise _flat(points) from None
        kept = np.sort(hull.vertices)
        if len(kept) > most:
            expected = f"a hull of at most {most:,} corners"
            message = f"vertices: got a hull of {len(kept):,} corners; expected {expected}; simplify the mesh"
            raise InvalidRequest("vertices", len(kept), expected, message=message)
        if len(kept) == len(points):
            break
        points = points[kept]  # which corners count as one by rounding depends on what else is there
    faces, normals = hull.simplices.astype(np.intp), hull.equations[:, :3].copy()
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = (cross(b - a, c - a) * normals).sum(axis=-1) < 0.0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    first = faces.argmin(axis=1)
    faces = np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1)
    order = np.lexsort(faces.T[::-1])
    return points, faces[order], normals[order]


def _flat(points: FloatArray) -> InvalidRequest:
    size = (points.max(axis=0) - points.min(axis=0)).tolist() if len(points) else []
    expected = "points that span a solid; give a flat mesh some thickness"
    message = f"vertices: flat, {len(points)} points within {size} m; expected {expected}"
    return InvalidRequest("vertices", points, expected, message=message)


def _require_inside(points: FloatArray, normals: FloatArray, offsets: FloatArray) -> None:
    """Raise unless the hull holds every point, up to rounding: so no point was lost on the way."""
    allowed = ROUNDING * float((points.max(axis=0) - points.min(axis=0)).max())
    if float((_farthest(points, normals, offsets) - offsets).max()) > allowed:
        raise _flat(points)


def _farthest(points: FloatArray, directions: FloatArray, reached: FloatArray) -> FloatArray:
    """The largest component of points (n, 3) along each unit vector of (k, 3), (k,), with the bits of ``along``.

    Args:
        reached: The component of one of the points, (k,), or what is to be given where none has more.
    """
    farthest: FloatArray = load_core().farthest(points, directions, reached)
    return farthest


def _to_segments(points: FloatArray, start: FloatArray, edge: FloatArray) -> FloatArray:
    """Distances from points (k, 3) to segments (t, 3) from ``start`` along ``edge``, (k, t)."""
    square = (edge * edge).sum(axis=-1)
    x = points[:, None, :] - start
    share = np.clip((x * edge).sum(axis=-1) / square, 0.0, 1.0)
    rest = x - share[..., None] * edge
    return np.asarray(np.sqrt((rest * rest).sum(axis=-1)))
