"""Vertices and triangles of STL, OBJ and PLY files, vertices of COLLADA ones: read with care, nothing else followed.

Materials, textures and whatever else such a file names are never opened.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.collada import dae_vertices
from planner_service.geometry.shapes import MAX_LENGTH, FloatArray

__all__ = ["MAX_BYTES", "MAX_TRIANGLES", "MAX_VERTICES", "MESH_SUFFIXES", "IntArray", "read_triangles", "read_vertices"]

IntArray = NDArray[np.intp]

MAX_BYTES = 50_000_000
"""A binary STL of a million triangles, three times the largest seen in a robot's description."""

MAX_VERTICES = 500_000
"""Different points of a mesh."""

MAX_TRIANGLES = 1_000_000
"""Triangles of a mesh, as many as a file of that size has in binary."""

MAX_DIGITS = 64
"""Characters of a number; Python would read megabytes of digits."""

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


def read_vertices(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> FloatArray:
    """The vertices (n, 3) in an STL, OBJ, PLY or COLLADA file, each once, times ``scale``; told apart by the suffix.

    Raises:
        InvalidFile: another suffix, larger than 50 MB, not what the suffix says, malformed, no vertices or too many,
            or a coordinate that is not finite or beyond 1 km.
    """
    data = _content(path)
    try:
        return _placed(_different(_rows_of(path, data))[0], scale)
    except Malformed as error:
        raise InvalidFile(path, [str(error)]) from None


def read_triangles(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[FloatArray, IntArray]:
    """The vertices (n, 3) that ``read_vertices`` finds, and the triangles (t, 3) between them, as rows of vertices.

    Equal vertices are one, a polygon is a fan of triangles around its first corner, a triangle without three
    different corners is left out, and one that a negative scale mirrors keeps its outside outside.

    Raises:
        InvalidFile: what ``read_vertices`` refuses, no triangles or more than a million, or a corner that is no vertex.
    """
    data = _content(path)
    suffix = path.suffix.lower()
    if suffix not in _CORNERS:
        raise InvalidFile(path, [f"triangles of {suffix} files are not read; expected one of {', '.join(_CORNERS)}"])
    try:
        rows = _rows_of(path, data)
        corners = _CORNERS[suffix](data, len(rows))
        if len(corners) > MAX_TRIANGLES:
            raise Malformed(f"{len(corners):,} triangles; expected at most {MAX_TRIANGLES:,}")
        if corners.size and not (int(corners.min()) >= 0 and int(corners.max()) < len(rows)):
            raise Malformed(f"a corner of a triangle is none of the {len(rows)} vertices")
        points, place = _different(rows)
        faces = place[corners]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        if len(faces) == 0:
            raise Malformed("no triangles")
        vertices = _placed(points, scale)
    except Malformed as error:
        raise InvalidFile(path, [str(error)]) from None
    mirrored = sum(factor < 0.0 for factor in scale) % 2 == 1
    return vertices, faces[:, ::-1].copy() if mirrored else faces


def _content(path: Path) -> bytes:
    if path.suffix.lower() not in _READERS:
        raise InvalidFile(path, [f"suffix {path.suffix!r}; expected one of {', '.join(MESH_SUFFIXES)}"])
    return read_bytes(path, MAX_BYTES)


def _rows_of(path: Path, data: bytes) -> FloatArray:
    """The vertices in a file's content, as often as they are there."""
    with np.errstate(invalid="ignore"):  # a signalling NaN is found later, like any other
        return _READERS[path.suffix.lower()](data)


def _different(rows: FloatArray) -> tuple[FloatArray, IntArray]:
    """Each of the rows once, sorted, and where each of all rows is among them."""
    with np.errstate(invalid="ignore"):  # a signalling NaN is found later, like any other
        points, place = np.unique(rows, axis=0, return_inverse=True)
    return np.asarray(points), place.reshape(-1).astype(np.intp)


def _placed(points: FloatArray, scale: tuple[float, float, float]) -> FloatArray:
    """Different points (n, 3) of a file, in metres."""
    if len(points) > MAX_VERTICES:
        raise Malformed(f"{len(points):,} different vertices; expected at most {MAX_VERTICES:,}")
    if len(points) == 0:
        raise Malformed("no vertices")
    with np.errstate(over="ignore"):
        points = points * np.array(scale)
    if not np.all(np.abs(points) <= MAX_LENGTH):
        raise Malformed(f"a vertex is not finite or more than {MAX_LENGTH:g} m from 0; is the scale right?")
    return np.asarray(points)


def _stl(data: bytes) -> FloatArray:
    count = int.from_bytes(data[80:STL_HEAD], "little") if len(data) >= STL_HEAD else -1
    if count >= 0 and len(data) == STL_HEAD + count * STL_FACET:
        facets = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("rest", "<u2")]), offset=84)
        return np.asarray(facets["v"].reshape(-1, 3), dtype=np.float64)
    if not data[:512].lstrip().lower().startswith(b"solid"):
        raise Malformed(f"no STL: {len(data):,} bytes are not those of {max(count, 0):,} triangles, nor is it a text")
    text = _text(data)
    if not re.search(r"\bendsolid\b", text[-1000:], re.IGNORECASE):
        raise Malformed("an STL text without its end")
    words = text.split()
    at = [k for k, word in enumerate(words) if word.lower() == "vertex"]
    if not at or len(at) % 3:
        raise Malformed(f"{len(at)} vertices of an STL text; expected three for each triangle")
    return _rows((words[k + 1 : k + 4] for k in at), len(at))


