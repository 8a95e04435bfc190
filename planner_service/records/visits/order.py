"""What an ordering of visits came to, as a section of a task file."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any

from planner_service.files.schema import Count, Prose, Record, Text, as_text, at_most, recorded
from planner_service.records.plan_file import SavedTask
from planner_service.records.visits.file import MAX_VISITS
from planner_service.tasks.ordering import OrderResult

__all__ = ["ORDER", "OrderRecord", "saved_order"]

ORDER = "order"
"""The section of a task file."""

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
