"""Each model holds all that the class it is of has: what a class gains is kept by its files and its HTTP bodies."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import pytest

from planner_service.collision import CheckCounts
from planner_service.files.schema import Record, plain
from planner_service.memory import memory_file
from planner_service.planning.request import Pace, PlanRequest, World
from planner_service.planning.result import Failure, MotionReport, PlanResult, StageReport
from planner_service.planning.task_result import Handling, Segment
from planner_service.records.http.bodies import HandlingBody, PaceBody, RequestBody, SolveBody
from planner_service.records.http.replies import VERBS, RobotReply
from planner_service.records.plan_file import PlanRecord, SavedPlan, SavedTask, SegmentRecord, TaskRecord
from planner_service.records.request import RequestRecord
from planner_service.records.result import FailureRecord, MotionRecord, ResultRecord, StageRecord
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import SceneRecord
from planner_service.roadmap import roadmap_file
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService

MODELS = ("planner_service.records", memory_file.__name__, roadmap_file.__name__)
"""Where the models of files and bodies are; of other modules those that have been imported would come along."""


def makers(model: type[Record] = Record) -> Iterator[tuple[type[Record], type[Any]]]:
    """The models that say which class they make."""
    for child in model.__subclasses__():
        if isinstance(child.makes, type) and is_dataclass(child.makes) and child.__module__.startswith(MODELS):
            yield child, child.makes
        yield from makers(child)


OTHERWISE: dict[type[Any], str] = {
    SavedPlan: "begin",  # robot, scene, allowed, edge_step
    SavedTask: "begin",
    World: "scene",  # of a request
    PlanRequest: "goal",  # goals
    PlanResult: "roadmap trace origin fraction allowed no_path known learned",  # of its process, or of sections
    StageReport: "counts",  # one by one
    Robot: "visuals description groups",  # not what it is, but what it is shown as and called
    Obstacle: "colour",  # what it is drawn in, which scene files alone keep
    Segment: "width grip",
    Handling: "cancel",
    CheckCounts: "projections",  # a roadmap is built without any; files of plans and bodies have them
}
"""What of a class is in a file under another name, or not at all."""

OF = {
    RequestRecord: PlanRequest,
    RequestBody: PlanRequest,
    PaceBody: Pace,
    HandlingBody: Handling,
    ResultRecord: PlanResult,
    StageRecord: StageReport,
    FailureRecord: Failure,
    MotionRecord: MotionReport,
    SceneRecord: Scene,
    RobotRecord: Robot,
    SegmentRecord: Segment,
    PlanRecord: SavedPlan,
    TaskRecord: SavedTask,
    RobotReply: World,
}


@pytest.mark.parametrize(("model", "kind"), [*OF.items(), *makers()], ids=lambda each: each.__name__)
def test_a_model_has_each_field_of_its_class(model: type[Record], kind: type[Any]) -> None:
    expected = {item.name for item in fields(kind) if item.init} - set(OTHERWISE.get(kind, "").split())
    assert expected <= set(model.model_fields)


@pytest.mark.parametrize(("body", "kind"), [(RequestBody, PlanRequest), (HandlingBody, Handling)])
def test_what_a_body_does_not_say_is_as_the_class_has_it(body: type[Record], kind: type[Any]) -> None:
    for item in fields(kind):
        field = body.model_fields.get(item.name)
        if field is not None and not field.is_required() and item.default is not MISSING:
            usual = field.get_default(call_default_factory=True)
            assert plain(usual.value if isinstance(usual, Record) else usual) == plain(item.default), item.name


def test_a_task_is_solved_by_a_server_with_the_librarys_limits() -> None:
    usual = inspect.signature(PlannerService.solve).parameters
    for name in ("beam", "searches"):
        assert SolveBody.model_fields[name].default == usual[name].default


def test_the_table_of_verbs_says_which_answers_are_files() -> None:
    tasks = {name for name, verb in VERBS.items() if verb.is_task}
    assert tasks == {"pick", "place", "pick_place", "solve", "order"}
    assert {name for name, verb in VERBS.items() if verb.is_file} == tasks | {"plans", "move_linear", "replan"}
