"""Where a gripper can take hold of an object: tool poses, best first.

The robot's gripper names the axes of the tool frame along which it approaches and its fingers close. The origin of the
tool frame is between the fingertips, or in the middle of a cup's rim.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, cross, cross_of
from planner_service.geometry.shapes import Box, Cylinder, Pose
from planner_service.geometry.validation import instance, items, number
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = ["middle_of", "offset_from", "top_grasps", "width_across"]

TILTS = (0.0, math.radians(15.0), math.radians(-15.0), math.radians(30.0), math.radians(-30.0))
"""How far the approach leans from straight down, in the order tried: the arm cannot rise far with a vertical gripper,
and a lean gives it room."""

MAX_TILTS = 1_000

FACING_UP = 0.5
"""Least height of the unit vector out of a face that a cup takes: leaning by 60 degrees."""

_YAWS_OF_A_ROUND_OBJECT = 8


def top_grasps(robot: Robot, target: Obstacle, *, tilts: Sequence[float] = TILTS) -> tuple[Pose, ...]:
    """Grasps of an object from above, its centre between the fingertips: upright first, then leaning ones.

    A box is taken across its faces, a round object from several sides. Grasps that are wider than the gripper opens are
    left out. A vacuum gripper takes a box or cylinder by the flat face that looks up most, in its middle, turned to any
    of several sides; it has no use for ``tilts``.

    Args:
        tilts: Leans in radians about the axis through the fingers, in the order of preference.

    Raises:
        InvalidRequest: The robot has no gripper, or the object is too wide for it from every side, or has no flat face
            for its cup.
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
    if gripper.kind == "vacuum":
        return tuple(_by_face(gripper, target))
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
    T = np.eye(4)
    T[:3, :3] = _taking(gripper, approach, fingers)
    T[:3, 3] = position
    return T


def _by_face(gripper: Gripper, target: Obstacle) -> Iterator[Pose]:
    """The tool poses that bring a cup to the flat face that looks up most, one for each of several turns."""
    faces = sorted(_faces(target), key=lambda face: float(face[0][2]))
    if not faces or faces[-1][0][2] < FACING_UP or faces[-1][2] < gripper.radius:
        room = f"at least {2.0 * gripper.radius:.3f} m wide"
        raise InvalidRequest("target", target.name, f"a box or cylinder with a flat face that looks up, {room}")
    outward, middle, _ = faces[-1]
    least = int(np.argmin(np.abs(outward)))
    side = np.eye(3)[least] - outward[least] * outward
    side /= math.sqrt(float((side * side).sum()))
    other = cross(outward, side)
    for k in range(_YAWS_OF_A_ROUND_OBJECT):
        angle = 2.0 * math.pi * k / _YAWS_OF_A_ROUND_OBJECT
        T = np.eye(4)
        T[:3, :3] = _taking(gripper, -outward, side * math.cos(angle) + other * math.sin(angle))
        T[:3, 3] = middle
        yield Pose.from_matrix(T)


def _faces(target: Obstacle) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """The flat faces of a box or cylinder: unit vector outwards, middle, and metres from there to the nearest rim."""
    shape, R, place = target.shape, target.pose.rotation, np.array(target.pose.position)
    if isinstance(shape, Box):
        for k, size in enumerate(shape.size):
            room = min(other for j, other in enumerate(shape.size) if j != k) / 2.0
            yield from ((sign * R[:, k], place + sign * size / 2.0 * R[:, k], room) for sign in (1.0, -1.0))
    if isinstance(shape, Cylinder):
        half = shape.length / 2.0
        yield from ((sign * R[:, 2], place + sign * half * R[:, 2], shape.radius) for sign in (1.0, -1.0))


def _taking(gripper: Gripper, approach: FloatArray, closing: FloatArray) -> FloatArray:
    """The rotation (3, 3) of the tool whose axes of approach and closing point so in the world."""
    x, y = np.array(gripper.approach), np.array(gripper.closing)
    third = (
        np.array(cross_of(*pair))
        for pair in ((approach.tolist(), closing.tolist()), (gripper.approach, gripper.closing))
    )
    axes = ((approach, x), (closing, y), tuple(third))
    return np.asarray(sum(world[:, None] * tool for world, tool in axes))  # what each axis of the tool becomes


def middle_of(target: Obstacle) -> tuple[float, float, float]:
    """The middle of an object's extents along its own axes, in the base frame: its position, unless it is lopsided."""
    axes = np.eye(3)
    aside = 0.5 * (target.shape.support(axes) + target.shape.support(-axes)).diagonal()
    if not aside.any():
        return target.pose.position
    return (target.pose @ Pose((float(aside[0]), float(aside[1]), float(aside[2])))).position


def width_across(target: Obstacle, grasp: Pose, gripper: Gripper) -> float:
    """The extent of an object in metres along the axis on which the fingers of a grasp close; 0 for a cup."""
    if gripper.kind == "vacuum":
        return 0.0
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
