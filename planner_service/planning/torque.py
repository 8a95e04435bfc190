"""Torque limits of a plan: those of the robot, with its payload and what it has attached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner_service.geometry.mass_properties import mass_properties
from planner_service.geometry.shapes import Pose
from planner_service.planning.request import Pace
from planner_service.robot.inertia import LinkInertia, Payload, tensor_numbers
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Scene
from planner_service.timing.torque_limits import TorqueLimits

__all__ = ["torque_limits", "torques_of"]


def torque_limits(robot: Robot, scene: Scene, payload: Payload | None = None, scale: float = 1.0) -> TorqueLimits:
    """The torque limits of a robot that carries a payload, and the attached objects of a scene that have a mass.

    Raises:
        InvalidRequest: As ``TorqueLimits``.
    """
    tool = Pose.from_matrix(robot.tool_placement)
    loads = [] if payload is None else [_payload(payload)]
    loads += [_attached(held, held.mass) for held in scene.attached if held.mass is not None]
    carried = (replace(load, body=robot.tool_body, pose=tool @ load.pose) for load in loads)
    return TorqueLimits(robot, tuple(carried), scale)


def torques_of(pace: Pace, robot: Robot, scene: Scene) -> TorqueLimits | None:
    """The torque limits that a pace asks for; None if it asks for none.

    Raises:
        InvalidRequest: As ``TorqueLimits``.
    """
    return torque_limits(robot, scene, pace.payload, pace.torque_scale) if pace.keeps_torques else None


def _payload(payload: Payload) -> LinkInertia:
    """A payload in the tool frame."""
    return LinkInertia("payload", 0, payload.mass, payload.inertia, Pose(payload.com))


def _attached(held: Attached, mass: float) -> LinkInertia:
    """An object in the tool frame whose mass is spread evenly over its shape."""
    volume, (x, y, z), tensor = mass_properties(held.shape)
    numbers = tensor_numbers(np.asarray(tensor) * (mass / volume))
    return LinkInertia(held.name, 0, mass, numbers, held.pose @ Pose((float(x), float(y), float(z))))
