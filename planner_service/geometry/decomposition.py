"""Cutting a mesh into convex pieces, for when its hull would fill a hollow that matters."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.disk_cache import DiskCache, cache_folder
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_formats import MAX_VERTICES, distinct, read_triangles
from planner_service.geometry.plane_cuts import DIRECTIONS, Cut, CutPlan, parts_of, plan_cuts, signed_volume
from planner_service.geometry.validation import MAX_LENGTH, number

__all__ = [
    "MAX_PIECES",
    "MOST",
    "concave_surface",
    "hull_ratio",
    "pieces_of_file",
    "pieces_of_mesh",
    "pieces_of_surface",
    "surface_of",
]

MAX_PIECES = 64
"""Each piece is checked against everything near it: more pieces cost more than a finer shape is worth."""

MOST = 8
"""Pieces at most where nobody says how many: links take two to four."""

TIGHT = 1.02
"""Volume of a hull relative to its mesh up to which the hull is as good as any pieces."""

VERSION = 2
"""Of the way to choose planes, in the keys of what is kept on disk: raise it when that changes."""


def pieces_of_file(
    path: str | os.PathLike[str], scale: Sequence[float] = (1.0, 1.0, 1.0), *, most: int = 16
) -> tuple[Mesh, ...]:
    """Convex solids that together contain the mesh in an STL, OBJ, PLY or COLLADA file, its inside included.

    They are hulls of the parts into which planes cut the mesh (``plane_cuts``, which says why nothing is left out),
    or its hull where that is as good. Of a body that is not closed only the surface is sure to be contained; its
    triangles count as winding around a point from a quarter turn on.

    Equal for equal arguments. The planes are cached on disk (``files/disk_cache.py``); a changed cache makes the pieces
    looser or tighter, but they contain the mesh all the same.

    Args:
        scale: Factors that turn the file's x, y and z into metres; a negative one mirrors.
        most: Maximum number of pieces, 1 to 64; 1 gives the hull. With fewer, they fill more of what is not solid.

    Raises:
        InvalidFile: no such file, or a mesh that is flat.
        InvalidRequest: ``scale`` or ``most`` out of range.
    """
    file = as_path("path", path)
    expected = f"a whole number from 1 to {MAX_PIECES}"
    if not number("most", most, expected, 1, MAX_PIECES).is_integer():
        raise InvalidRequest("most", most, expected)
    return pieces_of_mesh(Mesh.from_file(file, scale), int(most))


def pieces_of_mesh(hull: Mesh, most: int = MOST) -> tuple[Mesh, ...]:
    """As ``pieces_of_file``, of a mesh that was read; the mesh itself if no file of it is known."""
    surface = None if most == 1 else concave_surface(hull)
    return (hull,) if surface is None else pieces_of_surface(hull, *surface, most)


def concave_surface(mesh: Mesh) -> tuple[FloatArray, IntArray] | None:
    """The vertices and triangles of the file of a mesh whose hull fills what may be free.

    None if it does not, or if no file with triangles is known: the hull is then all there is.
    """
    surface = surface_of(mesh)
    return surface if surface is not None and hull_ratio(mesh, *surface) > TIGHT else None


def surface_of(mesh: Mesh) -> tuple[FloatArray, IntArray] | None:
    """The vertices and triangles of the file of a mesh, None if no file with triangles is known."""
    if mesh.source is None:
        return None
    try:
        return read_triangles(mesh.source.path, mesh.source.scale)
    except InvalidFile:  # vertices alone
        return None


def pieces_of_surface(hull: Mesh, vertices: FloatArray, faces: IntArray, most: int = MOST) -> tuple[Mesh, ...]:
    """As ``pieces_of_file``, of what ``concave_surface`` gives of a mesh."""
    plan = _plan(vertices, faces, most)
    if len(plan.groups) == 1:
        return (hull,)
    try:
        parts = parts_of(vertices, faces, plan)
        return tuple(Mesh.around(each if len(each) <= MAX_VERTICES else distinct(each)[0]) for each in parts)
    except InvalidRequest:  # a flat piece
        return (hull,)


def hull_ratio(hull: Mesh, vertices: FloatArray, faces: IntArray) -> float:
    """Volume of a mesh's hull divided by the volume of the mesh: 1 if convex, 3 if two thirds of the hull are air.

    Infinite if the triangles are not closed (some edge of one is not an edge, in the other direction, of just one
    other) or enclose nothing. Where bodies in the mesh overlap, the overlap counts twice, and the ratio is too low.
    """
    enclosed = abs(signed_volume(vertices, faces)) if _is_closed(faces) else 0.0
    return signed_volume(hull.vertices, hull.faces) / enclosed if enclosed > 0.0 else math.inf


def _is_closed(faces: IntArray) -> bool:
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    ways, back = (np.unique(edges[:, k] * (int(faces.max()) + 1) + edges[:, 1 - k]) for k in (0, 1))
    return len(ways) == len(edges) and np.array_equal(ways, back)


def _plan(vertices: FloatArray, faces: IntArray, most: int) -> CutPlan:
    """How to cut a mesh, from disk or else worked out."""
    content = hashlib.sha256(f"plane cuts {VERSION} {most} {len(vertices)} {len(faces)} ".encode())
    content.update(vertices.astype("<f8").tobytes())
    content.update(faces.astype("<i4").tobytes())
    cache, key = DiskCache(cache_folder()), content.hexdigest()
    kept = _kept_plan(cache.get(key), most)
    if kept is None:
        kept = plan_cuts(vertices, faces, most)
        cache.put(key, json.dumps(asdict(kept)).encode())
    return kept


def _kept_plan(data: bytes | None, most: int) -> CutPlan | None:
    """The plan that ``data`` is, or None if it is none of at most so many pieces."""
    try:
        told: Any = json.loads(data or b"")
        cuts = tuple(Cut(int(c["part"]), int(c["direction"]), float(c["offset"])) for c in told["cuts"])
        groups = tuple(tuple(map(int, group)) for group in told["groups"])
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError):
        return None
    sound = all(
        0 <= cut.part <= k and 0 <= cut.direction < len(DIRECTIONS) and abs(cut.offset) <= 3.0 * MAX_LENGTH
        for k, cut in enumerate(cuts)
    )
    parts = sorted(part for group in groups for part in group)
    sound &= len(cuts) < MAX_PIECES * 2 and parts == list(range(len(cuts) + 1))
    return CutPlan(cuts, groups) if sound and 1 <= len(groups) <= most else None
