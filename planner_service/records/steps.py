"""Tasks in files: their steps as JSON objects.

::

    {
      "format": "planner-service/steps",
      "version": 1,
      "name": "a block onto the tray",
      "steps": [
        {"kind": "Connect", "name": "to pregrasp"},
        {"kind": "Approach"},
        {"kind": "Grasp", "object": "blue_block", "support": "table"},
        {"kind": "Retreat", "name": "lift"},
        {"kind": "MoveTo", "goal": [{"joints": "home"}]}
      ]
    }

Only what is not as usual need be said; keys are the fields of the steps, units are metres and radians.
"""

from __future__ import annotations

import os
import re
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import read_json
from planner_service.files.json_writer import indented_json
from planner_service.files.reading import as_path
from planner_service.files.schema import (
    Count,
    FirstOnly,
    GrownRecord,
    Joints,
    Numbers,
    Reading,
    Record,
    Rows,
    Text,
    Vector3,
    at_most,
    plain,
    read_record,
    recorded,
)
from planner_service.files.writing import write_whole
from planner_service.grasping.covering import MOST
from planner_service.grasping.held import FRICTION
from planner_service.grasping.kinds import GraspKind, GraspKinds
from planner_service.records.request import MAX_GOALS, ONE_OF_BOTH, JointGoal, RoomRecord, ToolGoal
from planner_service.records.values import Constraints, KindRecord, PoseRecord, Target
from planner_service.tasks import steps as values
from planner_service.tasks.steps import MAX_BRANCHES, MAX_POSES, MAX_STEPS, GraspSource, Step
from planner_service.tasks.task import Task

__all__ = ["STEPS_FORMAT", "Grasps", "StepsRecord", "load_steps", "save_steps", "steps_of"]

STEPS_FORMAT = "planner-service/steps"
OURS = re.compile(rb'\s*\{\s*"format":\s*"planner-service/steps"')
"""How such files begin."""

MAX_DEPTH = 32
"""Lists and objects within each other, in a list of steps."""


def _shallow(steps: Any) -> Any:
    if not isinstance(steps, list):
        return steps  # refused as what it is
    layer: list[Any] = [steps]
    for _ in range(MAX_DEPTH):
        layer = [part for whole in layer for part in (whole.values() if isinstance(whole, dict) else whole)]
        layer = [part for part in layer if isinstance(part, dict | list)]
        if not layer:
            return steps
    raise ValueError(f"at most {MAX_DEPTH} lists and objects within each other")


class TaskStep(KindRecord, GrownRecord):
    """A step; what has its usual value need not be there."""

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        return super().fields_of(value) | {"kind": value.kind}


class PlaceGoal(ToolGoal):
    """A pose of the tool, with room or without."""

    room: RoomRecord | None = None


class NamedGoal(JointGoal):
    """A configuration.

    Attributes:
        joints: Joint values in radians (metres for joints that slide), or the name of a pose of the robot such as
            home.
    """

    joints: Joints | Text  # type: ignore[assignment]

    @cached_property
    def value(self) -> Any:
        return self.joints if isinstance(self.joints, str) else tuple(self.joints)


StepGoal = Annotated[Annotated[NamedGoal, Tag("joints")] | Annotated[PlaceGoal, Tag("tool")], ONE_OF_BOTH]
Goals = Annotated[list[StepGoal], Field(min_length=1), at_most(MAX_GOALS)]
Targets = Annotated[list[Target], Field(min_length=1), at_most(MAX_STEPS)]
Poses = Annotated[list[PoseRecord], FirstOnly(), at_most(MAX_POSES)]
Lengths = Annotated[Numbers, at_most(MAX_BRANCHES)]


Kinds = Annotated[list[Literal["top", "side", "antipodal", "suction"]], FirstOnly(), at_most(len(GraspKind))]


class GraspKindsRecord(GrownRecord):
    """A ``GraspKinds``; what has its usual value need not be there.

    Attributes:
        kinds: In the order of preference: "top", "side", "antipodal", "suction".
        friction: Coefficient of friction between fingers and object, for antipodal grasps.
    """

    makes = about = GraspKinds

    kinds: Kinds = Field(default_factory=lambda: [kind.value for kind in GraspKind])
    friction: float = FRICTION
    seed: Count = 0
    most: Count = MOST

    @property
    def arguments(self) -> dict[str, Any]:
        return super().arguments | {"kinds": tuple(map(GraspKind, self.kinds))}


def _grasps_kind(value: Any) -> str:
    return "by kind" if isinstance(value, dict | GraspKinds | GraspKindsRecord) else "poses"


Grasps = Annotated[
    Annotated[Poses, Tag("poses")] | Annotated[GraspKindsRecord, Tag("by kind")], Discriminator(_grasps_kind)
]
"""Poses of the tool, or the kinds of grasps that are looked for."""


