"""Robots by name or file: those that come with the package, and any URDF, xacro or MJCF file."""

from __future__ import annotations

import os
from pathlib import Path

from planner_service.concurrency.library_import import loaded
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.files.reading import as_path
from planner_service.geometry.validation import flag
from planner_service.robot.model import Robot, robot_names
from planner_service.robot.package_files import EXAMPLES, example_urdf

__all__ = ["load_robot"]

DESCRIPTIONS = (".urdf", ".xacro", ".xml", ".mjcf")
"""Suffixes of files that describe a robot by themselves: URDF, xacro and MJCF."""


def _loading() -> None:
    import planner_service.robot.loading  # noqa: F401  pydantic takes 0.1 s


def load_robot(name_or_path: str | Path, *, cut_meshes: bool = True) -> Robot:
    """The robot of a robot.toml, URDF, xacro or MJCF file: by name if it comes with the package, else by path.

    ``example-robot-data:ur5_robot`` is the URDF of that name in the package example-robot-data.

    A URDF (``my.urdf``) works by itself, with the SRDF beside it if there is one: in its folder, ../srdf or ../config,
    with the same stem or the same name of the robot. Links may touch that are adjacent, that the SRDF disables, or that
    overlapped in each of 1,000 random configurations; ``Robot.allowed_contacts`` gives the reasons. Limits are those of
    ``Robot.from_urdf``. Home is the SRDF's "home" or "ready", else zero where the limits allow it, else their middle;
    where the robot collides with itself there, it is the nearest free configuration found. A xacro file is expanded
    with the defaults of its arguments (extra xacro); MJCF (``.xml``, ``.mjcf``) is compiled by mujoco (extra mjcf), and
    brings excluded contacts and keyframes itself.

    Meshes of a URDF or xacro file are cut into convex pieces where their hulls touch what they do not: a second for
    each, once, as the cuts are kept on disk. A robot.toml names the links to cut itself (``decompose``).

    Args:
        cut_meshes: False: all meshes of a URDF or xacro file count as their solid hulls.

    Raises:
        UnknownName: no robot of that name comes with the package, or with example-robot-data.
        InvalidFile: robot.toml, its URDF or its SRDF has problems; all of them are named.
        MissingDependency: its files are in a package that is not installed; the message says what to install.
    """
    loaded(_loading)
    from planner_service.robot.loading import robot_from_file

    if not isinstance(name_or_path, (str, os.PathLike)):
        raise InvalidRequest("robot", name_or_path, "the name of a robot or the path of a file")
    path = as_path("robot", name_or_path)
    name = str(name_or_path)
    source, colon, example = name.partition(":")
    if colon and source == EXAMPLES and isinstance(name_or_path, str):
        path = example_urdf(example)
    if path.suffix.lower() in DESCRIPTIONS:
        from planner_service.robot_setup.urdf_robot import load_urdf

        return load_urdf(path, cut_meshes=flag("cut_meshes", cut_meshes))
    if not isinstance(name_or_path, str) or "/" in name or name.endswith(".toml"):
        return robot_from_file(path)
    if name not in robot_names():
        raise UnknownName("robot", name, robot_names())
    return robot_from_file(data_folder("robots") / name / "robot.toml")
