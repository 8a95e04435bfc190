"""What LeRobot reads of a data set beside the frames, in the layout of its version 3.0 or 2.1.

Version 3.0 has many episodes in a file and describes them in Parquet; 2.1 has a file per episode and lines of JSON.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from planner_service.datasets.card import EpisodesSummary
from planner_service.datasets.episode import EpisodeWork
from planner_service.datasets.folder import EPISODE_PATH, FILES_PER_FOLDER, PACKED_PATH, DatasetFolder
from planner_service.datasets.parquet import REAL, TEXT, WHOLE, rows_of, sheet_bytes
from planner_service.geometry.arrays import FloatArray

__all__ = ["info_of", "write_meta"]

EPISODES_PATH = "meta/episodes/chunk-{:03d}/file-{:03d}.parquet"

FILE_MEGABYTES = {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
"""The sizes at which LeRobot begins another file when it adds episodes itself; its own defaults."""


def info_of(work: EpisodeWork, summary: EpisodesSummary) -> dict[str, Any]:
    """The content of ``meta/info.json``."""
    info = {
        "codebase_version": work.layout,
        "robot_type": work.robot.name,
        "total_episodes": summary.episodes,
        "total_frames": summary.frames,
        "total_tasks": 1,
        "chunks_size": FILES_PER_FOLDER,
        "fps": work.fps,
        "splits": {"train": f"0:{summary.episodes}"},
        "data_path": PACKED_PATH,
        "video_path": None,
        "features": work.features,
    }
    if work.layout == "v3.0":
        return info | FILE_MEGABYTES
    folders = -(-summary.episodes // work.chunk)
    return info | {
        "total_videos": 0,
        "total_chunks": folders,
        "chunks_size": work.chunk,
        "data_path": EPISODE_PATH,
    }


def write_meta(folder: DatasetFolder, work: EpisodeWork, info: dict[str, Any]) -> None:
    """Write the files in ``meta`` that describe the whole data set.

    Raises:
        InvalidFile: one cannot be written.
    """
    meta, sentence = folder.path / "meta", work.task.sentence
    folder.write(meta / "info.json", [(json.dumps(info, indent=4) + "\n").encode()])
    if work.layout == "v2.1":
        folder.write(meta / "tasks.jsonl", [_line({"task_index": 0, "task": sentence})])
        lengths, figures = (folder.rows("episodes", ("episode_index", name)) for name in ("length", "stats"))
        episodes = ({"episode_index": r["episode_index"], "tasks": [sentence], "length": r["length"]} for r in lengths)
        folder.write(meta / "episodes.jsonl", map(_line, episodes))
        folder.write(meta / "episodes_stats.jsonl", (_line(r | {"stats": json.loads(r["stats"])}) for r in figures))
        return
    tasks = sheet_bytes([{"task_index": 0, "task": sentence}], {"task_index": WHOLE, "task": TEXT}, index="task")
    folder.write(meta / "tasks.parquet", [tasks])
    together: dict[str, _Together] = {}
    for chunk, file in enumerate(folder.files("episodes")):
        rows = [_described(row, chunk, sentence, together) for row in rows_of(file, COLUMNS)]
        if rows:
            kinds = {name: _kind(name, value) for name, value in rows[0].items()}
            place = folder.path / EPISODES_PATH.format(*divmod(chunk, FILES_PER_FOLDER))
            folder.write(place, [sheet_bytes(rows, kinds)])
    stats = {name: joined.stats for name, joined in together.items()}
    folder.write(meta / "stats.json", [(json.dumps(stats, indent=4, allow_nan=False) + "\n").encode("ascii")])


COLUMNS = ("episode_index", "first_index", "length", "stats")


def _described(row: dict[str, Any], chunk: int, sentence: str, together: dict[str, _Together]) -> dict[str, Any]:
    """The row of an episode in version 3.0; its statistics are joined to those of the others."""
    folder, file = divmod(chunk, FILES_PER_FOLDER)
    out = {
        "episode_index": row["episode_index"],
        "tasks": [sentence],
        "length": row["length"],
        "data/chunk_index": folder,
        "data/file_index": file,
        "dataset_from_index": row["first_index"],
        "dataset_to_index": row["first_index"] + row["length"],
    }
    for name, stats in json.loads(row["stats"]).items():
        together.setdefault(name, _Together()).add(stats)
        out |= {f"stats/{name}/{kind}": values for kind, values in stats.items()}
    return out | {"meta/episodes/chunk_index": folder, "meta/episodes/file_index": file}


def _kind(name: str, value: Any) -> Any:
    if name == "tasks":
        return [TEXT]
    if isinstance(value, list):
        return [WHOLE if name.endswith("/count") else REAL]
    return WHOLE


class _Together:
    """The statistics of a feature over all episodes, from those of each.

    Means and spreads are those of all frames; quantiles are the means of the episodes' quantiles, weighted by their
    lengths, as LeRobot joins them.
    """

    def __init__(self) -> None:
        self._count = 0
        self._kept: dict[str, FloatArray] = {}

    def add(self, stats: dict[str, list[float]]) -> None:
        """Join the statistics of another episode."""
        (count,) = stats["count"]
        new = {kind: np.array(values, dtype=np.float64) for kind, values in stats.items() if kind != "count"}
        total = self._count + int(count)
        share, old = int(count) / total, self._kept or new
        away = new["mean"] - old["mean"]
        variance = (1.0 - share) * old["std"] * old["std"] + share * new["std"] * new["std"]
        joined = {kind: values + share * (new[kind] - values) for kind, values in old.items()}
        joined["min"], joined["max"] = np.minimum(old["min"], new["min"]), np.maximum(old["max"], new["max"])
        joined["std"] = np.sqrt(variance + share * (1.0 - share) * away * away)
        self._count, self._kept = total, joined

    @property
    def stats(self) -> dict[str, list[float]]:
        """Those of all episodes that were joined."""
        return {kind: values.tolist() for kind, values in self._kept.items()} | {"count": [self._count]}


def _line(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, allow_nan=False) + "\n").encode("ascii")
