"""Robots by name or file: those that come with the package, and any URDF, xacro or MJCF file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import NoneType

from planner_service.concurrency.library_import import loaded
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.package_data import data_folder
from planner_service.files.reading import as_path
from planner_service.geometry.validation import flag, instance, items
from planner_service.robot.model import Robot, robot_names
from planner_service.robot.package_files import EXAMPLES, example_urdf

__all__ = ["load_robot", "refuse_for_toml", "robot_file"]

DESCRIPTIONS = (".urdf", ".xacro", ".xml", ".mjcf")
"""Suffixes of files that describe a robot by themselves: URDF, xacro and MJCF."""


def _loading() -> None:
    import planner_service.robot.loading  # noqa: F401  pydantic takes 0.1 s


def robot_file(name_or_path: str | Path) -> Path:
    """The file of a robot that ``load_robot`` knows by name or path: a robot.toml or a description.

    Raises:
        UnknownName, InvalidRequest: as of ``load_robot``.
    """
    if not isinstance(name_or_path, (str, os.PathLike)):
        raise InvalidRequest("robot", name_or_path, "the name of a robot or the path of a file")
    path, name = as_path("robot", name_or_path), str(name_or_path)
    if not isinstance(name_or_path, str):
        return path
    source, colon, example = name.partition(":")
    if colon and source == EXAMPLES:
        return example_urdf(example)
    if path.suffix.lower() in DESCRIPTIONS or "/" in name or name.endswith(".toml"):
        return path
    if name not in robot_names():
        raise UnknownName("robot", name, robot_names())
    return data_folder("robots") / name / "robot.toml"


def refuse_for_toml(**given: object) -> None:
    """Raise if anything is given that is for descriptions alone; None is not given.

    Raises:
        InvalidRequest: it is.
    """
    for field, value in given.items():
        if value is not None:
            raise InvalidRequest(field, value, "none: it is for URDF, xacro and MJCF; a robot.toml says it itself")


def load_robot(
    name_or_path: str | Path,
    *,
    cut_meshes: bool = True,
    package_dirs: Sequence[Path | str] = (),
    xacro_args: Mapping[str, object] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    tool_frame: str | None = None,
    gripper: Sequence[str] | None = None,
) -> Robot:
    """The robot of a robot.toml, URDF, xacro or MJCF file: by name if it comes with the package, else by path.

    ``example-robot-data:ur5_robot`` is the URDF of that name in the package example-robot-data.

    A URDF (``my.urdf``) works by itself, with the SRDF beside it if there is one: in its folder, ../srdf or ../config,
    with the same stem or the same name of the robot. Links may touch that are adjacent, that the SRDF disables, or that
    overlapped in each of 1,000 random configurations; ``Robot.allowed_contacts`` gives the reasons. Limits are those of
    ``Robot.from_urdf``. Home is the SRDF's "home" or "ready", else zero where the limits allow it, else their middle;
    where the robot collides with itself there, it is the nearest free configuration found. A xacro file is expanded
    with the defaults of its arguments (extra xacro); MJCF (``.xml``, ``.mjcf``) is compiled by mujoco (extra mjcf), and
    brings excluded contacts and keyframes itself. ROS packages are found in the repository of the file.

    Meshes of a URDF or xacro file are cut into convex pieces where their hulls touch what they do not: about a second
    for each, once, since the cuts are cached on disk. A robot.toml names the links to cut itself (``decompose``).

    Args:
        cut_meshes: False: all meshes of a URDF or xacro file count as their solid hulls.
        package_dirs: Further folders that may be read, with the ROS packages in them. Of a URDF, xacro or MJCF file
            alone, as the next.
        xacro_args: The arguments of a xacro file that do not have their defaults, by name.
        locked_joints: Joints that do not move, with their positions in rad or m.
        tool_frame: The link whose frame is the tool's; None: the one that its name, a gripper or the SRDF makes likely.
            A leg, a head or a finger has none, and of several arms the first has it. Of a description alone, as the
            next.
        gripper: The joints of its fingers; () for none, so that fingers are joints like others; None: two fingers that
            leave no doubt. Fingers that do are locked where they rest, and a warning says why.

    Raises:
        UnknownName: no robot of that name comes with the package, or with example-robot-data; or no such joint or link.
        InvalidFile: robot.toml, its URDF or its SRDF has problems; all of them are named.
        InvalidRequest: a robot.toml, which says itself where its files are, is given folders or arguments.
        MissingDependency: its files are in a package that is not installed; the message says what to install.
    """
    loaded(_loading)
    from planner_service.robot.loading import Selection, robot_from_file
    from planner_service.robot.macros.expansion import checked_xacro_args

    path = robot_file(name_or_path)
    folders = tuple(as_path("package_dirs", each) for each in items("package_dirs", package_dirs, object, "folders"))
    locked = instance(
        "locked_joints", {} if locked_joints is None else locked_joints, Mapping, "positions by joint name"
    )
    cut = flag("cut_meshes", cut_meshes)
    arguments = checked_xacro_args({} if xacro_args is None else xacro_args)
    instance("tool_frame", tool_frame, (str, NoneType), "the name of a link, or None")
    hand = None if gripper is None else items("gripper", gripper, str, "names of joints")
    if path.suffix.lower() in DESCRIPTIONS:
        from planner_service.robot_setup.urdf_robot import load_urdf

        chosen = Selection(tool_frame=tool_frame, locked_joints=locked, xacro_args=arguments, gripper=hand)
        return load_urdf(path, folders, chosen, cut_meshes=cut)
    places = list(map(str, folders)) or None
    refuse_for_toml(
        cut_meshes=None if cut else False,
        package_dirs=places,
        xacro_args=arguments or None,
        tool_frame=tool_frame,
        gripper=hand,
    )
    return robot_from_file(path).locked(locked)
