"""Files written whole or not at all, with the mode they had, and never in the place of a file of another kind."""

from __future__ import annotations

import fcntl
import os
import re
import stat
from contextlib import suppress
from pathlib import Path

from planner_service.errors import InvalidFile

__all__ = ["remove_leftovers", "require_writable", "swap_in", "write_whole"]

LEFTOVER = re.compile(r"\.planner-service-[0-9a-f]{32}\.tmp")
"""Names of files that are not whole yet. Who writes one holds a lock on it, which ends with its process."""

HEAD = 4_096
"""The first bytes of a file, which tell its kind."""


def require_writable(path: str | os.PathLike[str], ours: re.Pattern[bytes] | None = None) -> None:
    """Return if a file can be put at ``path``; call it before work whose result would be lost.

    Args:
        ours: What a file that is already there has to begin with, unless it is empty; anything if None.

    Raises:
        InvalidFile: it cannot, and why.
    """
    try:
        target = Path(os.path.realpath(path))
        regular = target.is_file() or not target.exists()
        if regular:
            probe = target.parent / _temporary_name()
            probe.touch(exist_ok=False)
            probe.unlink(missing_ok=True)
        head = b"" if ours is None or not target.is_file() else _head(target)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        missing = isinstance(error, FileNotFoundError)
        where = f"; the folder {target.parent} has to be there" if missing else ""
        raise InvalidFile(os.fspath(path), [f"cannot be written: {reason}{where}"]) from None
    if not regular:  # to put a file in the place of a device or a folder is never meant
        raise InvalidFile(os.fspath(path), ["cannot be written: it exists and is not a regular file"])
    if head and ours is not None and not ours.match(head):
        expected = "a file of another kind is there; remove it, or choose another name"
        raise InvalidFile(os.fspath(path), [f"cannot be written: {expected}"])


def write_whole(path: Path, content: str | bytes, ours: re.Pattern[bytes] | None = None) -> None:
    """Put ``content`` into the file at ``path``, or leave everything as it was.

    A file that is there keeps its mode; a new one has what the umask leaves.

    Args:
        ours: As for ``require_writable``.

    Raises:
        InvalidFile: the folder does not exist, may not be written, is full, or ``path`` is a folder, a device or a file
            of another kind.
    """
    require_writable(path, ours)
    try:
        target = Path(os.path.realpath(path))  # a link stays a link
        remove_leftovers(target.parent)
        swap_in(target, content.encode("utf-8") if isinstance(content, str) else content)
    except (OSError, ValueError) as error:
        raise InvalidFile(path, [f"cannot be written: {getattr(error, 'strerror', None) or error}"]) from error


def swap_in(target: Path, content: bytes, *, sync: bool = True) -> None:
    """Write a file beside ``target`` and put it in its place in one step; nothing is left of it after an OSError.

    Without ``sync`` the content survives the end of the process, and not yet a power cut.
    """
    try:
        mode = stat.S_IMODE(target.stat().st_mode)
    except FileNotFoundError:
        mode = None
    temporary = target.parent / _temporary_name()  # in another folder the exchange would not be atomic
    try:
        with os.fdopen(_locked(temporary, 0o666 if mode is None else mode & 0o700), "wb") as file:
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            if sync:
                os.fsync(file.fileno())
            os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def _locked(path: Path, mode: int) -> int:
    """The descriptor of a new file, locked as long as it is open."""
    while True:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        _lock(descriptor, wait=True)
        if path.exists():
            return descriptor
        os.close(descriptor)  # taken for a leftover before it was locked


def remove_leftovers(folder: Path) -> None:
    """Delete what processes that were killed while they wrote have left in a folder; no failure matters."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if LEFTOVER.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                with suppress(OSError):
                    _remove_if_left(entry.path)


def _remove_if_left(path: str) -> None:
    descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        if _lock(descriptor, wait=False):
            os.unlink(path)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, *, wait: bool) -> bool:
    """Lock an open file; False if that is not possible, or another process has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        return False
    return True


def _temporary_name() -> str:
    import uuid  # a plan writes no file

    return f".planner-service-{uuid.uuid4().hex}.tmp"


def _head(path: Path) -> bytes:
    with open(path, "rb") as file:
        return file.read(HEAD)
