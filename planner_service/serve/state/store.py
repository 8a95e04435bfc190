"""What a server keeps in its folder: scenes with versions, roadmaps, and every job with its answer.

``index.db`` (SQLite) holds all of it; a document, a roadmap and an answer stand there once, under the SHA-256 of their
content, which is checked whenever one is read. ``lock`` is held by the one server that uses the folder. The folder must
be on a local disk.

How long things last:

- Whatever a method did survives the end of the process, at any moment after it returned.
- Scenes, roadmaps and jobs accepted before ``sync`` survive a power cut too. An answer does within about
  ``SYNC_SECONDS``; a power cut before that leaves its job as one to be run, and it has the same answer again.
- Of the jobs that have ended, the oldest are deleted beyond ``MAX_JOBS`` or ``MAX_BYTES``; of a scene, all but the
  latest ``MAX_VERSIONS`` versions. What a job reads stays as long as the job.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.serve.state.index import FolderLock, open_index

__all__ = [
    "ENDED",
    "MAX_BYTES",
    "MAX_CONTENT",
    "MAX_JOBS",
    "MAX_ROADMAPS",
    "MAX_SCENES",
    "MAX_VERSIONS",
    "Job",
    "ReusedKey",
    "SceneVersion",
    "StaleVersion",
    "State",
    "StateUnusable",
    "Store",
]

MAX_JOBS = 10_000
"""Ended jobs that are kept; a plan's answer takes about 20 kB."""

MAX_BYTES = 2_000_000_000
"""Bytes of the answers that are kept."""

MAX_CONTENT = 50_000_000
"""Bytes of one document, roadmap or answer, as of a plan file."""

MAX_VERSIONS = 20
"""Versions of a scene that are kept."""

MAX_SCENES, MAX_ROADMAPS = 1_000, 100
"""How many there may be at once; more are refused, since they go only when somebody deletes them."""

SYNC_SECONDS = 1.0
"""Between an answer and the start of writing it through to the disk, so that one turn of the disk serves many."""

LOG_LENGTH = 4_000
"""Pages in SQLite's log before it is moved into the database, in the background."""

TRANSACTION, PAGE = 4, 4_096
"""Pages that a transaction takes in the log, beside its contents, and bytes of a page."""

JOB = "id, kind, state, attempts, accepted, ended, answer, size, ok, reason"

DELETE_UNUSED = """
DELETE FROM contents WHERE hash = ?
    AND NOT EXISTS (SELECT 1 FROM jobs WHERE answer = contents.hash)
    AND NOT EXISTS (SELECT 1 FROM scenes WHERE content = contents.hash)
    AND NOT EXISTS (SELECT 1 FROM roadmaps WHERE content = contents.hash)
    AND NOT EXISTS (SELECT 1 FROM uses WHERE content = contents.hash)
"""


class StateUnusable(InvalidFile):
    """The folder of a server cannot be used now: the disk is full or has failed, or there is no access."""


