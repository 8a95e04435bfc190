"""A whole pick-and-place: from the start to the object, onto another one, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance
from planner_service.grasping.grasps import middle_of
from planner_service.memory import Memory
from planner_service.planning.request import PlanRequest
from planner_service.planning.task_result import Handling, TaskResult
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.primitives import pick_steps, place_steps, require_grasps, require_poses
from planner_service.tasks.solver import solved
from planner_service.tasks.steps import Connect, MoveTo
from planner_service.tasks.task import Task

__all__ = ["places_on", "plan_pick_place", "standing_on"]

STANDING_GAP = 0.005
"""Metres at most between an object and what it stands on: scenes leave a millimetre, detections more."""

UP = np.array([0.0, 0.0, 1.0])


def plan_pick_place(
    service: PlannerService,
    target: str,
    onto: str,
    request: PlanRequest,
    *,
    poses: Sequence[Pose] | None = None,
    upright: float | None = None,
    memory: Memory | None = None,
    cancel: CancelToken | None = None,
) -> TaskResult:
    """Plan home -> pregrasp -> descend -> lift -> transfer -> lower -> retreat -> home, as far as there are plans.

    Grasps are those of ``GraspKinds()``: from above where one of these has a plan, else of the other kinds.

    Args:
        onto: The obstacle that the object is set down on.
        poses: Where the object may be set down, in the base frame, best first; None for the middle of ``onto``'s top.
        request: Its start is where the robot starts and returns to. Planner, timing, seed, scales, padding and limits
            are those of all motions; its goal is not used. Its ``time_limit`` holds for the pick, for the place and for
            the way home, its ``max_checks`` for each motion. A start that overlaps by a little is left first, by a
            motion called "leave", and where that ends is where the robot returns to.
        upright: Radians by which the object may lean while it is carried, from how it stood; None for any.
        memory: As for ``pick``.
        cancel: Ends the task before its next check when cancelled from another thread.

    Raises:
        UnknownName: There is no such obstacle.
        InvalidRequest: The robot has no gripper, the object is too wide for it, or ``upright`` is out of range.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, PlanRequest, "a PlanRequest")
    scene = service.scene
    obstacle, support = scene.obstacle(target), scene.obstacle(onto)
    if target == onto:
        raise InvalidRequest("--onto", onto, "another obstacle than the object itself")
    if poses is not None:
        require_poses("poses", poses)
    places = places_on(obstacle, support) if poses is None else poses
    picking = Handling(support=standing_on(scene, target), request=request, upright=upright)
    require_grasps(service.robot, obstacle)
    _, *taken = pick_steps(target, None, picking)
    steps = (Connect("home -> pregrasp"), *taken, *place_steps(target, places, Handling(support=onto)))
    title = f"pick {target} from {scene.name or 'the scene'}, place on {onto}"
    task = Task((*steps, MoveTo(name="retreat -> home")), title)
    return solved(service, task, request.start, request, None, memory, cancel)


def standing_on(scene: Scene, name: str) -> str | None:
    """The obstacle below an object's centre whose top is within 5 mm of its underside; None if there is none."""
    target = instance("scene", scene, Scene, "a Scene").obstacle(name)
    x, y, _ = middle_of(target)
    bottom = -_reach(target, -UP)
    gaps = {
        other.name: abs(bottom - _reach(other, UP))
        for other in scene.obstacles
        if other.name != name and _spans(other, 0, x) and _spans(other, 1, y)
    }
    near = [(gap, support) for support, gap in gaps.items() if gap <= STANDING_GAP]
    return min(near)[1] if near else None


def places_on(target: Obstacle, support: Obstacle) -> tuple[Pose, ...]:
    """Poses of an object with its underside on the middle of a support's top: as it is turned now, then by quarters."""
    for field, obstacle in (("target", target), ("support", support)):
        instance(field, obstacle, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
    x, y, _ = middle_of(support)
    height = _reach(target, -UP) + target.pose.position[2]
    top = _reach(support, UP)
    quarters = (Pose(quaternion=(math.cos(k * math.pi / 4), 0.0, 0.0, math.sin(k * math.pi / 4))) for k in range(4))
    poses = []
    for quarter in quarters:
        turned = (quarter @ Pose(quaternion=target.pose.quaternion)).quaternion
        u, v, _ = middle_of(Obstacle(target.name, target.shape, Pose(quaternion=turned)))
        poses.append(Pose((x - u, y - v, top + height), turned))
    return tuple(poses)


def _reach(obstacle: Obstacle, direction: FloatArray) -> float:
    """How far an obstacle extends from the base frame's origin in a direction, in metres."""
    local = obstacle.pose.rotation.T @ direction
    return float(direction @ np.asarray(obstacle.pose.position) + local @ obstacle.shape.support(local))


def _spans(obstacle: Obstacle, axis: int, value: float) -> bool:
    direction = np.eye(3)[axis]
    return -_reach(obstacle, -direction) <= value <= _reach(obstacle, direction)
