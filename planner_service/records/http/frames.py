"""Frames of a channel: maps in msgpack, read as strictly as JSON files are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgpack

from planner_service.files.json_reader import each_once

__all__ = ["packed", "unpacked"]

MAX_LIST, MAX_KEYS = 100_000, 10_000
"""Entries of a list and of a map in a frame, for which room is made before they are read."""


def packed(frame: Mapping[str, Any], default: Callable[[Any], Any] | None = None) -> bytes:
    """The bytes of a frame.

    Args:
        default: Makes values of msgpack's of others.

    Raises:
        ValueError, TypeError: It has a value that msgpack has not.
    """
    try:
        return bytes(msgpack.packb(frame, default=default))
    except OverflowError as error:
        raise ValueError(str(error)) from None


def unpacked(data: bytes) -> Any:
    """The value that a frame holds.

    Raises:
        ValueError: It holds none, a key comes twice in a map, or a list or a map in it is too long.
    """
    try:
        return msgpack.unpackb(
            data, object_pairs_hook=each_once, max_array_len=MAX_LIST, max_map_len=MAX_KEYS, max_ext_len=0
        )
    except (ValueError, TypeError, RecursionError, MemoryError) as error:
        raise ValueError(f"no msgpack: {error!s:.200}") from None
