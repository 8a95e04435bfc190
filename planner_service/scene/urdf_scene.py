"""Worlds described in URDF, as simulators take them: nothing moves, and joints that could stand at zero."""

from __future__ import annotations

import os

from planner_service.files.reading import as_path, tell_notes
from planner_service.geometry.shapes import Pose
from planner_service.robot.urdf_model import Urdf
from planner_service.robot.urdf_reader import read_urdf
from planner_service.scene.obstacle_list import ObstacleList
from planner_service.scene.scene import Scene

__all__ = ["read_urdf_scene"]


def read_urdf_scene(path: str | os.PathLike[str]) -> Scene:
    """The collision shapes of a URDF or xacro file, in the file's order.

    The frame of the root link is taken as the robot's base frame. A link of several shapes becomes the obstacles
    ``link``, ``link#2``, ...; masses and visual shapes are left out. A joint that can move stands at zero, with a
    warning.

    Raises:
        InvalidFile: with every problem found, those of the file itself before those of its use as a world: a name that
            is taken.
        MissingDependency: a xacro file, and xacro is not installed.
    """
    path = as_path("path", path)
    urdf = read_urdf(path)
    obstacles = ObstacleList()
    moving = [
        f"joint {joint.name!r}: it can move ({joint.kind}), and stands at zero here: nothing in a scene moves"
        for joint in urdf.joints
        if joint.kind != "fixed"
    ]
    tell_notes(path, [*urdf.notes, *moving])
    stands = _link_poses(urdf)
    for link in urdf.links:
        for k, item in enumerate(link.collisions):
            pose = stands[link.name] @ Pose.from_rpy(item.xyz, item.rpy)
            where = f"link {link.name!r} collision[{k}]"
            obstacles.add(where, link.name if k == 0 else f"{link.name}#{k + 1}", item.shape, pose)
    return obstacles.scene(path, urdf.name)


def _link_poses(urdf: Urdf) -> dict[str, Pose]:
    """Where each link is in the root's frame, every joint taken as fixed."""
    stands, open_links = {urdf.root: Pose()}, [urdf.root]
    for parent in open_links:  # grows while it is read
        for joint in urdf.below[parent]:
            stands[joint.child] = stands[parent] @ Pose.from_rpy(joint.xyz, joint.rpy)
            open_links.append(joint.child)
    return stands
