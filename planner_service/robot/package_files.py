"""Locating the robot files that other installed packages contain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planner_service.errors import MissingDependency, UnknownName

__all__ = ["package_folder"]


@dataclass(frozen=True)
class _Package:
    """The folder of robot files in a distribution, and our extra that installs it; None if it is always installed."""

    folder: str
    extra: str | None


_PACKAGES = {
    "example-robot-data": _Package("cmeel.prefix/share/example-robot-data", None),
    "trossen-arm-sim": _Package("trossen_arm_sim", "wxai-meshes"),
}


def package_folder(name: str) -> Path:
    """The resolved folder of robot files in an installed package; the package itself is not imported.

    Raises:
        UnknownName: not a package that contains robot files.
        MissingDependency: it is not installed, and one of our extras would install it.
        LookupError: it is not installed although we depend on it, or it has no such folder.
    """
    from importlib.metadata import PackageNotFoundError, distribution

    if name not in _PACKAGES:
        raise UnknownName("package", name, _PACKAGES)
    package = _PACKAGES[name]
    try:
        folder = Path(str(distribution(name).locate_file(package.folder))).resolve()
    except PackageNotFoundError:
        if package.extra is not None:
            raise MissingDependency(name, package.extra) from None
        raise LookupError(f"package {name!r} is not installed; pip install {name}") from None
    if not folder.is_dir():
        raise LookupError(f"package {name!r} is installed, but {folder} is not a folder; pip install --force {name}")
    return folder
