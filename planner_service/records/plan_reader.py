"""Plans and tasks of one world that come one after another: its robot and scene are compared, not built each time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from planner_service.errors import InvalidFile
from planner_service.files.schema import Record, read_record
from planner_service.planning.request import PlanRequest, World
from planner_service.records.plan_file import PlanRecord, SavedPlan, SavedTask, StepRecord, TaskRecord
from planner_service.records.request import RequestRecord
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import PlanReading, SceneRecord

__all__ = ["PlanReader"]

R = TypeVar("R", bound=Record)

SOLID = ("obstacles", "attached")
"""What of a scene changes verdicts; it may have another name."""


class PlanReader:
    """Reads plans and tasks that were made in one world, as strictly as ``load_plan`` does.

    What is read has this world's robot and scene: the texts of both are compared, or the robot's hash if a server was
    asked for that alone, and whatever was made in another world is refused. To build a robot takes ten times as long
    as to read the rest of a plan.
    """

    def __init__(self, world: World) -> None:
        self.world = world

    def plan(self, document: Mapping[str, Any], source: str, request: PlanRequest | None = None) -> SavedPlan:
        """The plan that is the content of a file.

        Args:
            source: Where it comes from, for messages.
            request: What was asked; if the plan's is the same, it has this one.

        Raises:
            InvalidFile: It is no plan, or one that was made in another world.
        """
        if request is not None:
            record = _known(RequestRecord.of(request), request)
            if document.get("request") == record.document():
                document = {**document, "request": record}
        plan: SavedPlan = self._read(PlanRecord, document, Path(source)).value
        return plan

    def task(self, document: Mapping[str, Any], source: str) -> SavedTask:
        """The task that is the content of a file.

        Raises:
            InvalidFile: It is no task, or one that was made in another world.
        """
        task: SavedTask = self._read(TaskRecord, document, Path(source)).value
        return task

    def _read(self, model: type[R], document: Mapping[str, Any], file: Path) -> R:
        return read_record(model, self.shared(document, str(file)), file, PlanReading(joints=self.world.robot.n))

    def shared(self, document: Mapping[str, Any], source: str) -> dict[str, Any]:
        """The document of a plan or a task with this world's robot and scene in place of its own, which are as these.

        Raises:
            InvalidFile: It was made in another world.
        """
        self._require_this_world(document, Path(source))
        return {**document, "robot": self._robot[0], "scene": self._scene[0]}

    def _require_this_world(self, document: Mapping[str, Any], file: Path) -> None:
        scene, own = document.get("scene"), self._scene[1]
        same = {
            "robot": document.get("robot") in (self._robot[1], {"hash": self.world.robot.hash}),
            "scene": isinstance(scene, dict) and all(scene.get(name) == own[name] for name in SOLID),
            "allowed": document.get("allowed") == [list(pair) for pair in self.world.allowed],
            "edge_step": document.get("edge_step") == self._edge_step,
        }
        if problems := [
            f"{name}: another one than that of the world it should be of" for name in same if not same[name]
        ]:
            raise InvalidFile(file, problems)

    @cached_property
    def _robot(self) -> tuple[RobotRecord, dict[str, Any]]:
        return _read_back(RobotRecord.of(self.world.robot), self.world.robot)

    @cached_property
    def _scene(self) -> tuple[SceneRecord, dict[str, Any]]:
        return _read_back(SceneRecord.of(self.world.scene), self.world.scene)

    @cached_property
    def _edge_step(self) -> dict[str, Any] | None:
        record = StepRecord.find(self.world.edge_step)
        return None if record is None else record.document()


def _read_back(record: R, value: Any) -> tuple[R, dict[str, Any]]:
    """A record whose value is known, and its document as it is read from a file."""
    return _known(record, value), json.loads(json.dumps(record.document()))


def _known(record: R, value: Any) -> R:
    """A record whose value is known."""
    record.__dict__["value"] = value  # where a cached property keeps it
    return record
