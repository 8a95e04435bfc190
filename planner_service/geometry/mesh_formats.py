"""Reading mesh files: vertices and triangles of STL, OBJ, PLY, COLLADA and binary glTF.

A file gives all of its vertices or is refused: a lost vertex would be a hole in an obstacle. Materials, textures and
other files that it names are never opened. ``docs/design/libraries.md`` says why no library does this.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from planner_service.files.numerals import plain_float, plain_int
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.collada import dae_surface
from planner_service.geometry.gltf import glb_surface
from planner_service.geometry.validation import MAX_LENGTH, in_file

__all__ = [
    "MAX_BYTES",
    "MAX_TRIANGLES",
    "MAX_VERTICES",
    "MESH_SUFFIXES",
    "distinct",
    "has_faces",
    "read_triangles",
    "read_vertices",
]


MAX_BYTES = 50_000_000
"""A binary STL of a million triangles, three times the largest seen in a robot's description."""

MAX_VERTICES = 500_000
"""Distinct points of a mesh."""

MAX_TRIANGLES = 1_000_000
"""Triangles of a mesh: as many as a binary file of ``MAX_BYTES`` holds."""

STL_HEAD, STL_FACET = 84, 50
"""Bytes before the first triangle of a binary STL, and of each triangle."""

PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
PLY_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
MAX_HEADER = 10_000
"""Bytes of a PLY header."""

_Parsed = tuple[FloatArray, Callable[[], IntArray]]
"""The vertices of a file, repeated as in the file, and a function that reads its triangles: a hull needs none."""


def read_vertices(
    path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0), *, on_faces: bool = False
) -> FloatArray:
    """The vertices (n, 3) in a file, each once, times ``scale``; the suffix says which of the formats it has.

    Args:
        on_faces: Leave out vertices that no face uses: they are no part of the surface, and other readers drop them
            too. All are kept if the file has no faces, or if these cannot be read: more vertices make a larger hull.

    Raises:
        InvalidFile: another suffix, larger than 50 MB, not what the suffix says, malformed, no vertices or too many,
            or a coordinate that is not finite or beyond 1 km.
    """
    return in_file(
        path, lambda: _scaled(distinct(_on_faces(*_parsed(path)) if on_faces else _parsed(path)[0])[0], scale)
    )


def _on_faces(rows: FloatArray, read_corners: Callable[[], IntArray]) -> FloatArray:
    try:
        with np.errstate(all="ignore"):  # what is no number is found among the vertices
            corners = read_corners()
    except Malformed:
        return rows
    if corners.size == 0 or int(corners.min()) < 0 or int(corners.max()) >= len(rows):
        return rows
    used = np.zeros(len(rows), dtype=np.bool_)
    used[corners.reshape(-1)] = True
    return rows if used.all() else rows[used]


