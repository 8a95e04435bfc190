"""Where a parallel gripper can take hold of an object: tool poses, best first.

The robot's gripper names the axes of the tool frame along which it approaches and its fingers close. The origin of the
tool frame is between the fingertips.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.geometry.validation import instance, items, number
from planner_service.robot.model import Gripper, Robot
from planner_service.scene.scene import Obstacle

__all__ = ["middle_of", "offset_from", "top_grasps", "width_across"]

TILTS = (0.0, math.radians(15.0), math.radians(-15.0), math.radians(30.0), math.radians(-30.0))
"""How far the approach leans from straight down, in the order tried: the arm cannot rise far with a vertical gripper,
and a lean gives it room."""

MAX_TILTS = 1_000

_YAWS_OF_A_ROUND_OBJECT = 8


def top_grasps(robot: Robot, target: Obstacle, *, tilts: Sequence[float] = TILTS) -> tuple[Pose, ...]:
    """Grasps of an object from above, its centre between the fingertips: upright first, then leaning ones.

    A box is taken across its faces, a round object from several sides. Grasps that are wider than the gripper opens are
    left out.

    Args:
        tilts: Leans in radians about the axis through the fingers, in the order of preference.

    Raises:
        InvalidRequest: The robot has no gripper, or the object is too wide for it from every side.
    """
    instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    leans = items("tilts", tilts, (int, float), "angles in radians", MAX_TILTS)
    if not leans:
        raise InvalidRequest("tilts", tilts, "at least one angle in radians")
    for k, lean in enumerate(leans):
        number(f"tilts[{k}]", lean, "an angle in [-pi, pi]", -math.pi, math.pi)
    gripper = instance("robot", robot, Robot, "a Robot").gripper
    if gripper is None:
        raise InvalidRequest("robot", robot.name, "a robot with a gripper")
    R = target.pose.rotation
    heading = math.atan2(R[1, 0], R[0, 0])
    middle = middle_of(target)
    count = 4 if isinstance(target.shape, Box) else _YAWS_OF_A_ROUND_OBJECT
    grasps = [
        Pose.from_matrix(_from_above(gripper, middle, heading + 2 * math.pi * k / count, tilt))
        for tilt in leans
        for k in range(count)
    ]
    fitting = tuple(pose for pose in grasps if width_across(target, pose, gripper) <= gripper.upper)
    if not fitting:
        width = min(width_across(target, pose, gripper) for pose in grasps)
        expected = f"an object at most {gripper.upper:.3f} m wide; this one is {width:.3f} m"
        raise InvalidRequest("target", target.name, expected)
    return fitting


def _from_above(gripper: Gripper, position: Sequence[float], yaw: float, tilt: float) -> FloatArray:
    """The tool pose (4, 4) that points down at a position, turned by yaw about the vertical, leaning by tilt about the
    finger axis.
    """
    fingers = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    outward = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    approach = outward * math.sin(tilt) + np.array([0.0, 0.0, -math.cos(tilt)])
    x, y = np.array(gripper.approach), np.array(gripper.closing)
    axes = ((approach, x), (fingers, y), (np.cross(approach, fingers), np.cross(x, y)))
    T = np.eye(4)
    T[:3, :3] = sum(world[:, None] * tool for world, tool in axes)  # what each axis of the tool becomes
    T[:3, 3] = position
    return T


def middle_of(target: Obstacle) -> tuple[float, float, float]:
    """The middle of an object's extents along its own axes, in the base frame: its position, unless it is lopsided."""
    axes = np.eye(3)
    aside = 0.5 * (target.shape.support(axes) + target.shape.support(-axes)).diagonal()
    if not aside.any():
        return target.pose.position
    return (target.pose @ Pose((float(aside[0]), float(aside[1]), float(aside[2])))).position


def width_across(target: Obstacle, grasp: Pose, gripper: Gripper) -> float:
    """The extent of an object in metres along the axis on which the fingers of a grasp close."""
    axis = _seen_from(target.pose, _closing(grasp, gripper))
    return _product(axis, target.shape.support(axis) - target.shape.support(-axis))


def offset_from(target: Obstacle, grasp: Pose, gripper: Gripper) -> tuple[float, float]:
    """Metres between an object's centre and the middle between the fingers, and between fingertips and object."""
    fingers = _closing(grasp, gripper)
    aside = abs(_product(fingers, np.array(middle_of(target)) - np.array(grasp.position)))
    tips = _seen_from(target.pose, np.array(grasp.position) - np.array(target.pose.position))
    return aside, float(target.shape.distance(tips))


def _closing(grasp: Pose, gripper: Gripper) -> list[float]:
    """The direction in which the fingers of a grasp close, in the base frame."""
    return [_product(row, gripper.closing) for row in grasp.rotation_rows]


def _seen_from(pose: Pose, direction: Sequence[float] | FloatArray) -> FloatArray:
    """A direction in the axes of a pose, shape (3,): summed in a fixed order, which BLAS does not promise."""
    return np.array([_product(column, direction) for column in zip(*pose.rotation_rows, strict=True)])


def _product(a: Sequence[float] | FloatArray, b: Sequence[float] | FloatArray) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
