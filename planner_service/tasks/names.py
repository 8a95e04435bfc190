"""What a task names: it is there when its turn comes, or refused before anything is planned."""

from __future__ import annotations

from collections.abc import Sequence

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.tasks.contacts import gripper_of
from planner_service.tasks.steps import Grasp, MoveTo
from planner_service.tasks.task import ChoiceStage, ContactStage, Stage

__all__ = ["require_names"]


def require_names(service: PlannerService, stages: Sequence[Stage]) -> None:
    """Refuse what a task names and is not there when its turn comes.

    Raises:
        UnknownName: There is no such obstacle, carried object or pose.
        InvalidRequest: The robot has no gripper; or alternatives do not end with the same objects carried.
    """
    _carried(service.robot, service.scene, stages, frozenset(held.name for held in service.scene.attached))


def _carried(robot: Robot, scene: Scene, stages: Sequence[Stage], held: frozenset[str]) -> frozenset[str]:
    """What is carried after stages, if ``held`` is before."""
    for stage in stages:
        if isinstance(stage, ChoiceStage):
            after = [_carried(robot, scene, branch, held) for branch in stage.branches]
            if any(other != after[0] for other in after):
                raise InvalidRequest("steps", "alternatives", "ones that all end with the same objects carried")
            held = after[0]
            continue
        standing = [name for name in scene.names if name not in held]
        step = stage.act.step if isinstance(stage, ContactStage) else stage.motion.step
        for name in filter(None, (getattr(step, "frame", ""), getattr(step, "support", None))):
            if name not in standing:
                raise UnknownName("obstacle", name, standing)
        if isinstance(step, MoveTo):
            for goal in step.goal or ():
                if isinstance(goal, str):
                    robot.pose(goal)
        if not isinstance(stage, ContactStage):
            continue
        gripper_of(robot)
        takes = isinstance(step, Grasp)
        if takes and step.object not in standing:
            raise UnknownName("obstacle", step.object, standing)
        if not takes and step.object not in held:
            raise UnknownName("carried object", step.object, sorted(held))
        held = held | {step.object} if takes else held - {step.object}
    return held
