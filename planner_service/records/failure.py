"""Failures as JSON objects, and back: what touches, what was in the way, and why a pose cannot be reached."""

from __future__ import annotations

import enum
from collections.abc import Callable
from functools import cached_property
from typing import Annotated

from pydantic import AfterValidator, Field

from planner_service.collision import Contact
from planner_service.files import schema
from planner_service.geometry.arrays import read_only
from planner_service.kinematics.reachability import Cause, LimitExcess, Slip, Suggestion, Unreachable
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.records.values import PoseRecord

__all__ = ["MAX_PAIRS", "FailureRecord", "StageName"]

MAX_PAIRS = 100_000


def _one_of(kind: type[enum.Enum]) -> Callable[[str], str]:
    values = [member.value for member in kind]

    def checked(value: str) -> str:
        if value not in values:
            raise ValueError(f"one of {', '.join(values)}")
        return value

    return checked


StageName = Annotated[str, AfterValidator(_one_of(Stage))]
ReasonName = Annotated[str, AfterValidator(_one_of(Reason))]
CauseName = Annotated[str, AfterValidator(_one_of(Cause))]
SlipName = Annotated[str, AfterValidator(_one_of(Slip))]


class ContactRecord(schema.Record, makes=Contact):
    """A ``Contact``."""

    depth: float = Field(alias="depth_at_most")


class BlockedRecord(schema.Record):
    """One entry of ``Failure.blocked_by``."""

    a: schema.Text
    b: schema.Text
    share: float

    @cached_property
    def value(self) -> tuple[str, str, float]:
        return self.a, self.b, self.share


class LimitExcessRecord(schema.Record, makes=LimitExcess):
    """A ``LimitExcess``."""


class SuggestionRecord(schema.Record, makes=Suggestion):
    """A ``Suggestion``."""

    slips: Annotated[list[SlipName], schema.at_most(len(Slip))]
    pose: PoseRecord

    @cached_property
    def value(self) -> Suggestion:
        return Suggestion(tuple(map(Slip, self.slips)), self.pose.value)


class UnreachableRecord(schema.Record, makes=Unreachable):
    """An ``Unreachable``."""

    cause: CauseName

    @cached_property
    def value(self) -> Unreachable:
        arguments = self.arguments
        return Unreachable(**arguments | {"cause": Cause(self.cause), "nearest": read_only(arguments["nearest"])})


class FailureRecord(schema.GrownRecord):
    """A ``Failure``."""

    stage: StageName
    reason: ReasonName
    detail: schema.Prose
    contacts: Annotated[list[ContactRecord], schema.at_most(MAX_PAIRS)]
    nearest_free: schema.Joints | None
    blocked_by: Annotated[list[BlockedRecord], schema.at_most(MAX_PAIRS)]
    unreachable: UnreachableRecord | None = None
    proven: bool = False

    @cached_property
    def value(self) -> Failure:
        arguments = self.arguments | {"stage": Stage(self.stage), "reason": Reason(self.reason)}
        return Failure(**arguments | {"nearest_free": self.nearest_free and read_only(self.nearest_free)})
