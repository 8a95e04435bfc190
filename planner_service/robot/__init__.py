"""Robots as immutable values, and the files they are read from."""

from planner_service.robot.inertia import Payload
from planner_service.robot.model import (
    AllowedContact,
    Body,
    ExemptRetreat,
    Gripper,
    JointLimits,
    LinkShape,
    Robot,
    robot_names,
)

__all__ = [
    "AllowedContact",
    "Body",
    "ExemptRetreat",
    "Gripper",
    "JointLimits",
    "LinkShape",
    "Payload",
    "Robot",
    "robot_names",
]
