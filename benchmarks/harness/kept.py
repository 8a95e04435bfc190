"""What a long study has done already, in a file: the same command goes on after it, however it ended."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from benchmarks.harness.report import Row

__all__ = ["NONE", "Kept"]


class Kept:
    """Rows by what they are of, each appended to a file as soon as it is there.

    Args:
        path: The file, made if it is not there; None to keep nothing.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._rows = dict[str, Row]()
        if path is not None and path.exists():
            for line in path.read_text("utf-8").splitlines():
                try:
                    key, row = json.loads(line)
                except ValueError:  # it was ended while it wrote this
                    continue
                self._rows[key] = row

    def get(self, key: str) -> Row | None:
        """What was done of that; None if it was not."""
        return self._rows.get(key)

    def put(self, key: str, row: Row) -> None:
        """It is done."""
        if self._path is not None:
            self._rows[key] = row
            with self._path.open("a", encoding="utf-8") as file:
                file.write("\n" * self._broken() + json.dumps([key, row]) + "\n")

    def rows(self, key: str, make: Callable[[], Iterable[Row]] | None) -> list[Row]:
        """The rows of something: those that are kept, or those that are made, and kept all at once.

        Args:
            make: Makes them; None for rows that were not asked for, of which there are those that are kept.
        """
        done = self.get(key)
        if done is None and make is not None:
            done = {"rows": list(make())}
            self.put(key, done)
        return [] if done is None else list(done["rows"])

    def _broken(self) -> bool:
        """Whether the last line has no end."""
        assert self._path is not None
        if not self._path.exists() or not (size := self._path.stat().st_size):
            return False
        with self._path.open("rb") as file:
            file.seek(size - 1)
            return file.read() != b"\n"


NONE = Kept()
"""Keeps nothing."""
