"""Scenes by name or file, and written to files."""

from __future__ import annotations

import os

from planner_service.concurrency.library_import import loaded
from planner_service.errors import UnknownName
from planner_service.files.package_data import data_folder
from planner_service.files.reading import as_path
from planner_service.geometry.validation import instance
from planner_service.scene.scene import Scene, scene_names

__all__ = ["load_scene", "save_scene"]


def _files() -> None:
    import planner_service.scene.toml_reader  # noqa: F401  pydantic takes 0.1 s


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene that comes with the package under that name, or the one in a file.

    A text without a folder and without ``.toml`` is a name, everything else a path.

    Raises:
        UnknownName: no scene of that name comes with the package.
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    loaded(_files)
    from planner_service.scene.toml_reader import read_scene

    instance("scene", name_or_path, (str, os.PathLike), "the name of a scene or the path of a file")
    path = as_path("scene", name_or_path)
    if isinstance(name_or_path, str) and path.name == name_or_path and path.suffix != ".toml":
        if name_or_path not in scene_names():
            raise UnknownName("scene", name_or_path, scene_names())
        return read_scene(data_folder("scenes") / f"{name_or_path}.toml")
    return read_scene(path)


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write ``scene`` to a TOML file; ``load_scene`` gives back an equal one with an equal hash.

    A mesh is written as the corners of its hull, a cloud as its cells, so that the file needs no other.

    The file is there whole or not at all: after a failure an old file is as it was.

    Raises:
        InvalidRequest: the file would be too large to be loaded again.
        InvalidFile: it cannot be written.
    """
    loaded(_files)
    from planner_service.scene.toml_reader import write_scene

    write_scene(instance("scene", scene, Scene, "a Scene"), as_path("path", path))
