"""A folder for one process: the lock on a file in it, which ends with its process however that ends."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from planner_service.errors import InvalidFile

__all__ = ["FolderLock"]


class FolderLock:
    """Creates ``folder`` if it is not there, and keeps other processes from using it until ``release``.

    Raises:
        InvalidFile: another process uses it, it holds other files and no lock, or it cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        self._descriptor = -1
        path = folder / "lock"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            if not path.exists() and any(folder.iterdir()):
                raise InvalidFile(folder, ["not the folder of a server: it holds other files; choose an empty one"])
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, str(os.getpid()).encode(), 0)
        except BlockingIOError:
            holder = os.pread(self._descriptor, 20, 0).decode("ascii", "replace")
            self.release()
            owner = f"process {holder}" if holder.isdecimal() else "another process"
            raise InvalidFile(folder, [f"in use by {owner}; each server needs a folder of its own"]) from None
        except OSError as error:
            self.release()
            raise InvalidFile(folder, [f"cannot be used: {error.strerror or error}"]) from error

    def release(self) -> None:
        """Let other processes use the folder."""
        with suppress(OSError):
            os.close(self._descriptor)
        self._descriptor = -1
