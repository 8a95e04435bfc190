"""The content of a URDF as checked values, without materials, transmissions and what is for other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from planner_service.geometry.arrays import Vector
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.shapes import Pose, Shape

__all__ = ["Description", "Inertial", "Mimic", "Urdf", "UrdfCollision", "UrdfJoint", "UrdfLink", "Vector", "Visual"]


@dataclass(frozen=True)
class Inertial:
    """Mass (kg), centre of mass and its frame, and the tensor ixx, ixy, ixz, iyy, iyz, izz (kg m^2)."""

    mass: float
    xyz: Vector
    rpy: Vector
    tensor: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class UrdfCollision:
    """A collision shape and its ``<origin>`` in the link."""

    shape: Shape
    xyz: Vector
    rpy: Vector


@dataclass(frozen=True, eq=False)
class Visual:
    """One visual element of a link.

    Attributes:
        appearance: The triangles of its mesh, or its box, cylinder or sphere.
        pose: T_link_visual; ``Robot.link_frame`` says where the link is.
    """

    appearance: Shape | Surface
    pose: Pose


@dataclass(frozen=True)
class UrdfLink:
    """A link with its collision shapes, in the file's order, and what it looks like if the reader was asked for it."""

    name: str
    collisions: tuple[UrdfCollision, ...]
    inertial: Inertial | None
    visuals: tuple[Visual, ...] = ()


@dataclass(frozen=True)
class Mimic:
    """position = multiplier * position of ``joint`` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; ``kind`` is revolute, prismatic or fixed; ``axis`` is a unit vector.

    One that is ``continuous`` is revolute, and its limits are a whole turn either way. They are the soft
    limits of the robot's own controller where these are narrower than those of its hardware, which are ``hard`` then.
    ``velocity``, ``effort``, ``acceleration`` and ``jerk`` are 0 where the file does not state them.
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector = (1.0, 0.0, 0.0)
    lower: float = 0.0
    upper: float = 0.0
    velocity: float = 0.0
    effort: float = 0.0
    mimic: Mimic | None = None
    continuous: bool = False
    hard: tuple[float, float] | None = None
    acceleration: float = 0.0
    jerk: float = 0.0


@dataclass(frozen=True)
class Description:
    """The file that describes a robot, the folders that may be read for it, and the arguments of its macros."""

    path: Path
    folders: tuple[Path, ...]
    xacro_args: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Urdf:
    """A robot description: one tree of links with the root ``root``.

    Attributes:
        unread_visuals: Why visual elements that the reader was asked for are missing, a line each.
        remarks: What the reader understood although it is written in an unusual way, a line each.
        notes: What the reader did not understand, or does not use, without a harm to what it did; a line each.
        unused_limits: Limits that joints without end have, a line each.
        description: Where it was read; None if it was no URDF.
    """

    name: str
    root: str
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]
    unread_visuals: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unused_limits: tuple[str, ...] = ()
    description: Description | None = None

    @cached_property
    def below(self) -> Mapping[str, Sequence[UrdfJoint]]:
        """The joints of which each link is the parent, in the file's order."""
        below: dict[str, list[UrdfJoint]] = {link.name: [] for link in self.links}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        return below

    @cached_property
    def above(self) -> Mapping[str, UrdfJoint]:
        """The joint of which each link but the root is the child."""
        return {joint.child: joint for joint in self.joints}
