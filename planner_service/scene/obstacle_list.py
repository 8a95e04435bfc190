"""Obstacles read from a file one by one, and everything that is wrong with them."""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Pose
from planner_service.scene.scene import MAX_OBJECTS, Obstacle, Scene

__all__ = ["MAX_FOUND", "ObstacleList"]

MAX_FOUND = 200
"""Problems with a file after which reading it stops: what is wrong so often is wrong everywhere."""

T = TypeVar("T")


class ObstacleList:
    """Obstacles in the order of their file; what is wrong goes to ``problems``, and reading goes on."""

    def __init__(self) -> None:
        self.obstacles: list[Obstacle] = []
        self.problems: list[str] = []
        self._first: dict[str, str] = {}

    @property
    def hopeless(self) -> bool:
        """Whether there is no use in reading on: too many problems, or more obstacles than a scene can have."""
        return len(self.problems) > MAX_FOUND or len(self.obstacles) > MAX_OBJECTS

    def attempt(self, where: str, make: Callable[[], T]) -> T | None:
        """What ``make`` returns; None if it refuses, which is a problem at ``where`` (empty: of the file)."""
        try:
            return make()
        except InvalidRequest as error:
            self.problems.append(f"{where}: {error}" if where else str(error))
            return None

    def add(self, where: str, name: str, shape: Solid | None, pose: Pose | None) -> None:
        """Take an obstacle; one without shape or pose, whose problems are noted already, only for its name."""
        if name in self._first:
            self.problems.append(f"{where}: the name {reprlib.repr(name)} is taken ({self._first[name]})")
            return
        self._first[name] = where
        if shape is None or pose is None:
            return
        obstacle = self.attempt(where, lambda: Obstacle(name, shape, pose))
        if obstacle is not None:
            self.obstacles.append(obstacle)

    def scene(self, path: Path, name: str) -> Scene:
        """The scene of all obstacles.

        Raises:
            InvalidFile: with every problem noted, or if together they are no scene.
        """
        scene = None if self.problems else self.attempt("", lambda: Scene(tuple(self.obstacles), name=name))
        if scene is None:
            raise InvalidFile(path, self.problems)
        return scene
