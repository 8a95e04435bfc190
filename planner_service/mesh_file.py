"""The vertices of STL, OBJ, PLY and COLLADA files, read with care: nothing else is needed, and nothing else followed.

Materials, textures and whatever else such a file names are never opened.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from planner_service.dae_file import dae_vertices
from planner_service.errors import InvalidFile
from planner_service.geometry import MAX_LENGTH, FloatArray
from planner_service.regular_file import read_bytes
from planner_service.xml_file import Malformed

__all__ = ["MAX_BYTES", "MAX_VERTICES", "MESH_SUFFIXES", "read_vertices"]

MAX_BYTES = 50_000_000
"""A binary STL of a million triangles, three times the largest seen in a robot's description."""

MAX_VERTICES = 500_000
"""Different points of a mesh."""

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
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InvalidFile(path, [f"suffix {path.suffix!r}; expected one of {', '.join(MESH_SUFFIXES)}"])
    data = read_bytes(path, MAX_BYTES)
    try:
        points: FloatArray = np.unique(reader(data), axis=0)
        if len(points) > MAX_VERTICES:
            raise Malformed(f"{len(points):,} different vertices; expected at most {MAX_VERTICES:,}")
        if len(points) == 0:
            raise Malformed("no vertices")
        with np.errstate(over="ignore"):
            points = points * np.array(scale)
        if not np.all(np.abs(points) <= MAX_LENGTH):
            raise Malformed(f"a vertex is not finite or more than {MAX_LENGTH:g} m from 0; is the scale right?")
    except Malformed as error:
        raise InvalidFile(path, [str(error)]) from None
    return np.asarray(points)


def _stl(data: bytes) -> FloatArray:
    count = int.from_bytes(data[80:STL_HEAD], "little") if len(data) >= STL_HEAD else -1
    if len(data) == STL_HEAD + count * STL_FACET:
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


def _obj(data: bytes) -> FloatArray:
    lines = [line.split()[1:4] for line in _text(data).splitlines() if line.startswith(("v ", "v\t"))]
    return _rows(lines, len(lines))


def _ply(data: bytes) -> FloatArray:
    end = data.find(b"end_header", 0, MAX_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise Malformed("no PLY: it does not begin with 'ply' and a header")
    start = data.find(b"\n", end) + 1
    if start == 0:
        raise Malformed("a PLY header without its end")
    lines = [line.split() for line in _text(data[:end]).splitlines()[1:] if line.strip()]
    lines = [words for words in lines if words[0] not in ("comment", "obj_info")]
    kinds = [words[1] for words in lines if words[0] == "format" and len(words) == 3]
    if len(kinds) != 1 or kinds[0] not in PLY_FORMATS:
        raise Malformed(f"PLY format {' '.join(kinds) or 'is missing'}; expected one of {', '.join(PLY_FORMATS)}")
    count, names, types = _ply_vertices(lines)
    if kinds[0] == "ascii":
        rows = _text(data[start:]).splitlines()[:count]
        if len(rows) < count:
            raise Malformed(f"{len(rows)} vertices; the PLY header says {count}")
        at = [names.index(axis) for axis in "xyz"]
        return _rows(([words[k] for k in at] for words in map(str.split, rows) if len(words) == len(names)), count)
    dtype = np.dtype([(name, PLY_FORMATS[kinds[0]] + kind) for name, kind in zip(names, types, strict=True)])
    if len(data) - start < count * dtype.itemsize:
        raise Malformed(f"cut short: the PLY header says {count} vertices")
    table = np.frombuffer(data, dtype, count, start)
    return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)


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

MESH_SUFFIXES = tuple(_READERS)
"""Formats simple enough to be read with care."""
