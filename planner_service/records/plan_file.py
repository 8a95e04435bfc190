"""Plans and tasks in JSON files: written whole, read back bit for bit, with the world they were made in.

A file holds its robot, its scene and what was asked, so that a plan is certified, shown, planned again and rehearsed
from the file alone. What a file claims is only a claim: hashes are computed anew, and whoever moves an arm proves the
motion again (``records/recertify.py``). Floats are written with the fewest digits that read back as the same bits;
there is no NaN and no infinity in a file. ``docs/reference/plan-files.md`` describes the format.
"""

from __future__ import annotations

import math
import os
import platform
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, JsonValue

from planner_service.collision import CheckCounts, EdgeStep, JointStep, MotionStep
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import MAX_BYTES, parse_json, read_json
from planner_service.files.json_writer import indented_json
from planner_service.files.reading import as_path
from planner_service.files.schema import (
    Count,
    GrownRecord,
    Prose,
    Record,
    Text,
    as_text,
    at_most,
    read_record,
    recorded,
)
from planner_service.files.writing import write_whole
from planner_service.geometry.validation import instance
from planner_service.planning.request import PlanRequest, World
from planner_service.planning.result import Failure, Origin, PlanResult
from planner_service.planning.task_result import (
    SAME_WIDTH,
    Segment,
    StepReport,
    TaskResult,
    require_joined,
    task_blocks,
)
from planner_service.presentation.page import OpenPage, show_page
from planner_service.presentation.tables import render_html, render_text
from planner_service.records.old_versions import command_of
from planner_service.records.request import RequestRecord, TimingRecord
from planner_service.records.result import (
    CountsRecord,
    FailureRecord,
    GripperMotionRecord,
    PairList,
    ResultRecord,
)
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import PlanReading, SceneRecord, WorldRecord
from planner_service.robot.model import Robot, length_unit
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService

__all__ = [
    "OURS",
    "PLAN_FORMAT",
    "TASK_FORMAT",
    "VERSION",
    "SavedPlan",
    "SavedTask",
    "Sections",
    "load_plan",
    "load_plan_or_task",
    "load_task",
    "made_with_here",
    "plan_or_task",
    "plan_or_task_of",
]

OURS = re.compile(
    rb'\s*\{(?:.*"format":\s*"planner-service/|\s*"version":[\s\d]+,\s*"made_with":\s*\{[^}]*"planner_service")',
    re.DOTALL,
)
"""How plan and task files begin, whichever version."""

PLAN_FORMAT = "planner-service/plan"
TASK_FORMAT = "planner-service/task"
VERSION = 3

MAX_SEGMENTS = 1_000
MAX_STEPS = 1_000
MAX_WAIT = 3_600.0
MAX_DEPTH = 64
"""Of what is nested in a section."""

_LIBRARIES = ("planner-service", "numpy", "python-fcl", "ompl", "pin", "toppra")


