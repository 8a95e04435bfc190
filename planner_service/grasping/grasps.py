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
from planner_service.geometry.shapes import Box, Pose
from planner_service.geometry.validation import instance, items, number
from planner_service.grasping.faces import flat_faces
from planner_service.grasping.hand import DEPTHS, HandCheck
from planner_service.grasping.held import held_by, middle_of, require_fingers
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = ["cup_poses", "middle_of", "offset_from", "side_grasps", "tool_rotation", "top_grasps", "width_across"]

TILTS = (0.0, math.radians(15.0), math.radians(-15.0), math.radians(30.0), math.radians(-30.0))
"""How far the approach leans from straight down, in the order tried: the arm cannot rise far with a vertical gripper,
and a lean gives it room."""

LEANS = (0.0, math.radians(15.0), math.radians(30.0))
"""How far the approach of a grasp from the side comes from above, in the order tried: a palm wider than the fingers
needs room over a table."""

CENTRED = 1e-6
"""Metres that the middle of what fingers hold may be beside the middle between them: that is rounding."""

MAX_TILTS = 1_000

FACING_UP = 0.5
"""Least height of the unit vector out of a face that a cup takes: leaning by 60 degrees."""

_YAWS_OF_A_ROUND_OBJECT = 8


def top_grasps(robot: Robot, target: Obstacle, *, tilts: Sequence[float] = TILTS) -> tuple[Pose, ...]:
    """Grasps of an object from above, its middle between the fingertips: upright first, then leaning ones.

    A box is taken across its faces, a round object from several sides. Grasps that are wider than the gripper opens are
    left out. A vacuum gripper takes an object by the flat face that looks up most, in its middle, turned to any of
    several sides; it has no use for ``tilts``.

    Args:
        tilts: Leans in radians about the axis through the fingers, in the order of preference.

    Raises:
        InvalidRequest: The robot has no gripper, or the object is too wide for it from every side, or has no flat face
            for its cup.
    """
    instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    leans = _angles("tilts", tilts)
    gripper = instance("robot", robot, Robot, "a Robot").gripper
    if gripper is None:
        raise InvalidRequest("robot", robot.name, "a robot with a gripper")
    if gripper.kind == "vacuum":
        return tuple(_by_face(gripper, target))
    return _around(robot, gripper, target, leans)


def side_grasps(robot: Robot, target: Obstacle, *, leans: Sequence[float] = LEANS) -> tuple[Pose, ...]:
    """Grasps of an object from the side, its middle between the fingertips, which close level: level ones first.

    A box is taken across its faces, a round object from several sides. Grasps that are wider than the gripper opens are
    left out.

    Args:
        leans: Angles in radians by which the approach comes from above the level, in the order of preference.

    Raises:
        InvalidRequest: The robot has no fingers, or the object is too wide for them from every side.
    """
    instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    tilts = [math.pi / 2.0 - lean for lean in _angles("leans", leans)]
    return _around(robot, require_fingers(robot), target, tilts)


def _angles(field: str, angles: Sequence[float]) -> tuple[float, ...]:
    given = items(field, angles, (int, float), "angles in radians", MAX_TILTS)
    if not given:
        raise InvalidRequest(field, angles, "at least one angle in radians")
    return tuple(
        number(f"{field}[{k}]", angle, "an angle in [-pi, pi]", -math.pi, math.pi) for k, angle in enumerate(given)
    )


def _around(robot: Robot, gripper: Gripper, target: Obstacle, tilts: Sequence[float]) -> tuple[Pose, ...]:
    """Grasps through an object's middle whose fingers close level, from several sides for each of ``tilts``."""
    R = target.pose.rotation
    heading = math.atan2(R[1, 0], R[0, 0])
    middle = middle_of(target)
    count = 4 if isinstance(target.shape, Box) else _YAWS_OF_A_ROUND_OBJECT
    grasps = [
        Pose.from_matrix(_from_above(gripper, middle, heading + 2 * math.pi * k / count, tilt))
        for tilt in tilts
        for k in range(count)
    ]
    held = [held_by(target, pose, robot) for pose in grasps]
    if not any(each.width <= gripper.upper for each in held):
        width = min(each.width for each in held)
        expected = f"an object at most {gripper.upper:.3f} m wide; this one is {width:.3f} m"
        raise InvalidRequest("target", target.name, expected)
    x, y, z = gripper.closing
    placed = [
        (pose if each.aside < CENTRED else pose @ Pose((-each.shift * x, -each.shift * y, -each.shift * z)), each.width)
        for pose, each in zip(grasps, held, strict=True)
        if each.width <= gripper.upper
    ]
    if gripper.kind == "parallel":
        return tuple(pose for pose, _ in placed)
    hand = HandCheck(robot, target.shape)
    return tuple(_deep(gripper, target, pose, width, hand) for pose, width in placed)


