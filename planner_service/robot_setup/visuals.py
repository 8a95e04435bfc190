"""What the links of a robot look like, which no check ever asks about: for pictures, and to compare with the shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.macros.expansion import package_folders
from planner_service.robot.model import Robot
from planner_service.robot.urdf_model import Urdf, Visual
from planner_service.robot.urdf_reader import read_urdf

__all__ = ["Looks", "Visual", "link_visuals", "looks_of", "shape_poses", "visuals_of"]


def link_visuals(urdf: Path, package_dirs: Sequence[Path] = ()) -> dict[str, tuple[Visual, ...]]:
    """What each link of a URDF looks like; links without visual elements are left out, as are those with a problem.

    Args:
        package_dirs: Folders in which meshes may lie, besides those in which ``load_robot`` looks.

    Raises:
        InvalidFile: the URDF has problems besides those of visual elements.
    """
    return visuals_of(read_urdf(urdf, (*package_dirs, *package_folders(urdf)), visuals=True))


def visuals_of(urdf: Urdf) -> dict[str, tuple[Visual, ...]]:
    """As ``link_visuals``, of a URDF that was read with its visual elements."""
    return {link.name: link.visuals for link in urdf.links if link.visuals}


def shape_poses(urdf: Urdf) -> dict[str, Pose]:
    """T_link_shape of the first collision shape of each link that has one."""
    first = ((link.name, link.collisions[0]) for link in urdf.links if link.collisions)
    return {name: Pose.from_rpy(item.xyz, item.rpy) for name, item in first}


@dataclass(frozen=True, eq=False)
class Looks:
    """What a robot looks like.

    Attributes:
        visuals: As ``link_visuals``.
        unread: Why visual elements are missing, a line each.
        shaped: As ``shape_poses``.
    """

    visuals: Mapping[str, tuple[Visual, ...]]
    unread: tuple[str, ...]
    shaped: Mapping[str, Pose]

    def placements(self, robot: Robot, q: ArrayLike) -> dict[str, FloatArray]:
        """T_world_link (4, 4) of the links that look like something, with the robot at q (n,).

        Fingers, which move with the gripper's width, are where their shapes are; one without shapes is left out.
        """
        bodies = [body_matrix(pose) for pose in robot.body_poses(np.asarray(q, dtype=np.float64))]
        placed = {frame.link: bodies[frame.body] @ frame.pose.matrix for frame in robot.link_frames}
        placed[robot.tool_frame] = bodies[robot.tool_body] @ robot.tool_placement
        for item in reversed(robot.shapes):  # so that of several the first remains
            if robot.gripper is not None and item.link in robot.gripper.links and item.link in self.shaped:
                placed[item.link] = bodies[item.body] @ item.pose.matrix @ np.linalg.inv(self.shaped[item.link].matrix)
        return {link: placed[link] for link in self.visuals if link in placed}


def looks_of(robot: Robot) -> Looks:
    """What a robot looks like, read from the file that describes it; nothing if there is none.

    Raises:
        InvalidFile: the file has changed and has problems now.
    """
    if robot.description is None:
        return Looks({}, (), {})
    of = robot.description
    urdf = read_urdf(of.path, of.folders, visuals=True, xacro_args=of.xacro_args)
    return Looks(visuals_of(urdf), urdf.unread_visuals, shape_poses(urdf))
