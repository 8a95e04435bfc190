"""A data set on disk: grown request by request, intact after every interruption, and the same bytes in the end.

A request is in the data set once its line is in ``meta/journal.jsonl``; the frames of its episode are written before,
in a file of their own. When a chunk of requests is complete, its tables are written and its journal is deleted. In a
packed data set the frames of a chunk then become one file; those of an unfinished chunk are in ``meta/frames`` as well.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from planner_service.datasets.episode import Episode, counter_stats
from planner_service.datasets.parquet import (
    TABLES,
    Rows,
    episode_bytes,
    joined_bytes,
    row_count,
    rows_of,
    table_bytes,
)
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import read_json

__all__ = ["EPISODE_PATH", "FILES_PER_FOLDER", "PACKED_PATH", "DatasetFolder"]

EPISODE_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
"""LeRobot's path pattern of version 2.1, by which readers find the file of an episode."""

PACKED_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
"""The same of version 3.0, for a file of many episodes."""

FILES_PER_FOLDER = 1000
"""Files of many episodes in each folder, LeRobot's own number."""

GROUP = 100
"""Requests per row group of a table; about 4 MB of journal are in memory at a time."""


class DatasetFolder(AbstractContextManager["DatasetFolder"]):
    """The folder of a data set, locked while it is open.

    Args:
        path: Created if missing; its parent must exist.
        settings: JSON values that decide every byte, except the number of requests.
        chunk: Requests per file of a table, and per packed file; episodes per folder of a data set that is not packed.
        packed: Whether the frames of a chunk become one file.

    Raises:
        InvalidRequest: the folder holds something else, was begun with other settings, or is in use.
        InvalidFile: it cannot be created or read.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any], chunk: int, *, packed: bool) -> None:
        self.path = path
        self._chunk, self._packed = chunk, packed
        self._journal = path / "meta" / "journal.jsonl"
        self._lock = self._locked()
        try:
            self._claim(settings)
            self.refresh()
        except BaseException:
            os.close(self._lock)
            raise

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    def refresh(self) -> None:
        """Count the finished requests, and delete what an interruption left incomplete."""
        with _as_invalid_file(self.path):
            self._refresh()

    def _refresh(self) -> None:
        for rest in self.path.rglob(".*.tmp"):
            rest.unlink()
        self.requests = self.episodes = self.frames = self._closed = 0
        while self._is_full(self.chunks):
            chunk, frames = self.chunks, self.frames
            for row in rows_of(self._table("requests", chunk), ("ok", "frames")):
                self._count(row)
            self._require_packed(chunk, self.frames - frames)
            self._closed = self.episodes
        kept = sum(len(line) for line in self._valid_lines())
        if self._journal.exists():
            os.truncate(self._journal, kept)
        if kept == 0:
            self._journal.unlink(missing_ok=True)
        first, present = self._closed if self._packed else 0, 0
        for file in self._loose.rglob("episode_*.parquet"):
            number = file.stem.removeprefix("episode_")
            if number.isdecimal() and not first <= int(number) < self.episodes:
                file.unlink()
            elif number.isdecimal():
                present += file == self._data(int(number))
        if present < self.episodes - first:
            raise InvalidFile(self._loose, [f"{self.episodes - first - present} of {self.episodes} episodes missing"])
        self._close_chunk()

    @property
    def chunks(self) -> int:
        """The number of complete chunks."""
        return self.requests // self._chunk

    def add(self, episode: Episode) -> None:
        """Add the next request with its frames."""
        rows = self._numbered(episode.rows)
        (request,) = rows["requests"]
        if episode.columns is not None:
            numbers = {"episode_index": self.episodes, "task_index": 0, "index": self.frames}
            self.write(self._data(self.episodes), [episode_bytes(episode.columns, numbers, request["frames"])])
        line = json.dumps(rows, allow_nan=False, separators=(",", ":")).encode("ascii") + b"\n"
        with _as_invalid_file(self._journal), open(self._journal, "ab") as journal:
            journal.write(line)
            journal.flush()  # writes everything or raises
            os.fsync(journal.fileno())
        self._count(request)
        self._close_chunk()

    def write_tables(self) -> None:
        """Write the frames and tables of the requests in the journal; requests last, as it implies the others."""
        if not self._journal.exists():
            return
        chunk = (self.requests - 1) // self._chunk
        if self._packed and self.episodes > self._closed:
            self.write(self.packed(chunk), [joined_bytes(map(self._data, range(self._closed, self.episodes)))])
        for name, content in table_bytes(self._groups()).items():
            self.write(self._table(name, chunk), [content])

    def write(self, file: Path, parts: Iterable[bytes]) -> None:
        """Write a file, whole or not at all, from parts of which one is in memory at a time.

        Raises:
            InvalidFile: it cannot be written, for example because the disk is full; finished episodes stay.
        """
        temporary = file.with_name(f".{file.name}.tmp")
        with _as_invalid_file(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            with open(temporary, "wb") as out:
                out.writelines(parts)
                out.flush()
                os.fsync(out.fileno())
            os.replace(temporary, file)

    def rows(self, table: str, columns: tuple[str, ...]) -> Iterator[dict[str, Any]]:
        """The rows of a table, from all its files in order."""
        for file in self.files(table):
            yield from rows_of(file, columns)

    def files(self, table: str) -> list[Path]:
        """The files of a table: one for each chunk, the last of which may be unfinished."""
        return [self._table(table, chunk) for chunk in range(-(-self.requests // self._chunk))]

    def packed(self, chunk: int) -> Path:
        """The file of a chunk's frames; there is none where no request of the chunk has an episode."""
        folder, file = divmod(chunk, FILES_PER_FOLDER)
        return self.path / PACKED_PATH.format(chunk_index=folder, file_index=file)

    def _locked(self) -> int:
        try:
            self.path.mkdir(exist_ok=True)
            lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InvalidFile(self.path, [f"cannot be a data set's folder: {reason}"]) from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            raise InvalidRequest("out", str(self.path), "a folder that no other process is writing to") from None
        return lock

    def _claim(self, settings: Mapping[str, Any]) -> None:
        """Check that the folder is a data set begun with these settings, or begin it."""
        about = self.path / "meta" / "generation.json"
        begun = {about.parent, about.with_name(f".{about.name}.tmp")}  # what a run interrupted at its beginning leaves
        if begun.issuperset(self.path.rglob("*")):
            self.write(about, [(json.dumps(settings, indent=1, allow_nan=False) + "\n").encode("ascii")])
        if not about.is_file():
            raise InvalidRequest("out", str(self.path), "a new or empty folder, or a data set to continue")
        begun_with = read_json(about)
        if not isinstance(begun_with, dict) or begun_with.get("format") != settings["format"]:
            raise InvalidRequest("out", str(self.path), "a data set; meta/generation.json is something else")
        for key in settings:
            if begun_with.get(key) != settings[key]:
                message = (
                    f"{self.path} was begun with {key} {begun_with.get(key)!r}; it cannot go on with {settings[key]!r}"
                )
                raise InvalidRequest(key, settings[key], f"{begun_with.get(key)!r}, or another folder", message=message)

    def _close_chunk(self) -> None:
        """If the chunk is complete, write its files and delete what they were made of."""
        if self.requests % self._chunk == 0:
            self.write_tables()
            self._journal.unlink(missing_ok=True)
            if self._packed:
                for episode in range(self._closed, self.episodes):
                    self._data(episode).unlink(missing_ok=True)
                self._closed = self.episodes

    def _require_packed(self, chunk: int, frames: int) -> None:
        """Refuse a full chunk whose file of frames is missing or not whole."""
        if self._packed and frames and (found := row_count(self.packed(chunk))) != frames:
            raise InvalidFile(self.packed(chunk), [f"{found} frames; expected {frames}"])

    def _is_full(self, chunk: int) -> bool:
        table = self._table("requests", chunk)
        if self.requests != chunk * self._chunk or not table.exists() or row_count(table) != self._chunk:
            return False
        for name in TABLES:
            row_count(self._table(name, chunk))  # raises if the table is missing or cut short
        return True

    def _valid_lines(self) -> Iterator[bytes]:
        """The valid lines of the journal, each counted, up to one that is out of order or lacks its frames."""
        if not self._journal.exists():
            return
        with open(self._journal, "rb") as journal:
            for line in journal:
                try:
                    (request,) = json.loads(line)["requests"] if line.endswith(b"\n") else ({},)
                    if request["request_index"] != self.requests:
                        return
                    if request["ok"] and row_count(self._data(self.episodes)) != request["frames"]:
                        return
                except (ValueError, KeyError, TypeError, InvalidFile):
                    return
                self._count(request)
                yield line

    def _count(self, request: Mapping[str, Any]) -> None:
        self.requests += 1
        self.episodes += bool(request["ok"])
        self.frames += request["frames"]

    def _numbered(self, rows: Rows) -> Rows:
        """Rows with the values that depend on earlier episodes: the indices of the episode and of its first frame."""
        (request,) = rows["requests"]
        episode = self.episodes if request["ok"] else None
        given: dict[str, Any] = {"episode_index": episode, "first_index": self.frames}
        if episode is not None:
            given["stats"] = json.dumps(rows["episodes"][0]["stats"] | self._counted_stats(request["frames"]))
        return {
            name: [row | {key: value for key, value in given.items() if key in TABLES[name]} for row in rows[name]]
            for name in TABLES
        }

    def _counted_stats(self, length: int) -> dict[str, dict[str, list[float]]]:
        """The statistics of the columns that depend on earlier episodes."""
        same = {"index": counter_stats(self.frames, length), "frame_index": counter_stats(0, length)}
        for name, value in (("episode_index", self.episodes), ("task_index", 0)):
            same[name] = {**counter_stats(value, 1), "count": [length]}
        return same

    def _groups(self) -> Iterator[Rows]:
        """The rows of the journal, a group of requests at a time."""
        with open(self._journal, "rb") as journal:
            while True:
                group: list[Rows] = [json.loads(line) for line in islice(journal, GROUP)]
                if not group:
                    return
                yield {name: [row for rows in group for row in rows[name]] for name in TABLES}

    @property
    def _loose(self) -> Path:
        """Where the files of single episodes are."""
        return self.path / ("meta/frames" if self._packed else "data")

    def _data(self, episode: int) -> Path:
        if self._packed:
            return self._loose / f"episode_{episode:06d}.parquet"
        return self.path / EPISODE_PATH.format(episode_chunk=episode // self._chunk, episode_index=episode)

    def _table(self, name: str, chunk: int) -> Path:
        return self.path / "tables" / name / f"chunk-{chunk:03d}.parquet"


@contextmanager
def _as_invalid_file(file: Path) -> Iterator[None]:
    """Turn an OSError into an InvalidFile."""
    try:
        yield
    except OSError as error:
        raise InvalidFile(file, [f"cannot be written: {error.strerror or error}"]) from error
