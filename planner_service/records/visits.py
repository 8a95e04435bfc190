"""Visits that are to be put in order, in files, and what their order came to, as a section of a task file.

::

    {
      "format": "planner-service/visits",
      "version": 1,
      "visits": [
        {"name": "left", "branches": [{"joints": [0.4, 0.9, 1.1, -1.2, 0.0, 0.0]}]},
        {"name": "right", "branches": [{"pose": {"position": [0.3, -0.2, 0.15], "quaternion_wxyz": [1, 0, 0, 0]}}]},
        {"name": "out", "branches": [...], "then": [{"name": "back", "branches": [...]}], "after": ["left"]}
      ]
    }

Units are metres and radians.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import read_json
from planner_service.files.json_writer import indented_json
from planner_service.files.reading import as_path
from planner_service.files.schema import (
    Count,
    GrownRecord,
    Joints,
    Prose,
    Reading,
    Record,
    Text,
    as_text,
    at_most,
    read_record,
    recorded,
)
from planner_service.files.writing import write_whole
from planner_service.geometry.shapes import Pose
from planner_service.ordering import Branch, OrderResult, Visit
from planner_service.ordering.visits import MAX_BRANCHES, chain_of, require_visits
from planner_service.records.plan_file import SavedTask
from planner_service.records.values import PoseRecord

__all__ = ["ORDER", "VISITS_FORMAT", "OrderRecord", "Visits", "load_visits", "save_visits", "saved_order"]

VISITS_FORMAT = "planner-service/visits"
OURS = re.compile(rb'\s*\{\s*"format":\s*"planner-service/visits"')
"""How such files begin."""

ORDER = "order"
"""The section of a task file."""

MAX_VISITS = 500
"""Of a file, with those that follow others: a task file holds the motions of all of them."""

MAX_TOLD = 1_000
"""Legs without a plan, and branches that are not used, that a file names."""


class JointBranchRecord(Record):
    """A configuration at which a visit is made.

    Attributes:
        joints: Joint values in radians (metres for joints that slide).
    """

    joints: Joints

    @classmethod
    def fields_of(cls, value: Branch) -> dict[str, Any]:
        elsewhere = value.before is not None or value.after is not None or not np.array_equal(value.q, value.end)
        if value.motions or elsewhere:
            raise InvalidRequest("branches", value, "joint values and poses: motions and loads have no place in a file")
        return {"joints": value.q.tolist()}

    @cached_property
    def value(self) -> Branch:
        return Branch(np.array(self.joints, dtype=np.float64))


class ToolBranchRecord(Record):
    """A pose of the tool at which a visit is made, with any of the configurations that bring it there.

    Attributes:
        pose: Pose of the tool frame in the robot's base frame.
    """

    pose: PoseRecord

    @classmethod
    def fields_of(cls, value: Pose) -> dict[str, Any]:
        return {"pose": value}

    @cached_property
    def value(self) -> Pose:
        pose: Pose = self.pose.value
        return pose


def _branch_kind(branch: Any) -> str | None:
    """Which of both kinds a branch is, or the object of one; None if neither or both."""
    if isinstance(branch, dict):
        kinds = [key for key in ("joints", "pose") if key in branch]
        return kinds[0] if len(kinds) == 1 else None
    if isinstance(branch, Branch | JointBranchRecord):
        return "joints"
    return "pose" if isinstance(branch, Pose | ToolBranchRecord) else None


BranchRecord = Annotated[
    Annotated[JointBranchRecord, Tag("joints")] | Annotated[ToolBranchRecord, Tag("pose")],
    Discriminator(
        _branch_kind,
        custom_error_type="branch",
        custom_error_message="an object with joints, a list of their values, or with pose, one of the tool",
    ),
]


class NextVisitRecord(GrownRecord):
    """A visit that must follow another at once.

    Attributes:
        name: For messages and results.
        branches: Ways to make it.
    """

    name: Text
    branches: Annotated[list[BranchRecord], Field(min_length=1), at_most(MAX_BRANCHES)]

    @classmethod
    def fields_of(cls, value: Visit) -> dict[str, Any]:
        return {"name": value.name, "branches": list(value.ways)}

    @property
    def ways(self) -> list[Branch | Pose]:
        """The branches as values."""
        return [branch.value for branch in self.branches]

    @cached_property
    def value(self) -> Visit:
        return Visit(self.name, self.ways)


class VisitRecord(NextVisitRecord):
    """A visit.

    Attributes:
        name: For messages and results.
        branches: Ways to make it.
        then: Visits that must follow at once, in this order.
        after: Names of visits that must come before.
    """

    then: Annotated[list[NextVisitRecord], at_most(MAX_VISITS)] = Field(default_factory=list)
    after: Annotated[list[Text], at_most(MAX_VISITS)] = Field(default_factory=list)

    @classmethod
    def fields_of(cls, value: Visit) -> dict[str, Any]:
        return super().fields_of(value) | {"then": list(chain_of(value)[1:]), "after": list(value.after)}

    @cached_property
    def value(self) -> Visit:
        then: Visit | None = None
        for each in reversed(self.then):
            then = Visit(each.name, each.ways, then)
        return Visit(self.name, self.ways, then, tuple(self.after))


def _possible(visits: list[VisitRecord]) -> list[VisitRecord]:
    """Refuse visits that are too many, are named twice, or wait for each other."""
    count = len(visits) + sum(len(visit.then) for visit in visits)
    if count > MAX_VISITS:
        raise ValueError(f"at most {MAX_VISITS} visits, with those that follow others; there are {count:,}")
    require_visits([visit.value for visit in visits])
    return visits


Visits = Annotated[list[VisitRecord], Field(min_length=1), at_most(MAX_VISITS), AfterValidator(_possible)]
"""Those that are to be put in order."""


class VisitsRecord(Record):
    """A file of visits.

    Attributes:
        format: Tells files of visits from others.
        version: The version of the format.
        visits: In any order.
    """

    format: Literal["planner-service/visits"]
    version: Literal[1]
    visits: Visits

    @cached_property
    def value(self) -> tuple[Visit, ...]:
        return tuple(visit.value for visit in self.visits)


def save_visits(visits: Sequence[Visit], path: str | os.PathLike[str]) -> None:
    """Write visits to a file, whole or not at all.

    Raises:
        InvalidRequest: A value is of the wrong kind or has no place in a file, or the visits cannot be put in order.
        UnknownName: One must come after a visit that is not there.
        InvalidFile: The file cannot be written.
    """
    file = as_path("path", path)
    require_visits(visits)
    content = {"format": VISITS_FORMAT, "version": 1, "visits": list(visits)}
    document = recorded("", lambda: VisitsRecord.model_validate(content)).document()
    write_whole(file, indented_json(document) + "\n", OURS)


def load_visits(path: str | os.PathLike[str]) -> tuple[Visit, ...]:
    """The visits in a file.

    Raises:
        InvalidFile: It is no such file; all that is wrong in it is listed.
    """
    file = as_path("path", path)
    document = read_json(file)
    if isinstance(document, dict) and document.get("format", VISITS_FORMAT) != VISITS_FORMAT:
        raise InvalidFile(file, [f"format: got {document['format']!r:.100}; expected {VISITS_FORMAT!r}"])
    visits: tuple[Visit, ...] = read_record(VisitsRecord, document, Path(file), Reading()).value
    return visits


class MadeVisitRecord(Record):
    """A visit as it is made.

    Attributes:
        visit: Its name.
        branch: Which of its branches; poses stand for several, in the order in which inverse kinematics finds them.
        motion: The number of the motion to it, from 0.
    """

    visit: Text
    branch: Count
    motion: Count


class OrderRecord(Record):
    """What an ordering came to; the section ``order`` of a task file. All of it is what the planner said.

    Attributes:
        stops: The visits, in order.
        duration: Seconds of all motions; null without an order.
        bound: No order of these branches takes less with the plans of this request, in seconds; null without an order.
        floor: No order takes less, whatever plans its motions, in seconds; null without an order.
        gap: Share of the bound by which the order may be longer than the best; null if that is not known.
        plans: Legs that were planned.
        failed: Those of them without a plan, and why; the first 1,000.
        refused: Branches that were not used, and why; the first 1,000.
    """

    about = OrderResult

    stops: Annotated[list[MadeVisitRecord], at_most(MAX_VISITS)]
    duration: float | None
    bound: float | None
    floor: float | None
    gap: float | None
    plans: Count
    failed: Annotated[list[Prose], at_most(MAX_TOLD)]
    refused: Annotated[list[Prose], at_most(MAX_TOLD)]

    @classmethod
    def fields_of(cls, value: OrderResult) -> dict[str, Any]:
        first = {segment.name: k for k, segment in reversed(list(enumerate(value.task.segments)))}
        numbers = {name: getattr(value, name) for name in ("duration", "bound", "floor", "gap")}
        return {
            "stops": [
                {"visit": stop.name, "branch": stop.branch, "motion": first[f"to {stop.name}"]} for stop in value.stops
            ],
            **{name: number if value.ok and math.isfinite(number) else None for name, number in numbers.items()},
            "plans": value.plans,
            "failed": [as_text(str(leg)) for leg in value.failed[:MAX_TOLD]],
            "refused": [as_text(each) for each in value.refused[:MAX_TOLD]],
        }


def saved_order(found: OrderResult) -> SavedTask:
    """The task of an order as its file holds it, with the order as a section."""
    task = SavedTask.of(found.task)
    return replace(task, sections={ORDER: recorded(ORDER, lambda: OrderRecord.of(found)).document()})
