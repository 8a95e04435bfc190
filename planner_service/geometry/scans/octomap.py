"""Reading the occupied cells of OctoMap's trees: ``.bt`` (occupied or free) and ``.ot`` (log odds).

The format is that of ``AbstractOcTree::write`` and ``writeBinary`` (github.com/OctoMap/octomap): a header of text,
then the nodes depth first. A tree has 16 levels below its root; the smallest cells are ``res`` metres wide, and cell 0
along an axis begins at 0. What is unknown is not occupied.
"""

from __future__ import annotations

import math
import re
import struct

import numpy as np

from planner_service.files.numerals import plain_float, plain_int
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import IntArray

__all__ = ["octree_cells"]

DEPTH = 16
"""Levels below the root; OctoMap's keys have as many bits."""

MAX_NODES = 3_000_000
"""A map of a large room at one centimetre; they take about as many microseconds."""

MAX_CELLS = 1_000_000
"""As many as a cloud may have."""

MAX_HEADER = 10_000
"""Bytes."""

VALUES = {"OcTree": 4, "ColorOcTree": 7, "OcTreeStamped": 8}
"""Bytes that a node of a full tree holds, its log odds first, by the kind of the tree."""

_Cubes = list[tuple[int, int, int, int]]
"""Lowest cell and the level of cubes of 2^level cells along each axis."""


def octree_cells(data: bytes, resolution: float | None = None) -> tuple[IntArray, float]:
    """The occupied cells (n, 3) of a tree as whole numbers of edges, and the edge in metres.

    A node is occupied if its log odds are not negative, as OctoMap decides unless told otherwise.

    Args:
        resolution: The edge: 1, 2, 4, ... times that of the tree's smallest cells, which it is if not given. A
            coarser cell is occupied if anything in it is.

    Raises:
        Malformed: neither format, another kind of tree, cut short, too deep, no occupied cell, or too many.
    """
    end = re.search(rb"^data[ \t]*\r?\n", data[:MAX_HEADER], re.MULTILINE)
    first = data[:100].split(b"\n")[0]
    if end is None or not first.startswith(b"# Octomap OcTree"):
        raise Malformed("no OctoMap: expected '# Octomap OcTree' and a header that ends with data")
    words = [line.split() for line in data[: end.start()].decode("latin-1").splitlines() if not line.startswith("#")]
    header = {pair[0]: pair[1] for pair in words if len(pair) == 2}
    try:
        edge, nodes = plain_float(header["res"]), plain_int(header["size"])
    except (KeyError, ValueError):
        raise Malformed("an OctoMap header without id, size and res; expected a line for each") from None
    if not 1e-4 <= edge <= 1e3 or not 1 <= nodes <= MAX_NODES:
        raise Malformed(f"res {edge:g} and size {nodes:,}; expected 0.0001 to 1000 m and 1 to {MAX_NODES:,} nodes")
    kind, body = header.get("id", ""), data[end.end() :]
    try:
        if kind not in VALUES:
            raise Malformed(f"id {kind[:40]!r}; expected {', '.join(VALUES)}")
        cubes = _binary(body, nodes) if b"binary" in first else _full(body, nodes, VALUES[kind])
    except (IndexError, struct.error):
        raise Malformed(f"cut short: the header says {nodes:,} nodes") from None
    coarser = _levels(edge, resolution)
    return _cells(cubes, coarser), edge * 2**coarser if resolution is None else resolution


def _levels(edge: float, resolution: float | None) -> int:
    """By how many levels of the tree cells of the resolution are coarser than its smallest."""
    if resolution is None:
        return 0
    levels = round(math.log2(resolution / edge))
    if not 0 <= levels <= DEPTH or not math.isclose(edge * 2**levels, resolution, rel_tol=1e-12):
        raise Malformed(
            f"its cells are {edge:g} m wide; expected a resolution of {edge:g}, {2 * edge:g}, {4 * edge:g}, ..."
        )
    return levels


def _binary(body: bytes, nodes: int) -> _Cubes:
    """Of each inner node two bytes: two bits for each child, 1 free, 2 occupied, 3 an inner node of its own."""
    cubes: _Cubes = []
    below = [(0, 0, 0, DEPTH)]
    at, seen = 0, 1
    while below:
        x, y, z, level = below.pop()
        if level == 0:
            raise Malformed(f"more than {DEPTH} levels")
        bits = body[at] | body[at + 1] << 8
        at += 2
        inner, half = [], 1 << (level - 1)
        for child in range(8):
            state = bits >> 2 * child & 3
            if state:
                seen += 1
                place = (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2), level - 1)
                if state == 2:
                    cubes.append(place)
                elif state == 3:
                    inner.append(place)
        if seen > nodes:
            raise Malformed(f"more nodes than the {nodes:,} of the header")
        below.extend(reversed(inner))
    if seen != nodes or at != len(body):
        raise Malformed(f"{seen:,} nodes in {len(body):,} bytes; the header says {nodes:,}")
    return cubes


def _full(body: bytes, nodes: int, size: int) -> _Cubes:
    """Of each node its value and a byte with a bit for each child."""
    cubes: _Cubes = []
    below = [(0, 0, 0, DEPTH)]
    at, seen = 0, 0
    while below:
        x, y, z, level = below.pop()
        (odds,) = struct.unpack_from("<f", body, at)
        children = body[at + size]
        at, seen = at + size + 1, seen + 1
        if seen > nodes:
            raise Malformed(f"more nodes than the {nodes:,} of the header")
        if not children:
            if not odds < 0.0:  # what is no number counts as occupied
                cubes.append((x, y, z, level))
            continue
        if level == 0:
            raise Malformed(f"more than {DEPTH} levels")
        half = 1 << (level - 1)
        below += [
            (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2), level - 1)
            for child in range(7, -1, -1)
            if children >> child & 1
        ]
    if seen != nodes or at != len(body):
        raise Malformed(f"{seen:,} nodes in {len(body):,} bytes; the header says {nodes:,}")
    return cubes


def _cells(cubes: _Cubes, coarser: int) -> IntArray:
    """The cells of so many levels above the smallest that are in cubes of different sizes, or around them."""
    if not cubes:
        raise Malformed("no occupied cell")
    table = np.array(cubes, dtype=np.int64)
    low, levels = table[:, :3] >> coarser, np.maximum(table[:, 3] - coarser, 0)
    count = sum(8**level for level in levels.tolist())
    if count > MAX_CELLS:
        raise Malformed(f"{count:,} occupied cells; expected at most {MAX_CELLS:,}: name a coarser resolution")
    parts = []
    for level in np.unique(levels).tolist():
        side = np.arange(1 << level)
        steps = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
        parts.append((low[levels == level][:, None, :] + steps[None, :, :]).reshape(-1, 3))
    return np.asarray(np.concatenate(parts) - (1 << (DEPTH - 1) >> coarser))
