"""Scenes by name, or from a file of any known format."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from planner_service.files.reading import as_path
from planner_service.scene.loading import load_scene
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.scene import Scene
from planner_service.scene.urdf_scene import read_urdf_scene

__all__ = ["load_world"]

READERS: Mapping[str, Callable[[Path], Scene]] = {".scene": read_moveit_scene, ".urdf": read_urdf_scene}
"""Who reads the files that are not our own, by their suffix in any case."""


def load_world(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene in a MoveIt ``.scene`` or URDF file, or what ``load_scene`` finds under any other name or path.

    Raises:
        UnknownName: no scene of that name comes with the package.
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    path = as_path("scene", name_or_path)
    reader = READERS.get(path.suffix.lower())
    return load_scene(name_or_path) if reader is None else reader(path)
