"""Files of visits that are to be put in order.

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

import os
import re
from collections.abc import Sequence
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
    GrownRecord,
    Joints,
    Reading,
    Record,
    Text,
    at_most,
    read_record,
    recorded,
)
from planner_service.files.writing import write_whole
from planner_service.geometry.shapes import Pose
from planner_service.records.values import PoseRecord
from planner_service.tasks.ordering import Branch, Visit
from planner_service.tasks.ordering.visits import MAX_BRANCHES, chain_of, require_visits

__all__ = ["MAX_VISITS", "VISITS_FORMAT", "Visits", "load_visits", "save_visits"]

VISITS_FORMAT = "planner-service/visits"
OURS = re.compile(rb'\s*\{\s*"format":\s*"planner-service/visits"')
"""How such files begin."""

MAX_VISITS = 500
"""Of a file, with those that follow others: a task file holds the motions of all of them."""


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
