"""Xacro files: the robot that their macros make, expanded where they can do no harm."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from planner_service.concurrency.confined import ScriptFailed, run_confined
from planner_service.errors import InvalidFile, InvalidRequest, MissingDependency
from planner_service.files.ros_packages import packages_around, packages_below
from planner_service.files.xml_reader import MAX_XML_BYTES, Malformed, parse_xml, read_xml
from planner_service.geometry.validation import instance
from planner_service.robot.macros.explanation import explained

__all__ = ["checked_xacro_args", "expanded_xml", "package_folders", "robot_folders"]

SUFFIX = ".xacro"
PREFIX = "xacro:"
"""What the names of xacro's elements begin with."""
URDF_FOLDERS = ("urdf", "robots", "mjcf", "xml")
"""Folders that hold descriptions of robots, whose meshes are in a folder next to them."""
LOST = re.compile(r"package://([^/'\"\s]+)")
"""What ``$(find name)`` is if there is no such package (``xacro_child``)."""
MAX_ARGS = 1_000
"""Characters of an argument's value, and arguments."""
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
    return tuple(dict.fromkeys((own, *map(_resolved, package_dirs))))


def package_folders(path: Path) -> list[Path]:
    """The folder above a folder of URDFs, and the ROS package of the file with its repository (``packages_around``)."""
    own = path.resolve().parent
    return [*([own.parent] if own.name in URDF_FOLDERS else []), *packages_around(path)]


def _resolved(folder: Path) -> Path:
    try:
        return folder.resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL, a lone surrogate, a cycle of links
        raise InvalidRequest("package_dirs", str(folder), f"a folder: {error}") from None


def checked_xacro_args(given: object) -> dict[str, str]:
    """Arguments of a xacro file by name, as the texts that xacro takes.

    Raises:
        InvalidRequest: they are none.
    """
    texts = {}
    for name, value in instance("xacro_args", given, Mapping, "values by the name of the argument").items():
        if not isinstance(name, str) or not name or len(name) > MAX_ARGS:
            raise InvalidRequest("xacro_args", name, "the name of an argument")
        if not isinstance(value, str | int | float):
            raise InvalidRequest(f"xacro_args[{name!r}]", value, "a text, a number or a truth value")
        texts[name] = str(value).lower() if isinstance(value, bool) else str(value)
        if len(texts[name]) > MAX_ARGS:
            raise InvalidRequest(f"xacro_args[{name!r}]", texts[name][:20], f"at most {MAX_ARGS} characters")
    if len(texts) > MAX_ARGS:
        raise InvalidRequest("xacro_args", len(texts), f"at most {MAX_ARGS} arguments")
    return texts


def expanded_xml(
    path: Path, folders: Sequence[Path], xacro_args: Mapping[str, str] | None = None
) -> ElementTree.Element:
    """The ``<robot>`` of a URDF, or of what a xacro file expands to with these arguments and the defaults of others.

    ``$(find name)`` is the package of that name in ``folders`` (``packages_below``); one that is missing is no problem
    as long as nothing of it is read. Nothing but these folders is read, and nothing is run but arithmetic: expressions
    that reach for more are refused, in ``$(eval)`` too, as are files that need more than 10 s, 1 GB or 10 MB of text.

    Args:
        folders: Resolved folders that may be read; the file's own first.

    Raises:
        InvalidFile: no XML of a robot, or macros that cannot be expanded.
        InvalidRequest: arguments for a file that takes none.
        MissingDependency: it holds macros, and xacro is not installed.
    """
    root, given = read_xml(path, "robot"), dict(xacro_args or {})
    if path.suffix.lower() != SUFFIX and not any(element.tag.startswith(PREFIX) for element in root.iter()):
        if given:
            raise InvalidRequest("xacro_args", sorted(given), f"none: {path.name} holds no xacro")
        return root
    if importlib.util.find_spec("xacro") is None:
        raise MissingDependency("xacro", "xacro")
    packages = {name: str(folder) for name, folder in packages_below(folders).items()}
    job = {
        "file": str(path.resolve()),
        "folders": [str(folder) for folder in folders],
        "packages": packages,
        "args": given,
        "most": MAX_XML_BYTES,
    }
    script, order = Path(__file__).with_name("xacro_child.py"), json.dumps(job).encode()
    try:
        told = json.loads(run_confined(script, {}, seconds=SECONDS, memory=MEMORY, given=order, bare=True))
        expanded = parse_xml(told["urdf"].encode()) if "urdf" in told else root
        told |= _lost(expanded, packages) if "urdf" in told else {}
        problem = explained(told, packages, path.resolve().parent) if "problem" in told else None
    except (ScriptFailed, Malformed) as error:
        problem = str(error)
    if problem is not None:
        raise InvalidFile(path, [f"its macros cannot be expanded: {problem}"])
    if expanded.find("link") is None:
        macros = ", ".join(sorted(str(each.get("name")) for each in root.findall(f"{PREFIX}macro")))
        hint = f"it defines the macros {macros}; write a file that includes it and uses one" if macros else "no link"
        raise InvalidFile(path, [f"expands to a robot without links: {hint}"])
    return expanded


def _lost(robot: ElementTree.Element, packages: Mapping[str, str]) -> dict[str, str]:
    """The package that is missing, if a link or joint has its place elsewhere than in the name of a file."""
    for part in robot:
        for element in part.iter() if part.tag in ("link", "joint") else ():
            for key, value in element.attrib.items():
                found = LOST.search(value)
                if found is not None and key != "filename" and found[1] not in packages:
                    return {"problem": "a package is missing", "package": found[1]}
    return {}
