"""Locking joints of a robot: the bodies that they moved become part of the bodies that carry them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TypeVar

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, Vector, product, turned, vector
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import number
from planner_service.robot.gripper import Gripper
from planner_service.robot.inertia import Dynamics, LinkInertia
from planner_service.robot.kinematic_tree import Body, LinkFrame, LinkShape, chain_to_base, joint_motion
from planner_service.robot.model import ExemptRetreat, JointLimits, Robot

__all__ = ["group_of", "lock_joints"]

Item = TypeVar("Item", LinkShape, LinkFrame, LinkInertia)

Anchor = tuple[int, FloatArray | None]
"""The body of the new robot that an old one belongs to, and T_new_old; None if they are the same body."""


def lock_joints(robot: Robot, joints: Mapping[str, float]) -> Robot:
    """See ``Robot.locked``."""
    positions = _checked(robot, joints)
    if not positions:
        return robot
    kept = [index for index in range(robot.n) if index not in positions]
    bodies, anchors = _merged(robot, positions, kept)
    shapes = tuple(_moved(item, anchors) for item in robot.shapes)
    standing = dict.fromkeys([*robot.base_links, *(item.link for item in shapes if item.body == 0)])
    tool_body, offset = anchors[robot.tool_body]
    on_the_way = any(index in positions for index in _joints_above(robot, robot.tool_body))
    return replace(
        robot,
        joint_names=tuple(robot.joint_names[index] for index in kept),
        limits=JointLimits(**{item.name: getattr(robot.limits, item.name)[kept] for item in fields(JointLimits)}),
        named_poses=tuple((name, q[kept]) for name, q in robot.named_poses),
        base_links=tuple(standing),
        tool_body=tool_body,
        tool_placement=robot.tool_placement if offset is None else product(offset, robot.tool_placement),
        bodies=bodies,
        shapes=shapes,
        gripper=robot.gripper and _moved_gripper(robot.gripper, anchors),
        retreats=_kept_retreats(robot, positions, kept, shapes),
        link_frames=tuple(_moved(item, anchors) for item in robot.link_frames),
        dynamics=robot.dynamics and _moved_masses(robot.dynamics, anchors, kept),
        inverse="numeric" if on_the_way else robot.inverse,
        locked_joints=(*robot.locked_joints, *_locked(robot, positions)),
        continuous=tuple(robot.continuous[index] for index in kept) if robot.continuous else (),
    )


def _checked(robot: Robot, joints: Mapping[str, float]) -> dict[int, float]:
    """Positions by index of the joint."""
    if not isinstance(joints, Mapping):
        raise InvalidRequest("joints", joints, "positions by joint name")
    positions = {}
    for name, position in joints.items():
        if name not in robot.joint_names:
            raise UnknownName("joint", name, robot.joint_names)
        index = robot.joint_names.index(name)
        low, high = (float(bound[index]) for bound in robot.bounds)
        positions[index] = number(f"joints[{name!r}]", position, f"a position in [{low:g}, {high:g}]", low, high)
    if len(positions) == robot.n:
        raise InvalidRequest("joints", sorted(joints), f"at least one of the {robot.n} joints to remain unlocked")
    return positions


def _locked(robot: Robot, positions: Mapping[int, float]) -> list[tuple[str, float]]:
    """The joints that are locked now, and where."""
    return [(robot.joint_names[index], position) for index, position in sorted(positions.items())]


def _merged(robot: Robot, positions: Mapping[int, float], kept: list[int]) -> tuple[tuple[Body, ...], list[Anchor]]:
    """The base and the bodies that still move, and the anchor of each old body."""
    bodies = [robot.bodies[0]]
    anchors: list[Anchor] = [(0, None)]
    for body in robot.bodies[1:]:
        parent, offset = anchors[body.parent]
        placement = body.placement if offset is None else product(offset, body.placement)
        if body.q_index in positions:
            way, axis = body.multiplier * positions[body.q_index], vector(body.axis.tolist())
            anchors.append((parent, product(placement, joint_motion(axis, way, slides=body.prismatic))))
        else:
            anchors.append((len(bodies), None))
            bodies.append(replace(body, parent=parent, placement=placement, q_index=kept.index(body.q_index)))
    return tuple(bodies), anchors


def _moved(item: Item, anchors: list[Anchor]) -> Item:
    body, offset = anchors[item.body]
    pose = item.pose if offset is None else Pose.from_matrix(product(offset, item.pose.matrix))
    return replace(item, body=body, pose=pose)


def _moved_masses(dynamics: Dynamics, anchors: list[Anchor], kept: list[int]) -> Dynamics:
    return Dynamics(dynamics.effort[kept], tuple(_moved(item, anchors) for item in dynamics.links))


def _moved_gripper(gripper: Gripper, anchors: list[Anchor]) -> Gripper:
    directions, turns, across = list(gripper.directions), list(gripper.turns), gripper.across
    for k, item in enumerate(gripper.closed):
        offset = anchors[item.body][1]
        if offset is not None and gripper.directions:
            directions[k] = turned(gripper.directions[k], offset)
        if offset is not None and gripper.turns:
            across = turned(gripper.across, offset)
            turns[k] = tuple(
                replace(turn, axis=turned(turn.axis, offset), point=_placed(turn.point, offset))
                for turn in gripper.turns[k]
            )
    closed = tuple(_moved(item, anchors) for item in gripper.closed)
    return replace(gripper, closed=closed, directions=tuple(directions), turns=tuple(turns), across=across)


def _placed(point: Vector, T: FloatArray) -> Vector:
    x, y, z = (a + b for a, b in zip(turned(point, T), T[:3, 3].tolist(), strict=True))
    return (x, y, z)


def _kept_retreats(
    robot: Robot, positions: Mapping[int, float], kept: list[int], shapes: tuple[LinkShape, ...]
) -> tuple[ExemptRetreat, ...]:
    """The retreats whose pairs still move against each other exactly as before.

    A retreat was checked on one line of the joints between the two links; with one of these joints locked at another
    position, nothing is known about it.
    """
    old, new = ({item.link: item.body for item in items} for items in (robot.shapes, shapes))
    retreats = []
    for retreat in robot.retreats:
        rest = robot.pose(retreat.pose)
        pairs = tuple((a, b) for a, b in retreat.pairs if new[a] != new[b])
        between = {
            robot.bodies[body].q_index
            for a, b in pairs
            for body in set(chain_to_base(robot.bodies, old[a])) ^ set(chain_to_base(robot.bodies, old[b]))
            if robot.bodies[body].q_index in positions
        }
        if pairs and all(float(rest[i]) == positions[i] == float(retreat.to[i]) for i in between):
            retreats.append(replace(retreat, to=retreat.to[kept], pairs=pairs))
    return tuple(retreats)


def _joints_above(robot: Robot, body: int) -> list[int]:
    """The joints that move a body."""
    return [robot.bodies[index].q_index for index in chain_to_base(robot.bodies, body)]


def group_of(robot: Robot, name: str) -> Robot:
    """See ``Robot.group``."""
    groups = {group.name: group for group in robot.groups}
    if not isinstance(name, str) or name not in groups:
        raise UnknownName("planning group", name, groups)
    group = groups[name]
    moving = [joint for joint in robot.joint_names if joint in group.joints]
    if not moving:
        raise InvalidRequest("group", name, f"one with joints that move; {', '.join(group.joints) or 'none'} do not")
    still = {joint: float(q) for joint, q in zip(robot.joint_names, robot.home, strict=True) if joint not in moving}
    part = replace(lock_joints(robot, still), groups=())
    if group.tip is None or group.tip == robot.tool_frame:
        return part
    body, placement = part.link_frame(group.tip)
    return replace(part, tool_frame=group.tip, tool_body=body, tool_placement=placement)
