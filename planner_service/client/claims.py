"""What a server claims to have planned, and whether that is what it was asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner_service.client.answer import Answer
from planner_service.constraints import ToolRegion
from planner_service.errors import InvalidFile
from planner_service.memory.memory import NOTHING, Memory
from planner_service.planning.request import Pace, PlanRequest, World
from planner_service.planning.result import Origin, PlanResult
from planner_service.planning.task_result import TaskResult
from planner_service.records.plan_file import SavedTask
from planner_service.records.request import RequestRecord, astray
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached
from planner_service.tasks.steps import Grasp
from planner_service.tasks.task import ContactStage, Stage

__all__ = ["of_server", "require_asked", "require_carried", "require_there", "sure_grasps", "task_result"]


def of_server(result: PlanResult, world: World, request: PlanRequest | None, pace: Pace | None = None) -> PlanResult:
    return replace(result, origin=Origin(world, request, pace, elsewhere=True))


def require_asked(answer: Answer, answered: PlanRequest | None, asked: PlanRequest) -> None:
    """Refuse the answer to another request."""
    if answered is asked:
        return
    if answered is None or RequestRecord.of(answered) != RequestRecord.of(asked):
        raise InvalidFile(answer.url, ["request: another one than was sent"])


def require_there(
    answer: Answer, request: PlanRequest, result: PlanResult, robot: Robot, *, task: bool = False
) -> None:
    """Refuse a motion that begins elsewhere than asked, or ends there unless it is a part of a ``task``, or a line."""
    if elsewhere := astray(request, result, robot, task=task):
        raise InvalidFile(answer.url, [f"path: {elsewhere}"])


def sure_grasps(stages: Sequence[Stage]) -> tuple[Grasp, ...]:
    """The grasps of a task, without those of its alternatives."""
    acts = [stage.act.step for stage in stages if isinstance(stage, ContactStage)]
    return tuple(step for step in acts if isinstance(step, Grasp))


def require_carried(answer: Answer, grasps: Sequence[Grasp], carried: Sequence[Attached]) -> None:
    """Refuse a task in which something is never carried, or not as upright as it should be, that is to be taken."""
    for grasp in grasps:
        held = [each for each in carried if each.name == grasp.object]
        if not held:
            raise InvalidFile(answer.url, [f"{grasp.object}: never carried, but it was to be taken"])
        tilts = {bound.tilt for each in held for bound in each.constraints if isinstance(bound, ToolRegion)}
        if grasp.upright is not None and not any(tilt is not None and tilt <= grasp.upright for tilt in tilts):
            raise InvalidFile(answer.url, [f"{grasp.object}: carried without the constraint that was asked for"])


def task_result(saved: SavedTask, request: PlanRequest, memory: Memory = NOTHING) -> TaskResult:
    """A task as the library returns it, with what is remembered after it."""
    world, end, segments = saved.begin, np.asarray(request.start), []
    for segment in saved.segments:
        world = segment.world_after(world)
        end = end if segment.result.path is None else segment.result.path.waypoints[-1]
        segments.append(replace(segment, result=of_server(segment.result, world, None)))
    done = tuple(segments)
    said = saved.failure, saved.choosing, saved.notes, request, saved.task, saved.seconds
    return TaskResult(done, world, end, *said, steps=saved.steps, memory=memory)
