"""Data sets for learning: thousands of planned and proven motions in random worlds."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from planner_service.datasets.bin_task import BinPickPlace
from planner_service.datasets.card import EpisodesSummary
from planner_service.datasets.dataset import write_episodes
from planner_service.datasets.episode import EpisodeWork
from planner_service.datasets.task import EpisodeTask, EpisodeWorld, RandomDraws
from planner_service.errors import UnknownName
from planner_service.geometry.validation import text

__all__ = [
    "EPISODE_TASKS",
    "EpisodeTask",
    "EpisodeWork",
    "EpisodeWorld",
    "EpisodesSummary",
    "RandomDraws",
    "episode_task",
    "write_episodes",
]

EPISODE_TASKS: Mapping[str, EpisodeTask] = MappingProxyType({task.name: task for task in (BinPickPlace(),)})
"""The tasks of the command line, by name."""


def episode_task(name: str) -> EpisodeTask:
    """The task of that name.

    Raises:
        UnknownName: there is none; the message offers the nearest.
    """
    if text("name", name) not in EPISODE_TASKS:
        raise UnknownName("task", name, EPISODE_TASKS)
    return EPISODE_TASKS[name]
