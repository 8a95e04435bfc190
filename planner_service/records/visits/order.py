"""What an ordering of visits came to, as a section of a task file."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any

from planner_service.errors import InvalidRequest
from planner_service.files.schema import Count, Prose, Record, Text, as_text, at_most, recorded
from planner_service.planning.task_result import TaskResult
from planner_service.records.plan_file import SavedTask
from planner_service.records.visits.file import MAX_VISITS
from planner_service.tasks.ordering import FailedLeg, OrderResult, Stop

__all__ = ["ORDER", "OrderRecord", "saved_order"]

ORDER = "order"
"""The section of a task file."""

NONE = math.inf, 0.0, 0.0
"""Duration, bound and floor without an order."""

MAX_TOLD = 1_000
"""Legs without a plan, and branches that are not used, that a file names."""


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


class LegEndRecord(Record):
    """Where a leg begins or ends.

    Attributes:
        visit: The name of a visit; null for where the robot starts, or ends.
        branch: Which of its branches.
    """

    visit: Text | None
    branch: Count

    @classmethod
    def fields_of(cls, value: tuple[str, int]) -> dict[str, Any]:
        return {"visit": value[0] or None, "branch": value[1]}

    @cached_property
    def value(self) -> tuple[str, int]:
        return self.visit or "", self.branch


class FailedLegRecord(Record):
    """A leg without a plan.

    Attributes:
        start: Where it begins.
        goal: Where it ends.
        why: Why it has none.
    """

    about = FailedLeg

    start: LegEndRecord
    goal: LegEndRecord
    why: Prose

    @classmethod
    def fields_of(cls, value: FailedLeg) -> dict[str, Any]:
        ends = {"start": LegEndRecord.of(value.start), "goal": LegEndRecord.of(value.goal)}
        return ends | {"why": as_text(value.why)}

    @cached_property
    def value(self) -> FailedLeg:
        return FailedLeg(self.start.value, self.goal.value, self.why)


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
        deterministic: Whether no clock had a say.
    """

    about = OrderResult

    stops: Annotated[list[MadeVisitRecord], at_most(MAX_VISITS)]
    duration: float | None
    bound: float | None
    floor: float | None
    gap: float | None
    plans: Count
    failed: Annotated[list[FailedLegRecord], at_most(MAX_TOLD)]
    refused: Annotated[list[Prose], at_most(MAX_TOLD)]
    deterministic: bool

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
            "failed": [FailedLegRecord.of(leg) for leg in value.failed[:MAX_TOLD]],
            "refused": [as_text(each) for each in value.refused[:MAX_TOLD]],
            "deterministic": value.deterministic,
        }

    def result(self, task: TaskResult) -> OrderResult:
        """The order whose motions a task is, as far as both agree.

        Raises:
            InvalidRequest: They do not: a duration, a bound or a motion is another one.
        """
        ok, numbers = task.ok, (self.duration, self.bound, self.floor, self.gap)
        if any((number is None) == ok for number in numbers[:3]) or (not ok and (self.stops or self.gap is not None)):
            raise InvalidRequest("order", "times and visits", "some with an order, and none without")
        legs = [segment.result for segment in task.segments]
        if ok and [stop.motion for stop in self.stops] != list(range(len(legs) - 1)):
            raise InvalidRequest("stops", f"{len(self.stops)} of {len(legs)} motions", "a motion to each, and one on")
        duration, bound, floor = (usual if each is None else each for each, usual in zip(numbers, NONE, strict=False))
        if ok and not (duration == task.duration and 0.0 <= floor <= bound <= duration):
            raise InvalidRequest("duration", duration, f"that of the motions, {task.duration}, and bounds below it")
        found = OrderResult(
            tuple(Stop(stop.visit, stop.branch, leg) for stop, leg in zip(self.stops, legs, strict=False)),
            task,
            duration,
            bound,
            floor,
            self.plans,
            tuple(leg.value for leg in self.failed),
            tuple(self.refused),
            task.counts,
            task.failure,
            self.deterministic,
        )
        if ok and self.gap != (found.gap if math.isfinite(found.gap) else None):
            raise InvalidRequest("gap", self.gap, f"{found.gap}, by duration and bound")
        return found


def saved_order(found: OrderResult) -> SavedTask:
    """The task of an order as its file holds it, with the order as a section."""
    task = SavedTask.of(found.task)
    return replace(task, sections={ORDER: recorded(ORDER, lambda: OrderRecord.of(found)).document()})
