"""Cutting a mesh into convex pieces, for when its hull would fill a hollow that matters."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner_service.concurrency.confined import ScriptFailed, run_confined
from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.files.disk_cache import DiskCache, cache_folder
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray, IntArray, set_fields
from planner_service.geometry.covering import covering, longest_gap, slack
from planner_service.geometry.mesh import Mesh, checked_scale
from planner_service.geometry.mesh_formats import read_triangles
from planner_service.geometry.validation import MAX_LENGTH, in_file, number

__all__ = ["MAX_PIECES", "hull_ratio", "pieces_of_file"]

MAX_PIECES = 64
"""Each piece is checked against everything near it: more pieces cost more than a finer shape is worth."""

FINEST = 1e-4
"""Metres: no arm is so exact that a finer shape would matter."""

TIGHT = 1.02
"""Volume of a hull relative to its mesh up to which the hull is as good as any pieces."""

SECONDS = 600
"""Fifty times what most links of robots take; some never end."""

BYTES = 4_000_000_000
"""Bytes of address space; a mesh of a thousand triangles takes a twentieth of it."""

MAX_POINTS = 2_000_000
"""Points of all pieces together, as coacd returns them."""

FORMAT = 1
"""Version of the entries kept on disk: raise it when the settings of coacd or the format of its answer change."""


def pieces_of_file(
    path: str | os.PathLike[str], scale: Sequence[float] = (1.0, 1.0, 1.0), *, most: int = 16, tolerance: float = 0.01
) -> tuple[Mesh, ...]:
    """Convex solids that together contain the mesh in an STL, OBJ or PLY file.

    They come from coacd (Wei et al., ACM TOG 41(4), 2022) unless the hull of the mesh is enough.

    The pieces contain the whole surface, whatever coacd answers: they are grown until they contain every triangle
    (``covering.py``), each by less than 1.1 thousandths of the size of the mesh, plus the depth of whatever coacd left
    out. Whether they also contain the inside of a closed mesh is checked along 300 lines (fewer from 70,000 triangles
    on): if one of them has a gap, the answer is the hull. A mesh that is not closed has no inside.

    Equal for equal arguments, version of coacd and kind of machine. coacd runs in a process of its own, for up to ten
    minutes and 4 GB; its answer is kept on disk (``files/disk_cache.py``) and checked against the surface each time.

    Args:
        scale: Factors that turn the file's x, y and z into metres; a negative one mirrors.
        most: Maximum number of pieces, 1 to 64; 1 gives the hull. With fewer pieces, coacd makes thicker ones.
        tolerance: Metres by which a piece may fill what is not solid; coacd aims at it but does not guarantee it.

    Raises:
        InvalidFile: no such file, or a mesh that is flat or that coacd cannot cut in time.
        InvalidRequest: ``scale``, ``most`` or ``tolerance`` out of range.
        MissingDependency: more than the hull is needed, and coacd is not installed.
    """
    file = as_path("path", path)
    settings = _Settings(most, tolerance)
    vertices, faces = read_triangles(file, checked_scale("scale", scale))
    return in_file(file, lambda: _pieces(Mesh(vertices), vertices, faces, settings))


@dataclass(frozen=True)
class _Settings:
    most: int
    tolerance: float

    def __post_init__(self) -> None:
        expected = f"a whole number from 1 to {MAX_PIECES}"
        if not number("most", self.most, expected, 1, MAX_PIECES).is_integer():
            raise InvalidRequest("most", self.most, expected)
        expected = f"metres from {FINEST:g} to {MAX_LENGTH:g}"
        tolerance = number("tolerance", self.tolerance, expected, FINEST, MAX_LENGTH)
        set_fields(self, most=int(self.most), tolerance=tolerance)

    def for_coacd(self) -> dict[str, Any]:
        """Arguments of ``coacd.run_coacd``, without its repair of meshes, which makes thousands of corners."""
        return {
            "threshold": self.tolerance,
            "real_metric": True,  # the threshold in the units of the mesh
            "max_convex_hull": self.most,
            "preprocess_mode": "off",
            "seed": 0,
        }


def _pieces(hull: Mesh, vertices: FloatArray, faces: IntArray, settings: _Settings) -> tuple[Mesh, ...]:
    if settings.most == 1 or hull_ratio(hull, vertices, faces) <= TIGHT:
        return (hull,)
    cut = []
    for points in _cut(hull, vertices, faces, settings):
        try:
            cut.append(Mesh(points))
        except InvalidRequest:  # a flat piece; others take over what it held
            continue
    try:
        pieces = covering(cut, vertices, faces) if cut else (hull,)
    except InvalidRequest:  # too many corners
        return (hull,)
    gap = longest_gap(pieces, vertices, faces) if _is_closed(faces) else 0.0
    return pieces if gap <= slack(vertices) else (hull,)


def hull_ratio(hull: Mesh, vertices: FloatArray, faces: IntArray) -> float:
    """Volume of a mesh's hull divided by the volume of the mesh: 1 if convex, 3 if two thirds of the hull are air.

    Infinite if the triangles are not closed (some edge of one is not an edge, in the other direction, of just one
    other) or enclose nothing. Where bodies in the mesh overlap, the overlap counts twice, and the ratio is too low.
    """
    enclosed = abs(_volume(vertices, faces)) if _is_closed(faces) else 0.0
    return _volume(hull.vertices, hull.faces) / enclosed if enclosed > 0.0 else math.inf


def _is_closed(faces: IntArray) -> bool:
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    ways = np.unique(edges, axis=0)
    return len(ways) == len(edges) and np.array_equal(ways, np.unique(edges[:, ::-1], axis=0))


def _volume(vertices: FloatArray, faces: IntArray) -> float:
    """The enclosed volume, negative if triangles face inwards: tetrahedra from one corner, added up exactly."""
    (a, b, c), (d, e, f), (g, h, i) = (vertices[faces[:, k]].T - vertices[0][:, None] for k in range(3))
    return math.fsum((a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)).tolist()) / 6.0


def _cut(hull: Mesh, vertices: FloatArray, faces: IntArray, settings: _Settings) -> list[FloatArray]:
    """Points of each piece, from disk or else from coacd; neither is trusted to be right."""
    from importlib.metadata import PackageNotFoundError, version  # slower than all of this module

    try:
        release = version("coacd")
    except PackageNotFoundError:
        raise MissingDependency("coacd", "decompose") from None
    about = json.dumps({"format": FORMAT, "coacd": release, **settings.for_coacd()}, sort_keys=True)
    content = hashlib.sha256(f"{about} {len(vertices)} {len(faces)} ".encode())
    content.update(vertices.astype("<f8").tobytes())
    content.update(faces.astype("<i4").tobytes())
    cache, key = DiskCache(cache_folder()), content.hexdigest()
    kept = _points(cache.get(key), settings.most)
    if kept is not None and all(_within(hull, points, slack(vertices)) for points in kept):
        return kept
    data = _run_coacd(vertices, faces, settings)
    pieces = _points(data, settings.most)
    if pieces is None:
        raise _failed(f"its answer is not 1 to {settings.most} pieces of finite points")
    cache.put(key, data)
    return pieces


def _within(hull: Mesh, points: FloatArray, by: float) -> bool:
    """Whether no point is farther than ``by`` outside a hull, as for every true piece of its mesh."""
    starts = range(0, len(points), 1_000)
    return all(float((points[k : k + 1_000] @ hull.normals.T - hull.offsets).max(initial=-1.0)) <= by for k in starts)


def _points(data: bytes | None, most: int) -> list[FloatArray] | None:
    """The pieces that ``coacd_child`` wrote, or None if ``data`` is not in its format."""
    if data is None or len(data) < 4:
        return None
    many = int(np.frombuffer(data, "<u4", 1)[0])
    if not 1 <= many <= most or len(data) < 4 + 4 * many:
        return None
    counts = np.frombuffer(data, "<u4", many, 4).tolist()
    start = 4 + 4 * many
    if sum(counts) > MAX_POINTS or len(data) != start + 24 * sum(counts):
        return None
    points = np.frombuffer(data, "<f8", 3 * sum(counts), start).reshape(-1, 3).astype(np.float64)
    if not np.all(np.abs(points) <= MAX_LENGTH):
        return None
    return list(np.split(points, np.cumsum(counts)[:-1]))


def _run_coacd(vertices: FloatArray, faces: IntArray, settings: _Settings) -> bytes:
    """The answer of ``coacd_child`` for a mesh.

    Raises:
        InvalidRequest: it crashed, took too long or too much memory, or coacd refused the mesh.
    """
    script = Path(__file__).with_name("coacd_child.py")
    job = {"vertices": len(vertices), "triangles": len(faces), "settings": settings.for_coacd()}
    given = vertices.astype("<f8").tobytes() + faces.astype("<i4").tobytes()
    try:
        return run_confined(script, job, seconds=SECONDS, memory=BYTES, given=given)
    except ScriptFailed as error:
        raise _failed(str(error)) from None


def _failed(why: str) -> InvalidRequest:
    expected = "a mesh that coacd can cut into convex pieces"
    message = f"coacd did not cut the mesh: {why}; simplify the mesh, allow a larger tolerance, or use its hull"
    return InvalidRequest("mesh", None, expected, message=message)
