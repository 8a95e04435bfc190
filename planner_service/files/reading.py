"""Reading files: regular ones only, up to a size; anything else raises ``InvalidFile`` with the reason."""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from planner_service.errors import InvalidFile, InvalidRequest

__all__ = ["as_path", "read_bytes", "tell_notes"]

logger = logging.getLogger(__name__)

TOLD = 20
"""Notes on one file that are logged."""


def as_path(field: str, value: object) -> Path:
    """The path a caller gave.

    Raises:
        InvalidRequest: neither a string nor a path of strings.
    """
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if not isinstance(text, str):
        raise InvalidRequest(field, value, "the path of a file")
    return Path(text)


def read_bytes(path: Path, most: int) -> bytes:
    """The content of the file at ``path``, at most ``most`` bytes of it.

    Raises:
        InvalidFile: not a regular file (a pipe would block, a device would never end), unreadable, or larger.
    """
    try:
        regular = stat.S_ISREG(os.stat(path).st_mode)  # checked before opening: opening a pipe waits for its writer
        data = b""
        if regular:
            with open(path, "rb") as file:
                data = file.read(most + 1)
    except FileNotFoundError:
        raise InvalidFile(path, ["no such file"]) from None
    except OSError as error:
        raise InvalidFile(path, [f"cannot be read: {error.strerror or error}"]) from None
    except ValueError as error:  # a NUL character or half a surrogate pair in the path
        raise InvalidFile(path, [f"cannot be read: {error}"]) from None
    if not regular:
        raise InvalidFile(path, ["not a file"])
    if len(data) > most:
        raise InvalidFile(path, [f"too large: more than {most:,} bytes"])
    return data


def tell_notes(path: Path, notes: Sequence[str]) -> None:
    """Log what was not understood of a file, or is not used, as warnings."""
    more = [f"and {len(notes) - TOLD} more; robot check shows them all"] if len(notes) > TOLD else []
    for note in (*notes[:TOLD], *more):
        logger.warning("%s: %s", path, note)
