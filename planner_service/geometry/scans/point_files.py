"""Reading arrays and measured points from files, safely: no pickles, false headers, zip bombs or endless trees.

Points come from PLY, PCD, XYZ, LAS, LAZ, NPY and NPZ files and from OctoMap's trees; height fields from NPY and NPZ.
"""

from __future__ import annotations

import ast
import io
import zlib
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidFile, MissingDependency
from planner_service.files.numerals import plain_float
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.mesh_formats import MAX_BYTES, MAX_VERTICES, read_vertices
from planner_service.geometry.scans.octomap import octree_cells
from planner_service.geometry.scans.pcd import pcd_points
from planner_service.geometry.validation import in_file

__all__ = ["MAX_POINTS", "POINT_SUFFIXES", "TREES", "Scan", "arrays_of", "read_array", "read_scan"]

MAX_POINTS = MAX_VERTICES
"""Points of a cloud."""

MAX_NUMBERS = 16_000_000
"""Numbers of a file of points or heights: a byte of the file becomes eight, and a packed one thousands."""

ARRAYS = (".npz", ".npy")

TREES = (".bt", ".ot")

POINT_SUFFIXES = (".ply", *ARRAYS, ".pcd", ".xyz", ".las", ".laz", *TREES)
"""Files that hold measured points, or a tree of cells."""

MAX_HEADER = 10_000
"""Bytes of an NPY header, a Python literal: long ones are slow to parse."""

VERSIONS = {1: 2, 2: 4, 3: 4}
"""Bytes of the header's length, by major version of the format."""

MAGIC = b"\x93NUMPY"


@dataclass(frozen=True, eq=False)
class Scan:
    """What was measured: points, or the occupied cells of an octree.

    Attributes:
        points: (n, 3), metres times the file's unit; the centres of the cells of a tree.
        edge: Metres of the cells of a tree; None for points.
        cells: Those cells as whole numbers of edges (n, 3); None for points.
        notes: What the file says that is not used, a line each.
    """

    points: FloatArray
    edge: float | None = None
    cells: IntArray | None = None
    notes: tuple[str, ...] = ()


def read_array(path: Path, name: str) -> FloatArray:
    """The numbers in an NPY or NPZ file.

    Args:
        name: The array to read from an NPZ file that holds several.

    Raises:
        InvalidFile: another suffix, larger than 50 MB compressed or not, more than 16,000,000 numbers, not the format
            of its suffix, malformed, no array of that name, or anything but real numbers in it.
    """
    suffix = path.suffix.lower()
    if suffix not in ARRAYS:
        raise InvalidFile(path, [f"suffix {path.suffix!r}; expected one of {', '.join(ARRAYS)}"])
    data = read_bytes(path, MAX_BYTES)
    array = in_file(path, lambda: _npy(_member(data, name, MAX_BYTES) if suffix == ".npz" else data, MAX_NUMBERS))
    with np.errstate(all="ignore"):  # beyond the range of floats there is infinity
        return np.asarray(array, dtype=np.float64)


