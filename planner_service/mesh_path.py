"""Where a mesh named in a robot file may lie: inside the robot's own folder or a folder the caller named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

__all__ = ["MESH_SUFFIXES", "mesh_path_problem"]

MESH_SUFFIXES = (".stl", ".obj")
"""Formats simple enough to be read with care."""


def mesh_path_problem(filename: str, folders: Sequence[Path]) -> str | None:
    """Why a mesh may not be read, or None.

    ``package://name/rest`` is looked for as ``name/rest`` and as ``rest`` in each folder, anything relative in each
    folder; a path that leaves all of them, also through a symbolic link, is refused.

    Args:
        folders: Resolved folders that may be read; the robot file's own first.
    """
    if not filename or "\0" in filename:
        return f"mesh filename {filename!r}; expected a path"
    if not filename.lower().endswith(MESH_SUFFIXES):
        return f"mesh {filename!r} is no {' or '.join(MESH_SUFFIXES)} file"
    inside = [path for path in _candidates(filename, folders) if any(path.is_relative_to(f) for f in folders)]
    if not inside:
        allowed = ", ".join(str(folder) for folder in folders)
        return f"mesh {filename!r} lies outside the folders that may be read ({allowed})"
    if not any(path.is_file() for path in inside):
        return f"mesh {filename!r} does not exist"
    return None


def _candidates(filename: str, folders: Sequence[Path]) -> list[Path]:
    scheme, mark, rest = filename.partition("://")
    if not mark:
        return [(folder / filename).resolve() for folder in folders]
    if scheme == "file":
        return [Path(unquote(rest)).resolve()]
    if scheme == "package":
        package, _, tail = rest.partition("/")
        tails = [rest] if package in ("", ".", "..") else [rest, tail]
        return [(folder / tail).resolve() for folder in folders for tail in tails if tail]
    return []
