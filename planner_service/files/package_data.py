"""What comes with the package: the folders of its robots and scenes."""

from __future__ import annotations

from pathlib import Path

__all__ = ["data_folder"]


def data_folder(kind: str) -> Path:
    """The folder of the shipped "robots" or "scenes": in a wheel inside the package, in a checkout beside it."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "_data" / kind
    return inside if inside.is_dir() else package.parent / kind
