"""Arms of a cell: robots at places as one robot, and each arm alone with the others standing or away.

Every name gets that of its arm before it: ``left_joint_0``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from typing import TypeVar

import numpy as np

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, product, turned
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, items
from planner_service.robot.gripper import FingerTurn, Gripper
from planner_service.robot.groups import PlanningGroup
from planner_service.robot.inertia import Dynamics, LinkInertia
from planner_service.robot.kinematic_tree import LinkFrame, LinkShape, body_matrix, chain_to_base
from planner_service.robot.model import AllowedContact, JointLimits, Robot, lock_joints

__all__ = ["Arm", "Part", "parts_at_places", "parts_of"]

Item = TypeVar("Item", LinkShape, LinkFrame, LinkInertia)


@dataclass(frozen=True)
class Arm:
    """A robot, and where its base stands in the cell's frame.

    Raises:
        InvalidRequest: They are no Robot and no Pose.
    """

    robot: Robot
    base: Pose = field(default_factory=Pose)

    def __post_init__(self) -> None:
        instance("robot", self.robot, Robot, "a Robot")
        instance("base", self.base, Pose, "a Pose")


@dataclass(frozen=True, eq=False)
class Part:
    """One arm of the whole.

    Attributes:
        name: What the arm is called.
        robot: The arm alone, in the cell's frame: its own tool and gripper, and shapes that never move.
        columns: Its joints among those of the whole.
        moving: The shaped links that its joints move.
    """

    name: str
    robot: Robot
    columns: Sequence[int]
    moving: frozenset[str]

    def beside(self, others: Iterable[tuple[Part, FloatArray]]) -> Robot:
        """This arm with others that stand at q (their n,)."""
        shapes, links = list(self.robot.shapes), list(self.robot.base_links)
        for other, q in others:
            poses = [body_matrix(pose) for pose in other.robot.body_poses(q)]
            for item in other.robot.shapes:
                if item.link in other.moving:
                    pose = Pose.from_matrix(product(poses[item.body], item.pose.matrix))
                    shapes.append(LinkShape(item.link, 0, item.shape, pose))
            links += sorted(other.moving)
        return replace(self.robot, shapes=tuple(shapes), base_links=tuple(links))


def parts_at_places(arms: Mapping[str, Arm]) -> tuple[Robot, tuple[Part, ...]]:
    """All arms as one robot, whose joints are in the order of the arms, and each arm.

    Tool and gripper of the whole are those of the first. Named poses are those that every arm has. Retreats out of a
    folded pose are each arm's own.

    Raises:
        InvalidRequest: Two things would get one name.
    """
    placed = {name: _placed(name, arm) for name, arm in arms.items()}
    robots = list(placed.values())
    names = [name for robot in robots for name in sorted({*robot.joint_names, *robot.links, *_framed(robot)})]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidRequest("arms", list(arms), f"names that keep parts of arms apart: {twice[0]!r} would be two")
    shifted, bodies, joints = list[Robot](), 0, 0
    for robot in robots:
        shifted.append(_shifted(robot, bodies, joints))
        bodies, joints = bodies + len(robot.bodies) - 1, joints + robot.n
    whole = _together(tuple(placed), shifted)
    standing = [item for robot in robots for item in robot.shapes if item.body == 0]
    parts, first = [], 0
    for name, robot in placed.items():
        own = {item.link for item in robot.shapes}
        others = tuple(item for item in standing if item.link not in own)
        alone = replace(
            robot,
            shapes=(*robot.shapes, *others),
            base_links=tuple(dict.fromkeys([*robot.base_links, *(item.link for item in others)])),
        )
        parts.append(Part(name, alone, range(first, first + robot.n), _moving(robot)))
        first += robot.n
    return whole, tuple(parts)


def parts_of(robot: Robot, groups: Mapping[str, Sequence[str]], tools: Mapping[str, str]) -> tuple[Part, ...]:
    """The arms of one robot: the joints of each, and the link that is its tool.

    Raises:
        UnknownName: No such joint, link or arm.
        InvalidRequest: A joint is in two arms, or an arm has none.
    """
    for name in tools:
        if name not in groups:
            raise UnknownName("arm", name, groups)
    columns: dict[str, list[int]] = {}
    taken: dict[str, str] = {}
    for name, given in groups.items():
        joints = items(f"groups[{name!r}]", given, str, "names of joints")
        for joint in joints:
            if joint not in robot.joint_names:
                raise UnknownName("joint", joint, robot.joint_names)
            if joint in taken:
                raise InvalidRequest(f"groups[{name!r}]", joint, f"a joint that is not in {taken[joint]!r} as well")
            taken[joint] = name
        if not joints:
            raise InvalidRequest(f"groups[{name!r}]", joints, "one joint at least")
        columns[name] = sorted(robot.joint_names.index(joint) for joint in joints)
    moving = {name: _moved_by(robot, own) for name, own in columns.items()}
    shared = [(a, b, moving[a] & moving[b]) for a in groups for b in groups if a < b and moving[a] & moving[b]]
    if shared:
        a, b, links = shared[0]
        raise InvalidRequest("groups", [a, b], f"arms that do not carry each other; both move {min(links)}")
    return tuple(_part(robot, name, own, moving, tools.get(name)) for name, own in columns.items())


def _part(robot: Robot, name: str, own: Sequence[int], moving: Mapping[str, frozenset[str]], tool: str | None) -> Part:
    """An arm, the joints of others at home and what these move away."""
    still = {joint: float(robot.home[k]) for k, joint in enumerate(robot.joint_names) if k not in own}
    alone = lock_joints(robot, still)
    away = frozenset(chain.from_iterable(links for other, links in moving.items() if other != name))
    hand = alone.gripper
    alone = replace(
        alone,
        name=f"{robot.name}:{name}",
        shapes=tuple(item for item in alone.shapes if item.link not in away),
        base_links=tuple(link for link in alone.base_links if link not in away),
        gripper=hand if hand is not None and not away.intersection(hand.links) else None,
        allowed_contacts=tuple(c for c in alone.allowed_contacts if not away.intersection(c.links)),
        retreats=(),
        groups=(),
    )
    if tool is not None and tool != alone.tool_frame:
        body, placement = alone.link_frame(tool)
        alone = replace(alone, tool_frame=tool, tool_body=body, tool_placement=placement, inverse="numeric")
    return Part(name, alone, own, moving[name])


def _moving(robot: Robot) -> frozenset[str]:
    return frozenset(item.link for item in robot.shapes if item.body > 0)


def _moved_by(robot: Robot, columns: Sequence[int]) -> frozenset[str]:
    """The shaped links that some joints move."""
    return frozenset(
        item.link
        for item in robot.shapes
        if any(robot.bodies[body].q_index in columns for body in chain_to_base(robot.bodies, item.body))
    )


def _framed(robot: Robot) -> list[str]:
    return [item.link for item in robot.link_frames]


def _placed(name: str, arm: Arm) -> Robot:
    """An arm's robot in the cell's frame, under its names there."""
    robot, base, prefix = arm.robot, arm.base.matrix, f"{name}_"

    def renamed(item: Item) -> Item:
        pose = Pose.from_matrix(product(base, item.pose.matrix)) if item.body == 0 else item.pose
        return replace(item, link=prefix + item.link, pose=pose)

    def pair(links: tuple[str, str]) -> tuple[str, str]:
        return prefix + links[0], prefix + links[1]

    return replace(
        robot,
        name=name,
        joint_names=tuple(prefix + joint for joint in robot.joint_names),
        base_links=tuple(prefix + link for link in robot.base_links),
        tool_frame=prefix + robot.tool_frame,
        tool_placement=product(base, robot.tool_placement) if robot.tool_body == 0 else robot.tool_placement,
        bodies=tuple(
            replace(body, name=prefix + body.name, placement=product(base, body.placement))
            if body.parent == 0
            else replace(body, name=prefix + body.name)
            for body in robot.bodies
        ),
        shapes=tuple(renamed(item) for item in robot.shapes),
        allowed_contacts=tuple(AllowedContact(pair(c.links), c.reason) for c in robot.allowed_contacts),
        gripper=robot.gripper and _placed_gripper(robot.gripper, base, prefix),
        retreats=tuple(replace(r, pairs=tuple(pair(links) for links in r.pairs)) for r in robot.retreats),
        link_frames=tuple(renamed(item) for item in robot.link_frames),
        locked_joints=tuple((prefix + joint, q) for joint, q in robot.locked_joints),
        dynamics=robot.dynamics
        and Dynamics(robot.dynamics.effort, tuple(renamed(item) for item in robot.dynamics.links)),
        groups=(),
        description=None,
    )


def _placed_gripper(gripper: Gripper, base: FloatArray, prefix: str) -> Gripper:
    """The gripper under its names in the cell; one at a fixed link is seen from the cell's frame."""

    def turn(item: FingerTurn, *, fixed: bool) -> FingerTurn:
        if not fixed:
            return item
        x, y, z = (a + b for a, b in zip(turned(item.point, base), base[:3, 3].tolist(), strict=True))
        return replace(item, axis=turned(item.axis, base), point=(x, y, z))

    fixed = [item.body == 0 for item in gripper.closed]
    closed = tuple(
        replace(
            item,
            link=prefix + item.link,
            pose=Pose.from_matrix(product(base, item.pose.matrix)) if still else item.pose,
        )
        for item, still in zip(gripper.closed, fixed, strict=True)
    )
    return replace(
        gripper,
        joints=tuple(prefix + joint for joint in gripper.joints),
        links=tuple(prefix + link for link in gripper.links),
        tips=tuple(prefix + link for link in gripper.tips),
        closed=closed,
        directions=tuple(
            turned(way, base) if still else way for way, still in zip(gripper.directions, fixed, strict=False)
        ),
        turns=tuple(
            tuple(turn(item, fixed=still) for item in each) for each, still in zip(gripper.turns, fixed, strict=False)
        ),
        across=turned(gripper.across, base) if any(fixed) else gripper.across,
    )


