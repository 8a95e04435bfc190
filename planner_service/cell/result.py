"""Motions of several arms on their own clocks, as one value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell.goal_kinds import AtTool
from planner_service.cell.layout import Layout
from planner_service.collision import CheckCounts
from planner_service.errors import PlanningFailed
from planner_service.geometry.arrays import FloatArray, read_only, set_fields
from planner_service.geometry.validation import copied_in
from planner_service.path.joint_path import within
from planner_service.planning.result import Failure, PlanResult

__all__ = ["CellPlan", "OwnClock"]


@dataclass(frozen=True, eq=False)
class OwnClock:
    """A motion on a clock of its own.

    Attributes:
        arms: The arms that it moves; several where they share the clock.
        plan: The motion, proven against the scene, itself, and arms that stand.
        start: Seconds after the start of the whole at which it starts.
        columns: Of each arm its joints among those of the whole.
    """

    arms: tuple[str, ...]
    plan: PlanResult
    start: float
    columns: tuple[tuple[int, ...], ...]

    @property
    def end(self) -> float:
        """Seconds after the start of the whole at which it ends."""
        return self.start + self.plan.unwrap()[1].duration


@dataclass(frozen=True, eq=False)
class CellPlan:
    """Motions of several arms that do not touch each other, or the reason why there are none.

    Attributes:
        clocks: The motions, by their starts; none without a plan.
        tolerates: Seconds by which every arm may be late, each for itself, at any time, without touching another: that
            is proven. Infinite where one arm moves.
        failure: None with a plan.
        still: q of the whole (n,), with the arms at their starts.
        rectangles: Of two arms' motions, those that were asked for a proof.
        distances: Bounds that this took, beside those of each motion's own proof.
        tried: All plans that were made for it, for what it cost.
        notes: How the motions were brought together.
        layout: What the cell is made of that they were planned for; None if that is not known.
        goals: Where tools are at the end in the tool frames of other arms, by the names of the arms, as was asked.
    """

    clocks: tuple[OwnClock, ...]
    tolerates: float
    failure: Failure | None
    still: FloatArray
    rectangles: int = 0
    distances: int = 0
    tried: tuple[PlanResult, ...] = ()
    notes: tuple[str, ...] = ()
    layout: Layout | None = field(default=None, repr=False)
    goals: Mapping[str, AtTool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        copied_in(self, "clocks", "tried", "notes", "goals")
        set_fields(self, still=read_only(self.still))

    def __repr__(self) -> str:
        if self.failure is not None:
            return f"<CellPlan: no plan, {self.failure.reason.value}>"
        return f"<CellPlan: {self.duration:.2f} s of motion, tolerates {self.tolerates:.2f} s of delay>"

    def __str__(self) -> str:
        if self.failure is not None:
            return f"no plan: {self.failure}"
        late = "one arm moves" if self.tolerates == math.inf else f"tolerates {self.tolerates:.3f} s of delay"
        lines = [f"{self.duration:.2f} s of motion, {late} ({self.rectangles:,} rectangles, {self.distances:,} bounds)"]
        for clock in self.clocks:
            arms = " and ".join(clock.arms)
            lines.append(f"  {arms}: from {clock.start:.2f} to {clock.end:.2f} s, {clock.plan.certificate}")
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    @property
    def ok(self) -> bool:
        """Whether there is a plan."""
        return self.failure is None

    @property
    def duration(self) -> float:
        """Seconds from the first start to the last end; 0 without a plan."""
        return max((clock.end for clock in self.clocks), default=0.0)

    @property
    def counts(self) -> CheckCounts:
        """What it cost: all plans that were made, and the proof between arms."""
        return sum((plan.counts for plan in self.tried), CheckCounts()) + CheckCounts(distances=self.distances)

    def __call__(self, t: ArrayLike, late: Mapping[str, ArrayLike] | None = None) -> FloatArray:
        """q of the whole at times t, shape (..., n).

        Args:
            t: Seconds in [0, duration].
            late: Seconds by which arms are late at these times, by their names, shaped like t.

        Raises:
            PlanningFailed: There is no plan.
            InvalidRequest: A time outside.
        """
        if self.failure is not None:
            raise PlanningFailed(self.failure)
        times = within("t", t, self.duration)
        q = np.repeat(self.still[None], times.size, axis=0)
        for clock in self.clocks:
            trajectory = clock.plan.unwrap()[1]
            for arm, columns in zip(clock.arms, clock.columns, strict=True):
                behind = np.asarray((late or {}).get(arm, 0.0), dtype=np.float64)
                rows = trajectory(np.clip(times - clock.start - behind, 0.0, trajectory.duration).reshape(-1))
                joints = list(columns)  # a plan of several arms is one of all joints
                q[:, joints] = rows if len(clock.arms) == 1 else rows[:, joints]
        return q.reshape(*times.shape, -1)
