"""Thousands of episodes as a data set: drawn, planned, proven, sampled and written, or the reasons why not."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from planner_service.datasets.card import card
from planner_service.datasets.episode import Episode, EpisodeWork, lost
from planner_service.datasets.folder import DATA_PATH, Folder
from planner_service.datasets.parquet import pyarrow_version
from planner_service.datasets.random_draws import Draws
from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.shapes import copied_in, whole
from planner_service.parallel import Engine, Lost, Processes
from planner_service.planning.request import PlanRequest

__all__ = ["EpisodesSummary", "write_episodes"]

FORMAT, VERSION = "planner-service/episodes", 1
"""The number counts up whenever a seed gives other worlds, or an episode other columns."""

MOST = 10_000_000
"""Requests of a data set: its files are numbered, and a file system has an end."""

TIME_LIMIT = 600.0
"""Seconds after which an episode is given up. None takes more than one: a worker that takes this long hangs."""

LIBRARIES = ("planner-service", "numpy", "ompl", "toppra", "pyarrow")
"""What may change a byte of an episode."""


@dataclass(frozen=True)
class EpisodesSummary:
    """What a data set holds.

    Attributes:
        requests: Worlds that were drawn.
        episodes: Those in which everything has a plan; the others are in the table of failures.
        frames: Of all episodes.
        failures: How often which reason.
        motions: In the episodes.
        certified: How many of these are proven: all of them.
        motion_seconds: Of motion; what the gripper takes is beside it.
        states: What all requests asked of the collision checker.
        edges: The same, in edges.
        distances: The same, in distance bounds.
        new: Requests that this run added.
    """

    requests: int
    episodes: int
    frames: int
    failures: Mapping[str, int]
    motions: int
    certified: int
    motion_seconds: float
    states: int
    edges: int
    distances: int
    new: int

    def __post_init__(self) -> None:
        copied_in(self, "failures")


def write_episodes(
    out: str | os.PathLike[str],
    work: EpisodeWork,
    count: int,
    *,
    engine: Engine | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> EpisodesSummary:
    """Write a data set of so many requests, going on with what is there of it (files: ``docs/guides/datasets.md``).

    The bytes of every file depend on ``work``, ``count`` and the releases of the libraries alone: not on the engine,
    nor on whether the run was interrupted, or asked for fewer before. An interrupted run leaves a data set of what is
    done. Only a request that is lost with its worker is one more failure, though it might have had an episode.

    Args:
        out: A new or empty folder, or one that was begun with the same ``work``.
        engine: Who works; ``Processes()`` if not given.
        progress: Told how many requests are done, and of how many.

    Raises:
        InvalidRequest: the folder holds something else, was begun with other settings or has more requests already;
            the task cannot be done by the robot; or ``count`` is no number of requests.
        MissingDependency: pyarrow is not there; the extra ``episodes`` brings it.
    """
    whole("count", count, 1, MOST)
    work.task.draw(work.robot, Draws(work.seed, 0))  # a robot that cannot be used is told of here, not by a worker
    with Folder(as_path("out", out), _generation(work), work.chunk) as folder:
        if folder.requests > count:
            raise InvalidRequest("count", count, f"at least {folder.requests:,}: so many requests are there already")
        before = folder.requests
        try:
            _grow(folder, work, count, engine or Processes(), progress or (lambda done, total: None))
        except KeyboardInterrupt:
            folder.refresh()  # whatever was interrupted
            if folder.requests:
                _finish(folder, work, before)
            raise
        return _finish(folder, work, before)


def _grow(folder: Folder, work: EpisodeWork, count: int, engine: Engine, progress: Callable[[int, int], None]) -> None:
    first = folder.requests
    progress(first, count)
    if first == count:
        return
    answers = engine.run(work, range(first, count), limit=lambda item: TIME_LIMIT)
    try:
        for _, answer in answers:
            folder.add(_told(folder.requests, answer))
            progress(folder.requests, count)
    except KeyboardInterrupt:
        answers.close()
        folder.refresh()
        while (left := answers.finished.get(folder.requests - first)) is not None:
            folder.add(_told(folder.requests, left))
        raise
    finally:
        answers.close()


def _told(request: int, answer: Episode | Lost) -> Episode:
    return lost(request, answer) if isinstance(answer, Lost) else answer


def _generation(work: EpisodeWork) -> dict[str, Any]:
    """All that decides a byte, the number of requests apart."""
    from importlib.metadata import PackageNotFoundError, version

    def release(library: str) -> str:
        try:
            return version(library)
        except PackageNotFoundError:
            return "not installed as a package"

    asked = PlanRequest((), ())
    return {
        "format": FORMAT,
        "version": VERSION,
        "task": work.task.name,
        "sentence": work.task.sentence,
        "seed": work.seed,
        "fps": work.fps,
        "gripper_speed": work.gripper_speed,
        "max_checks": work.max_checks,
        "chunk": work.chunk,
        "robot": work.robot.name,
        "robot_hash": work.robot.hash,
        "joint_names": list(work.robot.joint_names),
        "planner": repr(asked.planner),
        "timing": repr(asked.timing),
        "libraries": {**{name: release(name) for name in LIBRARIES}, "pyarrow": pyarrow_version()},
    }


def _finish(folder: Folder, work: EpisodeWork, before: int) -> EpisodesSummary:
    """Write what tells of the whole data set, and count it."""
    folder.write_tables()
    summary = _summary(folder, before)
    info = {
        "codebase_version": "v2.1",
        "robot_type": work.robot.name,
        "total_episodes": summary.episodes,
        "total_frames": summary.frames,
        "total_tasks": 1,
        "total_videos": 0,
        "total_chunks": -(-summary.episodes // work.chunk),
        "chunks_size": work.chunk,
        "fps": work.fps,
        "splits": {"train": f"0:{summary.episodes}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": work.features,
    }
    meta = folder.path / "meta"
    folder.write(meta / "info.json", [(json.dumps(info, indent=4) + "\n").encode()])
    folder.write(meta / "tasks.jsonl", [_line({"task_index": 0, "task": work.task.sentence})])
    folder.write(meta / "episodes.jsonl", _episode_lines(folder, work.task.sentence))
    folder.write(meta / "episodes_stats.jsonl", _stats_lines(folder))
    folder.write(folder.path / "README.md", [card(_generation(work), info, work.task.carrying, summary).encode()])
    return summary


def _summary(folder: Folder, before: int) -> EpisodesSummary:
    totals: Counter[str] = Counter()
    for row in folder.rows("requests", ("states", "edges", "distances")):
        totals.update(row)
    reasons = Counter(row["reason"] for row in folder.rows("failures", ("reason",)))
    motions = Counter(row["certified"] for row in folder.rows("motions", ("certified",)))
    seconds = math.fsum(row["motion_s"] for row in folder.rows("requests", ("motion_s",)))
    return EpisodesSummary(
        folder.requests,
        folder.episodes,
        folder.frames,
        dict(sorted(reasons.items())),
        motions.total(),
        motions[True],
        seconds,
        totals["states"],
        totals["edges"],
        totals["distances"],
        folder.requests - before,
    )


def _episode_lines(folder: Folder, sentence: str) -> Iterator[bytes]:
    for row in folder.rows("episodes", ("episode_index", "length")):
        yield _line({"episode_index": row["episode_index"], "tasks": [sentence], "length": row["length"]})


def _stats_lines(folder: Folder) -> Iterator[bytes]:
    for row in folder.rows("episodes", ("episode_index", "stats")):
        yield _line({"episode_index": row["episode_index"], "stats": json.loads(row["stats"])})


def _line(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, allow_nan=False) + "\n").encode("ascii")
