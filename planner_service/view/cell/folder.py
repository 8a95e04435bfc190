"""The one folder that the page may read obstacles from and write scenes to: the one that the operator named."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.mesh_formats import MESH_SUFFIXES
from planner_service.geometry.scans import POINT_SUFFIXES
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Obstacle, Scene
from planner_service.scene.solid_scene import read_solid_scene

__all__ = ["UNITS", "CellFolder"]

SCENES = (".toml",)
SUFFIXES = (*SCENES, *MESH_SUFFIXES, *POINT_SUFFIXES)
"""Of files with obstacles; other formats name files elsewhere."""

MAX_LISTED = 500
"""Files offered; a folder with more is none that was made for this."""

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,63}", re.ASCII)

UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "mm": 0.001, "cm": 0.01, "inch": 0.0254})
"""What the numbers in a mesh or a cloud are, in metres."""


class CellFolder:
    """A folder of scenes, meshes and clouds.

    Args:
        folder: It has to exist.

    Raises:
        InvalidRequest: it is no folder.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        path = as_path("folder", folder)
        if not path.is_dir():
            raise InvalidRequest("folder", os.fspath(folder), "a folder that exists")
        self.path = path.resolve()

    def files(self) -> tuple[str, ...]:
        """The names of the files that can be loaded, sorted; those in folders below are not."""
        try:
            names = sorted(entry.name for entry in os.scandir(self.path) if self._loadable(entry))
        except OSError:
            return ()
        return tuple(names[:MAX_LISTED])

    def _loadable(self, entry: os.DirEntry[str]) -> bool:
        named = entry.name.lower().endswith(SUFFIXES) and entry.name.isprintable()
        return named and entry.is_file(follow_symlinks=False)

    def load(self, name: str, unit: str) -> tuple[Obstacle, ...]:
        """The obstacles in a file.

        Args:
            name: One of ``files()``.
            unit: One of ``UNITS``; scene files are in metres.

        Raises:
            InvalidRequest: there is no such file in the folder.
            InvalidFile: it cannot be used.
            MissingDependency: an extra is needed for it.
        """
        if name not in self.files():
            raise InvalidRequest("file", name, f"a file in {self.path}")
        path = self.path / name
        scene = load_scene(path) if path.suffix.lower() in SCENES else read_solid_scene(path, UNITS[unit])
        if not scene.obstacles:
            raise InvalidFile(path, ["it has no obstacles"])
        return scene.obstacles

    def suggestion(self, name: str) -> str:
        """A name for the file of a scene of that name."""
        return name if FILE_NAME.fullmatch(name) else "cell"

    def target(self, name: str) -> Path:
        """The path of a scene file by its name, with or without ``.toml``.

        Raises:
            InvalidRequest: it would be elsewhere, or cannot be a file's name.
        """
        stem = name.removesuffix(".toml")
        if not FILE_NAME.fullmatch(stem) or stem != stem.strip(" ."):
            expected = "1 to 64 letters, digits, blanks, hyphens, underscores and dots, without a folder"
            raise InvalidRequest("file name", name, expected)
        path = self.path / f"{stem}.toml"
        if path.is_symlink():
            raise InvalidRequest("file name", name, "another name: that one is a link to somewhere else")
        return path

    def save(self, scene: Scene, name: str, *, replace: bool) -> Path | None:
        """Write a scene, whole or not at all, and read it again.

        Args:
            replace: Whether a file of that name may be replaced.

        Returns:
            Where it is; None if a file is there and may not be replaced.

        Raises:
            InvalidRequest: the name cannot be that of a file in the folder, or the scene is too large for one.
            InvalidFile: it cannot be written, or does not hold the same scene when it is read again.
        """
        path = self.target(name)
        if path.exists() and not replace:
            return None
        save_scene(scene, path)
        if load_scene(path).hash != scene.hash:
            raise InvalidFile(path, ["what was written is not the same scene when it is read again"])
        return path
