"""A checked robot description as values, and the canonical URDF text of it.

``Urdf.xml`` holds nothing but what was checked; visual elements, transmissions and plug-in tags are left out of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Shape, Sphere

__all__ = [
    "JOINT",
    "LINK",
    "Inertial",
    "Mimic",
    "Urdf",
    "UrdfCollision",
    "UrdfJoint",
    "UrdfLink",
    "Vector",
    "mesh_name",
]

LINK, JOINT = "link:", "joint:"
"""How names begin in our text: Pinocchio has one list of frames for both, with "universe" and "root_joint" in it."""

Vector = tuple[float, float, float]


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


@dataclass(frozen=True)
class UrdfLink:
    """A link with its collision shapes, in the file's order."""

    name: str
    collisions: tuple[UrdfCollision, ...]
    inertial: Inertial | None


@dataclass(frozen=True)
class Mimic:
    """position = multiplier * position of ``joint`` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; ``kind`` is revolute (also a continuous one), prismatic or fixed; ``axis`` is a unit vector."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    lower: float
    upper: float
    velocity: float
    effort: float
    mimic: Mimic | None


@dataclass(frozen=True)
class Urdf:
    """A checked robot description: one tree of links, rooted at ``root``."""

    name: str
    root: str
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]

    @property
    def shape_count(self) -> int:
        """Collision shapes of all links."""
        return sum(len(link.collisions) for link in self.links)

    def joint_above(self, link: str) -> UrdfJoint | None:
        """The joint whose child ``link`` is; None for the root."""
        return next((joint for joint in self.joints if joint.child == link), None)

    def xml(self) -> str:
        """The same robot as URDF text written by us: numbers in full precision, nothing that was not checked."""
        robot = ElementTree.Element("robot", name=self.name)
        for link in self.links:
            _write_link(robot, link)
        for joint in self.joints:
            _write_joint(robot, joint)
        return ElementTree.tostring(robot, encoding="unicode")


def _words(values: Sequence[float]) -> str:
    return " ".join(repr(value) for value in values)


def _write_link(robot: ElementTree.Element, link: UrdfLink) -> None:
    element = ElementTree.SubElement(robot, "link", name=LINK + link.name)
    if link.inertial is not None:
        inertial = ElementTree.SubElement(element, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_words(link.inertial.xyz), rpy=_words(link.inertial.rpy))
        ElementTree.SubElement(inertial, "mass", value=repr(link.inertial.mass))
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        tensor = {key: repr(value) for key, value in zip(keys, link.inertial.tensor, strict=True)}
        ElementTree.SubElement(inertial, "inertia", tensor)
    for item in link.collisions:
        collision = ElementTree.SubElement(element, "collision")
        ElementTree.SubElement(collision, "origin", xyz=_words(item.xyz), rpy=_words(item.rpy))
        geometry = ElementTree.SubElement(collision, "geometry")
        if isinstance(item.shape, Box):
            ElementTree.SubElement(geometry, "box", size=_words(item.shape.size))
        elif isinstance(item.shape, Cylinder):
            size = {"radius": repr(item.shape.radius), "length": repr(item.shape.length)}
            ElementTree.SubElement(geometry, "cylinder", size)
        elif isinstance(item.shape, Sphere):
            ElementTree.SubElement(geometry, "sphere", radius=repr(item.shape.radius))
        elif isinstance(item.shape, Mesh):
            ElementTree.SubElement(geometry, "mesh", filename=mesh_name(item.shape))


def mesh_name(mesh: Mesh) -> str:
    """What stands for a mesh in our text, where no other library gets to open a file: what it is, not where."""
    return f"sha256-{mesh.digest}.stl"


def _write_joint(robot: ElementTree.Element, joint: UrdfJoint) -> None:
    element = ElementTree.SubElement(robot, "joint", name=JOINT + joint.name, type=joint.kind)
    ElementTree.SubElement(element, "parent", link=LINK + joint.parent)
    ElementTree.SubElement(element, "child", link=LINK + joint.child)
    ElementTree.SubElement(element, "origin", xyz=_words(joint.xyz), rpy=_words(joint.rpy))
    if joint.kind != "fixed":
        ElementTree.SubElement(element, "axis", xyz=_words(joint.axis))
        limit = {key: repr(getattr(joint, key)) for key in ("lower", "upper", "velocity", "effort")}
        ElementTree.SubElement(element, "limit", limit)
