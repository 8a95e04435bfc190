"""Suction: where a cup may lie on an object, flat on one of its faces."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, along, cosines_and_sines, cross
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, whole
from planner_service.grasping.covering import MAX_GRASPS, MOST, covering
from planner_service.grasping.faces import FlatFace, flat_faces
from planner_service.grasping.grasps import cup_poses
from planner_service.grasping.guards import MEANT_OVERLAP, RIM_POINTS, grasp_objection
from planner_service.grasping.hand import HandCheck
from planner_service.grasping.held import mass_of
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = ["suction_grasps"]

SPOTS = 5
"""Places that are tried from the middle of a face to either side."""

BARE = 1e-4
"""Metres above a face where nothing of the object may be, all around the cup: no other piece of it covers the face."""


def suction_grasps(robot: Robot, target: Obstacle, *, most: int = MOST) -> tuple[Pose, ...]:
    """Where a cup lies flat on a face of an object, the best first and no two nearly equal.

    The best is where the line along the cup passes nearest to the centre of mass, as that tears at the rim least; of
    equal ones the face that looks up most comes first, then the place with most room around the cup. Each is turned to
    any of several sides. The flat patch is at least as large as the cup, and the tool is free of the object, as FCL
    says. What else is around is not looked at: planning refuses what it blocks.

    Args:
        most: Grasps at most, 1 to 1,000. The fewer, the less alike they are.

    Raises:
        InvalidRequest: The robot has no cup, the object has no flat face for it, or more than 5,000 pieces, or ``most``
            is out of its range.
    """
    gripper = instance("robot", robot, Robot, "a Robot").gripper
    if gripper is None or gripper.kind != "vacuum":
        given = robot.name if gripper is None else f"{robot.name}, whose gripper has fingers"
        raise InvalidRequest("robot", given, "a robot with a vacuum gripper")
    instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    most = whole("most", most, 1, MAX_GRASPS)
    centre, farthest = mass_of(target)
    mass = along(target.pose.rotation, centre) + np.array(target.pose.position)
    ranked = []
    for face in flat_faces(target, gripper.radius):
        for place, room in _spots(face, gripper, target):
            lever = math.sqrt(float((cross(mass - place, face.outward) ** 2).sum()))
            key = (round(lever / farthest, 9), -round(float(face.outward[2]), 9), -round(room, 9))
            ranked.append((key, place, face.outward))
    ranked.sort(key=lambda each: each[0])
    poses = [pose for _, place, outward in ranked for pose in cup_poses(gripper, place, outward)]
    hand = HandCheck(robot, target.shape)
    x, y, z = (-MEANT_OVERLAP * axis for axis in gripper.approach)

    def fits(number: int) -> bool:
        back = poses[number] @ Pose((x, y, z))
        return not grasp_objection(target, poses[number], robot) and not hand.touching(
            back.inverse() @ target.pose, gripper.upper
        )

    found = covering(poses, most, fits)
    if not found:
        expected = f"an object with a flat face at least {2.0 * gripper.radius:.3f} m wide"
        raise InvalidRequest("target", target.name, expected)
    return found


def _spots(face: FlatFace, gripper: Gripper, target: Obstacle) -> Iterator[tuple[FloatArray, float]]:
    """Places on a face where a cup fits, and how far each is from the nearest rim: its middle, and some all over it."""
    x = face.inward[0] if len(face.inward) else np.eye(3)[int(np.argmin(np.abs(face.outward)))]
    x = x - float((x * face.outward).sum()) * face.outward
    x = x / math.sqrt(float((x * x).sum()))
    y = cross(face.outward, x)
    steps = np.linspace(-face.reach, face.reach, 2 * SPOTS + 1)
    grid = face.middle + (steps[:, None, None] * x + steps[None, :, None] * y).reshape(-1, 3)
    places = np.concatenate([face.middle[None], grid])
    room = face.room(places)
    c, s = cosines_and_sines(np.asarray(np.arange(RIM_POINTS) * (2.0 * math.pi / RIM_POINTS), dtype=np.float64))
    rim = np.concatenate([np.zeros((1, 3)), gripper.radius * (c[:, None] * x + s[:, None] * y)])
    for k in np.flatnonzero(room >= gripper.radius).tolist():
        above = places[k] + rim + BARE * face.outward - np.array(target.pose.position)
        if float(target.shape.distance(along(target.pose.rotation.T, above)).min()) >= BARE / 2.0:
            yield places[k], float(room[k])
