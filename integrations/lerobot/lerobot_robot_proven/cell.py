"""The arms as the planner knows them, with fingers that may stand anywhere, and simulated arms in their scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planner_service import InvalidRequest, Robot, Scene, load_robot, load_scene
from planner_service.execute import SimulatedArm

__all__ = ["ASLEEP", "roomy", "simulated_arms"]

ASLEEP = (0.0,) * 6
"""Where an arm that is switched off lies."""


def roomy(robot: Robot, prefixes: Sequence[str]) -> Robot:
    """A robot whose fingers fill the room that they need at any width, of each arm.

    Raises:
        InvalidRequest: it has other joints than such arms.
    """
    joints = tuple(f"{prefix}joint_{k}" for prefix in prefixes for k in range(len(ASLEEP)))
    if robot.joint_names != joints or robot.gripper is None:
        raise InvalidRequest("model", robot.name, f"a robot with a gripper and the joints {', '.join(joints)}")
    done, first = robot.with_finger_room(), prefixes[0]
    shapes = list(done.shapes)
    for prefix in prefixes[1:]:  # the gripper of the robot is the first arm's; the others' are fixed, and equal to it
        twins = {prefix + link.removeprefix(first): link for link in robot.gripper.links}
        rooms = iter([item for link in twins.values() for item in done.shapes if item.link == link])
        for k, item in enumerate(shapes):
            if item.link in twins:
                room = next(rooms)
                shapes[k] = replace(item, shape=room.shape, pose=room.pose)
    return replace(done, shapes=tuple(shapes))


def simulated_arms(robot: Robot, scene: Scene, prefixes: Sequence[str]) -> list[SimulatedArm]:
    """An arm for each prefix, asleep among the scene's obstacles; they touch those, but not each other.

    Raises:
        InvalidRequest: as of ``SimulatedArm``.
        MissingDependency: likewise.
    """
    if len(prefixes) == 1:
        return [SimulatedArm(robot, scene, ASLEEP)]
    frames = {frame.link: frame.pose for frame in robot.link_frames}
    arms: list[SimulatedArm] = []
    try:
        for prefix in prefixes:
            around, back = load_scene("empty"), frames[f"{prefix}base_link"].inverse()
            for obstacle in scene.obstacles:
                around = around.with_obstacle(replace(obstacle, pose=back @ obstacle.pose))
            arms.append(SimulatedArm(load_robot("wxai"), around, ASLEEP))
    except BaseException:
        for arm in arms:
            arm.close()
        raise
    return arms
