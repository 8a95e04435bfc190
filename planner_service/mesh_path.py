"""Meshes named in a file: only from the file's own folder or folders the caller named, each read once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.mesh import Mesh, checked_scale
from planner_service.mesh_file import MESH_SUFFIXES

__all__ = ["MeshShelf"]

MAX_TOTAL = 500_000_000
"""Bytes of all meshes that one robot or scene may name."""


class MeshShelf:
    """Meshes by the names that a robot or scene file gives them.

    ``package://name/rest`` is looked for as ``name/rest`` and as ``rest`` in each folder, anything relative in each
    folder; a path that leaves all of them, also through a symbolic link, is refused.

    Args:
        folders: Resolved folders that may be read; the file's own first.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = tuple(folders)
        self._read: dict[tuple[Path, tuple[float, float, float]], Mesh] = {}
        self._left = MAX_TOTAL

    def mesh(self, filename: str, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> Mesh:
        """The mesh of that name.

        Raises:
            InvalidRequest: it may not be read, does not exist or is no mesh, in words.
        """
        path = self.path(filename)
        key = (path, checked_scale("scale", scale))
        if key not in self._read:
            self._left -= path.stat().st_size
            if self._left < 0:
                raise _refused(filename, f"is one too many: more than {MAX_TOTAL:,} bytes of meshes")
            try:
                self._read[key] = Mesh.from_file(path, key[1])
            except InvalidFile as error:
                raise _refused(filename, f"cannot be used: {'; '.join(error.problems)}") from None
        return self._read[key]

    def path(self, filename: str) -> Path:
        """The resolved file of that name.

        Raises:
            InvalidRequest: it may not be read, or does not exist, in words.
        """
        if not filename or "\0" in filename:
            message = f"mesh filename {filename!r}; expected a path"
            raise InvalidRequest("mesh", filename, "a path", message=message)
        if not filename.lower().endswith(MESH_SUFFIXES):
            raise _refused(filename, f"is no {' or '.join(MESH_SUFFIXES)} file")
        try:
            inside = [path for path in self._candidates(filename) if any(path.is_relative_to(f) for f in self._folders)]
            found = next((path for path in inside if path.is_file()), None)
        except (OSError, ValueError) as error:  # a name too long, half a surrogate pair, or a circle of links
            raise _refused(filename, f"is no path: {error}") from None
        allowed = ", ".join(str(folder) for folder in self._folders)
        if not inside:
            raise _refused(filename, f"lies outside the folders that may be read ({allowed})")
        if found is None:
            raise _refused(filename, f"does not exist in the folders that may be read ({allowed})")
        return found

    def _candidates(self, filename: str) -> list[Path]:
        scheme, mark, rest = filename.partition("://")
        if not mark:
            return [(folder / filename).resolve() for folder in self._folders]
        if scheme == "file":
            return [Path(unquote(rest)).resolve()]
        if scheme == "package":
            package, _, tail = rest.partition("/")
            tails = [rest] if package in ("", ".", "..") else [rest, tail]
            return [(folder / tail).resolve() for folder in self._folders for tail in tails if tail]
        return []


def _refused(filename: str, why: str) -> InvalidRequest:
    return InvalidRequest("mesh", filename, "a mesh that may be read", message=f"mesh {filename!r} {why}")
