"""Xacro files: the robot that their macros make, expanded where they can do no harm."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from xml.etree import ElementTree

from planner_service.concurrency.confined import ScriptFailed, run_confined
from planner_service.errors import InvalidFile, InvalidRequest, MissingDependency
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import MAX_XML_BYTES, Malformed, parse_xml, read_xml

__all__ = ["expanded_xml", "package_folders", "robot_folders"]

SUFFIX = ".xacro"
PREFIX = "xacro:"
"""What the names of xacro's elements begin with."""
URDF_FOLDERS = ("urdf", "robots", "mjcf", "xml")
"""Folders that hold descriptions of robots, whose meshes are in a folder next to them."""
PACKAGE = "package.xml"
"""The file that makes a folder a ROS package, and names it."""
SECONDS = 10
"""The largest robots known take half a second."""
MEMORY = 1_000_000_000
"""Bytes; the largest robots known take a tenth."""


def robot_folders(path: Path, package_dirs: Sequence[Path]) -> tuple[Path, ...]:
    """The resolved folders that a robot's description may read: its own first.

    Raises:
        InvalidFile: the description's own path is none.
        InvalidRequest: one of ``package_dirs`` is no path.
    """
    try:
        own = path.resolve().parent
    except (OSError, ValueError, RuntimeError) as error:  # a NUL, a lone surrogate, a cycle of links
        raise InvalidFile(path, [f"cannot be read: {error}"]) from None
    return (own, *map(_resolved, package_dirs))


def package_folders(path: Path) -> list[Path]:
    """The folder of the ROS package that a file is in, and the one above a folder of URDFs."""
    own = path.resolve().parent
    packages = (folder for folder in own.parents if (folder / PACKAGE).is_file())
    return [*([own.parent] if own.name in URDF_FOLDERS else []), *islice(packages, 1)]


def _resolved(folder: Path) -> Path:
    try:
        return folder.resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL, a lone surrogate, a cycle of links
        raise InvalidRequest("package_dirs", str(folder), f"a folder: {error}") from None


def expanded_xml(path: Path, folders: Sequence[Path]) -> ElementTree.Element:
    """The ``<robot>`` of a URDF, or of what a xacro file expands to with the defaults of its arguments.

    ``$(find name)`` is the folder whose package.xml has that name, else the folder called so, among ``folders``, those
    right in them. Nothing else is read, and nothing is run but arithmetic: ``$(eval)`` and expressions that reach for
    more are refused, as are files that need more than 10 s, 1 GB or 10 MB of text.

    Args:
        folders: Resolved folders that may be read; the file's own first.

    Raises:
        InvalidFile: no XML of a robot, or macros that cannot be expanded.
        MissingDependency: it holds macros, and xacro is not installed.
    """
    root = read_xml(path, "robot")
    if path.suffix.lower() != SUFFIX and not any(element.tag.startswith(PREFIX) for element in root.iter()):
        return root
    if importlib.util.find_spec("xacro") is None:
        raise MissingDependency("xacro", "xacro")
    job = {
        "file": str(path.resolve()),
        "folders": [str(folder) for folder in folders],
        "packages": {name: str(folder) for name, folder in _packages(folders).items()},
        "most": MAX_XML_BYTES,
    }
    script = Path(__file__).with_name("xacro_child.py")
    try:
        told = json.loads(run_confined(script, job, seconds=SECONDS, memory=MEMORY, bare=True))
        problem = told.get("problem")
        expanded = parse_xml(told["urdf"].encode()) if problem is None else root
    except (ScriptFailed, Malformed) as error:
        problem = str(error)
    if problem is not None:
        raise InvalidFile(path, [f"its macros cannot be expanded: {problem}"])
    if expanded.find("link") is None:
        macros = ", ".join(sorted(str(each.get("name")) for each in root.findall(f"{PREFIX}macro")))
        hint = f"it defines the macros {macros}; write a file that includes it and uses one" if macros else "no link"
        raise InvalidFile(path, [f"expands to a robot without links: {hint}"])
    return expanded


def _packages(folders: Sequence[Path]) -> dict[str, Path]:
    """ROS packages by name: the folders with a package.xml, which names them, and those called so."""
    found: dict[str, Path] = {}
    for folder in folders:
        inner = sorted(each for each in folder.iterdir() if each.is_dir()) if folder.is_dir() else []
        for each in (folder, *inner):
            found.setdefault(_package_name(each), each)
            found.setdefault(each.name, each)
    return found


def _package_name(folder: Path) -> str:
    file = folder / PACKAGE
    if not file.is_file():
        return folder.name
    try:
        return (parse_xml(read_bytes(file, MAX_XML_BYTES)).findtext("name") or folder.name).strip()
    except (InvalidFile, Malformed):
        return folder.name
