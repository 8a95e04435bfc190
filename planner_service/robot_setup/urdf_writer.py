"""A robot description as a URDF file with its meshes, for formats that other tools do not read."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from planner_service.errors import BrokenInvariant
from planner_service.files.writing import write_whole
from planner_service.geometry.arrays import Vector
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Sphere
from planner_service.robot.urdf_model import Urdf, UrdfCollision, UrdfJoint, UrdfLink

__all__ = ["write_urdf"]

MESHES = "meshes"


def write_urdf(urdf: Urdf, path: Path) -> None:
    """Write a URDF 1.2 of links with their collision shapes and masses, and of joints; hulls lie beside it as OBJ.

    Every number is written with all of its digits, so ``read_urdf`` gives the same robot, up to rounding of the axes.
    """
    root = Element("robot", {"name": urdf.name, "version": "1.2"})
    hulls: dict[str, str] = {}
    for link in urdf.links:
        _link(root, link, hulls)
    for joint in urdf.joints:
        _joint(root, joint)
    (path.parent / MESHES).mkdir(exist_ok=True)
    for text, name in hulls.items():
        write_whole(path.parent / name, text.encode())
    ElementTree.indent(root)
    write_whole(path, ElementTree.tostring(root))


def _link(root: Element, link: UrdfLink, hulls: dict[str, str]) -> None:
    element = SubElement(root, "link", {"name": link.name})
    if link.inertial is not None:
        inertial = SubElement(element, "inertial")
        _origin(inertial, link.inertial.xyz, link.inertial.rpy)
        SubElement(inertial, "mass", {"value": repr(link.inertial.mass)})
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        SubElement(inertial, "inertia", dict(zip(names, map(repr, link.inertial.tensor), strict=True)))
    for item in link.collisions:
        _collision(element, item, hulls)


def _collision(link: Element, item: UrdfCollision, hulls: dict[str, str]) -> None:
    element = SubElement(link, "collision")
    _origin(element, item.xyz, item.rpy)
    geometry, shape = SubElement(element, "geometry"), item.shape
    if isinstance(shape, Box):
        SubElement(geometry, "box", {"size": _numbers(shape.size)})
    elif isinstance(shape, Sphere):
        SubElement(geometry, "sphere", {"radius": repr(shape.radius)})
    elif isinstance(shape, Cylinder | Capsule):
        kind = type(shape).__name__.lower()
        SubElement(geometry, kind, {"radius": repr(shape.radius), "length": repr(shape.length)})
    elif isinstance(shape, Mesh):
        text = _obj(shape)
        SubElement(geometry, "mesh", {"filename": hulls.setdefault(text, f"{MESHES}/hull_{len(hulls)}.obj")})
    else:
        raise BrokenInvariant(f"a URDF has no {type(shape).__name__}")


def _obj(mesh: Mesh) -> str:
    corners = [f"v {_numbers(row)}" for row in mesh.vertices.tolist()]
    return "\n".join([*corners, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces.tolist()), ""])


def _joint(root: Element, joint: UrdfJoint) -> None:
    element = SubElement(root, "joint", {"name": joint.name, "type": "continuous" if joint.continuous else joint.kind})
    SubElement(element, "parent", {"link": joint.parent})
    SubElement(element, "child", {"link": joint.child})
    _origin(element, joint.xyz, joint.rpy)
    if joint.kind == "fixed":
        return
    SubElement(element, "axis", {"xyz": _numbers(joint.axis)})
    limits = {} if joint.continuous else {"lower": repr(joint.lower), "upper": repr(joint.upper)}
    for name in ("velocity", "effort", "acceleration", "jerk"):
        if getattr(joint, name):
            limits[name] = repr(getattr(joint, name))
    SubElement(element, "limit", limits)
    if joint.mimic is not None:
        numbers = {"multiplier": repr(joint.mimic.multiplier), "offset": repr(joint.mimic.offset)}
        SubElement(element, "mimic", {"joint": joint.mimic.joint, **numbers})


def _origin(element: Element, xyz: Vector, rpy: Vector) -> None:
    SubElement(element, "origin", {"xyz": _numbers(xyz), "rpy": _numbers(rpy)})


def _numbers(values: Vector | list[float]) -> str:
    return " ".join(map(repr, values))
