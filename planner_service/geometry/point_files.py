"""Reading arrays from NPY and NPZ files, and points from PLY files, safely: no pickles, false headers or zip bombs."""

from __future__ import annotations

import ast
import io
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh_formats import MAX_BYTES, MAX_VERTICES, read_vertices
from planner_service.geometry.validation import in_file

__all__ = ["MAX_POINTS", "arrays_of", "read_array"]

MAX_POINTS = MAX_VERTICES
"""Points of a cloud."""

MAX_NUMBERS = 4 * MAX_POINTS
"""Numbers of a cloud or height field: a byte of the file becomes eight, and a packed one thousands."""

MAX_HEADER = 10_000
"""Bytes of an NPY header, a Python literal: long ones are slow to parse."""

VERSIONS = {1: 2, 2: 4, 3: 4}
"""Bytes of the header's length, by major version of the format."""

MAGIC = b"\x93NUMPY"


def read_array(path: Path, name: str, suffixes: Sequence[str]) -> FloatArray:
    """The numbers in a file: the vertices (n, 3) of a PLY file, else the array that it holds.

    Args:
        name: The array to read from an NPZ file that holds several.

    Raises:
        InvalidFile: another suffix, larger than 50 MB compressed or not, more than 2,000,000 numbers, not the format of
            its suffix, malformed, no array of that name, or anything but real numbers in it.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise InvalidFile(path, [f"suffix {path.suffix!r}; expected one of {', '.join(suffixes)}"])
    if suffix == ".ply":
        return read_vertices(path)
    data = read_bytes(path, MAX_BYTES)
    array = in_file(path, lambda: _npy(_member(data, name, MAX_BYTES) if suffix == ".npz" else data, MAX_NUMBERS))
    with np.errstate(all="ignore"):  # beyond the range of floats there is infinity
        return np.asarray(array, dtype=np.float64)


def arrays_of(path: Path, most: int) -> Callable[[str, str], NDArray[Any]]:
    """A function that reads arrays of an NPZ file by name and kind ("iu" integers, "f" floats); the file is read once.

    Args:
        most: Maximum bytes of the file and of each array.

    Raises:
        InvalidFile: larger, not a file, or unreadable. The returned function raises it, too: no such array, a
            compressed one, or a malformed one.
    """
    data = read_bytes(path, most)

    def array(name: str, kinds: str) -> NDArray[Any]:
        numbers = in_file(path, lambda: _npy(_member(data, name, most, packed=False), most))
        if numbers.dtype.kind not in kinds:
            raise InvalidFile(path, [f"{name}: got numbers of type {numbers.dtype}; expected another kind of number"])
        return numbers

    return array


def _member(data: bytes, name: str, most: int, *, packed: bool = True) -> bytes:
    """The one array file in a zip archive, or that called ``name``."""
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
