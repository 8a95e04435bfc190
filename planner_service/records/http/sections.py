"""Sections of plan and task files: what a motion holds beside its plan."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import ConfigDict, JsonValue, WithJsonSchema

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.schema import Count, GrownRecord, Record, Rows, Text, Vector2, read_record, recorded
from planner_service.geometry.arrays import read_only
from planner_service.geometry.validation import in_file
from planner_service.memory import Memory
from planner_service.memory.memory_file import MemoryRecord
from planner_service.path.trajectory import Trajectory
from planner_service.records.http.bodies import PaceBody
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.result import ExemptRecord, FailureRecord, PathRecord, TrajectoryRecord
from planner_service.records.scene import PlanReading
from planner_service.records.visits import OrderRecord
from planner_service.replanning.result import Outcome, Replanned

__all__ = ["MEMORY", "LineSections", "PlanSections", "ReplannedRecord", "memory_of", "read_reply", "remembering"]

R = TypeVar("R", bound=Record)

MEMORY = "memory"
"""The section of a served task."""


def read_reply(model: type[R], document: Any, source: str, joints: int | None = None) -> R:
    """The answer that a document is; InvalidFile, naming ``source``, if it is something else."""
    return read_record(model, document, Path(source), PlanReading(joints=joints))


OutcomeName = Annotated[Text, WithJsonSchema({"type": "string", "enum": [outcome.value for outcome in Outcome]})]


class LineSections(GrownRecord):
    """Those of a motion along a line: how fast it was to be, and the share of the line that it covers, if not all.

    Attributes:
        fraction: Part in (0, 1] of the asked line that the motion covers; not there if all of it.
        pace: How fast it was asked to be.
    """

    fraction: float | None = None
    pace: PaceBody | None = None

    @classmethod
    def of_plan(cls, plan: SavedPlan, source: str) -> LineSections:
        """Those of a plan; InvalidFile if they are something else."""
        known = {name: plan.sections[name] for name in cls.model_fields if name in plan.sections}
        return read_reply(cls, known, source)


class StopRecord(Record):
    """A stop that is not proven, with its path.

    Attributes:
        path: The geometry.
        trajectory: The same in time.
    """

    path: PathRecord
    trajectory: TrajectoryRecord

    @classmethod
    def fields_of(cls, value: Trajectory) -> dict[str, Any]:
        return {"path": value.path, "trajectory": value}

    @cached_property
    def value(self) -> Trajectory:
        return self.trajectory.along(self.path.value)


class ReplannedRecord(Record):
    """What a ``Replanned`` holds beside its motion; the section ``replanned`` of a plan file.

    Attributes:
        splice: Seconds on the old motion's clock at which the new one begins.
        ahead: Old waypoints beyond the end of a stop, in radians (metres for joints that slide): the next call tries
            them first.
        outcome: How it ended; there is a proven motion unless it is UNSAFE.
    """

    about = Replanned

    outcome: OutcomeName
    splice: float
    ahead: Rows
    failure: FailureRecord | None
    stop: StopRecord | None

    @cached_property
    def value(self) -> Outcome:
        names = [outcome.value for outcome in Outcome]
        if self.outcome not in names:
            raise InvalidRequest("outcome", self.outcome, f"one of {', '.join(names)}")
        return Outcome(self.outcome)

    @classmethod
    def of_plan(cls, plan: SavedPlan, source: str) -> Replanned:
        """What replanning has made, of the plan that its motion is.

        Raises:
            InvalidFile: The plan is another one.
        """
        n = plan.robot.n
        record = read_reply(cls, plan.sections.get("replanned"), source, n)
        outcome, arguments = record.value, record.arguments
        if plan.request is None or (outcome is Outcome.UNSAFE) == plan.result.ok:
            raise InvalidFile(source, ["replanned: expected a request, and a motion unless nothing is safe"])
        ahead = read_only(np.array(record.ahead, dtype=np.float64).reshape(-1, n))
        return Replanned(
            **arguments | {"outcome": outcome, "ahead": ahead, "result": plan.result, "request": plan.request}
        )


class TrailRecord(GrownRecord):
    """What one proof rests on.

    Attributes:
        motion: Index of the motion, from 0.
        gripper: Metres between the finger pads before and after; the same but for a motion of the gripper alone.
        moved: How far the fingers are moved at these widths, in metres (radians of fingers that turn).
        clearance: Metres that every judged pair keeps; null if none is judged.
        padding: Metres by which every judged pair was proven apart.
        exempt: Stretches on which pairs were not judged.
        part: Path lengths s from which to which the curve was judged, in radians; null for all of it.
        s: Path lengths at which stretches begin and end, in radians: 64-bit floats, packed. What is packed is
            little-endian, compressed by zlib, in base64.
        pairs: For each judged pair the number of a piece, the first of those that it is judged with, and how many
            follow each other: rows of three 32-bit integers, packed.
        crowd: Numbers of the pieces of obstacles that come last in that order, as they come: 32-bit integers, packed.
        rows: For each stretch its pair, its ends in `s`, and directions that separate the two there: rows of nine
            32-bit integers, packed.
    """

    motion: Count
    gripper: Vector2
    moved: Vector2
    clearance: float | None
    padding: float
    exempt: list[ExemptRecord]
    part: Vector2 | None
    s: str
    pairs: str
    rows: str
    crowd: str | None = None


class EvidenceRecord(Record):
    """The trails of all proofs, which others can check without this package.

    Attributes:
        version: The version of its format.
        robot: SHA-256 of the robot in the file.
        scene: SHA-256 of the scene in the file.
        boxes: By the name of each cloud and height field the boxes that make it up, in metres in its own axes, lower
            and upper corners: rows of six 64-bit floats, packed.
        proofs: One for each motion, before it that of the gripper if that moves.
    """

    version: Count
    robot: str
    scene: str
    boxes: dict[str, str]
    proofs: list[TrailRecord]


class PlanSections(GrownRecord):
    """Further parts of a plan or task file, as far as this package writes them; other programs may add their own.

    Attributes:
        fraction: Of a motion along a line, the part in (0, 1] of it that the motion covers; not there if all of it.
        pace: Of a motion along a line, how fast it was asked to be.
        replanned: Of a new motion of a moving robot, how it continues the old one.
        evidence: The trails of the proofs, if the request asked for them.
        order: Of visits that were put in order, what that came to.
        memory: Of a task that a server answers, what was remembered before it, with its motions: for the next request,
            as it is.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    fraction: float | None = None
    pace: PaceBody | None = None
    replanned: ReplannedRecord | None = None
    evidence: EvidenceRecord | None = None
    order: OrderRecord | None = None
    memory: MemoryRecord | None = None


def remembering(saved: SavedTask, memory: Memory) -> SavedTask:
    """A task with what is remembered after it, as a section."""
    return replace(
        saved, sections={**saved.sections, MEMORY: recorded(MEMORY, lambda: MemoryRecord.of(memory)).document()}
    )


def memory_of(saved: SavedTask, source: str) -> Memory | None:
    """What is remembered after a task, as its section says; None if it has none.

    Raises:
        InvalidFile: It is no memory, or that of another robot.
    """
    if MEMORY not in saved.sections:
        return None
    memory: Memory = read_reply(MemoryRecord, saved.sections[MEMORY], source).value
    return in_file(Path(source), lambda: memory.require_joints(saved.robot.joint_names))
