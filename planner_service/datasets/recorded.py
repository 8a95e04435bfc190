"""Data sets in LeRobot's layout, whoever recorded them: what an arm was sent, and where it was."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner_service.datasets.parquet import rows_of
from planner_service.errors import InvalidFile
from planner_service.files.json_reader import read_json
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray

__all__ = ["RecordedEpisode", "RecordedSet"]

STATE, ACTION = "observation.state", "action"
"""The features of a data set that are read."""

ENDING = ".pos"
"""Behind the name of a joint where LeRobot means its position."""

MAX_FPS = 2000.0


@dataclass(frozen=True, eq=False)
class RecordedEpisode:
    """One episode: m frames of n joints.

    Attributes:
        number: As in the data set.
        times: Seconds since its beginning, (m,).
        states: Where the joints were, (m, n).
        actions: What they were sent, (m, n).
    """

    number: int
    times: FloatArray
    states: FloatArray
    actions: FloatArray


class RecordedSet:
    """A data set's folder, version 2.1 or 3.0.

    Args:
        folder: With ``meta/info.json``.
        joints: Names of the joints that are wanted; features name them so, with or without ``.pos`` behind.

    Attributes:
        fps: Frames a second.

    Raises:
        InvalidFile: no such data set, or without one of the joints.
    """

    def __init__(self, folder: str | Path, joints: tuple[str, ...]) -> None:
        self.folder = as_path("folder", folder)
        info = read_json(self.folder / "meta" / "info.json")
        features, fps = (info.get(key) if isinstance(info, dict) else None for key in ("features", "fps"))
        if not isinstance(features, dict) or isinstance(fps, bool) or not isinstance(fps, int | float):
            raise self._refusal("meta/info.json has no fps or no features")
        if not 0.0 < fps <= MAX_FPS:
            raise self._refusal(f"meta/info.json: fps = {fps} is no number in (0, {MAX_FPS:g}]")
        self.fps = float(fps)
        self._columns = {name: self._places(features, name, joints) for name in (STATE, ACTION)}

    def __iter__(self) -> Iterator[RecordedEpisode]:
        """The episodes, in the order of the files.

        Raises:
            InvalidFile: a file is missing, damaged, or holds something else than finite numbers.
        """
        kept: list[dict[str, Any]] = []
        for file in sorted((self.folder / "data").rglob("*.parquet")):
            for row in rows_of(file, (STATE, ACTION, "timestamp", "episode_index")):
                if kept and row["episode_index"] != kept[0]["episode_index"]:
                    yield self._episode(file, kept)
                    kept = []
                kept.append(row)
        if not kept:
            raise self._refusal("no frames in data")
        yield self._episode(self.folder / "data", kept)

    def _episode(self, file: Path, rows: list[dict[str, Any]]) -> RecordedEpisode:
        try:
            times = np.array([row["timestamp"] for row in rows], dtype=np.float64).reshape(len(rows))
            states, actions = (
                np.array([row[name] for row in rows], dtype=np.float64)[:, places]
                for name, places in self._columns.items()
            )
            number = int(rows[0]["episode_index"])
        except (TypeError, ValueError, IndexError) as error:
            raise InvalidFile(file, [f"frames are no rows of numbers: {error}"]) from None
        if not (np.isfinite(times).all() and np.isfinite(states).all() and np.isfinite(actions).all()):
            raise InvalidFile(file, [f"episode {number}: numbers that are not finite"])
        return RecordedEpisode(number, times, states, actions)

    def _places(self, features: dict[str, Any], name: str, joints: tuple[str, ...]) -> list[int]:
        """Where each joint is in the rows of a feature."""
        feature = features.get(name)
        names = feature.get("names") if isinstance(feature, dict) else None
        if isinstance(names, dict):  # older data sets have them under "motors"
            names = next((value for value in names.values() if isinstance(value, list)), None)
        if not isinstance(names, list) or not all(isinstance(each, str) for each in names):
            raise self._refusal(f"the feature {name} does not name its joints")
        plain = [each.removesuffix(ENDING) for each in names]
        missing = [joint for joint in joints if plain.count(joint) != 1]
        if missing:
            raise self._refusal(f"the feature {name} has no {missing[0]}, or twice; it has {', '.join(names)}")
        return [plain.index(joint) for joint in joints]

    def _refusal(self, what: str) -> InvalidFile:
        return InvalidFile(self.folder, [what])
