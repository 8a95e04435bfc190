"""Robots as JSON objects: all that a robot is, so that it is built again without any other file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from planner_service.errors import InvalidRequest
from planner_service.files import schema
from planner_service.geometry.arrays import FloatArray, vector
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import MAX_LENGTH
from planner_service.records.scene import ShapeRecord
from planner_service.robot.gripper import FingerTurn, Gripper
from planner_service.robot.inertia import Dynamics, LinkInertia
from planner_service.robot.kinematic_tree import MAX_MULTIPLIER, MIN_MULTIPLIER, Body, LinkFrame, LinkShape
from planner_service.robot.model import AllowedContact, ExemptRetreat, JointLimits, Robot

__all__ = ["RobotRecord"]

MAX_JOINTS = 1_000
MAX_SHAPES = 50_000
MAX_PAIRS = 100_000

UNIT = 1e-6
"""By which an axis or a direction may be off its length of 1."""

Texts = Annotated[list[schema.Text], schema.FirstOnly(), schema.at_most(MAX_SHAPES)]
Pairs = Annotated[list[schema.NamePair], schema.FirstOnly(), schema.at_most(MAX_PAIRS)]
Matrix = Annotated[list[schema.Numbers], schema.FirstOnly(), schema.at_most(4)]


def _placement(field: str, rows: list[list[float]]) -> FloatArray:
    """A rigid motion, 4 x 4."""
    if [len(row) for row in rows] != [4, 4, 4, 4]:
        raise InvalidRequest(field, rows, "a 4 x 4 matrix")
    matrix = np.array(rows, dtype=np.float64)
    try:
        Pose.from_matrix(matrix)
    except InvalidRequest as error:
        raise InvalidRequest(field, rows, error.expected) from None
    if np.abs(matrix[:3, 3]).max() > MAX_LENGTH:
        raise InvalidRequest(field, rows, f"metres, at most {MAX_LENGTH:g} along each axis")
    return matrix


def _require_unit(field: str, values: list[float]) -> None:
    if abs(sum(v * v for v in values) - 1.0) > UNIT:
        raise InvalidRequest(field, values, "a unit vector")


class LimitsRecord(schema.Record, makes=JointLimits):
    """``JointLimits``.

    Attributes:
        lower: Least positions, in radians (metres for joints that slide).
        upper: Largest positions, likewise.
        velocity: Largest speeds, in rad/s (m/s).
        acceleration: Largest accelerations, in rad/s^2 (m/s^2).
        jerk: Largest jerks, in rad/s^3 (m/s^3).
    """


class NamedPoseRecord(schema.Record):
    """A named configuration.

    Attributes:
        name: The name of the pose.
        q: Joint values in radians (metres for joints that slide).
    """

    name: schema.Text
    q: schema.Joints

    @cached_property
    def value(self) -> tuple[str, FloatArray]:
        return self.name, np.array(self.q)


class LockedJointRecord(schema.Record):
    """One of ``Robot.locked_joints``.

    Attributes:
        name: The name of the joint.
        position: Where it stays, in radians (metres if it slides).
    """

    name: schema.Text
    position: float

    @cached_property
    def value(self) -> tuple[str, float]:
        return self.name, self.position


class BodyRecord(schema.GrownRecord):
    """A ``Body``.

    Attributes:
        placement: The joint frame in the frame of the parent body at q = 0: rows of a 4 x 4 matrix, lengths in
            metres. The body's frame is that joint frame, moved by q along or about `axis`.
    """

    about = Body

    name: schema.Text
    parent: Annotated[int, Field(ge=-1, le=MAX_JOINTS)]
    placement: Matrix
    axis: schema.Vector3
    prismatic: bool
    q_index: Annotated[int, Field(ge=-1, le=MAX_JOINTS)]
    multiplier: float = 1.0

    @cached_property
    def value(self) -> Body:
        if self.parent >= 0:
            _require_unit("axis", self.axis)
        if not MIN_MULTIPLIER <= abs(self.multiplier) <= MAX_MULTIPLIER:
            expected = f"a number from {MIN_MULTIPLIER:g} to {MAX_MULTIPLIER:g}, or the negative of one"
            raise InvalidRequest("multiplier", self.multiplier, expected)
        placement, axis = _placement("placement", self.placement), np.array(self.axis)
        return Body(self.name, self.parent, placement, axis, self.prismatic, self.q_index, self.multiplier)


class LinkShapeRecord(schema.Record, makes=LinkShape):
    """A ``LinkShape``.

    Attributes:
        link: The name of the link.
        body: Index of the body that carries it, in `bodies`.
        shape: The solid.
        pose: Pose of the shape in the frame of the body.
    """

    link: schema.Text
    shape: ShapeRecord


class LinkFrameRecord(schema.Record, makes=LinkFrame):
    """A ``LinkFrame``.

    Attributes:
        link: The name of the link.
        body: Index of the body that carries it, in `bodies`.
        pose: Pose of the link's frame in that of the body.
    """


class AllowedContactRecord(schema.Record, makes=AllowedContact):
    """An ``AllowedContact``.

    Attributes:
        links: The names of both, or of one link whose shapes may touch each other.
        reason: Why they are never checked against each other.
    """

    reason: schema.Prose


class FingerTurnRecord(schema.Record):
    """A ``FingerTurn``.

    Attributes:
        ratio: Its angle in radians by that of the leader.
    """

    about = FingerTurn

    axis: schema.Vector3
    point: schema.Vector3
    ratio: float

    @cached_property
    def value(self) -> FingerTurn:
        _require_unit("axis", self.axis)
        if not MIN_MULTIPLIER <= abs(self.ratio) <= MAX_MULTIPLIER or max(map(abs, self.point)) > MAX_LENGTH:
            raise InvalidRequest("turns", self.ratio, "ratios and points that a finger can have")
        return FingerTurn(vector(self.axis), vector(self.point), self.ratio)


Turns = Annotated[list[FingerTurnRecord], schema.at_most(MAX_JOINTS)]


class GripperRecord(schema.GrownRecord):
    """A ``Gripper``."""

    about = Gripper

    joints: Texts
    links: Texts
    lower: float
    upper: float
    closed: Annotated[list[LinkShapeRecord], schema.at_most(MAX_SHAPES)]
    directions: Annotated[list[schema.Vector3], schema.FirstOnly()]
    approach: schema.Vector3
    closing: schema.Vector3
    kind: Literal["parallel", "revolute", "vacuum"] = "parallel"
    turns: Annotated[list[Turns], schema.at_most(MAX_SHAPES)] = Field(default_factory=list)
    tips: Texts = Field(default_factory=list)
    across: schema.Vector3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    positions: schema.Vector2 = Field(default_factory=lambda: [0.0, 0.0])
    radius: Annotated[float, Field(ge=0.0, le=MAX_LENGTH)] = 0.0

    @cached_property
    def value(self) -> Gripper:
        if not 0.0 <= self.lower <= self.upper <= MAX_LENGTH:
            raise InvalidRequest("lower", self.lower, f"0 <= lower <= upper = {self.upper:g} <= {MAX_LENGTH:g} m")
        for field, kind in (("directions", "parallel"), ("turns", "revolute")):
            count = len(self.closed) if self.kind == kind else 0
            if len(getattr(self, field)) != count:
                raise InvalidRequest(
                    field, len(getattr(self, field)), f"{count}, one for each closed shape that moves so"
                )
        if self.kind == "revolute":
            _require_unit("across", self.across)
            if len(self.tips) != 2 or any(all(item.link != tip for item in self.closed) for tip in self.tips):
                raise InvalidRequest("tips", self.tips, "two links with closed shapes")
        for k, direction in enumerate(self.directions):
            _require_unit(f"directions[{k}]", direction)
        _require_unit("approach", self.approach)
        _require_unit("closing", self.closing)
        if abs(math.fsum(a * b for a, b in zip(self.approach, self.closing, strict=True))) > UNIT:
            raise InvalidRequest("closing", self.closing, f"square to approach = {self.approach}")
        return Gripper(**self.arguments)


class RetreatRecord(schema.Record, makes=ExemptRetreat):
    """An ``ExemptRetreat``.

    Attributes:
        pose: The name of the pose.
        to: Where it ends, in radians (metres for joints that slide).
        pairs: The names of each two links.
        reason: Why they are not checked.
    """

    pairs: Pairs
    reason: schema.Prose


class LinkInertiaRecord(schema.Record, makes=LinkInertia):
    """A ``LinkInertia``.

    Attributes:
        link: The name of the link, or of a load.
        body: Index of the body that carries it, in `bodies`.
        mass: Kilograms.
        tensor: ixx, ixy, ixz, iyy, iyz, izz about the centre of mass, in kg m^2.
        pose: Pose of the axes of `tensor`, at the centre of mass, in the frame of the body.
    """

    mass: Annotated[float, Field(gt=0.0, le=1e9)]
    tensor: Annotated[schema.Numbers, schema.of_length(6, "6 finite numbers")]


class DynamicsRecord(schema.Record):
    """A ``Dynamics``.

    Attributes:
        effort: Largest torque of each joint in Nm (force in N of one that slides); 0 where it is not known.
        links: The links with a mass.
    """

    about = Dynamics

    effort: schema.Joints
    links: Annotated[list[LinkInertiaRecord], schema.at_most(MAX_SHAPES)]

    @cached_property
    def value(self) -> Dynamics:
        if min(self.effort, default=0.0) < 0.0:
            raise InvalidRequest("effort", self.effort, "numbers of at least 0")
        return Dynamics(np.array(self.effort), tuple(link.value for link in self.links))


class RobotRecord(schema.GrownRecord):
    """A ``Robot`` with its hash, which has to be that of its content.

    Attributes:
        name: The name of the robot.
        hash: SHA-256 of all that decides about motions.
        joint_names: The joints that move, in the order of all joint values.
        limits: Limits of these joints.
        named_poses: Configurations by name; home is one of them.
        tool_frame: The link whose frame is the tool's.
        tool_body: Index in `bodies` of the body that carries the tool frame.
        tool_placement: The tool frame in the frame of that body: rows of a 4 x 4 matrix, lengths in metres.
        allowed_contacts: Pairs of links that are never checked against each other.
        gripper: The gripper; null without one.
        retreats: Motions out of named poses during which some pairs are not checked.
        locked_joints: Joints that could move and do not; for information, not part of `hash`.
        continuous: Whether each joint turns without end; empty if none does. Planning goes the shortest way round.
    """

    about = Robot

    name: schema.Text
    hash: schema.Text
    joint_names: Annotated[list[schema.Text], Field(min_length=1), schema.at_most(MAX_JOINTS)]
    limits: LimitsRecord
    named_poses: Annotated[list[NamedPoseRecord], schema.at_most(MAX_JOINTS)]
    base_links: Texts
    tool_frame: schema.Text
    tool_body: schema.Count
    tool_placement: Matrix
    bodies: Annotated[list[BodyRecord], Field(min_length=2), schema.at_most(MAX_JOINTS + 1)]
    shapes: Annotated[list[LinkShapeRecord], schema.at_most(MAX_SHAPES)]
    allowed_contacts: Annotated[list[AllowedContactRecord], schema.at_most(MAX_PAIRS)]
    gripper: GripperRecord | None
    gripper_width: float
    retreats: Annotated[list[RetreatRecord], schema.at_most(MAX_JOINTS)]
    inverse: Literal["numeric", "wxai"]
    settle_time: Annotated[float, Field(ge=0.0, le=3600.0)]
    link_frames: Annotated[list[LinkFrameRecord], schema.at_most(MAX_SHAPES)] = Field(default_factory=list)
    continuous: Annotated[list[bool], schema.at_most(MAX_JOINTS)] = Field(default_factory=list)
    dynamics: DynamicsRecord | None = None
    locked_joints: Annotated[list[LockedJointRecord], schema.at_most(MAX_JOINTS)] = Field(default_factory=list)

    @cached_property
    def value(self) -> Robot:
        arguments = self.arguments | {"tool_placement": _placement("tool_placement", self.tool_placement)}
        del arguments["hash"]
        robot = Robot(**arguments)
        for field, found, expected in _contradictions(robot):
            raise InvalidRequest(field, found, expected)
        if robot.hash != self.hash:
            raise InvalidRequest("hash", self.hash, f"that of the content, {robot.hash}")
        return robot


def _contradictions(robot: Robot) -> Iterator[tuple[str, object, str]]:
    """What no robot can be: code that computes with its parts relies on how they refer to each other."""
    n, bodies = robot.n, robot.bodies
    if len(set(robot.joint_names)) != n:
        yield "joint_names", robot.joint_names, "each joint once"
    if [body.parent for body in bodies[:1]] != [-1] or any(not 0 <= b.parent < k for k, b in enumerate(bodies) if k):
        yield "bodies", [body.parent for body in bodies], "parents before children, -1 of the first alone"
    if [body.q_index for body in bodies[:1]] != [-1] or {b.q_index for b in bodies[1:]} != set(range(n)):
        yield "bodies", [body.q_index for body in bodies], f"a body for each of {n} joints, after the base"
        return
    for k, name in enumerate(robot.joint_names):
        moved = [body for body in bodies if body.q_index == k]
        own = [body for body in moved if body.multiplier == 1.0 and (len(moved) == 1 or body.name == name)]
        if len(own) != 1:
            found = [(body.name, body.multiplier) for body in moved]
            yield "bodies", found, f"one body that {name} moves by itself, its multiplier 1, among those of mimics"
    if robot.continuous and len(robot.continuous) != n:
        yield "continuous", robot.continuous, f"one for each of {n} joints, or none"
        return
    endless = [body for body in bodies[1:] if robot.continuous and robot.continuous[body.q_index]]
    if any(body.prismatic or not body.multiplier.is_integer() for body in endless):
        yield "continuous", robot.continuous, "False of a joint that slides, or moves another by a part of a turn"
    if robot.tool_body >= len(bodies):
        yield "tool_body", robot.tool_body, f"one of {len(bodies)} bodies"
    poses = [name for name, _ in robot.named_poses]
    if len(set(poses)) != len(poses) or "home" not in poses:
        yield "named_poses", poses, 'each pose once, "home" among them'
    body_of: dict[str, int] = {}
    for k, item in enumerate(robot.shapes):
        if item.body >= len(bodies) or body_of.setdefault(item.link, item.body) != item.body:
            yield f"shapes[{k}].body", item.body, f"one of {len(bodies)} bodies, the same for all shapes of a link"
    for k, frame in enumerate(robot.link_frames):
        if frame.body >= len(bodies) or body_of.setdefault(frame.link, frame.body) != frame.body:
            yield f"link_frames[{k}].body", frame.body, f"one of {len(bodies)} bodies, that of the link's shapes"
    if len({frame.link for frame in robot.link_frames}) != len(robot.link_frames):
        yield "link_frames", [frame.link for frame in robot.link_frames], "each link once"
    for k, inertia in enumerate(() if robot.dynamics is None else robot.dynamics.links):
        if inertia.body >= len(bodies):
            yield f"dynamics.links[{k}].body", inertia.body, f"one of {len(bodies)} bodies"
    for k, retreat in enumerate(robot.retreats):
        if retreat.pose not in poses:
            yield f"retreats[{k}].pose", retreat.pose, "a named pose"
    gripper = robot.gripper
    if gripper is None:
        if robot.gripper_width != 0.0:
            yield "gripper_width", robot.gripper_width, "0 without a gripper"
        return
    if not gripper.lower <= robot.gripper_width <= gripper.upper:
        yield "gripper_width", robot.gripper_width, f"metres in [{gripper.lower:g}, {gripper.upper:g}]"
    fingers = tuple(item for item in robot.shapes if item.link in gripper.links)
    if fingers != gripper.shapes(robot.gripper_width):
        yield "gripper.closed", len(gripper.closed), "the fingers' shapes, standing as at gripper_width"