def read_triangles(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[FloatArray, IntArray]:
    """The vertices (n, 3) that ``read_vertices`` finds, and the triangles (t, 3) between them, as rows of vertices.

    Equal vertices count as one. A polygon becomes a fan of triangles around its first corner, a triangle without three
    distinct corners is left out, and triangles that a negative scale mirrors still face outwards.

    Raises:
        InvalidFile: what ``read_vertices`` refuses, no triangles or more than a million, or a corner
            that is no vertex.
    """
    return in_file(path, lambda: _triangles(path, scale))


def has_faces(path: Path) -> bool:
    """Whether a PLY file says that it has faces; one without is a cloud of points.

    Raises:
        InvalidFile: unreadable or larger than 50 MB.
    """
    count = re.search(rb"^element[ \t]+face[ \t]+([0-9]+)", read_bytes(path, MAX_BYTES)[:MAX_HEADER], re.MULTILINE)
    return count is not None and int(count.group(1)) > 0


def _triangles(path: Path, scale: tuple[float, float, float]) -> tuple[FloatArray, IntArray]:
    rows, read_corners = _parsed(path)
    corners = read_corners()
    if len(corners) > MAX_TRIANGLES:
        raise Malformed(f"{len(corners):,} triangles; expected at most {MAX_TRIANGLES:,}")
    if corners.size and not (int(corners.min()) >= 0 and int(corners.max()) < len(rows)):
        raise Malformed(f"a corner of a triangle is none of the {len(rows)} vertices")
    points, place = distinct(rows)
    faces = place[corners]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if len(faces) == 0:
        raise Malformed("no triangles")
    vertices = _scaled(points, scale)
    mirrored = sum(factor < 0.0 for factor in scale) % 2 == 1
    return vertices, faces[:, ::-1].copy() if mirrored else faces


def _parsed(path: Path) -> _Parsed:
    parse = _PARSERS.get(path.suffix.lower())
    if parse is None:
        raise Malformed(f"suffix {path.suffix!r}; expected one of {', '.join(MESH_SUFFIXES)}")
    data = read_bytes(path, MAX_BYTES)
    with np.errstate(invalid="ignore"):  # a signalling NaN is found later, like any other
        return parse(data)


def distinct(rows: FloatArray) -> tuple[FloatArray, IntArray]:
    """The distinct rows, sorted, and for each row its index among them."""
    with np.errstate(invalid="ignore"):  # a signalling NaN is found later, like any other
        if _ascending(rows):
            return rows, np.arange(len(rows), dtype=np.intp)
        order = np.lexsort(rows.T[::-1])  # several times as fast as np.unique, which compares rows as records
        fresh = np.ones(len(rows), dtype=np.bool_)
        fresh[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    place = np.empty(len(rows), dtype=np.intp)
    place[order] = np.cumsum(fresh) - 1
    return rows[order[fresh]], place


def _ascending(rows: FloatArray) -> bool:
    """Whether each row is larger than the one before it, in the first component in which they differ."""
    (x, y, z), (u, v, w) = rows[:-1].T, rows[1:].T
    return bool(((x < u) | ((x == u) & ((y < v) | ((y == v) & (z < w))))).all())


def _scaled(points: FloatArray, scale: tuple[float, float, float]) -> FloatArray:
    """Distinct points (n, 3) of a file, in metres."""
    if len(points) > MAX_VERTICES:
        raise Malformed(f"{len(points):,} distinct vertices; expected at most {MAX_VERTICES:,}")
    if len(points) == 0:
        raise Malformed("no vertices")
    with np.errstate(over="ignore"):
        points = points * np.array(scale)
    if not np.all(np.abs(points) <= MAX_LENGTH):
        raise Malformed(f"a vertex is not finite or more than {MAX_LENGTH:g} m from 0; is the scale right?")
    return np.asarray(points)


def _stl(data: bytes) -> _Parsed:
    count = int.from_bytes(data[80:STL_HEAD], "little") if len(data) >= STL_HEAD else -1
    if count >= 0 and len(data) == STL_HEAD + count * STL_FACET:
        facets = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("rest", "<u2")]), offset=84)
        rows = np.asarray(facets["v"].reshape(-1, 3), dtype=np.float64)
    else:
        if not data[:512].lstrip().lower().startswith(b"solid"):
            size = f"{len(data):,} bytes are not those of {max(count, 0):,} triangles"
            raise Malformed(f"no STL: {size}, nor is it text")
        text = _text(data)
        if not re.search(r"\bendsolid\b", text[-1000:], re.IGNORECASE):
            raise Malformed("STL text without its end")
        words = text.split()
        at = [k for k, word in enumerate(words) if word.lower() == "vertex"]
        if not at or len(at) % 3:
            raise Malformed(f"{len(at)} vertices in STL text; expected three for each triangle")
        rows = _rows((words[k + 1 : k + 4] for k in at), len(at))
    return rows, lambda: np.arange(len(rows), dtype=np.intp).reshape(-1, 3)


def _obj(data: bytes) -> _Parsed:
    lines = [line.lstrip() for line in _text(data).splitlines()]
    if not any(line.startswith(("f ", "f\t")) for line in lines):
        raise Malformed("an OBJ without a face: cut short, or no more than points")
    rows = [line.split()[1:4] for line in lines if line.startswith(("v ", "v\t"))]
    return _rows(rows, len(rows)), lambda: _obj_corners(lines)


