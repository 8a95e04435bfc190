"""Reading the surface of binary glTF files, ``.glb`` of version 2 (Khronos, ISO/IEC 12113).

A file holds a description in JSON and one buffer. Meshes are read where the nodes of the scene put them; materials,
normals, cameras and animations are not. A file whose surface needs what is not in it, or depends on a pose, is refused:
other files, compression, sparse accessors, morphing, skins, lines and points. Coordinates are taken as they stand:
glTF calls +y up, and its numbers metres.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import FloatArray, IntArray, along, cross_of, dot, product
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import finite_tuple

__all__ = ["glb_surface"]

MAX_ROWS = 20_000
"""Nodes, meshes, accessors and views of the buffer, each; primitives of a mesh."""

HEADER, CHUNK = 12, 8
"""Bytes: magic, version and length of the file; length and kind of a chunk."""

FLOAT = 5126
WHOLE = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
"""Component types: of coordinates, and of corners."""

TRIANGLES = 4

LOOKS = ("NORMAL", "TANGENT", "COLOR_", "TEXCOORD_", "_")
"""Beginnings of the names of what vertices have beside their place; the last begins those of other programs."""


def glb_surface(data: bytes, most: int) -> tuple[FloatArray, IntArray]:
    """The vertices (n, 3) and triangles (t, 3) of the file's scene, each mesh where its nodes put it.

    Args:
        most: Vertices at most; and triangles, twice as many.

    Raises:
        Malformed: not the format, cut short, larger, or a surface that would not be whole.
    """
    described, buffer = _chunks(data)
    needed = described.get("extensionsRequired")
    if needed:
        raise Malformed(f"it needs {str(needed)[:80]}; export it without extensions")
    file = _File(described, buffer)
    vertices: list[FloatArray] = [np.empty((0, 3))]
    corners: list[IntArray] = [np.empty((0, 3), dtype=np.intp)]
    count = triangles = 0
    for frame, mesh in file.placed():
        for points, faces in file.mesh(mesh):
            vertices.append(along(points, frame[:3, :3]).T + frame[:3, 3])
            x, y, z = frame[:3, :3].tolist()
            corners.append((faces[:, ::-1] if dot(x, cross_of(y, z)) < 0.0 else faces) + count)
            count, triangles = count + len(points), triangles + len(faces)
            if count > most or triangles > 2 * most:
                raise Malformed(f"more than {most:,} vertices, or twice as many triangles, where its nodes put them")
    if triangles == 0:
        raise Malformed("no triangles in the scene of the file")
    return np.concatenate(vertices), np.concatenate(corners)


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The description in the first chunk, and the buffer in the second."""
    if data[:4] != b"glTF" or int.from_bytes(data[4:8], "little") != 2:
        raise Malformed("no binary glTF of version 2: the first bytes are wrong")
    size = int.from_bytes(data[12:16], "little")
    start = HEADER + CHUNK + size
    if int.from_bytes(data[8:12], "little") != len(data) or data[16:20] != b"JSON" or start > len(data):
        raise Malformed(f"cut short: {len(data):,} bytes are not those of its header")
    try:
        described = json.loads(data[HEADER + CHUNK : start])
    except (ValueError, RecursionError):
        raise Malformed("its JSON cannot be read") from None
    if not isinstance(described, dict):
        raise Malformed("its JSON is no object")
    length = int.from_bytes(data[start : start + 4], "little")
    if data[start + 4 : start + CHUNK] not in (b"BIN\0", b"") or start + CHUNK + length > max(len(data), start + CHUNK):
        raise Malformed("cut short: its buffer does not end in the file")
    return described, data[start + CHUNK : start + CHUNK + length]