def _shifted(robot: Robot, bodies: int, joints: int) -> Robot:
    """The robot with its bodies but the base numbered after others, and its joints after others."""

    def index(body: int) -> int:
        return body + bodies if body > 0 else body

    def moved(item: Item) -> Item:
        return replace(item, body=index(item.body))

    def hand(gripper: Gripper) -> Gripper:
        return replace(gripper, closed=tuple(moved(item) for item in gripper.closed))

    return replace(
        robot,
        tool_body=index(robot.tool_body),
        bodies=(
            robot.bodies[0],
            *(replace(b, parent=index(b.parent), q_index=b.q_index + joints) for b in robot.bodies[1:]),
        ),
        shapes=tuple(moved(item) for item in robot.shapes),
        gripper=robot.gripper and hand(robot.gripper),
        link_frames=tuple(moved(item) for item in robot.link_frames),
        dynamics=robot.dynamics and Dynamics(robot.dynamics.effort, tuple(moved(i) for i in robot.dynamics.links)),
    )


def _together(names: tuple[str, ...], robots: list[Robot]) -> Robot:
    """Robots whose bodies and joints follow each other, as one."""
    first = robots[0]
    common = [name for name in first.poses if all(name in robot.poses for robot in robots)]
    limits = {
        item.name: np.concatenate([getattr(robot.limits, item.name) for robot in robots])
        for item in fields(JointLimits)
    }
    masses = [robot.dynamics for robot in robots if robot.dynamics is not None]
    turning = [robot.continuous or (False,) * robot.n for robot in robots]
    return replace(
        first,
        name="+".join(names),
        joint_names=tuple(chain.from_iterable(robot.joint_names for robot in robots)),
        limits=JointLimits(**limits),
        named_poses=tuple((name, np.concatenate([robot.poses[name] for robot in robots])) for name in common),
        base_links=tuple(chain.from_iterable(robot.base_links for robot in robots)),
        bodies=(first.bodies[0], *chain.from_iterable(robot.bodies[1:] for robot in robots)),
        shapes=tuple(chain.from_iterable(robot.shapes for robot in robots)),
        allowed_contacts=tuple(chain.from_iterable(robot.allowed_contacts for robot in robots)),
        retreats=(),
        inverse="numeric" if len(robots) > 1 and first.inverse != "wxai" else first.inverse,
        settle_time=max(robot.settle_time for robot in robots),
        link_frames=tuple(chain.from_iterable(robot.link_frames for robot in robots)),
        continuous=tuple(chain.from_iterable(turning)) if any(map(any, turning)) else (),
        locked_joints=tuple(chain.from_iterable(robot.locked_joints for robot in robots)),
        dynamics=Dynamics(
            np.concatenate([each.effort for each in masses]), tuple(chain.from_iterable(each.links for each in masses))
        )
        if len(masses) == len(robots)
        else None,
        groups=tuple(
            PlanningGroup(name, robot.joint_names, robot.tool_frame) for name, robot in zip(names, robots, strict=True)
        ),
    )
