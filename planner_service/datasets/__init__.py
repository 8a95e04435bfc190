"""Oracle data sets: thousands of proven motions over worlds drawn at random, to learn from."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from planner_service.datasets.bin_task import BinPickPlace
from planner_service.datasets.dataset import EpisodesSummary, write_episodes
from planner_service.datasets.episode import EpisodeWork
from planner_service.datasets.random_draws import Draws
from planner_service.datasets.task import Drawn, EpisodeTask
from planner_service.errors import UnknownName
from planner_service.geometry.shapes import text

__all__ = [
    "EPISODE_TASKS",
    "Drawn",
    "Draws",
    "EpisodeTask",
    "EpisodeWork",
    "EpisodesSummary",
    "episode_task",
    "write_episodes",
]

EPISODE_TASKS: Mapping[str, EpisodeTask] = MappingProxyType({task.name: task for task in (BinPickPlace(),)})
"""The tasks that the command line knows, by name."""


def episode_task(name: str) -> EpisodeTask:
    """The task of that name.

    Raises:
        UnknownName: there is none; the message offers the nearest.
    """
    if text("name", name) not in EPISODE_TASKS:
        raise UnknownName("task", name, EPISODE_TASKS)
    return EPISODE_TASKS[name]
