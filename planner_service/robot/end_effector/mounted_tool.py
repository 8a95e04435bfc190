"""A tool that a robot.toml adds to its URDF: one more link with shapes, and the frame of its working point."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import vector
from planner_service.geometry.shapes import Box, Cylinder, Shape, Sphere
from planner_service.robot.toml_reader import ToolShapeTable, ToolTable
from planner_service.robot.urdf_model import Urdf, UrdfCollision, UrdfJoint, UrdfLink, Vector

__all__ = ["with_tool"]

ORIGIN: Vector = (0.0, 0.0, 0.0)


def with_tool(urdf: Urdf, tool: ToolTable) -> Urdf:
    """The URDF with the tool's link and frame.

    Raises:
        UnknownName: there is no link that it could be fixed to.
        InvalidRequest: a name is taken, or a shape is none.
    """
    links = [link.name for link in urdf.links]
    if tool.parent not in links:
        raise UnknownName("link of tool.parent", tool.parent, links)
    for key, name in (("link", tool.link), ("frame", tool.frame)):
        if name in links:
            raise InvalidRequest(f"tool.{key}", name, "a name that no link of the URDF has")
        links.append(name)
    shapes = tuple(_shapes(tool))
    added = (UrdfLink(tool.link, shapes, None), UrdfLink(tool.frame, (), None))
    joints = (
        _fixed(tool.link, tool.parent, vector(tool.position), vector(tool.rpy)),
        _fixed(tool.frame, tool.link, vector(tool.tip), ORIGIN),
    )
    return replace(urdf, links=(*urdf.links, *added), joints=(*urdf.joints, *joints))


def _shapes(tool: ToolTable) -> Iterator[UrdfCollision]:
    for k, table in enumerate(tool.shape):
        where = f"tool.shape[{k}]"
        try:
            yield UrdfCollision(_shape(table), vector(table.position), vector(table.rpy))
        except InvalidRequest as error:
            raise InvalidRequest(where, error.value, error.expected, message=f"{where}: {error}") from None


def _shape(table: ToolShapeTable) -> Shape:
    given: list[Shape] = []
    if table.box is not None:
        given.append(Box(vector(table.box)))
    if table.cylinder is not None:
        given.append(Cylinder(table.cylinder.radius, table.cylinder.length))
    if table.sphere is not None:
        given.append(Sphere(table.sphere))
    if len(given) != 1:
        raise InvalidRequest("shape", f"{len(given)} shapes", "one of box, cylinder and sphere")
    return given[0]


def _fixed(link: str, parent: str, xyz: Vector, rpy: Vector) -> UrdfJoint:
    return UrdfJoint(f"to {link}", "fixed", parent, link, xyz, rpy)