class MoveToRecord(TaskStep):
    """A ``MoveTo``.

    Attributes:
        kind: Tells kinds of steps apart.
        goal: Where to, any of them; null: where the task began.
    """

    makes = about = values.MoveTo

    kind: Literal["MoveTo"]
    goal: Goals | None = None
    frame: Text = ""
    constraints: Constraints = Field(default_factory=list)
    name: Text = "move"

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        goals = None if value.goal is None else [_goal(each) for each in value.goal]
        return super().fields_of(value) | {"goal": goals}


def _goal(goal: Any) -> Any:
    return (
        PlaceGoal.of(goal) if not isinstance(goal, str | tuple) else NamedGoal.model_validate({"joints": plain(goal)})
    )


class MoveLinearRecord(TaskStep):
    """A ``MoveLinear``.

    Attributes:
        kind: Tells kinds of steps apart.
        goal: Poses of the tool, or its displacements x, y, z in metres along the axes of the frame, to be passed in
            this order.
        frame: The obstacle in whose frame poses are given, and along whose axes displacements are; empty for the base.
        free_axis: Axis x, y, z in the tool frame about which the tool may turn as it likes; null for none.
        constraints: What holds during this motion, beside the constraints of the request and of what is carried.
    """

    makes = about = values.MoveLinear

    kind: Literal["MoveLinear"]
    goal: Targets
    frame: Text = ""
    zone: float = 0.0
    free_axis: Vector3 | None = None
    constraints: Constraints = Field(default_factory=list)
    name: Text = "line"


class MoveCircularRecord(TaskStep):
    """A ``MoveCircular``.

    Attributes:
        kind: Tells kinds of steps apart.
        frame: The obstacle in whose frame poses are given, and along whose axes displacements are; empty for the base.
        free_axis: Axis x, y, z in the tool frame about which the tool may turn as it likes; null for none.
        constraints: What holds during this motion, beside the constraints of the request and of what is carried.
    """

    makes = about = values.MoveCircular

    kind: Literal["MoveCircular"]
    via: Target
    goal: Target
    frame: Text = ""
    free_axis: Vector3 | None = None
    constraints: Constraints = Field(default_factory=list)
    name: Text = "arc"


class FollowRecord(TaskStep):
    """A ``Follow``.

    Attributes:
        kind: Tells kinds of steps apart.
        waypoints: Rows of joint values. It begins where the robot stands, or after a `Connect`, which goes there.
        constraints: What holds during this motion, beside the constraints of the request and of what is carried.
    """

    makes = about = values.Follow

    kind: Literal["Follow"]
    waypoints: Rows
    blend: float = 0.0
    constraints: Constraints = Field(default_factory=list)
    name: Text = "follow"


class ConnectRecord(TaskStep):
    """A ``Connect``.

    Attributes:
        kind: Tells kinds of steps apart.
        constraints: What holds during this motion, beside the constraints of the request and of what is carried.
    """

    makes = about = values.Connect

    kind: Literal["Connect"]
    name: Text = "transfer"
    constraints: Constraints = Field(default_factory=list)


class ApproachRecord(TaskStep):
    """An ``Approach``.

    Attributes:
        kind: Tells kinds of steps apart.
        lengths: Metres, at most 0.1, best first; the usual ones if not given.
        shorter: Metres that are tried only if nothing has a plan with those; null for the usual ones with the usual
            lengths, and for none with others.
    """

    makes = about = values.Approach

    kind: Literal["Approach"]
    name: Text = "approach"
    lengths: Lengths = list(values.USUAL_LENGTHS)  # noqa: RUF012 - pydantic copies it
    shorter: Lengths | None = None
    direction: Vector3 | None = None

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        usual = values.Approach(lengths=value.lengths).shorter
        return super().fields_of(value) | {"shorter": None if value.shorter == usual else plain(value.shorter)}

    @property
    def arguments(self) -> dict[str, Any]:
        given = super().arguments
        if given["shorter"] is None:
            del given["shorter"]
        return given


class RetreatRecord(TaskStep):
    """A ``Retreat``.

    Attributes:
        kind: Tells kinds of steps apart.
        lengths: Metres, at most 0.1, best first; null: back along the approach.
    """

    makes = about = values.Retreat

    kind: Literal["Retreat"]
    name: Text = "retreat"
    lengths: Lengths | None = None
    direction: Vector3 | None = None


