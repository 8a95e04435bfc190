"""Robots that nobody here drew: their descriptions, out of packages on PyPI, just as these bring them.

A package is fetched as a wheel and unpacked among the user's caches; nothing of it is installed or run.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import planner_service as ps
from planner_service.files.disk_cache import cache_folder
from planner_service.files.toml_reader import read_tables
from planner_service.robot.package_files import example_urdf, package_folder
from planner_service.robot.srdf import Srdf
from planner_service.robot.urdf_reader import read_urdf
from planner_service.robot_setup.gripper_detection import find_gripper

__all__ = [
    "FOLDER_VARIABLE",
    "MESHED",
    "READINGS",
    "ROBOTS",
    "ForeignRobot",
    "described_file",
    "folder_of",
    "table_of_robot",
]

FOLDER_VARIABLE = "PLANNER_SERVICE_ROBOTS"
"""The environment variable that names the folder of unpacked wheels."""

EXAMPLES = "example-robot-data"
"""Installed with the package: its robots load by name."""

LIST = Path(__file__).parent / "robots.toml"
"""What there is: by package, its version and the robots' names and files; the right tool frames; what is read alone."""


@dataclass(frozen=True)
class ForeignRobot:
    """A robot's name in tables, who brings it, what that calls it or its file therein, and its right tool frames."""

    name: str
    distribution: str
    file: str
    tools: tuple[str, ...] = ()

    def source(self) -> str:
        """What ``load_robot`` is given; the wheel is fetched if it is not there yet.

        Raises:
            InvalidRequest: it cannot be fetched.
        """
        if self.distribution == EXAMPLES:
            return f"{EXAMPLES}:{self.file}"
        return str(_unpacked(self.distribution) / self.file)


def _listed() -> tuple[tuple[ForeignRobot, ...], dict[str, str], dict[str, Any]]:
    """The robots, the versions of packages, and all that the list says."""
    listed = read_tables(LIST, 100_000)
    found = tuple(
        ForeignRobot(name, package, file, tuple(listed["tools"].get(name, ())))
        for package, content in listed["packages"].items()
        for name, file in content["robots"].items()
    )
    return found, {package: content["version"] for package, content in listed["packages"].items()}, listed


ROBOTS, VERSIONS, _LIST = _listed()

MESHED = tuple(one for one in ROBOTS if one.name in _LIST["meshed"])
"""Arms whose links are meshes."""

READINGS = (*ROBOTS, *(ForeignRobot(name, EXAMPLES, name) for name in _LIST["read_alone"]))
"""Robot files of which readings are compared."""


def described_file(source: str, place: Path | None) -> Path:
    """The file of a robot's source; with a folder for files that have to be made, as others can read it."""
    scheme, _, name = source.partition(":")
    path = example_urdf(name) if scheme == EXAMPLES else Path(source)
    if place is None:
        return path
    if "xmlns:xacro" in path.read_text("utf-8"):
        return _expanded(path, place)
    return _flattened(path, place) if path.suffix == ".xml" else path


def table_of_robot(robot: ps.Robot, source: str, place: Path) -> dict[str, Any]:
    """What the independent checker needs of a robot of ``source``: where its file is, and what was chosen of it.

    Args:
        place: A folder for files that have to be made.
    """
    urdf, examples = described_file(source, place), package_folder(EXAMPLES)
    folders = [*list(Path(source).parents)[:5], *list(urdf.parents)[:5], examples, examples.parent]
    values = {"lower": robot.bounds[0].tolist(), "upper": robot.bounds[1].tolist()}
    gripper = robot.gripper
    fingers: dict[str, Any] = {}
    if gripper is not None:
        found = find_gripper(read_urdf(urdf, folders), Srdf()) if urdf.suffix != ".xml" else None
        closed = [0.0] * len(gripper.joints) if found is None else found.table.closed_at
        position = gripper.position(robot.gripper_width)
        fingers = {"kind": gripper.kind, "joints": list(gripper.joints), "width": robot.gripper_width}
        fingers |= {"position": position, "closed_at": closed or [0.0] * len(gripper.joints)}
    return {
        "urdf": urdf,
        "package_dirs": folders,
        "joints": list(robot.joint_names),
        "locked_joints": dict(robot.locked_joints),
        "tool_frame": robot.tool_frame,
        "allowed_contacts": [{"links": contact.links} for contact in robot.allowed_contacts],
        "limits": {"position": values, "velocity": {"values": robot.limits.velocity.tolist()}},
        "gripper": fingers,
    }


def _expanded(path: Path, place: Path) -> Path:
    """The URDF that a xacro file expands to, by the package xacro itself."""
    import xacro

    out = place / "expanded.urdf"
    out.write_text(str(xacro.process_file(str(path)).toxml()), "utf-8")
    return out


def _flattened(path: Path, place: Path) -> Path:
    """The MJCF file with what it includes, which Pinocchio would read twice."""
    import mujoco

    out = place / "flat.xml"
    mujoco.mj_saveLastXML(str(out), mujoco.MjModel.from_xml_path(str(path)))
    root = ElementTree.fromstring(out.read_text("utf-8"))
    compiler = root.find("compiler")
    if compiler is not None and "meshdir" in compiler.attrib:
        compiler.set("meshdir", str((path.parent / compiler.attrib["meshdir"]).resolve()))
    out.write_text(ElementTree.tostring(root, encoding="unicode"), "utf-8")
    return out


def folder_of(surroundings: Mapping[str, str] = os.environ) -> Path:
    """Where wheels are unpacked: ``$PLANNER_SERVICE_ROBOTS``, else ``robots`` in the folder of the package's caches.

    Raises:
        InvalidRequest: neither is known.
    """
    named, caches = surroundings.get(FOLDER_VARIABLE), cache_folder(surroundings)
    if named:
        return Path(named).absolute()
    if caches is None:
        raise ps.InvalidRequest(FOLDER_VARIABLE, "unset", "the folder in which wheels are to be unpacked")
    return caches.absolute() / "robots"


def _unpacked(distribution: str) -> Path:
    """The folder of an unpacked wheel, fetched if need be."""
    wanted = f"{distribution}=={VERSIONS[distribution]}"
    folder = folder_of() / wanted
    if folder.is_dir():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent) as made:
        place = Path(made)
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--no-deps",
            "--only-binary",
            ":all:",
            "--dest",
            made,
            wanted,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wheels = list(place.glob("*.whl"))
        if done.returncode != 0 or len(wheels) != 1:
            raise ps.InvalidRequest("robots", wanted, f"a wheel that pip can fetch: {done.stderr.strip()[-300:]}")
        with zipfile.ZipFile(wheels[0]) as wheel:  # keeps what it unpacks inside
            wheel.extractall(place / "unpacked")
        (place / "unpacked").rename(folder)
    return folder