class State(Enum):
    """How far a job is."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    REFUSED = "refused"  # the request turned out to be invalid when it was read; the answer says why
    CANCELLED = "cancelled"
    LOST = "lost"


ENDED = frozenset({State.DONE, State.REFUSED, State.CANCELLED, State.LOST})


@dataclass(frozen=True)
class SceneVersion:
    """One version of a scene.

    Attributes:
        hash: ``Scene.hash``.
        content: SHA-256 of its document.
    """

    name: str
    version: int
    hash: str
    content: str


@dataclass(frozen=True)
class Job:
    """A request that was accepted, and what has become of it.

    Attributes:
        id: 32 hexadecimal digits, drawn at random.
        kind: What is asked for: ``plan``, ``pick``.
        attempts: How often it has been started.
        accepted, ended: Seconds since 1970; None while it has not ended.
        answer: SHA-256 of its answer, ``size`` bytes; None without one.
        ok: Whether what it asked for was found; None if it has no answer.
        reason: Why it was not found, or was lost, in one word.
    """

    id: str
    kind: str
    state: State
    attempts: int
    accepted: float
    ended: float | None
    answer: str | None
    size: int
    ok: bool | None
    reason: str | None


class StaleVersion(InvalidRequest):
    """A scene was to be changed from another version than its latest.

    Attributes:
        latest: Its latest version; None if there is no scene of that name.
    """

    def __init__(self, name: str, given: int | None, latest: int | None) -> None:
        is_now = "there is none of that name" if latest is None else f"its latest version is {latest}"
        super().__init__("version", given, f"the latest version of scene {name!r}: {is_now}")
        self.latest = latest


class ReusedKey(InvalidRequest):
    """An idempotency key came with another request before."""

    def __init__(self, key: str) -> None:
        super().__init__("Idempotency-Key", key, "a new key: it came with another request before")


ANY_VERSION = 0
"""Changes a scene without regard to its latest version."""


class Store:
    """The folder of a server; used by one process at a time, and by all its threads.

    Args:
        folder: Created if its parent is there. Must be empty or made by a store.
        max_jobs, max_bytes: Of ended jobs and their answers that are kept; the latest always is.

    Every method raises ``StateUnusable`` if the folder cannot be read or written, and then has changed nothing.

    Raises:
        InvalidFile: another server uses the folder, it holds other files, or ``index.db`` is damaged.
    """

    def __init__(self, folder: Path, *, max_jobs: int = MAX_JOBS, max_bytes: int = MAX_BYTES) -> None:
        self._folder, self._max_jobs, self._max_bytes = folder, max_jobs, max_bytes
        self._lock, self._syncing = threading.Lock(), threading.Lock()
        self._written = self._synced = self._moved = 0  # pages of SQLite's log
        self._failure: OSError | None = None
        self._folder_lock = FolderLock(folder)
        try:
            self._due, self._closing = threading.Event(), threading.Event()
            self._index = open_index(folder / "index.db")
            ended = self._rows("SELECT count(*), coalesce(sum(size), 0) FROM jobs WHERE ended IS NOT NULL")[0]
            self._jobs, self._bytes = int(ended[0]), int(ended[1])
            self._shrink()
            sync_file(folder)
        except BaseException:
            self._folder_lock.release()
            raise
        self._syncer = threading.Thread(target=self._sync_in_background, name="store sync", daemon=True)
        self._syncer.start()

    @property
    def usable(self) -> bool:
        """Whether the disk has written everything through; if it once failed to, what is on it is unknown."""
        return self._failure is None

    # scenes

    def put_scene(
        self, name: str, scene_hash: str, document: bytes, *, expected: int | None = ANY_VERSION
    ) -> SceneVersion:
        """Keep a new version of a scene, numbered from 1; the same document again is no new version.

        Args:
            scene_hash: Of the scene that the document describes.
            expected: The latest version, None if there must be none yet; any by default.

        Raises:
            StaleVersion: The latest version is another.
            InvalidRequest: There are ``MAX_SCENES`` already.
        """
        with self._writing() as index:
            last, latest = self._latest(name)
            _require_latest(name, expected, latest)
            if latest is None:
                self._make_room_for_a_scene()
            content = self._put(document)
            if latest is not None and (latest.hash, latest.content) == (scene_hash, content):
                entry = latest
            else:
                entry = SceneVersion(name, last + 1, scene_hash, content)
                index.execute("INSERT INTO scenes VALUES (?, ?, ?, ?)", (name, entry.version, scene_hash, content))
                old = entry.version - MAX_VERSIONS
                self._release("DELETE FROM scenes WHERE name = ? AND version <= ? RETURNING content", (name, old))
        self.sync()
        return entry

    def scene(self, name: str, version: int | None = None) -> SceneVersion:
        """A scene's latest version, or the given one; ``content`` has its document.

        Raises:
            UnknownName: There is no scene of that name, or not that version.
        """
        with self._lock:
            _, latest = self._latest(name)
            if latest is None:
                raise UnknownName("scene", name, [entry.name for entry in self._all_scenes()])
            if version is None:
                return latest
            rows = self._rows("SELECT * FROM scenes WHERE name = ? AND content IS NOT NULL", name)
        versions = {row[1]: SceneVersion(*row) for row in rows}
        if version not in versions:
            raise UnknownName(f"version of scene {name}", str(version), map(str, versions))
        return versions[version]

    def scenes(self) -> list[SceneVersion]:
        """The latest version of every scene, by name."""
        with self._lock:
            return self._all_scenes()

    def delete_scene(self, name: str, *, expected: int | None = ANY_VERSION) -> None:
        """Delete a scene with all its versions; one of the same name later has higher versions.

        Raises:
            StaleVersion: The latest version is another.
            UnknownName: There is no scene of that name.
        """
        with self._writing() as index:
            last, latest = self._latest(name)
            if latest is None:
                raise UnknownName("scene", name, [entry.name for entry in self._all_scenes()])
            _require_latest(name, expected, latest)
            self._release("DELETE FROM scenes WHERE name = ? RETURNING content", (name,))
            index.execute("INSERT INTO scenes VALUES (?, ?, NULL, NULL)", (name, last + 1))
        self.sync()

    def _latest(self, name: str) -> tuple[int, SceneVersion | None]:
        """The last version number that a name had, 0 if none, and the scene, unless it was deleted."""
        rows = self._rows("SELECT * FROM scenes WHERE name = ? ORDER BY version DESC LIMIT 1", name)
        for row in rows:
            return row[1], None if row[3] is None else SceneVersion(*row)
        return 0, None

    def _all_scenes(self) -> list[SceneVersion]:
        latest = "SELECT name, max(version), hash, content FROM scenes GROUP BY name ORDER BY name"
        return [SceneVersion(*row) for row in self._rows(latest) if row[3] is not None]

    def _make_room_for_a_scene(self) -> None:
        """Forget which versions a deleted scene had, or refuse one more."""
        if self._rows("SELECT count(DISTINCT name) FROM scenes")[0][0] < MAX_SCENES:
            return
        latest = "SELECT name, max(version), content FROM scenes GROUP BY name"
        deleted = self._rows(f"SELECT name FROM ({latest}) WHERE content IS NULL LIMIT 1")
        if not deleted:
            raise InvalidRequest("scenes", MAX_SCENES + 1, f"at most {MAX_SCENES:,} scenes; delete one")
        self._index.execute("DELETE FROM scenes WHERE name = ?", deleted[0])

    # roadmaps

    def put_roadmap(self, roadmap_hash: str, file: bytes) -> None:
        """Keep the file of a roadmap under the roadmap's hash; the same one again changes nothing.

        Raises:
            InvalidRequest: There are ``MAX_ROADMAPS`` already.
        """
        with self._writing() as index:
            kept = dict(self._rows("SELECT hash, content FROM roadmaps"))
            if roadmap_hash not in kept:
                if len(kept) >= MAX_ROADMAPS:
                    raise InvalidRequest("roadmaps", MAX_ROADMAPS + 1, f"at most {MAX_ROADMAPS:,} roadmaps; delete one")
                index.execute("INSERT INTO roadmaps VALUES (?, ?)", (roadmap_hash, self._put(file)))
        self.sync()

    def roadmap(self, roadmap_hash: str) -> str:
        """The content that is the file of the roadmap with that hash.

        Raises:
            UnknownName: There is none.
        """
        with self._lock:
            kept = dict(self._rows("SELECT hash, content FROM roadmaps ORDER BY hash"))
        if roadmap_hash not in kept:
            raise UnknownName("roadmap", roadmap_hash, kept)
        content: str = kept[roadmap_hash]
        return content

    def delete_roadmap(self, roadmap_hash: str) -> None:
        """Delete a roadmap; jobs that use it keep its content.

        Raises:
            UnknownName: There is none with that hash.
        """
        self.roadmap(roadmap_hash)
        with self._writing():
            self._release("DELETE FROM roadmaps WHERE hash = ? RETURNING content", (roadmap_hash,))
        self.sync()

    # jobs

    def accept(
        self, kind: str, work: bytes, *, request: bytes, key: str | None = None, uses: Sequence[str] = ()
    ) -> tuple[Job, bool]:
        """A new job, or the one that was accepted with the same key; and whether it is new.

        Call ``sync`` before telling a client that its job is accepted.

        Args:
            work: What is to be done, in which nothing has to be looked up again; kept until the job has ended.
            request: As the client sent it: with the same key it must be the same.
            key: The client's idempotency key.
            uses: Hashes of contents that the job reads, which are kept as long as the job.

        Raises:
            ReusedKey: The key came with another request before.
        """
        fingerprint = _fingerprint(kind, request)
        with self._writing() as index:
            earlier = None if key is None else self._with_key(key, fingerprint)
            if earlier is not None:
                return earlier, False
            added = index.execute(
                "INSERT INTO jobs (id, kind, key, fingerprint, work, state, attempts, accepted, size)"
                f" VALUES (?, ?, ?, ?, ?, 'queued', 0, ?, 0) RETURNING number, {JOB}",
                (uuid.uuid4().hex, kind, key, fingerprint, work, time.time()),
            ).fetchone()
            index.executemany("INSERT INTO uses VALUES (?, ?)", [(added[0], content) for content in set(uses)])
            return _job(added[1:]), True

    def accepted(self, kind: str, request: bytes, key: str) -> Job | None:
        """The job that was accepted with the same key, if there is one.

        Raises:
            ReusedKey: The key came with another request before.
        """
        with self._lock:
            return self._with_key(key, _fingerprint(kind, request))

    def _with_key(self, key: str, fingerprint: str) -> Job | None:
        for kept, *job in self._rows(f"SELECT fingerprint, {JOB} FROM jobs WHERE key = ?", key):
            if kept != fingerprint:
                raise ReusedKey(key)
            return _job(job)
        return None

    def knows(self, key: str) -> bool:
        """Whether a job was accepted with that key."""
        with self._lock:
            return bool(self._rows("SELECT 1 FROM jobs WHERE key = ?", key))

    def change_work(self, job: str, work: bytes) -> None:
        """Keep other work for a job, unless it has ended."""
        with self._writing() as index:
            index.execute("UPDATE jobs SET work = ? WHERE id = ? AND ended IS NULL", (work, job))

    def start(self, job: str) -> int | None:
        """Note that a worker begins the job, and return how often one has by now; None if the job has ended.

        What is under way when the store is closed does not count.
        """
        with self._writing() as index:
            row = index.execute(
                "UPDATE jobs SET state = 'running', attempts = attempts + 1"
                " WHERE id = ? AND state IN ('queued', 'running') RETURNING attempts",
                (job,),
            ).fetchone()
        return None if row is None else int(row[0])

    def end(
        self,
        job: str,
        state: State,
        answer: bytes | None = None,
        *,
        ok: bool | None = None,
        reason: str | None = None,
    ) -> bool:
        """Keep what a job has come to; False, and nothing is kept, if it has ended already.

        Args:
            state: One of ``ENDED``.
            answer: Needed if the job is done or refused.
        """
        with self._writing():
            content, size = (None, 0) if answer is None else (self._put(answer), len(answer))
            row = self._index.execute(
                "UPDATE jobs SET state = ?, ended = ?, answer = ?, size = ?, ok = ?, reason = ?, work = NULL"
                " WHERE id = ? AND ended IS NULL RETURNING size",
                (state.value, time.time(), content, size, ok, reason, job),
            ).fetchone()
            if row is None:
                self._delete_unused([content])
                return False
            self._jobs, self._bytes = self._jobs + 1, self._bytes + size
            self._make_room_beside(job)
        return True

    def job(self, job: str) -> Job:
        """A job as it is now.

        Raises:
            UnknownName: There is none with that id, or it has been deleted.
        """
        with self._lock:
            rows = self._rows(f"SELECT {JOB} FROM jobs WHERE id = ?", job)
        if not rows:
            raise UnknownName("job", job, ())
        return _job(rows[0])

    def work(self, job: str) -> bytes:
        """The work that came with a job that has not ended.

        Raises:
            UnknownName: There is no such job.
        """
        with self._lock:
            rows = self._rows("SELECT work FROM jobs WHERE id = ? AND ended IS NULL", job)
        if not rows:
            raise UnknownName("job", job, ())
        return bytes(rows[0][0])

    def jobs(self, limit: int = 100, *, before: str | None = None) -> list[Job]:
        """At most so many jobs, the latest first; with ``before`` those accepted before that one.

        Raises:
            UnknownName: There is no such job.
        """
        with self._lock:
            number: Any = 2**62
            if before is not None:
                rows = self._rows("SELECT number FROM jobs WHERE id = ?", before)
                if not rows:
                    raise UnknownName("job", before, ())
                number = rows[0][0]
            latest = f"SELECT {JOB} FROM jobs WHERE number < ? ORDER BY number DESC LIMIT ?"
            return [_job(row) for row in self._rows(latest, number, limit)]

    def unfinished(self) -> list[Job]:
        """All jobs that have not ended, in the order in which they were accepted: what a new server has to do first."""
        waiting = f"SELECT {JOB} FROM jobs WHERE ended IS NULL ORDER BY number"
        with self._lock:
            return [_job(row) for row in self._rows(waiting)]

    def delete(self, job: str) -> bool:
        """Delete a job that has ended, and its answer; False if it has not ended or is not there."""
        with self._writing():
            return self._delete("id = ? AND ended IS NOT NULL", (job,)) > 0

    def content(self, content: str) -> bytes:
        """The document, roadmap or answer with that SHA-256.

        Raises:
            InvalidFile: It is not there, or not as it was written.
        """
        with self._lock:
            rows = self._rows("SELECT data FROM contents WHERE hash = ?", content)
        return self._whole(content, rows[0][0] if rows else None)

    def answer(self, job: str) -> tuple[Job, bytes | None]:
        """A job as it is now, and its answer if it has one.

        Raises:
            UnknownName: There is no such job.
        """
        with self._lock:
            rows = self._rows(f"SELECT {JOB}, data FROM jobs LEFT JOIN contents ON hash = answer WHERE id = ?", job)
        if not rows:
            raise UnknownName("job", job, ())
        found, data = _job(rows[0][:-1]), rows[0][-1]
        return found, None if found.answer is None else self._whole(found.answer, data)

    def _whole(self, content: str, data: bytes | None) -> bytes:
        """What was found under a hash."""
        if data is None or hashlib.sha256(data).hexdigest() != content:
            raise InvalidFile(self._folder / "index.db", ["damaged: the SHA-256 of a content is not its name"])
        return data

    def _shrink(self) -> None:
        """Delete what is beyond the limits, which may have been higher before, and give the room back to the disk."""
        with self._writing():
            self._make_room_beside("")
        free, pages = (self._rows(f"PRAGMA {name}")[0][0] for name in ("freelist_count", "page_count"))
        if free > pages // 2:
            self._index.execute("VACUUM")

    def _make_room_beside(self, job: str) -> None:
        """Delete the jobs that ended first, as many as are too many."""
        oldest = "number = (SELECT number FROM jobs WHERE ended IS NOT NULL AND id <> ? ORDER BY ended, number LIMIT 1)"
        while self._jobs > 1 and (self._jobs > self._max_jobs or self._bytes > self._max_bytes):
            self._delete(oldest, (job,))

    def _delete(self, which: str, parameters: tuple[Any, ...]) -> int:
        """Delete ended jobs, with what only they use; returns how many."""
        uses = self._rows(f"SELECT content FROM uses JOIN jobs ON job = number WHERE {which}", *parameters)
        rows = self._rows(f"DELETE FROM jobs WHERE {which} RETURNING answer, size", *parameters)
        self._delete_unused([name for name, *_ in uses + rows])
        self._jobs, self._bytes = self._jobs - len(rows), self._bytes - sum(size for _, size in rows)
        return len(rows)

    # the disk

    def sync(self) -> None:
        """Return when what the index says now survives a power cut; threads share one turn of the disk."""
        with self._lock:
            until = self._written
        try:
            with self._syncing:
                if self._synced < until:
                    with self._lock:
                        written = self._written
                    sync_file(self._folder / "index.db-wal")
                    self._synced = written
        except OSError as error:
            self._failure = error
        self._require_disk()

    def close(self) -> None:
        """Write everything through, and let another server have the folder; nothing more may be called."""
        self._closing.set()
        self._due.set()
        self._syncer.join()
        try:
            with self._writing() as index:
                index.execute("UPDATE jobs SET state = 'queued', attempts = attempts - 1 WHERE state = 'running'")
            self.sync()
            with self._lock:
                self._index.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        finally:
            with self._lock:
                self._index.close()
            self._folder_lock.release()

    def _sync_in_background(self) -> None:
        while not self._closing.is_set():
            self._due.wait()
            self._due.clear()
            if not self._closing.wait(SYNC_SECONDS):
                with suppress(StateUnusable, sqlite3.Error):  # the next call says so
                    self.sync()
                    self._move_log()

    def _move_log(self) -> None:
        """Have SQLite use its log from the beginning again, which it does once all of it is in the database.

        Most is moved over a connection of its own, while nobody waits; what was written meanwhile, while all do.
        """
        if self._synced - self._moved >= LOG_LENGTH:
            self._moved = self._synced
            with closing(sqlite3.connect(self._folder / "index.db", isolation_level=None)) as index:
                index.execute("PRAGMA wal_checkpoint(PASSIVE)")
                with self._lock:
                    index.execute("PRAGMA wal_checkpoint(PASSIVE)")

    def _require_disk(self) -> None:
        if self._failure is not None:
            raise StateUnusable(self._folder, [f"the disk failed: {self._failure.strerror or self._failure}"])

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction; an exception leaves nothing of it."""
        self._require_disk()
        with self._lock:
            counted = self._jobs, self._bytes
            try:
                self._index.execute("BEGIN IMMEDIATE")
                try:
                    yield self._index
                    self._index.execute("COMMIT")
                except BaseException:
                    self._jobs, self._bytes = counted
                    with suppress(sqlite3.Error):
                        self._index.execute("ROLLBACK")
                    raise
            except sqlite3.Error as error:
                raise StateUnusable(self._folder / "index.db", [f"cannot be written: {error}"]) from error
            self._written += TRANSACTION
        self._due.set()

    def _rows(self, query: str, *parameters: Any) -> list[tuple[Any, ...]]:
        try:
            return self._index.execute(query, parameters).fetchall()
        except sqlite3.Error as error:
            raise StateUnusable(self._folder / "index.db", [f"cannot be read: {error}"]) from error

    def _put(self, content: bytes) -> str:
        """Keep a content that the transaction names, unless it is there; one that was damaged is written anew."""
        name = hashlib.sha256(content).hexdigest()
        if len(content) > MAX_CONTENT:
            raise InvalidFile(self._folder, [f"too large: {len(content):,} bytes; at most {MAX_CONTENT:,}"])
        self._index.execute(
            "INSERT INTO contents VALUES (:name, :data) ON CONFLICT DO UPDATE SET data = :data WHERE data <> :data",
            {"name": name, "data": content},
        )
        self._written += len(content) // PAGE
        return name

    def _release(self, query: str, parameters: tuple[Any, ...]) -> None:
        """Delete the contents that a query returns, unless something else still refers to them."""
        self._delete_unused([row[0] for row in self._rows(query, *parameters)])

    def _delete_unused(self, names: Sequence[str | None]) -> None:
        self._index.executemany(DELETE_UNUSED, [(name,) for name in names])


def sync_file(path: Path) -> None:
    """Return when a file, or the names in a folder, would survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _require_latest(name: str, expected: int | None, latest: SceneVersion | None) -> None:
    now = None if latest is None else latest.version
    if expected not in (ANY_VERSION, now):
        raise StaleVersion(name, expected, now)


def _fingerprint(kind: str, request: bytes) -> str:
    return hashlib.sha256(kind.encode() + b"\0" + request).hexdigest()


def _job(row: Sequence[Any]) -> Job:
    job, kind, state, attempts, accepted, ended, answer, size, ok, reason = row
    found = None if ok is None else bool(ok)
    return Job(job, kind, State(state), attempts, accepted, ended, answer, size, found, reason)
