"""A cache on disk for results that take long to compute; losing an entry costs only time.

Nothing here fails: an entry that cannot be read counts as missing, one that cannot be written is dropped. Entries are
not to be trusted: anyone with write access to the folder may have written them, so the caller checks what it gets.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from planner_service.errors import BrokenInvariant, InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.writing import remove_leftovers, swap_in

__all__ = ["CACHE_VARIABLE", "DiskCache", "cache_folder"]

CACHE_VARIABLE = "PLANNER_SERVICE_CACHE"
"""The environment variable that names the cache folder; if it is empty, nothing is kept."""

MAX_ENTRY = 50_000_000
"""Bytes of one entry, as for a mesh file."""

MAX_FOLDER = 500_000_000
"""Bytes of all entries of a folder; the decompositions of a robot's meshes take about a megabyte."""

KEY = re.compile(r"[0-9a-f]{64}")
OURS = re.compile(r"[0-9a-f]{64}\.bin|\.(?:planner-service-)?[0-9a-f]{32}\.tmp")
"""Names of our files: nothing else in the folder is ever counted or deleted."""

DIGEST = hashlib.sha256().digest_size


def cache_folder(environment: Mapping[str, str] = os.environ) -> Path | None:
    """The cache folder: ``$PLANNER_SERVICE_CACHE``, else ``planner-service`` in the user's cache folder.

    None if that variable is empty, or if there is neither ``$XDG_CACHE_HOME`` (an absolute path) nor a home folder.
    """
    if CACHE_VARIABLE in environment:
        return Path(environment[CACHE_VARIABLE]) if environment[CACHE_VARIABLE] else None
    above = Path(environment.get("XDG_CACHE_HOME", ""))
    if not above.is_absolute():
        try:
            above = Path.home() / ".cache"
        except RuntimeError:  # no home is known
            return None
    return above / "planner-service"


@dataclass(frozen=True)
class DiskCache:
    """Entries by key in a folder that several processes may share; the oldest are deleted when there are too many.

    Attributes:
        folder: Created with the first entry; None keeps nothing.
        most_bytes: Of all entries together, 0.5 GB unless said otherwise.
    """

    folder: Path | None
    most_bytes: int = MAX_FOLDER

    def get(self, key: str) -> bytes | None:
        """The whole entry of ``key`` (64 hexadecimal digits), or None."""
        path = self._path(key)
        if path is None:
            return None
        try:
            stored = read_bytes(path, MAX_ENTRY + DIGEST)
        except InvalidFile:
            return None
        data = stored[DIGEST:]
        if stored[:DIGEST] != _digest(key, data):
            return None
        with suppress(OSError):
            os.utime(path)  # so that the oldest is the one not used for longest
        return data

    def put(self, key: str, data: bytes) -> None:
        """Keep ``data`` under ``key`` if possible; a reader gets the old entry or the new one, never a mixture."""
        path = self._path(key)
        if path is None or len(data) > MAX_ENTRY:
            return
        with suppress(OSError, ValueError):  # a full disk, a folder that is a file or not ours, a NUL in its name
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            remove_leftovers(path.parent)
            swap_in(path, _digest(key, data) + data)
            self._prune(path.parent)

    def _path(self, key: str) -> Path | None:
        if not KEY.fullmatch(key):
            raise BrokenInvariant(f"cache key {key[:80]!r}; expected 64 hexadecimal digits")
        return None if self.folder is None else self.folder / f"{key}.bin"

    def _prune(self, folder: Path) -> None:
        """Delete our oldest files until the rest is small enough."""
        files = []
        with os.scandir(folder) as entries:
            for entry in entries:
                if OURS.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    with suppress(FileNotFoundError):  # another process deletes too
                        about = entry.stat(follow_symlinks=False)
                        files.append((about.st_mtime_ns, entry.name, about.st_size))
        left = sum(size for _, _, size in files)
        for _, name, size in sorted(files):
            if left <= self.most_bytes:
                return
            (folder / name).unlink(missing_ok=True)
            left -= size


def _digest(key: str, data: bytes) -> bytes:
    return hashlib.sha256(key.encode() + data).digest()