def read_scan(path: Path, resolution: float | None = None) -> Scan:
    """The points or cells in a file of ``POINT_SUFFIXES``; of a PLY file its vertices, of an NPZ file ``points``.

    Args:
        resolution: Of an octree (``octree_cells``).

    Raises:
        InvalidFile: another suffix, larger than 50 MB, not what the suffix says, malformed, or too many points.
        MissingDependency: a LAS or LAZ file, and laspy is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in POINT_SUFFIXES:
        raise InvalidFile(path, [f"suffix {path.suffix!r}; expected one of {', '.join(POINT_SUFFIXES)}"])
    if suffix in ARRAYS:
        return Scan(read_array(path, "points"))
    if suffix == ".ply":
        return Scan(read_vertices(path))
    return in_file(path, lambda: _scan(suffix, read_bytes(path, MAX_BYTES), resolution))


def _scan(suffix: str, data: bytes, resolution: float | None) -> Scan:
    if suffix == ".pcd":
        points, notes = pcd_points(data)
        return Scan(points, notes=notes)
    if suffix in TREES:
        cells, edge = octree_cells(data, resolution)
        return Scan(np.asarray((cells + 0.5) * edge), edge, cells)
    return Scan(_xyz(data) if suffix == ".xyz" else _las(data))


def _xyz(data: bytes) -> FloatArray:
    """Rows of x, y, z and perhaps more, which is not read; a header of names, or a number of points, may come first."""
    try:
        lines = [line.split("#")[0].replace(",", " ").replace(";", " ").split() for line in data.decode().splitlines()]
    except UnicodeDecodeError:
        raise Malformed("not UTF-8 text") from None
    rows = [(k, words) for k, words in enumerate(lines, 1) if words]
    axes = [0, 1, 2]
    if rows:
        first = [word.strip("\"'/").lower() for word in rows[0][1]]
        first = [word for word in first if word]
        if {"x", "y", "z"} <= set(first):
            axes, rows = [first.index(axis) for axis in "xyz"], rows[1:]
        elif len(first) == 1 and first[0].isdecimal():
            if int(first[0]) != len(rows) - 1:
                raise Malformed(f"line {rows[0][0]}: {first[0]} points; expected the {len(rows) - 1} that follow")
            rows = rows[1:]
    if not rows:
        raise Malformed("no points")
    wide = len(rows[0][1])
    points = np.empty((len(rows), 3))
    for k, (line, words) in enumerate(rows):
        if len(words) != wide or wide <= max(axes):
            raise Malformed(f"line {line}: {len(words)} numbers; expected x, y and z, and in each line as many numbers")
        try:
            points[k] = [plain_float(words[axis]) for axis in axes]
        except ValueError as error:
            raise Malformed(f"line {line}: got {error}; expected a number") from None
    return points


def _las(data: bytes) -> FloatArray:
    """The points of a LAS or LAZ file, in its own units."""
    try:
        import laspy
    except ModuleNotFoundError:
        raise MissingDependency("laspy", "las") from None
    try:
        with laspy.open(io.BytesIO(data)) as reader:
            count = reader.header.point_count
            if count > MAX_NUMBERS // 3:
                raise Malformed(f"{count:,} points; expected at most {MAX_NUMBERS // 3:,}")
            found = reader.read()
        points = np.asarray(found.xyz, dtype=np.float64)
    except Malformed:
        raise
    except Exception as error:  # the library raises whatever it stumbles over
        raise Malformed(f"laspy does not read it: {type(error).__name__}: {error}"[:200]) from None
    if len(points) != count:
        raise Malformed(f"cut short: {len(points):,} of {count:,} points")
    return points


def arrays_of(path: Path, most: int, known: Collection[str] | None = None) -> Callable[[str, str], NDArray[Any]]:
    """A function that reads arrays of an NPZ file by name and kind ("iu" integers, "f" floats); the file is read once.

    Args:
        most: Maximum bytes of the file and of each array.
        known: The arrays that it may have; None for any.

    Raises:
        InvalidFile: larger, not a file, unreadable, or with an array that is not known. The returned function raises
            it, too: no such array, a compressed one, or a malformed one.
    """
    data = read_bytes(path, most)
    if known is not None:
        unknown = sorted(set(in_file(path, lambda: _names(data))) - set(known))
        if unknown:
            raise InvalidFile(
                path, [f"{name[:40]!r}: no such array; known: {', '.join(known)}" for name in unknown[:5]]
            )

    def array(name: str, kinds: str) -> NDArray[Any]:
        numbers = in_file(path, lambda: _npy(_member(data, name, most, packed=False), most))
        if numbers.dtype.kind not in kinds:
            raise InvalidFile(path, [f"{name}: got numbers of type {numbers.dtype}; expected another kind of number"])
        return numbers

    return array


def _names(data: bytes) -> list[str]:
    """The names of the arrays in a zip archive."""
    import zipfile

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        raise Malformed(f"not an NPZ file: {error}") from None


def _member(data: bytes, name: str, most: int, *, packed: bool = True) -> bytes:
    """The one array file in a zip archive, or that called ``name``."""
    import zipfile  # few points come in an archive

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            info = members.get(name) or (next(iter(members.values())) if len(members) == 1 else None)
            if info is None:
                raise Malformed(f"holds {', '.join(sorted(members))[:80] or 'nothing'}; expected an array {name!r}")
            if not packed and (info.compress_type != zipfile.ZIP_STORED or info.file_size > len(data)):
                raise Malformed(f"{name}: compressed; expected it as numpy.savez writes it")
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise Malformed(f"compressed by method {info.compress_type}; expected what numpy writes")
            with archive.open(info) as file:
                content = file.read(most + 1)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError, ValueError) as error:
        raise Malformed(f"not an NPZ file: {error}") from None
    if len(content) > most:
        raise Malformed(f"unpacks to more than {most:,} bytes")
    return content


def _npy(data: bytes, most: int) -> NDArray[Any]:
    if not data.startswith(MAGIC) or len(data) < len(MAGIC) + 2 or data[len(MAGIC)] not in VERSIONS:
        raise Malformed("not an NPY file: the first bytes are wrong")
    start = len(MAGIC) + 2
    width = VERSIONS[data[len(MAGIC)]]
    length = int.from_bytes(data[start : start + width], "little")
    start += width
    if length > min(MAX_HEADER, len(data) - start):
        raise Malformed("an NPY header without its end")
    shape, dtype, by_columns = _header(data[start : start + length])
    count = int(np.prod([1, *shape], dtype=object))
    if count > most:
        raise Malformed(f"an array of shape {shape}; expected at most {most:,} numbers")
    body = data[start + length :]
    if len(body) != count * dtype.itemsize:
        raise Malformed(f"{len(body):,} bytes are not those of an array of shape {shape}")
    return np.frombuffer(body, dtype).reshape(shape, order="F" if by_columns else "C")


def _header(text: bytes) -> tuple[tuple[int, ...], np.dtype[np.generic], bool]:
    """Shape, type and order of an NPY file, from the literal in its header."""
    try:
        header = ast.literal_eval(text.decode("latin-1").strip())
        shape, kind, by_columns = header["shape"], header["descr"], header["fortran_order"]
        good = isinstance(shape, tuple) and all(type(size) is int and size >= 0 for size in shape)
        dtype = np.dtype(kind) if isinstance(kind, str) else np.dtype(object)
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError, IndexError):
        raise Malformed("an NPY header that cannot be read") from None
    if not good or len(shape) > 4 or dtype.kind not in "iuf" or not isinstance(by_columns, bool):
        raise Malformed(f"an array of {kind!r} with shape {shape!r}"[:120] + "; expected real numbers")
    return shape, dtype, by_columns
