"""Robots' files that other installed packages bring along: where they are, and that nothing beside them is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planner_service.errors import MissingDependency, UnknownName

__all__ = ["package_folder"]


@dataclass(frozen=True)
class _Package:
    """An installed distribution's folder of robot files, and the extra of ours that installs it; None: we need it."""

    folder: str
    extra: str | None


_PACKAGES = {
    "example-robot-data": _Package("cmeel.prefix/share/example-robot-data", None),
    "trossen-arm-sim": _Package("trossen_arm_sim", "wxai-meshes"),
}


def package_folder(name: str) -> Path:
    """The resolved folder of robot files in an installed package; the package itself is not imported.

    Raises:
        UnknownName: not a package that is known to have robot files.
        MissingDependency: it is not installed, and one of our extras would bring it.
        LookupError: it is not installed here though we depend on it, or has no such folder; in words.
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
        raise LookupError(f"package {name!r} is installed, but {folder} is no folder; pip install --force {name}")
    return folder
