"""What motions are planned in: a robot, a scene, and how they are checked."""

from __future__ import annotations

from dataclasses import dataclass, field

from planner_service.collision import EdgeStep, MotionStep
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["World"]


@dataclass(frozen=True, eq=False)
class World:
    """A robot in a scene, and how motions are checked there: all that a ``PlannerService`` is made of.

    Attributes:
        robot: With its gripper as it stands.
        scene: The obstacles, and what the robot carries.
        allowed: Pairs of link or object names that may touch, beside those the robot allows; sorted.
        edge_step: How finely edges are sampled; None if a file does not know, as it cannot hold a rule of your own.
    """

    robot: Robot
    scene: Scene
    allowed: tuple[tuple[str, str], ...] = ()
    edge_step: EdgeStep | None = field(default_factory=MotionStep)