@lru_cache(maxsize=1)
def made_with_here() -> Mapping[str, str]:
    """What plans are made with here."""
    versions = {"python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            versions[name.replace("-", "_")] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name.replace("-", "_")] = "unknown"
    return MappingProxyType(versions)


@dataclass(frozen=True, eq=False)
class _Saved(ABC):
    """What a plan and a task in a file have in common: the world they were made in."""

    begin: World

    @property
    def robot(self) -> Robot:
        """The robot it was made for."""
        return self.begin.robot

    @property
    def scene(self) -> Scene:
        """The scene at its start."""
        return self.begin.scene

    @property
    def allowed(self) -> tuple[tuple[str, str], ...]:
        """Pairs that its author allowed to touch."""
        return self.begin.allowed

    def service(self) -> PlannerService:
        """A service like the one it was made with; edges are sampled by ``MotionStep()`` if their rule is not known.

        Raises:
            InvalidRequest: robot, scene and pairs do not go together.
        """
        return PlannerService.of(self.begin)

    @abstractmethod
    def _record(self) -> _Head:
        """What the file holds."""

    def document(self) -> dict[str, Any]:
        """The content of the file, of plain JSON values.

        Raises:
            InvalidRequest: a value in it cannot be written.
        """
        return self._record().document()

    def file_text(self) -> str:
        """What a file of it holds, in ASCII.

        Raises:
            InvalidRequest: a value in it cannot be written, or the file would be too large.
        """
        text = self._record().text()
        if len(text) > MAX_BYTES:
            raise InvalidRequest("plan", f"{len(text):,} bytes", f"one that fits in {MAX_BYTES:,} bytes")
        return text

    def compact(self) -> bytes:
        """The same on one line, as servers answer; the robot comes last, so that it is easily left out.

        Raises:
            InvalidRequest: as ``file_text``.
        """
        data = self._record().compact()
        if len(data) > MAX_BYTES:
            raise InvalidRequest("plan", f"{len(data):,} bytes", f"one that fits in {MAX_BYTES:,} bytes")
        return data

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a file, whole or not at all.

        Raises:
            InvalidRequest: a value in it cannot be written, or the file would be too large.
            InvalidFile: the file cannot be written.
        """
        write_whole(as_path("path", path), self.file_text(), OURS)


@dataclass(frozen=True, eq=False)
class SavedPlan(_Saved):
    """A plan with its request and the world it was made in.

    Attributes:
        begin: The robot, the scene and the terms it was made for.
        request: None if its planner or timing law has no name to be made from.
        made_with: Versions of this package and of the libraries that plans depend on, by name.
        sections: Further parts of the file by name, JSON values; those that are not known are kept as they are.
    """

    request: PlanRequest | None
    result: PlanResult
    made_with: Mapping[str, str] = field(default_factory=made_with_here)
    sections: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<SavedPlan: {self.robot.name} in {self.scene.name or 'unnamed scene'}, {self.result!r}>"

    def __str__(self) -> str:
        return str(self._named_result)

    def _repr_html_(self) -> str:
        return self._named_result._repr_html_()

    @property
    def failure(self) -> Failure | None:
        """None for a plan."""
        return self.result.failure

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Its motion, as the one segment of a task."""
        return (Segment("motion", self.result, self.robot.gripper_width),)

    @property
    def _named_result(self) -> PlanResult:
        """The result with its robot and scene, which its title names."""
        return replace(self.result, origin=Origin(self.begin, self.request))

    @classmethod
    def of(cls, result: PlanResult) -> SavedPlan:
        """A plan that was made in this process.

        Raises:
            InvalidRequest: it comes from a file or another process: its world and request are not known.
        """
        if result.origin is None:
            expected = "SavedPlan(service.world, request, result): it does not know its world and request"
            raise InvalidRequest("plan", "a result from a file or another process", expected)
        return cls(result.origin.world, result.origin.request, result)

    def _record(self) -> _Head:
        return recorded("plan", lambda: PlanRecord.of(self))


@dataclass(frozen=True, eq=False)
class SavedTask(_Saved):
    """The motions of a task in order, with the robot and the scene at its start.

    Attributes:
        begin: The robot and the scene as they are before the first motion.
        task: What was done, in words.
        segments: The motions; those from a file have the scene that each is made in.
        choosing: What looking for grasps and placements cost, beyond the segments.
        seconds: Wall time of all of it.
        failure: None if every motion has a plan.
        request: What all motions were asked to keep: planner, timing, scales, limits; its goal means nothing. None if
            that is not known, or its planner or timing law has no name to be made from.
        made_with: As of ``SavedPlan``.
        sections: As of ``SavedPlan``.
        steps: How each step of the task fared; empty if that is not known.
    """

    task: str
    segments: tuple[Segment, ...]
    choosing: CheckCounts
    seconds: float
    failure: Failure | None = None
    notes: tuple[str, ...] = ()
    request: PlanRequest | None = None
    made_with: Mapping[str, str] = field(default_factory=made_with_here)
    sections: Mapping[str, Any] = field(default_factory=dict)
    steps: tuple[StepReport, ...] = ()

    def __repr__(self) -> str:
        what = f"{len(self.segments)} motions" if self.failure is None else f"no plan, {self.failure.reason.value}"
        return f"<SavedTask: {self.task or self.robot.name}, {what}, {self.counts}>"

    def __str__(self) -> str:
        return render_text(task_blocks(self, length_unit(self.robot)))

    def _repr_html_(self) -> str:
        return render_html(task_blocks(self, length_unit(self.robot)))

    @classmethod
    def of(cls, task: TaskResult) -> SavedTask:
        """A task that was planned in this process."""
        said = task.choosing, task.seconds, task.failure, task.notes, task.request
        return cls(task.begin, task.task, task.segments, *said, steps=task.steps)

    @property
    def counts(self) -> CheckCounts:
        """The collision checks of the whole task."""
        return sum((segment.counts for segment in self.segments), self.choosing)

    def followed_by(self, after: SavedTask) -> SavedTask:
        """This task and the one planned from where it ends, such as a pick and its place, as one.

        It has the request of both if that is one but for where it starts and ends; and no sections: evidence is of one
        file. ``save_plan`` gives it some if the request says so.

        Raises:
            InvalidRequest: One of the two has no plan, or the second begins with another robot, scene or gripper's
                opening than the first ends with, or elsewhere.
        """
        instance("after", after, SavedTask, "a SavedTask")
        for task in (self, after):
            if task.failure is not None or not task.segments:
                raise InvalidRequest("after", task.task or "a task", "tasks all of whose motions have a plan")
        segments = (*self._of_own_law(), *after._of_own_law())
        require_joined(segments)
        world = self.begin
        for segment in self.segments:
            world = segment.world_after(world)
        if world.robot.opened_like(after.robot).hash != after.robot.hash or self.allowed != after.allowed:
            given = f"{after.task or 'a task'}, which is of another robot, or allows other pairs to touch"
            raise InvalidRequest("after", given, f"one of {self.robot.name} with the same allowed pairs")
        width, then = world.robot.gripper_width, after.robot.gripper_width
        if world.robot.gripper is not None and abs(width - then) > SAME_WIDTH:
            given = f"{after.task or 'a task'}, which begins with a gripper {then:.6g} m open"
            raise InvalidRequest("after", given, f"one that begins with {width:.6g} m, as {self.task or 'this'} ends")
        if _contents(world.scene) != _contents(after.scene):
            given = f"{after.task or 'a task'}, which begins in another scene"
            raise InvalidRequest("after", given, f"the scene that {self.task or 'this'} leaves")
        words = "; ".join(filter(None, (self.task, after.task)))
        request = self.request if self.request is not None and _asks_the_same(self.request, after.request) else None
        if request is not None:  # the law of both
            segments = (*self.segments, *after.segments)
        return SavedTask(
            self.begin,
            words,
            segments,
            self.choosing + after.choosing,
            self.seconds + after.seconds,
            notes=(*self._named_notes(), *after._named_notes()),
            request=request,
            steps=(*self.steps, *after.steps),
        )

    def _named_notes(self) -> tuple[str, ...]:
        return tuple(f"{self.task}: {note}" if self.task and ";" not in self.task else note for note in self.notes)

    def _of_own_law(self) -> tuple[Segment, ...]:
        """The motions, each with its timing law beside it."""
        if self.request is None:
            return self.segments
        law = self.request.timing
        return tuple(
            segment if segment.timing is not None else replace(segment, timing=law) for segment in self.segments
        )

    def within(self, begin: World) -> SavedTask:
        """The same motions in another world, in which the task takes, carries and leaves the same things."""
        segments = [
            replace(segment, scene=segment.scene and _carried_over(segment.scene, self.scene, begin.scene))
            for segment in self.segments
        ]
        return replace(self, begin=begin, segments=tuple(segments))

    def show(self, *, port: int = 8080, block: bool | None = None) -> OpenPage:
        """Show the motions one after another on a page in the browser; see ``PlannerService.view``.

        Raises:
            MissingDependency: the extra ``view`` is not installed.
        """
        return show_page(self.begin, self, port=port, block=block)

    def _record(self) -> _Head:
        return recorded("task", lambda: TaskRecord.of(self))


def _contents(scene: Scene) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is in a scene, in any order."""
    return {item.name: item for item in scene.obstacles}, {item.name: item for item in scene.attached}


def _asks_the_same(one: PlanRequest, other: PlanRequest | None) -> bool:
    """Whether two requests differ in nothing but where they start and end."""
    if other is None:
        return False
    records = [RequestRecord.find(each) for each in (one, replace(other, start=one.start, goal=one.goal))]
    return records[0] is not None and records[0] == records[1]


def _carried_over(scene: Scene, first: Scene, other: Scene) -> Scene:
    """What becomes of another scene by what has made a scene of the first one."""
    if other == first:
        return scene
    unchanged = {obstacle.name for obstacle in set(first.obstacles) & set(scene.obstacles)}
    new = [obstacle for obstacle in scene.obstacles if obstacle.name not in unchanged]
    held = scene.attached if scene.attached != first.attached else other.attached
    changed = (*first.obstacles, *new), held
    gone = {item.name for items in changed for item in items} - unchanged
    kept = [obstacle for obstacle in other.obstacles if obstacle.name not in gone]
    return replace(other, obstacles=(*kept, *new), attached=held)


# The files, defined.


class StepRecord(Record):
    """A ``MotionStep`` or ``JointStep``: metres or radians.

    Attributes:
        kind: Whether no point of the robot moves farther than `size` between two samples, or no joint.
        size: Metres of a point (motion), or radians of a joint (joint).
    """

    kind: Literal["motion", "joint"]
    size: float

    @classmethod
    def find(cls, value: EdgeStep | None) -> StepRecord | None:
        """Its record, None of a rule of the caller's own."""
        if type(value) is MotionStep:
            return cls(kind="motion", size=value.distance)
        return cls(kind="joint", size=value.angle) if type(value) is JointStep else None

    @cached_property
    def value(self) -> MotionStep | JointStep:
        return MotionStep(self.size) if self.kind == "motion" else JointStep(self.size)


def _shallow(sections: dict[str, Any]) -> dict[str, Any]:
    layer: list[Any] = [sections]
    for _ in range(MAX_DEPTH):
        layer = [part for whole in layer if isinstance(whole, dict | list) for part in _blocks(whole)]
        if not layer:
            return sections
    raise ValueError(f"at most {MAX_DEPTH} values within each other")


def _blocks(whole: dict[str, Any] | list[Any]) -> list[Any]:
    return list(whole.values()) if isinstance(whole, dict) else whole


class _Head(Record):
    """What plans and tasks have in common.

    Attributes:
        version: The version of the format.
        robot: The robot.
        scene: The scene at the start.
        allowed: Pairs of names that its author allowed to touch.
        edge_step: How far apart edges were sampled by the search; null if that is not known. Proofs do not sample.
        made_with: Versions of this package and of the libraries that plans depend on, by name.
    """

    version: Literal[3]
    made_with: Annotated[dict[Text, Text], at_most(100)]
    robot: RobotRecord
    scene: SceneRecord
    allowed: PairList
    edge_step: StepRecord | None

    @classmethod
    def fields_of(cls, value: SavedPlan | SavedTask) -> dict[str, Any]:
        request = None if value.request is None else RequestRecord.find(value.request)
        step = StepRecord.find(value.begin.edge_step)
        world = {"robot": _robot_record(value.robot), "scene": _scene_record(_Same(value.scene))}
        return super().fields_of(value) | world | {"version": VERSION, "edge_step": step, "request": request}

    def text(self) -> str:
        """What ``json.dumps(document, indent=1)`` writes, and a line end; what many plans have in common is kept."""
        document = self.model_dump(by_alias=True, exclude={"robot", "scene"})
        parts = {name: indented_json(value, 1) for name, value in document.items()}
        parts |= {"robot": self.robot.section, "scene": self.scene.section}
        names = [name for name in type(self).model_fields if name in parts]
        return "{" + ",".join(f'\n "{name}": {parts[name]}' for name in names) + "\n}\n"

    def compact(self) -> bytes:
        """The same on one line, in UTF-8, with scene and robot as its end."""
        rest = self.model_dump_json(by_alias=True, exclude={"robot", "scene"}).encode()
        return b"".join((rest[:-1], b',"scene":', self.scene.line, b',"robot":', self.robot.line, b"}"))

    @property
    def arguments(self) -> dict[str, Any]:
        """Those of a ``SavedPlan`` or a ``SavedTask`` that both have."""
        arguments = super().arguments
        world = World(*(arguments.pop(name) for name in ("robot", "scene", "allowed", "edge_step")))
        del arguments["version"], arguments["format"]
        return arguments | {"begin": world, "made_with": MappingProxyType(self.made_with)}


@dataclass(frozen=True, eq=False)
class _Same:
    """A value that equals itself alone: scenes that are equal may differ in the sign of a zero."""

    value: Any

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


@lru_cache(maxsize=16)
def _robot_record(robot: Robot) -> RobotRecord:
    return RobotRecord.of(robot)


@lru_cache(maxsize=16)
def _scene_record(scene: _Same) -> SceneRecord:
    return SceneRecord.of(scene.value)


Sections = Annotated[dict[str, JsonValue], AfterValidator(_shallow)]


class PlanRecord(_Head):
    """A plan file.

    Attributes:
        format: Tells plan files from others.
        request: What was asked; null if its planner or timing law has no name to be made from.
        result: The plan, or why there is none, and what it cost.
        sections: Further parts of the file by name.
    """

    format: Literal["planner-service/plan"]
    request: RequestRecord | None
    result: ResultRecord
    sections: Sections

    makes = about = SavedPlan

    @classmethod
    def fields_of(cls, value: SavedPlan | SavedTask) -> dict[str, Any]:
        return super().fields_of(value) | {"format": PLAN_FORMAT}


class SegmentRecord(GrownRecord):
    """One motion of a task; ``scene`` is null where the scene is as in the motion before, or at the start.

    Attributes:
        name: The name of the motion.
        gripper_width: Metres between the finger pads during it; null if that is not known.
        scene: What the scene has become; null where it is as in the motion before, or at the start.
        result: The plan of the motion, or why there is none.
        wait: Seconds that the arm stands still before the motion; 0 if it is not there.
    """

    about = Segment

    name: Text
    gripper_width: float | None
    gripper: GripperMotionRecord | None
    timing: TimingRecord | None
    scene: WorldRecord | None
    result: ResultRecord
    wait: Annotated[float, Field(ge=0.0, le=MAX_WAIT)] = 0.0


class ReasonRecord(Record):
    """Why a step failed.

    Attributes:
        reason: In words.
        times: How often.
    """

    reason: Prose
    times: Count


class StepReportRecord(Record):
    """How a step of a task fared.

    Attributes:
        reasons: Why, the most frequent first.
    """

    about = StepReport

    step: Prose
    tried: Count
    failed: Count
    reasons: Annotated[list[ReasonRecord], at_most(MAX_SEGMENTS)]

    @classmethod
    def fields_of(cls, value: StepReport) -> dict[str, Any]:
        reasons = [{"reason": as_text(reason), "times": times} for reason, times in value.reasons]
        return super().fields_of(value) | {"reasons": reasons}

    @cached_property
    def value(self) -> StepReport:
        reasons = tuple((each.reason, each.times) for each in self.reasons)
        return StepReport(self.step, self.tried, self.failed, reasons)


class TaskRecord(_Head, GrownRecord):
    """A task file.

    Attributes:
        format: Tells task files from others.
        task: What was asked, in words.
        request: What all motions were asked to keep; its start and goals have no meaning. null if that is not known.
        ok: Whether every motion has a plan.
        failure: Why a motion has no plan; null if all have one.
        counts: What the whole task took.
        choosing: What looking for grasps and placements took, beyond the motions.
        seconds: Wall time of all of it, in seconds.
        notes: What a person should know beside it.
        segments: The motions in order.
        sections: Further parts of the file by name.
        steps: How each step of the task fared, in their order; not there if that is not known.
    """

    about = SavedTask

    format: Literal["planner-service/task"]
    task: Prose
    request: RequestRecord | None
    ok: bool
    failure: FailureRecord | None
    counts: CountsRecord
    choosing: CountsRecord
    seconds: float
    notes: Annotated[list[Prose], at_most(MAX_SEGMENTS)]
    segments: Annotated[list[SegmentRecord], at_most(MAX_SEGMENTS)]
    sections: Sections
    steps: Annotated[list[StepReportRecord], at_most(MAX_STEPS)] = Field(default_factory=list)

    @classmethod
    def fields_of(cls, value: SavedPlan | SavedTask) -> dict[str, Any]:
        assert isinstance(value, SavedTask)
        own = {"format": TASK_FORMAT, "ok": value.failure is None, "segments": _segment_fields(value)}
        return super().fields_of(value) | own | {"notes": list(value.notes[:MAX_SEGMENTS])}

    @cached_property
    def value(self) -> SavedTask:
        arguments = self.arguments
        del arguments["ok"], arguments["counts"]
        task = SavedTask(**arguments | {"segments": self._segments()})
        if self.ok != (task.failure is None):
            raise InvalidRequest("ok", self.ok, "false with a failure, true without")
        if task.counts != self.counts.value:
            raise InvalidRequest("counts", str(self.counts.value), f"the sum over all motions, {task.counts}")
        return task

    def _segments(self) -> tuple[Segment, ...]:
        first, gripper = self.scene.value, self.robot.value.gripper
        scene, before = first, {obstacle.name: obstacle for obstacle in first.obstacles}
        segments = []
        for k, record in enumerate(self.segments):
            width = record.gripper_width
            if gripper is not None and (width is None or not gripper.lower <= width <= gripper.upper):
                expected = f"metres in [{gripper.lower:g}, {gripper.upper:g}]"
                raise InvalidRequest(f"segments[{k}].gripper_width", width, expected)
            try:
                scene = scene if record.scene is None else record.scene.scene(first, before)
            except InvalidRequest as error:
                where = f"segments[{k}].scene"
                raise InvalidRequest(where, None, error.expected, message=f"{where}: {error}") from None
            grip = None if record.gripper is None else record.gripper.value
            law = None if record.timing is None else record.timing.value
            width = math.nan if width is None else width
            segments.append(Segment(record.name, record.result.value, width, scene, grip, law, record.wait))
        return tuple(segments)


def _segment_fields(task: SavedTask) -> list[dict[str, Any]]:
    first = scene = task.begin.scene
    segments = []
    for segment in task.segments:
        origin, before = segment.result.origin, scene
        scene = (segment.scene or scene) if origin is None else origin.world.scene
        segments.append(
            {
                "name": segment.name,
                "gripper_width": None if math.isnan(segment.width) else segment.width,
                "gripper": segment.gripper,
                "timing": None if segment.timing is None else TimingRecord.find(segment.timing),
                "scene": None if scene == before else WorldRecord.since(first, scene),
                "result": segment.result,
                "wait": segment.wait,
            }
        )
    return segments


# Writing and reading.


def load_plan(path: str | os.PathLike[str]) -> SavedPlan:
    """The plan in a file, its path and trajectory bit for bit as they were saved.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    plan: SavedPlan = _loaded(path, PLAN_FORMAT)
    return plan


def load_task(path: str | os.PathLike[str]) -> SavedTask:
    """The task in a file, its paths and trajectories bit for bit as they were saved.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    task: SavedTask = _loaded(path, TASK_FORMAT)
    return task


def load_plan_or_task(path: str | os.PathLike[str]) -> SavedPlan | SavedTask:
    """Whichever of both is in a file; see ``load_plan`` and ``load_task``.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    saved: SavedPlan | SavedTask = _loaded(path, None)
    return saved


def plan_or_task(name: str, data: bytes) -> SavedPlan | SavedTask:
    """Whichever of both the content of a file is; ``name`` stands in messages.

    Raises:
        InvalidFile: the content cannot be used; it lists all problems found, not the first.
    """
    return plan_or_task_of(Path(name), parse_json(Path(name), data))


def plan_or_task_of(file: Path, document: Any) -> SavedPlan | SavedTask:
    """The same of the document that is in a file.

    Raises:
        InvalidFile: as ``plan_or_task``.
    """
    saved: SavedPlan | SavedTask = _read(file, document, None)
    return saved


def _loaded(path: str | os.PathLike[str], kind: str | None) -> Any:
    file = as_path("path", path)
    return _read(file, read_json(file), kind)


def _read(file: Path, document: Any, kind: str | None) -> Any:
    """What a document of a format is; of whichever it says if None is given."""
    if kind is None:
        task = isinstance(document, dict) and document.get("format") == TASK_FORMAT
        kind = TASK_FORMAT if task else PLAN_FORMAT
    model = TaskRecord if kind == TASK_FORMAT else PlanRecord
    return read_record(model, document, file, _reading(file, document, kind)).value


def _reading(file: Path, document: Any, kind: str) -> PlanReading:
    """What a file's records are read with; InvalidFile at once if it is another file."""
    content = document if isinstance(document, dict) else {}
    if "format" in content and content["format"] != kind:
        raise InvalidFile(file, [f"format: got {content['format']!r:.100}; expected {kind!r}"])
    version = content.get("version")
    if "format" in content and isinstance(version, int) and version in (1, 2):
        lacking = f"version: got {version}; expected {VERSION}: this file does not hold its robot and scene"
        raise InvalidFile(file, [f"{lacking}; plan again: {command_of(content)}"])
    robot = content.get("robot")
    if isinstance(robot, dict) and set(robot) == {"hash"}:
        raise InvalidFile(file, ["robot: its hash alone; a file holds its robot: ask the server without robot=hash"])
    names = robot.get("joint_names") if isinstance(robot, dict) else None
    return PlanReading(joints=len(names) if isinstance(names, list) else None)
