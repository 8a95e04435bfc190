"""JSON files as plain values, refused before they take more time and memory than their size deserves."""

from __future__ import annotations

import json
import reprlib
from pathlib import Path
from typing import Any, NoReturn

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes

__all__ = ["MAX_BYTES", "each_once", "parse_json", "read_json"]

MAX_BYTES = 50_000_000
"""A plan of 10,000 waypoints takes about 5 MB; a larger file is no plan."""

MAX_KEY, MAX_KEYS = 500, 100_000
"""Characters of a key, and keys of an object."""

MAX_PARTS = 2_000_000
"""Lists and objects in a file: an empty one takes 60 bytes of memory and 2 of the file."""


def read_json(path: Path) -> Any:
    """The value in the JSON file at ``path``.

    Raises:
        InvalidFile: not a regular file, unreadable, over ``MAX_BYTES``, not UTF-8, malformed (with the
            line), with NaN or an infinity, with a key twice in one object, a key of more than 500 characters, or more
            than 100,000 keys in one object or 2,000,000 lists and objects.
    """
    return parse_json(path, read_bytes(path, MAX_BYTES))


def parse_json(path: Path, data: bytes) -> Any:
    """The value of a JSON text that a file at ``path`` holds.

    Raises:
        InvalidFile: as ``read_json``, but for the size.
    """
    if data.count(b"[") + data.count(b"{") > MAX_PARTS:
        raise InvalidFile(path, [f"too large: more than {MAX_PARTS:,} lists and objects"])
    try:
        return json.loads(data.decode("utf-8"), parse_constant=_refuse_constant, object_pairs_hook=each_once)
    except RecursionError:
        raise InvalidFile(path, ["malformed JSON: nested too deeply"]) from None
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8: byte {data[error.start]:#04x} at {error.start}"]) from None
    except ValueError as error:  # JSONDecodeError says where; an integer of thousands of digits is a plain ValueError
        raise InvalidFile(path, [f"malformed JSON: {error}"]) from None


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object, as the hook of a reader; ValueError if a key comes twice, or is too long, or there are too many."""
    content: dict[str, Any] = {}
    for name, value in pairs:
        if name in content:
            raise ValueError(f"key {reprlib.repr(name)} occurs twice in one object")
        if not isinstance(name, str) or len(name) > MAX_KEY:
            raise ValueError(f"key {reprlib.repr(name)} is longer than {MAX_KEY} characters")
        content[name] = value
    if len(content) > MAX_KEYS:
        raise ValueError(f"an object has more than {MAX_KEYS:,} keys")
    return content
