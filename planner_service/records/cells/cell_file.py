"""Plans of cells in JSON files: the arms and where they stand, the scene, and each motion with its own clock.

What a file claims is only a claim, as of plans: ``prove_cell`` works it out anew, over all clocks.
``docs/reference/cells.md`` describes the format.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, ValidatorFunctionWrapHandler, WrapValidator

from planner_service.cell import Arm, AtTool, Cell, CellPlan, OwnClock
from planner_service.cell.layout import Layout
from planner_service.collision import CheckCounts
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.json_reader import MAX_BYTES, read_json
from planner_service.files.json_writer import indented_json
from planner_service.files.reading import as_path
from planner_service.files.schema import (
    Count,
    GrownRecord,
    Numbers,
    Prose,
    Record,
    Text,
    at_most,
    read_record,
    recorded,
)
from planner_service.files.writing import write_whole
from planner_service.geometry.validation import instance
from planner_service.planning.result import Failure, Origin, PlanResult
from planner_service.records.plan_file import OURS, SavedPlan, SavedTask, Sections, made_with_here, plan_or_task_of
from planner_service.records.request import RequestRecord
from planner_service.records.result import CountsRecord, FailureRecord, ResultRecord
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import AttachedRecord, PlanReading, SceneRecord
from planner_service.records.values import PoseRecord
from planner_service.robot.model import Robot, joint_vector
from planner_service.scene.scene import Scene

__all__ = ["CELL_FORMAT", "SavedCellPlan", "bound", "cell_plan_of", "load_cell_plan", "load_saved", "save_cell_plan"]

CELL_FORMAT = "planner-service/cell-plan"
VERSION = 1

MAX_ARMS = 4
MAX_CARRIED = 100
"""Objects that an arm holds."""

MAX_NOTES = 1_000
MAX_JOINTS = 1_000

MAX_START = 1e6
"""Seconds; no arm waits longer."""


@dataclass(frozen=True, eq=False)
class SavedCellPlan:
    """A plan of a cell with the cell that it was made for.

    Attributes:
        plan: The motions; those from a file are claims. Their ``tried`` is empty.
        counts: What planning took.
        made_with: Versions of this package and of the libraries that plans depend on, by name.
        sections: Further parts of the file by name, JSON values; those that are not known are kept as they are.
    """

    plan: CellPlan
    counts: CheckCounts
    made_with: Mapping[str, str] = field(default_factory=made_with_here)
    sections: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<SavedCellPlan: {', '.join(self.cell.arms)} in {self.scene.name or 'unnamed scene'}, {self.plan!r}>"

    def __str__(self) -> str:
        return str(self.plan)

    @property
    def layout(self) -> Layout:
        """What the cell is made of.

        Raises:
            InvalidRequest: That is not known.
        """
        if self.plan.layout is None:
            raise InvalidRequest("plan", "a plan of an unknown cell", "a plan that Cell.plan made")
        return self.plan.layout

    @cached_property
    def cell(self) -> Cell:
        """The cell."""
        return Cell.laid_out(self.layout)

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.layout.scene

    @property
    def robots(self) -> tuple[Robot, ...]:
        """The robots of the arms, each once."""
        return tuple(_robots(self.layout))

    @property
    def failure(self) -> Failure | None:
        """None with a plan."""
        return self.plan.failure

    @classmethod
    def of(cls, plan: CellPlan) -> SavedCellPlan:
        """A plan that ``Cell.plan`` made.

        Raises:
            InvalidRequest: It does not know its cell.
        """
        instance("plan", plan, CellPlan, "a CellPlan")
        saved = cls(plan, plan.counts)
        saved.layout  # noqa: B018 - raises
        return saved

    def within(self, scene: Scene) -> SavedCellPlan:
        """The same motions in another scene.

        Raises:
            InvalidRequest: Something is carried in it.
        """
        instance("scene", scene, Scene, "a Scene")
        other = Cell.laid_out(replace(self.layout, scene=scene))
        return replace(self, plan=bound(replace(self.plan, layout=other.layout), other))

    def document(self) -> dict[str, Any]:
        """The content of the file, of plain JSON values.

        Raises:
            InvalidRequest: A value in it cannot be written.
        """
        return recorded("plan", lambda: CellPlanRecord.of(self)).document()

    def file_text(self) -> str:
        """What a file of it holds, in ASCII.

        Raises:
            InvalidRequest: A value in it cannot be written, or the file would be too large.
        """
        text = indented_json(self.document()) + "\n"
        if len(text) > MAX_BYTES:
            raise InvalidRequest("plan", f"{len(text):,} bytes", f"one that fits in {MAX_BYTES:,} bytes")
        return text

    def compact(self) -> bytes:
        """The same on one line, as servers answer.

        Raises:
            InvalidRequest: As ``file_text``.
        """
        data = recorded("plan", lambda: CellPlanRecord.of(self)).line
        if len(data) > MAX_BYTES:
            raise InvalidRequest("plan", f"{len(data):,} bytes", f"one that fits in {MAX_BYTES:,} bytes")
        return data

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a file, whole or not at all.

        Raises:
            InvalidRequest: A value in it cannot be written, or the file would be too large.
            InvalidFile: The file cannot be written.
        """
        write_whole(as_path("path", path), self.file_text(), OURS)


