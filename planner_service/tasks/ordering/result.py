"""What an ordering came to: the order, the branches, the proven motions, and how far from the best they can be."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planner_service.collision import CheckCounts
from planner_service.geometry.validation import copied_in
from planner_service.planning.result import Failure, PlanResult
from planner_service.planning.task_result import TaskResult

__all__ = ["FailedLeg", "OrderResult", "Stop"]


@dataclass(frozen=True, eq=False)
class Stop:
    """A visit as it is made.

    Attributes:
        name: Of the visit.
        branch: Which of its branches; poses stand for several, in the order of ``inverse_kinematics``.
        leg: The motion to it.
    """

    name: str
    branch: int
    leg: PlanResult


@dataclass(frozen=True)
class FailedLeg:
    """A leg without a plan: from which branch of which visit ("" for the start) to which ("" for the end), and why."""

    start: tuple[str, int]
    goal: tuple[str, int]
    why: str

    def __str__(self) -> str:
        (one, first), (two, second) = self.start, self.goal
        return f"{f'{one} [{first}]' if one else 'start'} -> {f'{two} [{second}]' if two else 'end'}: {self.why}"


@dataclass(frozen=True, eq=False)
class OrderResult:
    """An order of visits, or the reason why there is none.

    Attributes:
        stops: The visits, in order.
        task: All motions, in order, each proven: ``task.save``, ``task.show`` and a driver take it.
        duration: Seconds of all motions; infinite without an order.
        bound: No order, with any of the branches, takes less with the plans of this request: planned legs count as they
            are planned, those without a plan as impossible, all others as what any motion takes at least.
        floor: No order takes less, whatever plans its motions. At most ``bound``.
        plans: Legs that were planned.
        failed: Those of them that have no plan.
        refused: Branches that were not used as they touch something, with what.
        counts: What all plans cost together, those that are not used among them.
        failure: None if there is an order.
        deterministic: Whether no clock had a say.
    """

    stops: tuple[Stop, ...]
    task: TaskResult
    duration: float
    bound: float
    floor: float
    plans: int
    failed: tuple[FailedLeg, ...]
    refused: tuple[str, ...]
    counts: CheckCounts
    failure: Failure | None = None
    deterministic: bool = True

    def __post_init__(self) -> None:
        copied_in(self, "stops", "failed", "refused")

    @property
    def ok(self) -> bool:
        """Whether there is an order."""
        return self.failure is None

    @property
    def order(self) -> tuple[str, ...]:
        """The names of the visits, in order."""
        return tuple(stop.name for stop in self.stops)

    @property
    def gap(self) -> float:
        """By which share of ``bound`` the order may be longer than the best one; infinite without an order."""
        return self._above(self.bound)

    @property
    def floor_gap(self) -> float:
        """The same of ``floor``: what a better planner could gain, too."""
        return self._above(self.floor)

    def _above(self, bound: float) -> float:
        if not self.ok:
            return math.inf
        return self.duration / bound - 1.0 if bound > 0.0 else (0.0 if self.duration == 0.0 else math.inf)

    def __repr__(self) -> str:
        return f"<OrderResult: {self}>"

    def __str__(self) -> str:
        if self.failure is not None:
            return f"no order: {self.failure}"
        within = f"at most {self.gap:.1%} longer than the best ({self.floor_gap:.1%} with any planner)"
        return f"{len(self.stops)} visits in {self.duration:.2f} s, {within}; {self.plans} legs planned, {self.counts}"
