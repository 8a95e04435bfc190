"""What a gripper carries after it has closed or opened: found out where a task does not tell."""

from __future__ import annotations

from collections import Counter

from planner_service.collision.names import Names
from planner_service.geometry import FloatArray, Pose
from planner_service.scene import Attached, Obstacle, Scene
from planner_service.service import PlannerService

__all__ = ["service_after"]

GRIP = 0.002
"""Metres within which closed fingers hold something."""


def service_after(service: PlannerService, q: FloatArray, width: float) -> PlannerService:
    """The service once the gripper, at q (n,), has closed or opened to ``width`` metres; itself if it stays.

    What the fingers then touch rides along from there on; what rode along is left where it is when they open.
    """
    robot, scene = service.robot, service.scene
    if robot.gripper is None or width == robot.gripper_width:
        return service
    tool = Pose.from_matrix(robot.tool_pose(q))
    if width > robot.gripper_width:
        for held in scene.attached:
            scene = scene.without_attached(held.name).with_obstacle(Obstacle(held.name, held.shape, tool @ held.pose))
        return service.changed(gripper=width, scene=scene)
    fingers = tuple(dict.fromkeys(item.link for item in robot.gripper.closed))
    taken = _between(service.changed(gripper=width), q, fingers)
    return service.changed(gripper=width, scene=scene if taken is None else _carried(scene, taken, tool, fingers))


def _between(closed: PlannerService, q: FloatArray, fingers: tuple[str, ...]) -> Obstacle | None:
    """The obstacle that most fingers touch, None if none does."""
    names = Names(closed.robot, closed.scene)
    labels = set(map(names.link, fingers))
    touched = Counter(c.b for c in closed.checker.variant(padding=GRIP).contacts(q) if c.a in labels)
    found = [obstacle for obstacle in closed.scene.obstacles if touched[names.object(obstacle.name)]]
    return max(found, key=lambda obstacle: touched[names.object(obstacle.name)], default=None)


def _carried(scene: Scene, taken: Obstacle, tool: Pose, fingers: tuple[str, ...]) -> Scene:
    held = Attached(taken.name, taken.shape, tool.inverse() @ taken.pose, touch_links=fingers)
    return scene.without(taken.name).with_attached(held)
