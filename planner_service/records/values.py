"""Poses and constraints as JSON objects, and records that say by their kind what they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationInfo

from planner_service.constraints.values import MAX_CONSTRAINTS, JointRange, ToolRegion
from planner_service.files.schema import Reading, Record, Text, Vector3, Vector4, at_most, of_length
from planner_service.geometry.shapes import Pose

__all__ = ["Constraints", "KindRecord", "PoseRecord", "Target"]

Bounds = Annotated[list[float | None], of_length(3, "3 numbers, null for no bound")]


class PoseRecord(Record, makes=Pose):
    """A ``Pose``.

    Attributes:
        position: x, y, z in metres.
        quaternion: Orientation as a unit quaternion w, x, y, z.
    """

    quaternion: Vector4 = Field(alias="quaternion_wxyz")


def _target_kind(value: Any) -> str:
    return "displacement" if isinstance(value, list | tuple) else "pose"


Target = Annotated[
    Annotated[PoseRecord, Tag("pose")] | Annotated[Vector3, Tag("displacement")], Discriminator(_target_kind)
]
"""A pose of the tool, or its displacement."""


class KindRecord(Record):
    """One of several kinds of value; ``kind`` says which."""

    @property
    def arguments(self) -> dict[str, Any]:
        return {name: value for name, value in super().arguments.items() if name != "kind"}


class RegionRecord(KindRecord):
    """A ``ToolRegion``; a coordinate without a bound is null.

    Attributes:
        kind: Tells kinds of constraints apart.
        lower: Least coordinates x, y, z of the constrained frame's origin in `frame`, in metres; null for no bound.
        upper: Largest coordinates, likewise.
    """

    about = ToolRegion

    kind: Literal["tool region"] = "tool region"
    name: Text
    frame: PoseRecord
    lower: Bounds
    upper: Bounds
    tilt: float | None
    turn: float | None
    tool: PoseRecord
    link: Text | None
    relative_to: Text | None

    @classmethod
    def fields_of(cls, value: ToolRegion) -> dict[str, Any]:
        bounds = {"lower": _finite_or_null(value.lower), "upper": _finite_or_null(value.upper)}
        return super().fields_of(value) | bounds

    @cached_property
    def value(self) -> ToolRegion:
        lower, upper = _or_infinity(self.lower, -math.inf), _or_infinity(self.upper, math.inf)
        return ToolRegion(**self.arguments | {"lower": lower, "upper": upper})


def _finite_or_null(bounds: Sequence[float]) -> list[float | None]:
    return [bound if math.isfinite(bound) else None for bound in bounds]


def _or_infinity(bounds: Sequence[float | None], infinity: float) -> tuple[float, ...]:
    return tuple(infinity if bound is None else bound for bound in bounds)


class JointRangeRecord(KindRecord, makes=JointRange):
    """A ``JointRange``.

    Attributes:
        kind: Tells kinds of constraints apart.
        upper: The same; above `lower`.
    """

    kind: Literal["joint range"] = "joint range"


def _recorded(constraint: Any, info: ValidationInfo) -> Any:
    """For a constraint: its record."""
    if isinstance(constraint, dict | Record) or isinstance(info.context, Reading):
        return constraint
    return (JointRangeRecord if isinstance(constraint, JointRange) else RegionRecord).of(constraint)


Constraints = Annotated[
    list[Annotated[RegionRecord | JointRangeRecord, Discriminator("kind"), BeforeValidator(_recorded)]],
    at_most(MAX_CONSTRAINTS),
]