class _File:
    """The tables of a description, and its buffer."""

    def __init__(self, described: dict[str, Any], buffer: bytes) -> None:
        self.buffer = buffer
        self.nodes = _rows(described, "nodes")
        self.meshes = _rows(described, "meshes")
        self.accessors = _rows(described, "accessors")
        self.views = _rows(described, "bufferViews")
        self.scenes = _rows(described, "scenes")
        self.scene = described.get("scene", 0)
        buffers = _rows(described, "buffers")
        if any("uri" in row for row in buffers) or len(buffers) > 1:
            raise Malformed("parts of it are in other files; export it as one .glb")

    def placed(self) -> list[tuple[FloatArray, int]]:
        """The frame of each node of the scene that has a mesh, and that mesh."""
        children = [self.numbers(node, "children", len(self.nodes)) for node in self.nodes]
        below = [child for each in children for child in each]
        if len(set(below)) != len(below):
            raise Malformed("a node that is the child of two; expected a tree")
        roots = sorted(set(range(len(self.nodes))) - set(below))
        if self.scenes:
            if not isinstance(self.scene, int) or not 0 <= self.scene < len(self.scenes):
                raise Malformed(f"scene {self.scene!r}; expected one of {len(self.scenes)}")
            named = self.numbers(self.scenes[self.scene], "nodes", len(self.nodes))
            if not set(named) <= set(roots):
                raise Malformed("the scene names a node that is not at the top, or in a circle")
            roots = named
        found = []
        open_nodes = [(np.eye(4), k) for k in reversed(roots)]
        while open_nodes:  # a forest, and begun at its roots: it ends
            above, k = open_nodes.pop()
            node = self.nodes[k]
            if "skin" in node or "weights" in node:
                raise Malformed(f"node {k}: a skin or morph weights move it; export it rigid")
            frame = product(above, _frame(node, k))
            if "mesh" in node:
                found.append((frame, self.one(node, "mesh", len(self.meshes))))
            open_nodes += [(frame, child) for child in reversed(children[k])]
        return found

    def mesh(self, k: int) -> list[tuple[FloatArray, IntArray]]:
        """Vertices and triangles of each primitive of a mesh."""
        found: list[tuple[FloatArray, IntArray]] = []
        for part in _rows(self.meshes[k], "primitives"):
            attributes = part.get("attributes")
            if part.get("mode", TRIANGLES) != TRIANGLES or "targets" in part or not isinstance(attributes, dict):
                raise Malformed(
                    f"mesh {k}: a primitive of mode {part.get('mode', 4)!r}, or morphed; expected triangles"
                )
            unknown = [name for name in attributes if name != "POSITION" and not name.startswith(LOOKS)]
            if unknown:
                raise Malformed(f"mesh {k}: vertices have {', '.join(unknown)[:80]}; expected no more than their looks")
            points = self.array(self.one(attributes, "POSITION", len(self.accessors)), "VEC3", {FLOAT: "<f4"})
            if "indices" in part:
                corners = self.array(self.one(part, "indices", len(self.accessors)), "SCALAR", WHOLE).reshape(-1)
            else:
                corners = np.arange(len(points))
            if len(corners) % 3 or (len(corners) and int(corners.max()) >= len(points)):
                raise Malformed(f"mesh {k}: corners that are no triangles of its {len(points):,} vertices")
            found.append((points.astype(np.float64), corners.reshape(-1, 3).astype(np.intp)))
        return found

    def array(self, k: int, kind: str, types: dict[int, str]) -> NDArray[Any]:
        """The numbers of an accessor, (count, 3) or (count, 1)."""
        accessor = self.accessors[k]
        form = types.get(accessor.get("componentType", 0))
        if accessor.get("type") != kind or form is None or "sparse" in accessor:
            raise Malformed(f"accessor {k}: expected {kind} of type {' or '.join(map(str, types))}, not sparse")
        view = self.views[self.one(accessor, "bufferView", len(self.views))]
        wide = 3 if kind == "VEC3" else 1
        size = np.dtype(form).itemsize * wide
        count, begin = _whole(accessor, "count"), _whole(view, "byteOffset") + _whole(accessor, "byteOffset")
        stride = _whole(view, "byteStride") or size
        end = _whole(view, "byteOffset") + _whole(view, "byteLength")
        if stride < size or end > len(self.buffer) or (count and begin + (count - 1) * stride + size > end):
            raise Malformed(f"accessor {k}: {count:,} rows are not all in the buffer of {len(self.buffer):,} bytes")
        if count == 0:
            return np.empty((0, wide), dtype=form)
        return np.ndarray((count, wide), form, self.buffer, begin, (stride, size // wide))

    def one(self, row: dict[str, Any], key: str, most: int) -> int:
        """The number of a row in another table."""
        return self.numbers({key: [row.get(key)]}, key, most)[0]

    def numbers(self, row: dict[str, Any], key: str, most: int) -> list[int]:
        found = row.get(key, [])
        if not isinstance(found, list) or not all(type(k) is int and 0 <= k < most for k in found):
            raise Malformed(f"{key} {str(found)[:40]}; expected whole numbers below {most}")
        return found


def _frame(node: dict[str, Any], k: int) -> FloatArray:
    """What a node does to points, as a homogeneous matrix (4, 4)."""
    try:
        if "matrix" in node:
            matrix = np.array(finite_tuple("matrix", node["matrix"], 16)).reshape(4, 4).T
            if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
                raise Malformed(f"node {k}: its matrix is not one of scaling, turning and moving")
            return matrix
        x, y, z = finite_tuple("translation", node.get("translation", [0.0, 0.0, 0.0]), 3)
        qx, qy, qz, qw = finite_tuple("rotation", node.get("rotation", [0.0, 0.0, 0.0, 1.0]), 4)
        scale = finite_tuple("scale", node.get("scale", [1.0, 1.0, 1.0]), 3)
        return np.asarray(Pose((x, y, z), (qw, qx, qy, qz)).matrix * [*scale, 1.0])
    except InvalidRequest as error:
        raise Malformed(f"node {k}: {error}") from None


def _rows(described: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """A table of objects."""
    found = described.get(key, [])
    if not isinstance(found, list) or len(found) > MAX_ROWS or not all(isinstance(row, dict) for row in found):
        raise Malformed(f"{key}: expected a list of at most {MAX_ROWS:,} objects")
    return found


def _whole(row: dict[str, Any], key: str) -> int:
    value = row.get(key, 0)
    if type(value) is not int or not 0 <= value < 2**31:
        raise Malformed(f"{key} {str(value)[:20]}; expected a whole number")
    return value
