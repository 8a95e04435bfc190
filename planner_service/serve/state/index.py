"""The SQLite database that says what a server keeps, how it is opened and mistrusted, and the lock of its folder."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from contextlib import suppress
from pathlib import Path

from planner_service.errors import InvalidFile

__all__ = ["FolderLock", "open_index"]

APPLICATION = 0x706C616E
"""Tells SQLite's files of ours from others."""

SCHEMA = """
CREATE TABLE contents (
    hash TEXT PRIMARY KEY NOT NULL CHECK (length(hash) = 64 AND hash NOT GLOB '*[^0-9a-f]*'),
    data BLOB NOT NULL CHECK (typeof(data) = 'blob')
);
CREATE TABLE scenes (
    name TEXT NOT NULL CHECK (typeof(name) = 'text'),
    version INTEGER NOT NULL CHECK (typeof(version) = 'integer' AND version > 0),
    hash TEXT CHECK (length(hash) = 64 AND hash NOT GLOB '*[^0-9a-f]*'),
    content TEXT CHECK (length(content) = 64 AND content NOT GLOB '*[^0-9a-f]*'),
    PRIMARY KEY (name, version),
    CHECK ((hash IS NULL) = (content IS NULL))
) WITHOUT ROWID;
CREATE TABLE roadmaps (
    hash TEXT PRIMARY KEY NOT NULL CHECK (length(hash) = 64 AND hash NOT GLOB '*[^0-9a-f]*'),
    content TEXT NOT NULL CHECK (length(content) = 64 AND content NOT GLOB '*[^0-9a-f]*')
) WITHOUT ROWID;
CREATE TABLE jobs (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE CHECK (length(id) = 32 AND id NOT GLOB '*[^0-9a-f]*'),
    kind TEXT NOT NULL CHECK (typeof(kind) = 'text'),
    key TEXT UNIQUE CHECK (typeof(key) IN ('text', 'null')),
    fingerprint TEXT NOT NULL CHECK (typeof(fingerprint) = 'text'),
    work BLOB CHECK (typeof(work) IN ('blob', 'null')),
    state TEXT NOT NULL CHECK (state IN ('queued', 'running', 'done', 'refused', 'cancelled', 'lost')),
    attempts INTEGER NOT NULL CHECK (typeof(attempts) = 'integer' AND attempts BETWEEN 0 AND 1000000),
    accepted REAL NOT NULL CHECK (typeof(accepted) = 'real'),
    ended REAL CHECK (typeof(ended) IN ('real', 'null')),
    answer TEXT CHECK (length(answer) = 64 AND answer NOT GLOB '*[^0-9a-f]*'),
    size INTEGER NOT NULL CHECK (typeof(size) = 'integer' AND size BETWEEN 0 AND 1000000000),
    ok INTEGER CHECK (ok IN (0, 1)),
    reason TEXT CHECK (typeof(reason) IN ('text', 'null')),
    CHECK (answer IS NOT NULL OR state NOT IN ('done', 'refused')),
    CHECK (answer IS NULL OR ended IS NOT NULL),
    CHECK ((ended IS NOT NULL) = (state IN ('done', 'refused', 'cancelled', 'lost'))),
    CHECK ((work IS NULL) = (ended IS NOT NULL))
);
CREATE TABLE uses (
    job INTEGER NOT NULL REFERENCES jobs (number) ON DELETE CASCADE,
    content TEXT NOT NULL CHECK (length(content) = 64 AND content NOT GLOB '*[^0-9a-f]*'),
    PRIMARY KEY (job, content)
) WITHOUT ROWID;
CREATE INDEX jobs_answer ON jobs (answer);
CREATE INDEX jobs_ended ON jobs (ended, number);
CREATE INDEX scenes_content ON scenes (content);
CREATE INDEX uses_content ON uses (content);
"""


def open_index(path: Path) -> sqlite3.Connection:
    """A connection to the index, which is created if there is none.

    A transaction survives the end of the process once it is committed, and a power cut once the log beside the index
    is written through.

    Raises:
        InvalidFile: it is damaged, not ours, or cannot be used.
    """
    index: sqlite3.Connection | None = None
    new = not path.exists()
    try:
        index = sqlite3.connect(path, isolation_level=None, check_same_thread=False, cached_statements=256)
        os.chmod(path, 0o600)
        index.execute("PRAGMA trusted_schema = OFF")
        if new:
            _create(index)
        _require_ours(index)
        for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "wal_autocheckpoint = 0", "foreign_keys = ON"):
            index.execute(f"PRAGMA {pragma}")
    except (sqlite3.Error, OSError, ValueError) as error:
        if index is not None:
            index.close()
        raise InvalidFile(path, [f"damaged, or not the index of a server: {error}"]) from error
    return index


def _create(index: sqlite3.Connection) -> None:
    index.executescript(f"BEGIN IMMEDIATE; {SCHEMA} PRAGMA application_id = {APPLICATION}; COMMIT;")


def _require_ours(index: sqlite3.Connection) -> None:
    """Refuse a database that has other tables than ours, or triggers, or values that do not belong there.

    Raises:
        ValueError: It does.
    """
    tables = "SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY type, name"
    model = sqlite3.connect(":memory:", isolation_level=None)
    try:
        _create(model)
        same = index.execute(tables).fetchall() == model.execute(tables).fetchall()
    finally:
        model.close()
    if not same or index.execute("PRAGMA application_id").fetchone() != (APPLICATION,):
        raise ValueError("it has other tables, such as those of planner-service 0.3.0; restore it or empty the folder")
    problems = index.execute("PRAGMA integrity_check(5)").fetchall()
    if problems != [("ok",)]:
        raise ValueError("; ".join(str(row[0]) for row in problems))
    if index.execute("PRAGMA foreign_key_check").fetchall():
        raise ValueError("contents of jobs that are not there")


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
