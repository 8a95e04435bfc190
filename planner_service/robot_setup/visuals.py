"""What the links of a robot look like, which no check ever asks about: for pictures, and to compare with the shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.shapes import Pose, Shape
from planner_service.robot.macros.expansion import package_folders
from planner_service.robot.urdf_model import Urdf
from planner_service.robot.urdf_reader import read_urdf

__all__ = ["Visual", "link_visuals", "visuals_of"]


@dataclass(frozen=True, eq=False)
class Visual:
    """One visual element of a link.

    Attributes:
        appearance: The triangles of its mesh, or its box, cylinder or sphere.
        pose: T_link_visual; ``Robot.link_frame`` says where the link is.
    """

    appearance: Shape | Surface
    pose: Pose


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
    return {
        link.name: tuple(Visual(item.appearance, Pose.from_rpy(item.xyz, item.rpy)) for item in link.visuals)
        for link in urdf.links
        if link.visuals
    }