def _obj_corners(lines: Sequence[str]) -> IntArray:
    """Corners are counted from 1, or backwards from the last vertex before their line; what follows a / is not read."""
    seen = 0
    fans: list[int] = []
    for line in lines:
        if line.startswith(("v ", "v\t")):
            seen += 1
        elif line.startswith(("f ", "f\t")):
            numbers = [_corner(word.partition("/")[0]) for word in line.partition("#")[0].split()[1:]]
            _fan([k - 1 if k > 0 else seen + k if -seen <= k < 0 else -1 for k in numbers], fans)
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _ply(data: bytes) -> _Parsed:
    end = re.search(rb"\nend_header[ \t\r]*\n", data[:MAX_HEADER])  # a comment may contain the word
    if not data.startswith(b"ply") or end is None:
        raise Malformed("no PLY: it does not begin with 'ply' and a header that ends")
    lines = [line.split() for line in _text(data[: end.start()]).splitlines()[1:] if line.strip()]
    formats = [words[1] for words in lines if words[0] == "format" and len(words) == 3]
    if len(formats) != 1 or formats[0] not in PLY_FORMATS:
        raise Malformed(f"PLY format {' '.join(formats) or 'is missing'}; expected one of {', '.join(PLY_FORMATS)}")
    header = [words for words in lines if words[0] not in ("comment", "obj_info", "format")]
    order, body = PLY_FORMATS[formats[0]], data[end.end() :]
    count, properties = _ply_element(header, 0, "vertex", MAX_VERTICES)
    for words in properties:
        if len(words) != 3 or words[0] != "property" or words[1] not in PLY_TYPES:
            raise Malformed(f"PLY vertex {' '.join(words)[:80]!r}; expected a plain number")
    names = [words[2] for words in properties]
    if len(set(names)) != len(names) or not set("xyz") <= set(names):
        raise Malformed(f"PLY vertices have {', '.join(names)[:80] or 'nothing'}; expected x, y and z, each once")
    if not order:
        text = _text(body).splitlines(keepends=True)
        if len(text) < count or (count and text[count - 1][-1] not in "\r\n"):  # its last number may have lost digits
            raise Malformed(f"cut short: the PLY header says {count} vertices")
        at = [names.index(axis) for axis in "xyz"]
        rows = _rows(([row[k] for k in at] for row in map(str.split, text[:count]) if len(row) == len(names)), count)
        return rows, lambda: _ply_text_corners(header, text[count:])
    row_type = np.dtype([(name, order + PLY_TYPES[kind]) for _, kind, name in properties])
    if len(body) < count * row_type.itemsize:
        raise Malformed(f"cut short: the PLY header says {count} vertices")
    table = np.frombuffer(body, row_type, count)
    rows = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    return rows, lambda: _ply_binary_corners(header, body[count * row_type.itemsize :], order)


def _ply_element(header: list[list[str]], index: int, name: str, most: int) -> tuple[int, list[list[str]]]:
    """How many rows an element of the header has, and the lines in words that say what is in each."""
    starts = [k for k, words in enumerate(header) if words[0] == "element"]
    words = header[starts[index]] if index < len(starts) else []
    if len(words) != 3 or words[1] != name or not re.fullmatch(r"[0-9]{1,9}", words[2]):
        place = ("first", "second")[index]
        raise Malformed(f"expected 'element {name} <count>' as the {place} element of the PLY header")
    count = int(words[2])
    if count > most:
        raise Malformed(f"{count:,} {name} rows; expected at most {most:,}")
    return count, header[starts[index] + 1 : [*starts, len(header)][index + 1]]