def _stl_corners(data: bytes, count: int) -> IntArray:
    return np.arange(count, dtype=np.intp).reshape(-1, 3)


def _obj(data: bytes) -> FloatArray:
    lines = [line.lstrip() for line in _text(data).splitlines()]
    if not any(line.startswith(("f ", "f\t")) for line in lines):
        raise Malformed("an OBJ without a face: cut short, or no more than points")
    rows = [line.split()[1:4] for line in lines if line.startswith(("v ", "v\t"))]
    return _rows(rows, len(rows))


def _obj_corners(data: bytes, count: int) -> IntArray:
    """Corners are counted from 1, or backwards from the last vertex before their line; what follows a / is not read."""
    seen = 0
    fans: list[int] = []
    for line in map(str.lstrip, _text(data).splitlines()):
        if line.startswith(("v ", "v\t")):
            seen += 1
        elif line.startswith(("f ", "f\t")):
            named = [_whole(word.partition("/")[0]) for word in line.partition("#")[0].split()[1:]]
            _fan([k - 1 if k > 0 else seen + k if -seen <= k < 0 else -1 for k in named], fans)
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _ply(data: bytes) -> FloatArray:
    kind, lines, start = _ply_header(data)
    count, names, types = _ply_vertices(lines)
    if kind == "ascii":
        rows = _text(data[start:]).splitlines(keepends=True)[:count]
        if len(rows) < count or (rows and rows[-1][-1] not in "\r\n"):  # its last number may have lost digits
            raise Malformed(f"cut short: the PLY header says {count} vertices")
        at = [names.index(axis) for axis in "xyz"]
        return _rows(([words[k] for k in at] for words in map(str.split, rows) if len(words) == len(names)), count)
    dtype = _ply_row(kind, names, types)
    if len(data) - start < count * dtype.itemsize:
        raise Malformed(f"cut short: the PLY header says {count} vertices")
    table = np.frombuffer(data, dtype, count, start)
    return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)


def _ply_header(data: bytes) -> tuple[str, list[list[str]], int]:
    """The format, the lines in words, and where the rows begin."""
    end = re.search(rb"\nend_header[ \t\r]*\n", data[:MAX_HEADER])  # a comment may have the word, too
    if not data.startswith(b"ply") or end is None:
        raise Malformed("no PLY: it does not begin with 'ply' and a header that ends")
    start = end.end()
    lines = [line.split() for line in _text(data[: end.start()]).splitlines()[1:] if line.strip()]
    lines = [words for words in lines if words[0] not in ("comment", "obj_info")]
    kinds = [words[1] for words in lines if words[0] == "format" and len(words) == 3]
    if len(kinds) != 1 or kinds[0] not in PLY_FORMATS:
        raise Malformed(f"PLY format {' '.join(kinds) or 'is missing'}; expected one of {', '.join(PLY_FORMATS)}")
    return kinds[0], lines, start


def _ply_row(kind: str, names: Sequence[str], types: Sequence[str]) -> np.dtype[np.void]:
    return np.dtype([(name, PLY_FORMATS[kind] + number) for name, number in zip(names, types, strict=True)])


def _ply_vertices(lines: list[list[str]]) -> tuple[int, list[str], list[str]]:
    """How many vertices the header announces, and the names and types of their properties."""
    at = next((k for k, words in enumerate(lines) if words[0] == "element"), -1)
    if at < 0 or len(lines[at]) != 3 or lines[at][1] != "vertex" or not re.fullmatch(r"[0-9]{1,9}", lines[at][2]):
        raise Malformed("expected 'element vertex <count>' as the first element of the PLY header")
    properties = []
    for words in lines[at + 1 :]:
        if words[0] != "property":
            break
        if len(words) != 3 or words[1] not in PLY_TYPES:
            raise Malformed(f"PLY vertex {' '.join(words)[:80]!r}; expected a plain number")
        properties.append((words[2], PLY_TYPES[words[1]]))
    names = [name for name, _ in properties]
    if len(set(names)) != len(names) or not set("xyz") <= set(names):
        raise Malformed(f"PLY vertices have {', '.join(names)[:80] or 'nothing'}; expected x, y and z, each once")
    count = int(lines[at][2])
    if count > MAX_VERTICES:
        raise Malformed(f"{count:,} vertices; expected at most {MAX_VERTICES:,}")
    return count, names, [kind for _, kind in properties]


