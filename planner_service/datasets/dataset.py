"""Writes a data set: draws worlds, plans and proves the task in each, and writes the motions or the failures."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable
from typing import Any

from planner_service.datasets.card import EpisodesSummary, card
from planner_service.datasets.episode import Episode, EpisodeWork, lost_episode
from planner_service.datasets.folder import DatasetFolder
from planner_service.datasets.lerobot import info_of, write_meta
from planner_service.datasets.parquet import pyarrow_version
from planner_service.datasets.task import RandomDraws
from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.validation import whole
from planner_service.parallel import Engine, Lost, Processes
from planner_service.planning.request import PlanRequest

__all__ = ["write_episodes"]

FORMAT, VERSION = "planner-service/episodes", 2
"""The version increases whenever a seed gives other worlds, or an episode other columns."""

MAX_REQUESTS = 10_000_000
"""Requests in a data set; its file names have room for so many."""

TIME_LIMIT = 600.0
"""Seconds after which an episode is given up: one takes about a second, so the worker hangs."""

LIBRARIES = ("planner-service", "numpy", "ompl", "toppra", "pyarrow")
"""Libraries whose version may change a byte of an episode."""


def write_episodes(
    out: str | os.PathLike[str],
    work: EpisodeWork,
    count: int,
    *,
    engine: Engine | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> EpisodesSummary:
    """Write a data set of ``count`` requests, or continue one; the guide to data sets describes the files.

    The bytes of every file depend only on ``work``, ``count`` and the versions of the libraries: not on the engine, nor
    on interruptions or earlier runs with a smaller count. An interrupted run leaves a complete, smaller data set. The
    one exception: a request whose worker dies twice becomes a failure, though it might have an episode elsewhere.

    Args:
        out: A new or empty folder, or one begun with the same ``work``.
        engine: Runs the work; ``Processes()`` if not given.
        progress: Called with the number of finished requests and the total.

    Raises:
        InvalidRequest: the folder holds something else, was begun with other settings or has more requests already;
            the robot cannot do the task; or ``count`` is out of range.
        MissingDependency: pyarrow is not installed (extra ``episodes``).
    """
    whole("count", count, 1, MAX_REQUESTS)
    work.task.draw(work.robot, RandomDraws(work.seed, 0))  # refuses an unsuitable robot here, not in a worker
    packed = work.layout == "v3.0"
    with DatasetFolder(as_path("out", out), _generation(work), work.chunk, packed=packed) as folder:
        if folder.requests > count:
            raise InvalidRequest("count", count, f"at least {folder.requests:,}, the number of requests in the folder")
        before = folder.requests
        try:
            _grow(folder, work, count, engine or Processes(), progress or (lambda done, total: None))
        except KeyboardInterrupt:
            folder.refresh()  # a write may have been interrupted
            if folder.requests:
                _describe(folder, work, before)
            raise
        return _describe(folder, work, before)


def _grow(
    folder: DatasetFolder, work: EpisodeWork, count: int, engine: Engine, progress: Callable[[int, int], None]
) -> None:
    first = folder.requests
    progress(first, count)
    if first == count:
        return
    answers = engine.run(work, range(first, count), limit=lambda item: TIME_LIMIT)
    try:
        for _, answer in answers:
            folder.add(_as_episode(folder.requests, answer))
            progress(folder.requests, count)
    except KeyboardInterrupt:
        answers.close()
        folder.refresh()
        while (left := answers.finished.get(folder.requests - first)) is not None:
            folder.add(_as_episode(folder.requests, left))
        raise
    finally:
        answers.close()


def _as_episode(request: int, answer: Episode | Lost) -> Episode:
    return lost_episode(request, answer) if isinstance(answer, Lost) else answer


def _generation(work: EpisodeWork) -> dict[str, Any]:
    """Everything that decides a byte, except the number of requests."""
    from importlib.metadata import PackageNotFoundError, version

    def release(library: str) -> str:
        try:
            return version(library)
        except PackageNotFoundError:
            return "not installed as a package"

    defaults = PlanRequest((), ())
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
        "layout": work.layout,
        "robot": work.robot.name,
        "robot_hash": work.robot.hash,
        "joint_names": list(work.robot.joint_names),
        "planner": repr(defaults.planner),
        "timing": repr(defaults.timing),
        "libraries": {**{name: release(name) for name in LIBRARIES}, "pyarrow": pyarrow_version()},
    }


def _describe(folder: DatasetFolder, work: EpisodeWork, before: int) -> EpisodesSummary:
    """Write the files that describe the whole data set, and summarise it."""
    folder.write_tables()
    summary = _summary(folder, before)
    info = info_of(work, summary)
    write_meta(folder, work, info)
    folder.write(folder.path / "README.md", [card(_generation(work), info, work.task.carrying, summary).encode()])
    return summary


def _summary(folder: DatasetFolder, before: int) -> EpisodesSummary:
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