def _deep(gripper: Gripper, target: Obstacle, pose: Pose, width: float, hand: HandCheck) -> Pose:
    """The pose, or one farther in at which fingers that turn meet both sides; the pose where none is."""
    for depth in DEPTHS:
        x, y, z = (depth * axis for axis in gripper.approach)
        deeper = pose @ Pose((x, y, z)) if depth else pose
        if hand.meets(deeper.inverse() @ target.pose, width):
            return deeper
    return pose


def _from_above(gripper: Gripper, position: Sequence[float], yaw: float, tilt: float) -> FloatArray:
    """The tool pose (4, 4) that points down at a position, turned by yaw about the vertical, leaning by tilt about the
    finger axis.
    """
    fingers = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    outward = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    approach = outward * math.sin(tilt) + np.array([0.0, 0.0, -math.cos(tilt)])
    T = np.eye(4)
    T[:3, :3] = tool_rotation(gripper, approach, fingers)
    T[:3, 3] = position
    return T


def _by_face(gripper: Gripper, target: Obstacle) -> Iterator[Pose]:
    """The tool poses that bring a cup to the flat face that looks up most, one for each of several turns."""
    faces = sorted(flat_faces(target, gripper.radius), key=lambda face: float(face.outward[2]))
    if not faces or faces[-1].outward[2] < FACING_UP or faces[-1].room(faces[-1].middle[None])[0] < gripper.radius:
        expected = f"an object with a flat face that looks up, at least {2.0 * gripper.radius:.3f} m wide"
        raise InvalidRequest("target", target.name, expected)
    yield from cup_poses(gripper, faces[-1].middle, faces[-1].outward)


def cup_poses(gripper: Gripper, place: FloatArray, outward: FloatArray) -> Iterator[Pose]:
    """The tool poses that bring a cup to a place on a face, one for each of several turns about the face's normal."""
    least = int(np.argmin(np.abs(outward)))
    side = np.eye(3)[least] - outward[least] * outward
    side /= math.sqrt(float((side * side).sum()))
    other = cross(outward, side)
    for k in range(_YAWS_OF_A_ROUND_OBJECT):
        angle = 2.0 * math.pi * k / _YAWS_OF_A_ROUND_OBJECT
        T = np.eye(4)
        T[:3, :3] = tool_rotation(gripper, -outward, side * math.cos(angle) + other * math.sin(angle))
        T[:3, 3] = place
        yield Pose.from_matrix(T)


def tool_rotation(gripper: Gripper, approach: FloatArray, closing: FloatArray) -> FloatArray:
    """The rotation (3, 3) of the tool whose axes of approach and closing point so in the world."""
    x, y = np.array(gripper.approach), np.array(gripper.closing)
    third = (
        np.array(cross_of(*pair))
        for pair in ((approach.tolist(), closing.tolist()), (gripper.approach, gripper.closing))
    )
    axes = ((approach, x), (closing, y), tuple(third))
    return np.asarray(sum(world[:, None] * tool for world, tool in axes))  # what each axis of the tool becomes


def width_across(target: Obstacle, grasp: Pose, robot: Robot) -> float:
    """Metres that an object has between the fingers of a grasp, where they meet it; 0 for a cup."""
    return 0.0 if _has_cup(robot) else held_by(target, grasp, robot).width


def offset_from(target: Obstacle, grasp: Pose, robot: Robot) -> tuple[float, float]:
    """Metres between the middle of what fingers hold and the middle between them, and between fingertips and object."""
    held = held_by(target, grasp, robot)
    return held.aside, held.beyond


def _has_cup(robot: Robot) -> bool:
    return robot.gripper is not None and robot.gripper.kind == "vacuum"
