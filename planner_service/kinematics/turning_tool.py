"""A tool that may turn about one of its axes, as an arm with one joint more.

A pen, a welding torch or a disc looks the same however it is turned. An arm whose tool may turn so is the arm with a
further joint between it and the tool: what follows a line with that arm follows it with the axis alone.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from planner_service.geometry.arrays import FloatArray, Vector, cross_of, dot
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.pose_goal import turned_about
from planner_service.robot.kinematic_tree import Body, chain_to_base
from planner_service.robot.model import JointLimits, Robot

__all__ = ["LEANS", "PLAY", "least_turned", "turning", "with_turns"]

MOST_TURNED = 100.0
"""Radians that the tool may turn either way: more than any line asks for."""

PLAY = 5e-5
"""Radians by which the axis of an arm of fewer than six joints may lean either way, a hundredth of a line's tolerance.
Its model need not allow exactly what the arm is for: a SO-101, as its URDF rounds it, holds no pen upright to 3e-6."""

STIFFNESS = 100.0
"""An axis that leans counts as so many times the motion of a joint: the joints are to do what they can."""

LEANS = ("the tool's axis leaning one way", "the tool's axis leaning the other way")

STRAIGHT, OPPOSITE = 1e-12, 1e-6
"""Radians within which two directions are one, or opposite: below, the axis of the turn between them is rounding."""


@lru_cache(maxsize=32)
def turning(robot: Robot, free_axis: Vector) -> Robot:
    """A robot of these joints, without shapes, whose tool is turned by one joint more, the last one.

    Of fewer than six joints, by two before that, too, which let its axis lean by ``PLAY``.

    Args:
        free_axis: Unit vector in the tool frame.
    """
    moved = {robot.bodies[index].q_index for index in chain_to_base(robot.bodies, robot.tool_body)}
    across = _across(free_axis) if len(moved) < 6 else ()
    joints = [(name, axis, PLAY * STIFFNESS, 1.0 / STIFFNESS) for name, axis in zip(LEANS, across, strict=False)]
    joints.append(("the tool about its free axis", free_axis, MOST_TURNED, 1.0))
    bodies, parent, place = list(robot.bodies), robot.tool_body, robot.tool_placement
    for k, (name, axis, _, multiplier) in enumerate(joints):
        bodies.append(Body(name, parent, place, np.array(axis), False, robot.n + k, multiplier))
        parent, place = len(bodies) - 1, np.eye(4)
    ends, ones = np.array([most for _, _, most, _ in joints]), np.ones(len(joints))
    more = {"lower": -ends, "upper": ends, "velocity": ones, "acceleration": ones, "jerk": ones}
    limits = JointLimits(**{name: np.append(getattr(robot.limits, name), value) for name, value in more.items()})
    return replace(
        robot,
        joint_names=(*robot.joint_names, *(name for name, *_ in joints)),
        limits=limits,
        named_poses=tuple((name, np.append(q, 0.0 * ones)) for name, q in robot.named_poses),
        tool_body=parent,
        tool_placement=place,
        bodies=tuple(bodies),
        shapes=(),
        allowed_contacts=(),
        gripper=None,
        retreats=(),
        inverse="numeric",
        continuous=(*robot.continuous, *([False] * len(joints))) if robot.continuous else (),
        dynamics=None,
        groups=(),
    )


def with_turns(
    robot: Robot, waypoints: FloatArray, turns: FloatArray, free_axis: Vector | None
) -> tuple[Robot, FloatArray]:
    """A robot and its waypoints (N, n); or those that keep the tool from turning, which turned as ``ToolLine`` says."""
    if free_axis is None:
        return robot, waypoints
    arm = turning(robot, free_axis)
    out = np.zeros((len(waypoints), arm.n))
    out[:, : robot.n], out[:, -1] = waypoints, -turns[: len(waypoints)]
    return arm, out


def _across(axis: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors that are perpendicular to a third, and to each other."""
    least = min(range(3), key=lambda k: abs(axis[k]))
    x, y, z = cross_of(axis, [float(k == least) for k in range(3)])
    length = math.sqrt(x * x + y * y + z * z)
    first = (x / length, y / length, z / length)
    return first, cross_of(axis, first)


def least_turned(begin: Pose, end: Pose, free_axis: Vector | None) -> Pose:
    """The pose at the place of ``end`` with the axis as there, turned from ``begin`` by as little as that takes.

    ``end`` itself without an axis, and where the axis is turned round: every rotation that does that is half a turn.
    """
    if free_axis is None:
        return end
    before, after = ([dot(row, free_axis) for row in pose.rotation_rows] for pose in (begin, end))
    normal = cross_of(before, after)
    sine, cosine = math.sqrt(dot(normal, normal)), dot(before, after)
    if sine < (STRAIGHT if cosine > 0.0 else OPPOSITE):
        return replace(end, quaternion=begin.quaternion) if cosine > 0.0 else end
    x, y, z = (value / sine for value in normal)
    turn = turned_about((x, y, z), math.atan2(sine, cosine))
    return Pose(end.position, (turn @ Pose(quaternion=begin.quaternion)).quaternion)