def _ply_corners(data: bytes, count: int) -> IntArray:
    """Of the second element, ``face``: its rows are one list each, before or after which there may be plain numbers."""
    kind, lines, start = _ply_header(data)
    faces, before, sizes, after = _ply_faces(lines)
    fans: list[int] = []
    if kind == "ascii":
        rows = _text(data[start:]).splitlines()[count : count + faces]
        for words in map(str.split, rows):
            many = _whole(words[len(before)]) if len(before) < len(words) else -1
            if len(words) != len(before) + 1 + many + len(after):
                raise Malformed("a PLY face without as many corners as it says")
            _fan([_whole(word) for word in words[len(before) + 1 :][:many]], fans)
        if len(rows) < faces:
            raise Malformed(f"{len(rows)} faces; the PLY header says {faces}")
        return np.array(fans, dtype=np.intp).reshape(-1, 3)
    _, names, types = _ply_vertices(lines)
    at = start + count * _ply_row(kind, names, types).itemsize
    ahead, behind = (sum(np.dtype(number).itemsize for number in numbers) for numbers in (before, after))
    size, corner = (np.dtype(PLY_FORMATS[kind] + number) for number in sizes)
    for _ in range(faces):
        at += ahead
        many = int(np.frombuffer(data, size, 1, at)[0]) if at + size.itemsize <= len(data) else -1
        end = at + size.itemsize + max(many, 0) * corner.itemsize + behind
        if many < 0 or end > len(data):
            raise Malformed(f"cut short: the PLY header says {faces} faces")
        _fan(np.frombuffer(data, corner, many, at + size.itemsize).tolist(), fans)
        at = end
    return np.array(fans, dtype=np.intp).reshape(-1, 3)


def _ply_faces(lines: list[list[str]]) -> tuple[int, list[str], tuple[str, str], list[str]]:
    """How many faces, the types before the list of corners, those of its length and of its corners, those after."""
    starts = [k for k, words in enumerate(lines) if words[0] == "element"]
    words = lines[starts[1]] if len(starts) > 1 else []
    if len(words) != 3 or words[1] != "face" or not re.fullmatch(r"[0-9]{1,9}", words[2]):
        raise Malformed("expected 'element face <count>' as the second element of the PLY header")
    if int(words[2]) > MAX_TRIANGLES:
        raise Malformed(f"{words[2]} faces; expected at most {MAX_TRIANGLES:,}")
    plain: tuple[list[str], list[str]] = ([], [])
    corners: list[tuple[str, str]] = []
    for row in lines[starts[1] + 1 : starts[2] if len(starts) > 2 else None]:
        types = [PLY_TYPES.get(word, "") for word in row[1:-1]]
        if row[0] == "property" and len(row) == 3 and types[0]:
            plain[len(corners) > 0].append(types[0])
        elif (
            row[0] == "property"
            and row[1:2] == ["list"]
            and len(row) == 5
            and {types[1][:1], types[2][:1]} <= {"i", "u"}
        ):
            if row[4] not in ("vertex_indices", "vertex_index") or corners:
                raise Malformed(f"PLY faces have a list {row[4][:80]!r}; expected vertex_indices alone")
            corners.append((types[1], types[2]))
        else:
            raise Malformed(f"PLY face {' '.join(row)[:80]!r}; expected a plain number or a list of corners")
    if not corners:
        raise Malformed("PLY faces have no list vertex_indices")
    return int(words[2]), plain[0], corners[0], plain[1]


def _fan(polygon: Sequence[int], fans: list[int]) -> None:
    """Append the triangles of a polygon, flat in ``fans``."""
    if len(polygon) < 3:
        raise Malformed(f"a face with {len(polygon)} corners; expected three or more")
    if len(fans) // 3 + len(polygon) - 2 > MAX_TRIANGLES:
        raise Malformed(f"more than {MAX_TRIANGLES:,} triangles")
    for b, c in pairwise(polygon[1:]):
        fans += (polygon[0], b, c)


def _whole(word: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,9}", word, re.ASCII):
        raise Malformed(f"{word[:20]!r} in a face; expected the number of a vertex")
    return int(word)


def _text(data: bytes) -> str:
    try:
        return data.decode("ascii", "replace" if b"\0" not in data else "strict")  # names may be in any encoding
    except UnicodeDecodeError:
        raise Malformed("neither binary in the way its suffix says, nor a text") from None


def _rows(rows: Iterable[list[str]], count: int) -> FloatArray:
    """Rows of three numbers as an array (count, 3)."""
    values: list[float] = []
    for words in rows:
        values.extend(map(_number, words))
    if len(values) != 3 * count:
        raise Malformed("a vertex without three numbers")
    return np.array(values, dtype=np.float64).reshape(-1, 3)


def _number(word: str) -> float:
    try:
        return float(word if len(word) <= MAX_DIGITS and "_" not in word else "")
    except ValueError:
        raise Malformed(f"{word[:20]!r} in a vertex; expected a number") from None


_Reader = Callable[[bytes], FloatArray]
_READERS: dict[str, _Reader] = {".stl": _stl, ".obj": _obj, ".ply": _ply, ".dae": dae_vertices}

_CORNERS: dict[str, Callable[[bytes, int], IntArray]] = {
    ".stl": _stl_corners,
    ".obj": _obj_corners,
    ".ply": _ply_corners,
}

MESH_SUFFIXES = tuple(_READERS)
"""Formats simple enough to be read with care."""