@dataclass
class CellReading(PlanReading):
    """What is known while a file of a cell is read.

    Attributes:
        joints_of: How many joints each arm has, as far as the file can be understood; all of them under the name "".
    """

    joints_of: Mapping[str, int] = field(default_factory=dict)


def _with_own_joints(value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    """Read a robot, or a motion of some arms, with the number of its joints."""
    reading = info.context
    if not isinstance(reading, CellReading) or not isinstance(value, dict):
        return handler(value)
    names, arms = value.get("joint_names"), value.get("arms")
    if isinstance(arms, list):
        name = arms[0] if len(arms) == 1 else ""
        reading.joints = reading.joints_of.get(name) if isinstance(name, str) else None
    else:
        reading.joints = len(names) if isinstance(names, list) else None
    try:
        return handler(value)
    finally:
        reading.joints = None


class AtToolRecord(Record, makes=AtTool):
    """An ``AtTool``.

    Attributes:
        arm: The other arm.
        pose: The pose of the arm's own tool in that one's tool frame, when both are through.
    """

    arm: Text
    pose: PoseRecord


class ArmRecord(GrownRecord):
    """An arm of a cell: a robot at a place, or some joints of the one robot.

    Attributes:
        name: The name of the arm.
        robot: Which of `robots` it is, from 0.
        base: Pose of the robot's base frame in the cell's frame; not there where arms are joints of one robot.
        joints: The joints of the robot that are this arm's; not there where arms are robots at places.
        tool: The link that is the arm's tool; not there if it is the robot's.
        carried: What the arm holds, at poses in its tool frame; not there if nothing.
        at_tool: Where its tool is at the end in another arm's tool frame; not there if that was not asked.
    """

    name: Text
    robot: Count
    base: PoseRecord | None = None
    joints: Annotated[list[Text], at_most(MAX_JOINTS)] | None = None
    tool: Text | None = None
    carried: Annotated[list[AttachedRecord], at_most(MAX_CARRIED)] = Field(default_factory=list)
    at_tool: AtToolRecord | None = None


class ClockRecord(Record):
    """An ``OwnClock``.

    Attributes:
        arms: The arms that it moves; several where they share the clock.
        start: Seconds after the start of the whole at which it starts.
        request: What was asked of it; null if its planner or timing law has no name to be made from.
        result: The motion.
    """

    arms: Annotated[list[Text], Field(min_length=1), at_most(MAX_ARMS)]
    start: Annotated[float, Field(ge=0.0, le=MAX_START)]
    request: RequestRecord | None
    result: ResultRecord


class CellPlanRecord(Record):
    """A file with the plan of a cell.

    Attributes:
        format: Tells these files from others.
        version: The version of the format.
        made_with: Versions of this package and of the libraries that plans depend on, by name.
        arms: The arms, in the order of their joints in `still`.
        failure: Why there is no plan; null with one.
        tolerates: Seconds by which every arm may be late, each for itself, at any time; null for as long as it likes.
        still: Joint values of all arms at their starts.
        clocks: The motions, by their starts; none without a plan.
        rectangles: How many pairs of stretches of two arms' motions were asked for a proof.
        distances: Bounds that this took.
        counts: What planning took, all that was tried.
        notes: How the motions were brought together.
        scene: The scene, in the cell's frame.
        robots: The robots of the arms, each once.
        sections: Further parts of the file by name.
    """

    format: Literal["planner-service/cell-plan"]
    version: Literal[1]
    made_with: Annotated[dict[Text, Text], at_most(100)]
    arms: Annotated[list[ArmRecord], Field(min_length=1), at_most(MAX_ARMS)]
    failure: FailureRecord | None
    tolerates: Annotated[float, Field(ge=0.0)] | None
    still: Numbers
    clocks: Annotated[list[Annotated[ClockRecord, WrapValidator(_with_own_joints)]], at_most(MAX_ARMS)]
    rectangles: Count
    distances: Count
    counts: CountsRecord
    notes: Annotated[list[Prose], at_most(MAX_NOTES)]
    scene: SceneRecord
    robots: Annotated[
        list[Annotated[RobotRecord, WrapValidator(_with_own_joints)]], Field(min_length=1), at_most(MAX_ARMS)
    ]
    sections: Sections

    @classmethod
    def fields_of(cls, value: SavedCellPlan) -> dict[str, Any]:
        plan, layout = value.plan, value.layout
        robots = _robots(layout)
        late = plan.tolerates if math.isfinite(plan.tolerates) else None
        clocks = [
            {"arms": list(clock.arms), "start": clock.start, "request": _request(clock.plan), "result": clock.plan}
            for clock in plan.clocks
        ]
        return {
            "format": CELL_FORMAT,
            "version": VERSION,
            "made_with": dict(value.made_with),
            "arms": [{**arm, "at_tool": plan.goals.get(arm["name"])} for arm in _arms(layout, robots)],
            "failure": plan.failure,
            "tolerates": late,
            "still": plan.still.tolist(),
            "clocks": clocks,
            "rectangles": plan.rectangles,
            "distances": plan.distances,
            "counts": value.counts,
            "notes": list(plan.notes[:MAX_NOTES]),
            "scene": layout.scene,
            "robots": [_robot_record(robot) for robot in robots],
            "sections": dict(value.sections),
        }

    @cached_property
    def value(self) -> SavedCellPlan:
        cell = Cell.laid_out(self._layout())
        if (self.failure is None) != bool(self.clocks):
            raise InvalidRequest("clocks", len(self.clocks), "motions, or a failure and none")
        still = joint_vector("still", self.still, cell.robot)
        moved = [name for clock in self.clocks for name in clock.arms]
        for name in moved:
            if name not in cell.arms:
                raise UnknownName("arm", name, cell.arms)
            if moved.count(name) > 1:
                raise InvalidRequest("clocks", moved, f"one motion of each arm; {name!r} has several")
        for arm in self.arms:
            if arm.at_tool is not None and (arm.at_tool.arm not in cell.arms or arm.at_tool.arm == arm.name):
                raise InvalidRequest(f"{arm.name}.at_tool.arm", arm.at_tool.arm, "another arm")
        plan = CellPlan(
            tuple(_clock(k, each, cell) for k, each in enumerate(self.clocks)),
            math.inf if self.tolerates is None else self.tolerates,
            None if self.failure is None else self.failure.value,
            still,
            self.rectangles,
            self.distances,
            notes=tuple(self.notes),
            layout=cell.layout,
            goals={arm.name: arm.at_tool.value for arm in self.arms if arm.at_tool is not None},
        )
        counts: CheckCounts = self.counts.value
        return SavedCellPlan(bound(plan, cell), counts, MappingProxyType(self.made_with), self.sections)

    def _layout(self) -> Layout:
        names = [arm.name for arm in self.arms]
        if len(set(names)) < len(names):
            raise InvalidRequest("arms", names, "each name once")
        for k, arm in enumerate(self.arms):
            if arm.robot >= len(self.robots):
                raise InvalidRequest(f"arms[{k}].robot", arm.robot, f"one of {len(self.robots)} robots, from 0")
        of_one = [arm.joints is not None for arm in self.arms]
        scene: Scene = self.scene.value
        carried = {arm.name: tuple(held.value for held in arm.carried) for arm in self.arms if arm.carried}
        if not any(of_one):
            for k, arm in enumerate(self.arms):
                if arm.base is None or arm.tool is not None:
                    expected = "an arm with a base and without a tool, or joints of one robot"
                    raise InvalidRequest(f"arms[{k}]", arm.name, expected)
            bases = [arm.base.value for arm in self.arms if arm.base is not None]
            placed = (Arm(self.robots[arm.robot].value, base) for arm, base in zip(self.arms, bases, strict=True))
            return Layout(scene, dict(zip(names, placed, strict=True)), carried=carried)
        if not all(of_one) or len(self.robots) > 1 or any(arm.base is not None for arm in self.arms):
            raise InvalidRequest("arms", names, "robots at places, or joints of one robot that stands where it does")
        groups = {arm.name: tuple(arm.joints or ()) for arm in self.arms}
        tools = {arm.name: arm.tool for arm in self.arms if arm.tool is not None}
        return Layout(scene, whole=self.robots[0].value, groups=groups, tools=tools, carried=carried)


def _clock(k: int, record: ClockRecord, cell: Cell) -> OwnClock:
    """A motion from a file."""
    arms = tuple(record.arms)
    service = cell.arm(arms[0]) if len(arms) == 1 else cell.service
    request = None if record.request is None else record.request.value
    result: PlanResult = record.result.value
    if result.path is None or result.path.n != service.robot.n:
        found = None if result.path is None else result.path.n
        raise InvalidRequest(f"clocks[{k}].result", found, f"a motion of {service.robot.n} joints")
    if request is not None:
        joint_vector(f"clocks[{k}].request.start", request.start, service.robot)
    plan = replace(result, origin=Origin(service.world, request, elsewhere=True))
    every = np.arange(cell.robot.n)
    columns = tuple(tuple(int(column) for column in cell.of_arm(name, every)) for name in arms)
    return OwnClock(arms, plan, record.start, columns)


def bound(plan: CellPlan, cell: Cell) -> CellPlan:
    """The same motions, each in the world in which it is proven: with the arms that stand all the time, no others."""
    moved = {name for clock in plan.clocks for name in clock.arms}
    idle = {name: cell.of_arm(name, plan.still) for name in cell.arms if name not in moved}
    clocks = []
    for clock in plan.clocks:
        service = cell.arm(clock.arms[0], idle) if len(clock.arms) == 1 else cell.service
        had = clock.plan.origin
        origin = Origin(service.world, None, elsewhere=True) if had is None else replace(had, world=service.world)
        clocks.append(replace(clock, plan=replace(clock.plan, origin=origin)))
    return replace(plan, clocks=tuple(clocks))


def _robots(layout: Layout) -> list[Robot]:
    """Each robot once."""
    if layout.whole is not None:
        return [layout.whole]
    return list({id(arm.robot): arm.robot for arm in layout.arms.values()}.values())


def _arms(layout: Layout, robots: Sequence[Robot]) -> list[dict[str, Any]]:
    if layout.whole is not None:
        return [
            {"name": name, "robot": 0, "base": None, "joints": list(joints), "tool": layout.tools.get(name)}
            | {"carried": list(layout.carried.get(name, ()))}
            for name, joints in layout.groups.items()
        ]
    number = {id(robot): k for k, robot in enumerate(robots)}
    return [
        {"name": name, "robot": number[id(arm.robot)], "base": arm.base, "joints": None, "tool": None}
        | {"carried": list(layout.carried.get(name, ()))}
        for name, arm in layout.arms.items()
    ]


def _request(plan: PlanResult) -> RequestRecord | None:
    request = None if plan.origin is None else plan.origin.request
    return None if request is None else RequestRecord.find(request)


@lru_cache(maxsize=16)
def _robot_record(robot: Robot) -> RobotRecord:
    return RobotRecord.of(robot)


# Writing and reading.


def save_cell_plan(plan: CellPlan | SavedCellPlan, path: str | os.PathLike[str]) -> None:
    """Write the plan of a cell, or the failure that is in its place; the file is there whole or not at all.

    Raises:
        InvalidRequest: It does not know its cell, or a value in it cannot be written.
        InvalidFile: The file cannot be written.
    """
    saved = SavedCellPlan.of(plan) if isinstance(plan, CellPlan) else plan
    instance("plan", saved, SavedCellPlan, "a CellPlan or a SavedCellPlan").save(path)


def load_cell_plan(path: str | os.PathLike[str]) -> SavedCellPlan:
    """The plan of a cell in a file, paths and trajectories bit for bit as they were saved.

    Nothing of it is proven; ``prove_cell`` does that.

    Raises:
        InvalidFile: The file cannot be used; it lists all problems found, not the first.
    """
    file = as_path("path", path)
    return cell_plan_of(file, read_json(file))


def load_saved(path: str | os.PathLike[str]) -> SavedPlan | SavedTask | SavedCellPlan:
    """Whichever is in a file: a plan, a task or the plan of a cell.

    Raises:
        InvalidFile: The file cannot be used; it lists all problems found, not the first.
    """
    file = as_path("path", path)
    document = read_json(file)
    if isinstance(document, dict) and document.get("format") == CELL_FORMAT:
        return cell_plan_of(file, document)
    return plan_or_task_of(file, document)


def cell_plan_of(file: Path, document: Any) -> SavedCellPlan:
    """The same of the document that is in a file.

    Raises:
        InvalidFile: As ``load_cell_plan``.
    """
    content = document if isinstance(document, dict) else {}
    if "format" in content and content["format"] != CELL_FORMAT:
        raise InvalidFile(file, [f"format: got {content['format']!r:.100}; expected {CELL_FORMAT!r}"])
    saved: SavedCellPlan = read_record(CellPlanRecord, document, file, _reading(content)).value
    return saved


def _reading(content: Mapping[str, Any]) -> CellReading:
    """How many joints arms have, where the file can be understood; what else it holds is found wanting elsewhere."""
    counts: dict[str, int] = {}
    robots, arms = _list(content.get("robots")), _list(content.get("arms"))
    sizes = [
        len(robot["joint_names"]) if isinstance(robot, dict) and isinstance(robot.get("joint_names"), list) else None
        for robot in robots
    ]
    for arm in arms:
        if not isinstance(arm, dict) or not isinstance(arm.get("name"), str):
            continue
        number, joints = arm.get("robot"), arm.get("joints")
        known = sizes[number] if type(number) is int and 0 <= number < len(sizes) else None
        count = len(joints) if isinstance(joints, list) else known
        if count is not None:
            counts[arm["name"]] = count
    of_one = any(isinstance(arm, dict) and isinstance(arm.get("joints"), list) for arm in arms)
    if of_one and sizes and sizes[0] is not None:
        counts[""] = sizes[0]
    elif len(counts) == len(arms):
        counts[""] = sum(counts.values())
    return CellReading(joints_of=counts)


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
