"""A folder of files that are called by the SHA-256 of their content, which is checked whenever one is read."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from planner_service.errors import BrokenInvariant, InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.writing import remove_leftovers, swap_in

__all__ = ["MAX_CONTENT", "ContentFiles", "StateUnusable", "sync_file"]

MAX_CONTENT = 50_000_000
"""Bytes of one file, as of a plan file."""

HASH = re.compile(r"[0-9a-f]{64}")


class StateUnusable(InvalidFile):
    """The folder of a server cannot be used now: the disk is full or has failed, or there is no access."""


class ContentFiles:
    """The files of one folder, which is created if it is not there.

    Only one process may write to it at a time; see ``Store``.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(mode=0o700, exist_ok=True)
        remove_leftovers(folder)

    def put(self, content: bytes) -> str:
        """Write a file, which then survives the end of this process, and return its hash; ``sync`` for more.

        Raises:
            InvalidFile: it is too large.
            StateUnusable: it cannot be written.
        """
        name = hashlib.sha256(content).hexdigest()
        path = self._path(name)
        if len(content) > MAX_CONTENT:
            raise InvalidFile(path, [f"too large: {len(content):,} bytes; at most {MAX_CONTENT:,}"])
        try:
            self._write(path, content)
        except OSError as error:
            raise StateUnusable(path, [f"cannot be written: {error.strerror or error}"]) from error
        return name

    def read(self, name: str) -> bytes:
        """The content with that hash.

        Raises:
            InvalidFile: it is missing, cannot be read, or is not what was written.
        """
        path = self._path(name)
        content = read_bytes(path, MAX_CONTENT)
        if hashlib.sha256(content).hexdigest() != name:
            raise InvalidFile(path, ["damaged: the SHA-256 of its content is not its name"])
        return content

    def is_whole(self, name: str) -> bool:
        """Whether ``read`` would return the content."""
        try:
            self.read(name)
        except InvalidFile:
            return False
        return True

    def sync(self, names: Iterable[str]) -> None:
        """Return when these files would survive a power cut; those no longer there are ignored.

        Raises:
            OSError: The disk failed.
        """
        for name in names:
            with suppress(FileNotFoundError):
                sync_file(self._path(name))
        sync_file(self.folder)

    def remove(self, names: Iterable[str]) -> None:
        """Delete files; no failure matters, since ``remove_others`` tries again."""
        for name in names:
            with suppress(OSError):
                self._path(name).unlink(missing_ok=True)

    def remove_others(self, kept: set[str]) -> None:
        """Delete all files called by a hash that is not in ``kept``, and nothing else."""
        with os.scandir(self.folder) as entries:
            self.remove([e.name for e in entries if HASH.fullmatch(e.name) and e.name not in kept])

    def __bool__(self) -> bool:
        """Whether there are any."""
        with os.scandir(self.folder) as entries:
            return any(HASH.fullmatch(entry.name) for entry in entries)

    def _write(self, path: Path, content: bytes) -> None:
        """Write a file that nothing names yet, unless it is there; one that was damaged is written anew."""
        try:
            with open(path, "xb") as file:
                file.write(content)
        except FileExistsError:
            if not self.is_whole(path.name):
                swap_in(path, content, sync=False)
        except OSError:
            path.unlink(missing_ok=True)
            raise

    def _path(self, name: str) -> Path:
        if not HASH.fullmatch(name):
            raise BrokenInvariant(f"the hash of a content is {name[:80]!r}; expected 64 hexadecimal digits")
        return self.folder / name


def sync_file(path: Path) -> None:
    """Return when a file, or the names in a folder, would survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
