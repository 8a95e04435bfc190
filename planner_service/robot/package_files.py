"""Locating the robot files that other installed packages contain."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from planner_service.errors import InvalidRequest, MissingDependency, UnknownName

__all__ = ["EXAMPLES", "example_urdf", "package_folder"]

EXAMPLES = "example-robot-data"
"""The package of many robots, and what their names begin with, before a colon."""


@dataclass(frozen=True)
class _Package:
    """The folder of robot files in a distribution, and our extra that installs it; None if it is always installed."""

    folder: str
    extra: str | None


_PACKAGES = {
    EXAMPLES: _Package("cmeel.prefix/share/example-robot-data", None),
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


def example_urdf(name: str) -> Path:
    """The URDF of a robot in example-robot-data: its file's name without ``.urdf``, after a slash if several share it.

    ``anymal_c_simple_description/anymal`` is the one in that folder of ``robots``.

    Raises:
        UnknownName: there is no such URDF.
        InvalidRequest: the package is not installed, although we depend on it.
    """
    try:
        folder = package_folder(EXAMPLES) / "robots"
    except LookupError as error:
        raise InvalidRequest("robot", name, f"an installed package: {error}") from None
    files = sorted(folder.rglob("*.urdf"))
    stems = Counter(file.stem for file in files)
    found = {file.stem if stems[file.stem] == 1 else f"{file.parents[1].name}/{file.stem}": file for file in files}
    if name not in found:
        raise UnknownName(f"robot of {EXAMPLES}", name, found)
    return found[name]