class GraspRecord(TaskStep):
    """A ``Grasp``.

    Attributes:
        kind: Tells kinds of steps apart.
        grasps: Poses of the tool, best first; or which kinds of grasps are looked for, in the order of preference; null
            for those from above first, and of the other kinds where none of these has a plan.
    """

    makes = about = values.Grasp

    kind: Literal["Grasp"]
    object: Text
    grasps: Grasps | None = None
    frame: Text = ""
    open_width: float | None = None
    support: Text | None = None
    support_gap: float = 0.005
    upright: float | None = None

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        if isinstance(value.grasps, GraspSource) and type(value.grasps) is not GraspKinds:
            expected = "a list of Pose, GraspKinds, or None: a source of your own cannot be written to a file"
            raise InvalidRequest("grasps", value.grasps, expected)
        return super().fields_of(value)


class ReleaseRecord(TaskStep):
    """A ``Release``.

    Attributes:
        kind: Tells kinds of steps apart.
        poses: Where the object may be set down, best first; null, where there is no approach, for where it is.
    """

    makes = about = values.Release

    kind: Literal["Release"]
    object: Text
    poses: Poses | None = None
    frame: Text = ""
    open_width: float | None = None
    support: Text | None = None
    support_gap: float = 0.005


class WaitRecord(TaskStep):
    """A ``Wait``.

    Attributes:
        kind: Tells kinds of steps apart.
    """

    makes = about = values.Wait

    kind: Literal["Wait"]
    seconds: float


class AlternativesRecord(TaskStep):
    """An ``Alternatives``.

    Attributes:
        kind: Tells kinds of steps apart.
        branches: Lists of steps: the first is taken with which the rest of the task has a plan.
    """

    makes = about = values.Alternatives

    kind: Literal["Alternatives"]
    branches: Annotated[list[Annotated[list[AnyStep], at_most(MAX_STEPS)]], Field(min_length=1), at_most(MAX_BRANCHES)]


class RepeatRecord(TaskStep):
    """A ``Repeat``.

    Attributes:
        kind: Tells kinds of steps apart.
        steps: What is repeated.
    """

    makes = about = values.Repeat

    kind: Literal["Repeat"]
    steps: Annotated[list[AnyStep], at_most(MAX_STEPS)]
    times: Count


RECORDS: dict[str, type[TaskStep]] = {
    "MoveTo": MoveToRecord,
    "MoveLinear": MoveLinearRecord,
    "MoveCircular": MoveCircularRecord,
    "Follow": FollowRecord,
    "Connect": ConnectRecord,
    "Approach": ApproachRecord,
    "Retreat": RetreatRecord,
    "Grasp": GraspRecord,
    "Release": ReleaseRecord,
    "Wait": WaitRecord,
    "Alternatives": AlternativesRecord,
    "Repeat": RepeatRecord,
}


def _recorded(step: Any) -> Any:
    """For a step: its record."""
    return RECORDS[step.kind].of(step) if isinstance(step, Step) else step


AnyStep = Annotated[
    MoveToRecord
    | MoveLinearRecord
    | MoveCircularRecord
    | FollowRecord
    | ConnectRecord
    | ApproachRecord
    | RetreatRecord
    | GraspRecord
    | ReleaseRecord
    | WaitRecord
    | AlternativesRecord
    | RepeatRecord,
    Discriminator("kind"),
    BeforeValidator(_recorded),
]

Steps = Annotated[list[AnyStep], Field(min_length=1), at_most(MAX_STEPS), BeforeValidator(_shallow)]
"""The steps of a task."""

AlternativesRecord.model_rebuild()
RepeatRecord.model_rebuild()


class StepsRecord(Record):
    """A file of steps.

    Attributes:
        format: Tells files of steps from others.
        version: The version of the format.
    """

    makes = about = Task

    format: Literal["planner-service/steps"]
    version: Literal[1]
    name: Text = ""
    steps: Steps

    @classmethod
    def fields_of(cls, value: Task) -> dict[str, Any]:
        return super().fields_of(value) | {"format": STEPS_FORMAT, "version": 1}

    @property
    def arguments(self) -> dict[str, Any]:
        return {"name": self.name, "steps": steps_of(self.steps)}


def steps_of(records: list[Any]) -> tuple[Step, ...]:
    """The steps of records."""
    return tuple(record.value for record in records)


def save_steps(task: Task, path: str | os.PathLike[str]) -> None:
    """``Task.save``."""
    file = as_path("path", path)
    document = recorded("", lambda: StepsRecord.of(task)).document()
    write_whole(file, indented_json(document) + "\n", OURS)


def load_steps(path: str | os.PathLike[str]) -> Task:
    """``Task.load``."""
    file = as_path("path", path)
    document = read_json(file)
    if isinstance(document, dict) and document.get("format", STEPS_FORMAT) != STEPS_FORMAT:
        raise InvalidFile(file, [f"format: got {document['format']!r:.100}; expected {STEPS_FORMAT!r}"])
    task: Task = read_record(StepsRecord, document, Path(file), Reading()).value
    return task
