"""Constraint files, and constraints in scene files: what each key of their tables is.

::

    [[constraint]]
    kind = "tool region"
    name = "above the board"              # optional, as is everything below
    frame = { position = [0.3, 0.0, 0.2], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }
    lower = [-inf, -inf, 0.05]            # metres in the frame; inf for no bound
    upper = [inf, inf, 0.15]
    tilt = 0.1                            # radians, as is turn
    tool = { position = [0.05, 0.0, 0.0] }
    link = "link_6"                       # the tool frame if not given
    relative_to = "link_2"                # the base if not given

    [[constraint]]
    kind = "joint range"
    joint = "joint_4"
    lower = -1.0
    upper = 1.0
"""

from __future__ import annotations

import os
from dataclasses import fields
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field

from planner_service.constraints.values import MAX_CONSTRAINTS, Constraint, JointRange, ToolRegion
from planner_service.files.reading import as_path
from planner_service.files.schema import Reading, Record, Text, Vector3, Vector4, at_most, of_length, read_record
from planner_service.files.toml_reader import read_tables
from planner_service.geometry.shapes import Pose

__all__ = ["Table", "keys_of", "read_constraints"]

MAX_BYTES = 100_000
"""A table takes some three hundred bytes."""

Bounds = Annotated[
    list[Annotated[float, Field(allow_inf_nan=True)]], of_length(3, "3 numbers [x, y, z], inf for no bound")
]


def read_constraints(path: str | os.PathLike[str]) -> tuple[Constraint, ...]:
    """The constraints in a TOML file, as the module describes it, for ``PlanRequest.constraints``.

    Raises:
        InvalidFile: The file cannot be used; it lists all problems found, not the first.
    """
    file = as_path("path", path)
    constraints: tuple[Constraint, ...] = read_record(
        ConstraintFile, read_tables(file, MAX_BYTES), file, Reading()
    ).value
    return constraints


class PoseTable(Record):
    """``{ position = [x, y, z], quaternion_wxyz = [w, x, y, z] }``."""

    makes = Pose

    position: Vector3 = Field([0.0, 0.0, 0.0])
    quaternion: Vector4 = Field([1.0, 0.0, 0.0, 0.0], alias="quaternion_wxyz")


class ConstraintTable(Record):
    """``[[constraint]]``."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Those keys that the file gives, beside the kind."""
        given = super().arguments
        return {name: given[name] for name in self.model_fields_set if name != "kind"}


class RegionTable(ConstraintTable):
    """A ``ToolRegion``."""

    makes = ToolRegion

    kind: Literal["tool region"]
    name: Text = ""
    frame: PoseTable | None = None
    lower: Bounds | None = None
    upper: Bounds | None = None
    tilt: float | None = None
    turn: float | None = None
    tool: PoseTable | None = None
    link: Text | None = None
    relative_to: Text | None = None


class JointRangeTable(ConstraintTable):
    """A ``JointRange``."""

    makes = JointRange

    kind: Literal["joint range"]
    joint: Text
    lower: float
    upper: float


Table = Annotated[RegionTable | JointRangeTable, Discriminator("kind")]
"""A constraint."""


def keys_of(constraint: Constraint) -> dict[str, Any]:
    """The keys of a constraint's table; those with the value that they have if not given are left out."""
    kind = "joint range" if isinstance(constraint, JointRange) else "tool region"
    given = {item.name: (getattr(constraint, item.name), item.default) for item in fields(constraint)}
    return {"kind": kind, **{name: _toml_of(value) for name, (value, usual) in given.items() if value != usual}}


def _toml_of(value: Any) -> Any:
    if isinstance(value, Pose):
        return {"position": list(value.position), "quaternion_wxyz": list(value.quaternion)}
    return list(value) if isinstance(value, tuple) else value


class ConstraintFile(Record):
    """A constraint file."""

    constraint: Annotated[
        list[Table],
        Field(min_length=1, description="tables, each headed [[constraint]]"),
        at_most(MAX_CONSTRAINTS),
    ]

    @cached_property
    def value(self) -> tuple[Constraint, ...]:
        return tuple(table.value for table in self.constraint)
