"""ROS packages in the repository of a file: those that ``package://name`` and ``$(find name)`` mean."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.xml_reader import MAX_XML_BYTES, Malformed, parse_xml

__all__ = ["file_called", "listed_folders", "packages_around", "packages_below"]

PACKAGE = "package.xml"
"""The file that makes a folder a ROS package, and names it."""
REPOSITORY = (".git", ".hg", ".svn")
"""What a repository has in its root."""
MAX_FOLDERS = 10_000
"""Folders that are looked into for packages: many times those of the largest repositories of robots."""
MAX_DEPTH = 8
"""How far below a folder packages are looked for."""
BESIDE = 2
"""The same where nothing says where the repository ends."""
NAMED = 4
"""Folders that a message names."""


def packages_around(path: Path) -> list[Path]:
    """The resolved folders that belong to a robot's file: its ROS package, and what lies beside that.

    That is the repository, from the root that has a ``.git`` down. A file that is in a package but in no repository
    has the packages that lie in the same folder as its own, and nothing else of that folder.
    """
    own = path.resolve().parent
    packages = [folder for folder in (own, *own.parents) if (folder / PACKAGE).is_file()]
    root = next((each for each in (own, *own.parents) if any((each / mark).exists() for mark in REPOSITORY)), None)
    if root is not None:
        return [*(each for each in packages[:1] if each.is_relative_to(root)), root]
    if not packages:
        return []
    around = packages[-1].parent
    beside = [] if _is_shared(around) else sorted({*_crawled(around, BESIDE)} - {packages[0]})
    return [packages[0], *beside]


def packages_below(folders: Sequence[Path]) -> Mapping[str, Path]:
    """The ROS packages in folders by the names that their ``package.xml`` gives them; of two, the nearest to the first.

    A folder right in one of these, or the folder itself, that is no package goes by its own name.
    """
    found: dict[str, Path] = {}
    near = folders[0] if folders else Path()
    each_once = {place for folder in folders for place in _crawled(folder, MAX_DEPTH)}
    for place in sorted(each_once, key=lambda place: (-_shared(place, near), len(place.parts), place)):
        found.setdefault(_name(place), place)
    for folder in folders:
        inner = sorted(each for each in folder.iterdir() if each.is_dir()) if folder.is_dir() else []
        inner = [each for each in inner if each.name[0] != "."]
        for place in (folder, *inner):
            found.setdefault(place.name, place)
    return found


def listed_folders(folders: Sequence[Path]) -> str:
    """Folders in one line, of many the first."""
    more = f" and {len(folders) - NAMED} more" if len(folders) > NAMED else ""
    return f"{', '.join(map(str, folders[:NAMED]))}{more}"


def file_called(name: str, folders: Sequence[Path]) -> Path | None:
    """A file of that name in folders or below, upper and lower case being one; the nearest, and None if there is none.

    Nothing is looked at that only a symbolic link leads to.
    """
    found, left = list[Path](), MAX_FOLDERS
    for folder in folders:
        for place, inner, names in os.walk(folder):
            inner[:] = sorted(each for each in inner if each[0] != ".")
            found += [Path(place, each) for each in names if each.lower() == name.lower()]
            left -= 1
            if left < 0:
                break
    return min(found, key=lambda file: (len(file.parts), file), default=None)


def _crawled(folder: Path, depth: int) -> Iterator[Path]:
    """The packages at and below a folder; none that only a symbolic link leads to."""
    waiting, left = [(folder, 0)], MAX_FOLDERS
    for place, level in waiting:  # grows while it is read
        left -= 1
        try:
            if (place / PACKAGE).is_file():
                yield place
            if level == depth or left < 0:
                continue
            with os.scandir(place) as entries:
                names = sorted(e.name for e in entries if e.is_dir(follow_symlinks=False) and e.name[0] != ".")
        except OSError:  # nobody may look into it
            continue
        waiting += [(place / name, level + 1) for name in names]


def _shared(one: Path, other: Path) -> int:
    """How many folders two paths have in common."""
    return len(os.path.commonpath([one, other]).split(os.sep))


def _is_shared(folder: Path) -> bool:
    """Whether a folder is everybody's, or a user's whole home: what lies beside a package there is none of its own."""
    return folder in (Path.home(), Path(folder.anchor)) or bool(folder.stat().st_mode & stat.S_IWOTH)


def _name(folder: Path) -> str:
    try:
        root: ElementTree.Element = parse_xml(read_bytes(folder / PACKAGE, MAX_XML_BYTES))
    except (InvalidFile, Malformed):
        return folder.name
    return (root.findtext("name") or folder.name).strip()