def _ply_faces(header: list[list[str]]) -> tuple[int, list[str], tuple[str, str], list[str]]:
    """How many faces, the types before the list of corners, those of its length and of its corners, those after."""
    count, properties = _ply_element(header, 1, "face", MAX_TRIANGLES)
    plain: tuple[list[str], list[str]] = ([], [])
    corners: list[tuple[str, str]] = []
    for words in properties:
        types = [PLY_TYPES.get(word, "") for word in words[1:-1]]
        if words[0] == "property" and len(words) == 3 and types[0]:
            plain[len(corners) > 0].append(types[0])
        elif words[:2] == ["property", "list"] and len(words) == 5 and {kind[:1] for kind in types[1:]} <= {"i", "u"}:
            if words[4] not in ("vertex_indices", "vertex_index") or corners:
                raise Malformed(f"PLY faces have a list {words[4][:80]!r}; expected vertex_indices alone")
            corners.append((types[1], types[2]))
        else:
            raise Malformed(f"PLY face {' '.join(words)[:80]!r}; expected a plain number or a list of corners")
    if not corners:
        raise Malformed("PLY faces have no list vertex_indices")
    return count, plain[0], corners[0], plain[1]


def _ply_text_corners(header: list[list[str]], lines: Sequence[str]) -> IntArray:
    faces, before, _, after = _ply_faces(header)
    if len(lines) < faces:
        raise Malformed(f"{len(lines)} faces; the PLY header says {faces}")
    fans: list[int] = []
    for words in map(str.split, lines[:faces]):
        many = _corner(words[len(before)]) if len(before) < len(words) else -1
        if many < 0 or len(words) != len(before) + 1 + many + len(after):
            raise Malformed("a PLY face whose number of corners is wrong")
        _fan([_corner(word) for word in words[len(before) + 1 :][:many]], fans)
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _ply_binary_corners(header: list[list[str]], body: bytes, order: str) -> IntArray:
    faces, before, sizes, after = _ply_faces(header)
    ahead, behind = (sum(np.dtype(kind).itemsize for kind in kinds) for kinds in (before, after))
    size, corner = (np.dtype(order + kind) for kind in sizes)
    fans: list[int] = []
    at = 0
    for _ in range(faces):
        at += ahead
        many = int(np.frombuffer(body, size, 1, at)[0]) if at + size.itemsize <= len(body) else -1
        end = at + size.itemsize + max(many, 0) * corner.itemsize + behind
        if many < 0 or end > len(body):
            raise Malformed(f"cut short: the PLY header says {faces} faces")
        _fan(np.frombuffer(body, corner, many, at + size.itemsize).tolist(), fans)
        at = end
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _fan(polygon: Sequence[int], fans: list[int]) -> None:
    """Append the triangles of a polygon, flat in ``fans``."""
    if len(polygon) < 3:
        raise Malformed(f"a face with {len(polygon)} corners; expected three or more")
    if len(fans) // 3 + len(polygon) - 2 > MAX_TRIANGLES:
        raise Malformed(f"more than {MAX_TRIANGLES:,} triangles")
    for b, c in pairwise(polygon[1:]):
        fans += (polygon[0], b, c)


def _corner(word: str) -> int:
    try:
        return plain_int(word)
    except ValueError as error:
        raise Malformed(f"{error} in a face; expected the number of a vertex") from None


def _text(data: bytes) -> str:
    try:
        return data.decode("ascii", "replace" if b"\0" not in data else "strict")  # names may be in any encoding
    except UnicodeDecodeError:
        raise Malformed("neither the binary format of its suffix nor text") from None


def _rows(rows: Iterable[list[str]], count: int) -> FloatArray:
    """Rows of three numbers as an array (count, 3)."""
    try:
        values = [plain_float(word) for words in rows for word in words]
    except ValueError as error:
        raise Malformed(f"{error} in a vertex; expected a number") from None
    if len(values) != 3 * count:
        raise Malformed("a vertex without three numbers")
    return np.array(values, dtype=np.float64).reshape(-1, 3)


def _glb(data: bytes) -> _Parsed:
    vertices, corners = glb_surface(data, MAX_VERTICES)
    return vertices, lambda: corners


_PARSERS: dict[str, Callable[[bytes], _Parsed]] = {
    ".stl": _stl,
    ".obj": _obj,
    ".ply": _ply,
    ".dae": dae_surface,
    ".glb": _glb,
}

MESH_SUFFIXES = tuple(_PARSERS)
"""Suffixes of the formats that are read."""
