"""Loading the meshes, clouds and height fields that a file names, from its own folder or folders the caller named."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar
from urllib.parse import unquote

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.ros_packages import file_called, listed_folders, packages_below
from planner_service.geometry.arrays import FloatArray, IntArray, frozen
from planner_service.geometry.composite import HeightField, PointCloud
from planner_service.geometry.decomposition import pieces_of_file
from planner_service.geometry.mesh import Mesh, checked_scale
from planner_service.geometry.mesh_formats import MESH_SUFFIXES, read_triangles

__all__ = ["MeshLoader", "Surface"]

T = TypeVar("T")

logger = logging.getLogger(__name__)

MAX_TOTAL = 500_000_000
"""Bytes of all meshes and clouds of one robot or scene."""

MAX_SCALED = 100_000
"""Corners of all hulls of one robot or scene that repeat a file in another scale."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The triangles of a mesh file, (t, 3), as rows of ``vertices`` (n, 3), in metres.

    Seen from outside they are counter-clockwise if the file says so; nobody checks whether they enclose anything.
    """

    vertices: FloatArray
    triangles: IntArray


class MeshLoader:
    """Loads meshes, clouds and height fields by the names that a robot or scene file gives them.

    ``package://name/rest`` and ``model://name/rest`` are looked for as ``rest`` in the ROS package of that name
    (``packages_below``), as ``name/rest`` in each folder, as ``rest`` in a folder above that is called ``name``, and as
    ``rest`` in each folder; anything relative in each folder. A path that leaves all of them, even through a symbolic
    link, is refused.

    Args:
        folders: Resolved folders that may be read; the file's own first.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = tuple(folders)
        self._read: dict[tuple[Path, tuple[float, float, float]], Mesh] = {}
        self._left = MAX_TOTAL
        self._corners: dict[Path, int] = {}
        self._scaled = 0

    def mesh(self, filename: str, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Mesh:
        """The mesh that the file calls ``filename``.

        Raises:
            InvalidRequest: it may not be read, does not exist or is no mesh.
        """
        key = (self.path(filename), checked_scale("scale", scale))
        if key not in self._read:
            self._scaled += self._corners.get(key[0], 0)
            if self._scaled > MAX_SCALED:
                why = f"is used in too many scales: hulls with more than {MAX_SCALED:,} corners in all"
                raise _refused(filename, why)
            mesh = self._opened(filename, key[0], lambda: Mesh.from_file(*key))
            if mesh.growth:
                logger.info("%s: its hull is simplified, and at most %.2g mm larger", key[0], 1000.0 * mesh.growth)
            self._read[key] = mesh
            self._corners[key[0]] = len(self._read[key].vertices)
        return self._read[key]

    def pieces(self, filename: str, scale: Sequence[float], most: int) -> tuple[Mesh, ...]:
        """The mesh that the file calls ``filename``, in at most ``most`` pieces (``decomposition.pieces_of_file``).

        Raises:
            InvalidRequest: as for ``mesh``.
        """
        path, factors = self.path(filename), checked_scale("scale", scale)
        return self._opened(filename, path, lambda: pieces_of_file(path, factors, most=most))

    def surface(self, filename: str, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Surface:
        """The triangles of the mesh that the file calls ``filename``, hollows and all.

        Raises:
            InvalidRequest: as for ``mesh``, but that a flat one is fine.
        """
        path, factors = self.path(filename), checked_scale("scale", scale)
        vertices, triangles = self._opened(filename, path, lambda: read_triangles(path, factors))
        return Surface(frozen(vertices), frozen(triangles))

    def cloud(self, filename: str, resolution: float | None, scale: float = 1.0) -> PointCloud:
        """The point cloud that the file calls ``filename``.

        Raises:
            InvalidRequest: it may not be read, does not exist or is no cloud.
        """
        path = self._path(filename)
        return self._opened(filename, path, lambda: PointCloud.from_file(path, resolution, scale))

    def heights(self, filename: str, cell: float, floor: float) -> HeightField:
        """The height field that the file calls ``filename``.

        Raises:
            InvalidRequest: it may not be read, does not exist or is no height field.
        """
        path = self._path(filename)
        return self._opened(filename, path, lambda: HeightField.from_file(path, cell, floor))

    def _opened(self, filename: str, path: Path, read: Callable[[], T]) -> T:
        self._left -= path.stat().st_size
        if self._left < 0:
            raise _refused(filename, f"is too much: more than {MAX_TOTAL:,} bytes of mesh files in all")
        try:
            return read()
        except InvalidFile as error:
            raise _refused(filename, f"cannot be used: {'; '.join(error.problems)}") from None

    def path(self, filename: str) -> Path:
        """The resolved path of the mesh file ``filename``.

        Raises:
            InvalidRequest: it may not be read, does not exist or has another suffix.
        """
        if filename and not filename.lower().endswith(MESH_SUFFIXES):
            raise _refused(filename, f"is not a {', '.join(MESH_SUFFIXES[:-1])} or {MESH_SUFFIXES[-1]} file")
        return self._path(filename)

    def _path(self, filename: str) -> Path:
        if not filename or "\0" in filename:
            message = f"mesh filename {filename!r}; expected a path"
            raise InvalidRequest("mesh", filename, "a path", message=message)
        try:
            inside = [path for path in self._candidates(filename) if any(path.is_relative_to(f) for f in self._folders)]
            file = next((path for path in inside if path.is_file()), None)
        except (OSError, ValueError, RuntimeError) as error:  # too long, half a surrogate pair, a circle of links
            raise _refused(filename, f"is not a path: {error}") from None
        if file is not None:
            return file
        what = "does not exist in" if inside else "lies outside"
        step = self._written(filename) or "name more with package_dirs (--package-dir)"
        raise _refused(filename, f"{what} the folders that may be read ({listed_folders(self._folders)}); {step}")

    def _written(self, filename: str) -> str | None:
        """How a file is written that lies elsewhere in the folders, and has the name that was meant."""
        file = file_called(Path(unquote(filename)).name, self._folders)
        if file is None:
            return None
        packages = ((name, file.relative_to(at)) for name, at in self._packages.items() if file.is_relative_to(at))
        name, rest = min(packages, key=lambda each: len(each[1].parts), default=("", file))
        return f"write {f'package://{name}/{rest}' if name else file}"

    def _candidates(self, filename: str) -> Iterator[Path]:
        filename = filename.removeprefix("file://") if filename.startswith("file://package://") else filename
        scheme, mark, rest = filename.partition("://")
        if not mark:
            yield from ((folder / filename).resolve() for folder in self._folders)
        elif scheme == "file":
            yield Path(unquote(rest)).resolve()
        elif scheme in ("package", "model"):
            yield from (place.resolve() for place in self._in_packages(rest))

    def _in_packages(self, rest: str) -> Iterator[Path]:
        """Where ``package://rest`` may be, the likeliest place first."""
        if "/" in rest[1:]:
            rest = rest.lstrip("/")  # package:///name/rest is written, too
        package, _, tail = rest.partition("/")
        named = package not in ("", ".", "..")
        if named and tail and package in self._packages:
            yield self._packages[package] / tail
        yield from (folder / rest for folder in self._folders if rest)
        if named and tail:
            yield from (at / tail for folder in self._folders for at in folder.parents if at.name == package)
            yield from (folder / tail for folder in self._folders)

    @cached_property
    def _packages(self) -> Mapping[str, Path]:
        return packages_below(self._folders)


def _refused(filename: str, why: str) -> InvalidRequest:
    return InvalidRequest("mesh", filename, "a mesh that may be read", message=f"mesh {filename!r} {why}")
