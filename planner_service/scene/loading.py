"""Scenes by name or from a file of any format that is read, and written to files."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from planner_service.concurrency.library_import import loaded
from planner_service.errors import InvalidFile, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.files.reading import as_path
from planner_service.geometry.mesh_formats import MESH_SUFFIXES
from planner_service.geometry.scans import POINT_SUFFIXES
from planner_service.geometry.validation import instance
from planner_service.scene.scene import Scene, scene_names

__all__ = ["load_scene", "save_scene", "scene_text"]


def _files() -> None:
    import planner_service.scene.toml_reader  # noqa: F401  pydantic takes 0.1 s


def _toml(path: Path) -> Scene:
    loaded(_files)
    from planner_service.scene.toml_reader import read_scene

    return read_scene(path)


def _moveit(path: Path) -> Scene:
    from planner_service.scene.moveit_scene import read_moveit_scene

    return read_moveit_scene(path)


def _urdf(path: Path) -> Scene:
    from planner_service.scene.urdf_scene import read_urdf_scene

    return read_urdf_scene(path)


def _sdf(path: Path) -> Scene:
    from planner_service.scene.sdf_scene import read_sdf_scene

    return read_sdf_scene(path)


def _solid(path: Path) -> Scene:
    from planner_service.scene.solid_scene import read_solid_scene

    return read_solid_scene(path)


READERS: Mapping[str, Callable[[Path], Scene]] = {
    ".toml": _toml,
    "": _toml,
    ".scene": _moveit,
    ".urdf": _urdf,
    ".xacro": _urdf,
    ".sdf": _sdf,
    ".world": _sdf,
    **dict.fromkeys((*MESH_SUFFIXES, *POINT_SUFFIXES), _solid),
}
"""Who reads a file, by its suffix in any case; each is loaded with the first such file."""

STEPS = {
    (".gltf",): "export it as .glb, one file with all it needs",
    (".csv", ".txt", ".asc", ".pts"): "points in lines that begin with x, y and z are called .xyz",
    (".3mf", ".step", ".stp", ".iges", ".igs", ".usd", ".usda", ".usdc", ".usdz", ".fbx"): "export it as .stl or .glb",
}
"""What to do about files of other suffixes."""


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """The scene that comes with the package under that name, or the one in a file.

    The suffix says what the file is: our own (``.toml``, or none), MoveIt's ``.scene``, a URDF or xacro world, an
    SDFormat world (``.sdf``, ``.world``), or one obstacle: a mesh (``.stl``, ``.obj``, ``.glb``, ``.dae``, ``.ply``),
    measured points (``.ply`` without faces, ``.pcd``, ``.xyz``, ``.las``, ``.laz``, ``.npy``, ``.npz``) or OctoMap's
    trees (``.bt``, ``.ot``). Its frame is taken as the robot's base frame, and its numbers as metres; a scene file
    that names a mesh or points says otherwise (``mesh = { file = ..., scale = ... }``, ``cloud = { file = ...,
    resolution = ... }``).

    A text without a folder that is the name of a scene of the package is that scene; any other text is a path.

    Raises:
        UnknownName: neither a scene of that name nor such a file.
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
        MissingDependency: an extra is needed: laspy for LAS, xacro for xacro.
    """
    instance("scene", name_or_path, (str, os.PathLike), "the name of a scene or the path of a file")
    path = as_path("scene", name_or_path)
    if isinstance(name_or_path, str) and path.name == name_or_path:
        if name_or_path in scene_names():
            return _toml(data_folder("scenes") / f"{name_or_path}.toml")
        if (not path.suffix or path.suffix.lower() not in READERS) and not _exists(path):
            raise UnknownName("scene", name_or_path, scene_names())
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        step = next((f"; {step}" for suffixes, step in STEPS.items() if path.suffix.lower() in suffixes), "")
        expected = f"expected a scene, one of {', '.join(filter(None, READERS))}{step}"
        raise InvalidFile(path, [f"suffix {path.suffix!r}; {expected}"])
    return reader(path)


def _exists(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or a NUL in it
        return False


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


def scene_text(scene: Scene) -> str:
    """What ``save_scene`` writes.

    Raises:
        InvalidRequest: the file would be too large to be loaded again.
    """
    loaded(_files)
    from planner_service.scene.toml_reader import scene_file_text

    return scene_file_text(instance("scene", scene, Scene, "a Scene"))
