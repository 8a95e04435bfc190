"""What arms carry: objects that are links of the arm that holds them, each on the body of its own tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planner_service.cell.arms import Arm
from planner_service.cell.layout import Layout
from planner_service.constraints import Constraint
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.composite import Compound
from planner_service.geometry.shapes import Pose, Shape
from planner_service.planning.request import inertia_of
from planner_service.robot.inertia import LinkInertia
from planner_service.robot.kinematic_tree import LinkShape
from planner_service.robot.model import AllowedContact, Robot
from planner_service.scene.scene import Attached

__all__ = ["constraints_of", "loaded"]


def loaded(layout: Layout) -> Layout:
    """The same cell, what its arms carry as links of their robots, which are called ``left_box`` of the arm left.

    Raises:
        UnknownName: There is no such arm, or no touch link with shapes in its robot.
        InvalidRequest: Two things would get one name, or a shape is none of convex pieces.
    """
    if not any(layout.carried.values()):
        return layout
    names = layout.groups if layout.whole is not None else layout.arms
    for name in layout.carried:
        if name not in names:
            raise UnknownName("arm", name, names)
    if layout.whole is None:
        arms = {
            name: Arm(_holding(arm.robot, layout.carried.get(name, ()), "", arm.robot.tool_frame), arm.base)
            for name, arm in layout.arms.items()
        }
        return replace(layout, arms=arms, carried={})
    whole = layout.whole
    for name, held in layout.carried.items():
        whole = _holding(whole, held, f"{name}_", layout.tools.get(name, whole.tool_frame))
    return replace(layout, whole=whole, carried={})


def constraints_of(carried: Sequence[Attached]) -> tuple[Constraint, ...]:
    """What motions keep because of what an arm carries, each once."""
    return tuple(dict.fromkeys(constraint for held in carried for constraint in held.constraints))


def _holding(robot: Robot, carried: Sequence[Attached], prefix: str, tool: str) -> Robot:
    """A robot with objects at one of its links, at their poses there."""
    body, placement = robot.link_frame(tool)
    at = Pose.from_matrix(placement)
    shapes, contacts, masses = list(robot.shapes), list(robot.allowed_contacts), list[LinkInertia]()
    shaped = {item.link for item in robot.shapes}
    taken = {*robot.links, *(item.link for item in robot.link_frames)}
    for held in carried:
        link = prefix + held.name
        if link in taken:
            raise InvalidRequest("carried", held.name, f"names that no link has; {link!r} is one")
        taken.add(link)
        shapes += [LinkShape(link, body, shape, at @ held.pose @ pose) for shape, pose in _convex(held)]
        for touched in held.touch_links:
            if touched not in shaped:
                raise UnknownName("touch link", touched, shaped)
            contacts.append(AllowedContact((link, touched), "it is held there"))
        if held.mass is not None and robot.dynamics is not None:
            mass = inertia_of(held, held.mass)
            masses.append(replace(mass, link=link, body=body, pose=at @ mass.pose))
    dynamics = robot.dynamics and replace(robot.dynamics, links=(*robot.dynamics.links, *masses))
    return replace(robot, shapes=tuple(shapes), allowed_contacts=tuple(contacts), dynamics=dynamics)


def _convex(held: Attached) -> tuple[tuple[Shape, Pose], ...]:
    if isinstance(held.shape, Compound):
        return held.shape.parts
    if isinstance(held.shape, Shape):
        return ((held.shape, Pose()),)
    raise InvalidRequest("carried", held.name, "an object of convex pieces, such as a box or a compound")
