"""Reading the points of PCD files, the format of the Point Cloud Library: text, binary, and binary compressed.

The header says which fields a point has, of which type and size; x, y and z are read, whatever stands around them.
A point with a coordinate that is no number is where the sensor saw nothing: it is left out, and a note says so.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.files.numerals import plain_floats, plain_ints
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import FloatArray

__all__ = ["pcd_points"]

MAX_HEADER = 10_000
"""Bytes."""

MAX_POINTS = 5_000_000
"""More than a file of 50 MB holds, unless it is compressed."""

MAX_UNPACKED = 400_000_000
"""Bytes of a compressed file: as many points of 80 bytes."""

KINDS = {"I": "i", "U": "u", "F": "f"}
SIZES = {"i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (4, 8)}
WORDS = ("VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
AT_ORIGIN = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


def pcd_points(data: bytes) -> tuple[FloatArray, tuple[str, ...]]:
    """The points (n, 3) of a PCD file, and notes on what is not used of it.

    Raises:
        Malformed: not the format, cut short, without x, y and z, or too many points.
    """
    end = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", data[:MAX_HEADER], re.MULTILINE)
    if end is None:
        raise Malformed("no PCD: expected a header whose last line is DATA ascii, binary or binary_compressed")
    header = _header(data[: end.start()])
    row = _row_type(header)
    count = _count(header)
    body, form = data[end.end() :], end.group(1).decode("latin-1")
    if form == "ascii":
        columns = _text(body, row, count)
    elif form == "binary":
        if len(body) < count * row.itemsize:
            raise Malformed(f"cut short: the header says {count:,} points")
        table = np.frombuffer(body, row, count)
        columns = [table[axis].reshape(count) for axis in "xyz"]
    elif form == "binary_compressed":
        columns = _compressed(body, row, count)
    else:
        raise Malformed(f"DATA {form}; expected ascii, binary or binary_compressed")
    with np.errstate(invalid="ignore"):
        points = np.stack([column.astype(np.float64) for column in columns], axis=-1)
    seen = ~np.isnan(points).any(axis=1)
    notes = []
    if not seen.all():
        notes.append(f"{count - int(seen.sum()):,} of {count:,} points have no coordinates (nan), and are left out")
    if header.get("VIEWPOINT") is not None and _numbers(header, "VIEWPOINT") != AT_ORIGIN:
        notes.append("VIEWPOINT has no effect: points are taken as they stand")
    return points[seen], tuple(notes)


def _header(text: bytes) -> dict[str, list[str]]:
    """The words after the first word of each line."""
    lines = [line.partition("#")[0].split() for line in text.decode("latin-1").splitlines()]
    header = {}
    for words in lines:
        if words:
            key = words[0].upper()
            if key not in WORDS or key in header:
                twice = "twice" if key in header else "no word of a PCD header"
                raise Malformed(f"{words[0][:40]!r} is {twice}; expected {', '.join(WORDS)}, each at most once")
            header["FIELDS" if key == "COLUMNS" else key] = words[1:]
    return header


def _row_type(header: dict[str, list[str]]) -> np.dtype[np.void]:
    """How one point is stored: its fields, packed, little-endian."""
    names = header.get("FIELDS", [])
    sizes, kinds = _whole(header, "SIZE"), header.get("TYPE", [])
    counts = _whole(header, "COUNT") if "COUNT" in header else [1] * len(names)
    if not {"x", "y", "z"} <= set(names):
        raise Malformed(f"FIELDS {' '.join(names)[:80] or 'are missing'}; expected x, y and z among them")
    if not len(names) == len(sizes) == len(kinds) == len(counts):
        raise Malformed("FIELDS, SIZE, TYPE and COUNT differ in length; expected one entry for each field")
    fields = []
    for k, (name, size, kind, many) in enumerate(zip(names, sizes, kinds, counts, strict=True)):
        if kind not in KINDS or size not in SIZES[KINDS[kind]] or not 0 <= many <= 10_000:
            raise Malformed(
                f"field {name[:40]!r}: TYPE {kind[:10]} of SIZE {size} x {many}; expected I, U or F of 1 to 8 bytes"
            )
        if name in "xyz" and (many != 1 or names.count(name) != 1):
            raise Malformed(f"field {name!r}; expected it once, with COUNT 1")
        fields.append((name if name in ("x", "y", "z") else f"field {k}", f"<{KINDS[kind]}{size}", (many,)))
    return np.dtype(fields)


def _count(header: dict[str, list[str]]) -> int:
    wide, high = _whole(header, "WIDTH"), _whole(header, "HEIGHT") if "HEIGHT" in header else [1]
    count = _whole(header, "POINTS") if "POINTS" in header else [wide[0] * high[0]] if wide and high else []
    if len(count) != 1 or len(wide) != 1 or len(high) != 1 or count[0] != wide[0] * high[0]:
        raise Malformed("POINTS is not WIDTH times HEIGHT; expected one number for each of them")
    if not 1 <= count[0] <= MAX_POINTS:
        raise Malformed(f"{count[0]:,} points; expected 1 to {MAX_POINTS:,}")
    return count[0]


def _whole(header: dict[str, list[str]], key: str) -> list[int]:
    try:
        return plain_ints(" ".join(header.get(key, [])))
    except ValueError as error:
        raise Malformed(f"{key}: got {error}; expected whole numbers") from None


def _numbers(header: dict[str, list[str]], key: str) -> list[float]:
    try:
        return plain_floats(" ".join(header[key]))
    except ValueError as error:
        raise Malformed(f"{key}: got {error}; expected numbers") from None


def _text(body: bytes, row: np.dtype[np.void], count: int) -> list[NDArray[Any]]:
    """The columns x, y, z of lines of words."""
    starts, at = {}, 0
    for name in row.names or ():
        starts[name] = at
        at += row[name].shape[0]
    lines = [line.split() for line in body.decode("latin-1").splitlines() if line.strip()]
    if len(lines) != count:
        raise Malformed(f"{len(lines):,} lines of points; the header says {count:,}")
    for k, words in enumerate(lines):
        if len(words) != at:
            raise Malformed(f"point {k}: {len(words)} numbers; the header says {at}")
    try:
        return [np.array(plain_floats(" ".join(words[starts[axis]] for words in lines))) for axis in "xyz"]
    except ValueError as error:
        raise Malformed(f"got {error} as a coordinate; expected a number") from None


def _compressed(body: bytes, row: np.dtype[np.void], count: int) -> list[NDArray[Any]]:
    """The columns x, y, z, each field stored for all points before the next one."""
    packed, unpacked = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
    if unpacked != count * row.itemsize or len(body) < 8 + packed:
        raise Malformed(f"cut short, or not {count:,} points of {row.itemsize} bytes")
    if unpacked > MAX_UNPACKED:
        raise Malformed(f"unpacks to {unpacked:,} bytes; expected at most {MAX_UNPACKED:,}")
    content = _unpacked(body[8 : 8 + packed], unpacked)
    offsets = {name: row.fields[name][1] * count for name in "xyz"} if row.fields else {}
    return [np.frombuffer(content, row[axis].base, count, offsets[axis]) for axis in "xyz"]


def _unpacked(data: bytes, size: int) -> bytearray:
    """LZF: runs of literal bytes, and copies of what came before (Marc Lehmann's liblzf describes the format)."""
    out, at = bytearray(), 0
    try:
        while at < len(data):
            control = data[at]
            at += 1
            if control < 32:
                out += data[at : at + control + 1]
                at += control + 1
            else:
                length = control >> 5
                if length == 7:
                    length += data[at]
                    at += 1
                back = ((control & 31) << 8 | data[at]) + 1
                at += 1
                length += 2
                start = len(out) - back
                if start < 0:
                    raise Malformed("compressed points that refer to what is not there")
                if back >= length:
                    out += out[start : start + length]
                else:
                    run = out[start:]
                    out += (run * (length // back + 1))[:length]
            if len(out) > size:
                break
    except IndexError:
        raise Malformed("cut short in compressed points") from None
    if len(out) != size:
        raise Malformed(f"compressed points are {len(out):,} bytes; the header says {size:,}")
    return out
