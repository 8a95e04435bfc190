"""The motions of several arms on the page: all arms as one robot, each where its own clock has it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell import Cell, CellPlan, OwnClock
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.task_result import Segment
from planner_service.service import PlannerService
from planner_service.view.playback import Clip, Playback, Span
from planner_service.view.still.clocks import tool_ways, waits_of

__all__ = ["playback_of", "segments_of"]


@dataclass(frozen=True, eq=False)
class _AllArms:
    """The motion of all arms on the clock of the whole."""

    plan: CellPlan

    @property
    def duration(self) -> float:
        """Seconds from the first start to the last end."""
        return self.plan.duration

    def __call__(self, t: ArrayLike, order: int = 0) -> FloatArray:
        """q of the whole, or its derivative of an order, at times t, shape (..., n)."""
        if order == 0:
            return self.plan(t)
        times = np.asarray(t, dtype=np.float64)
        out = np.zeros((times.size, len(self.plan.still)))
        for clock in self.plan.clocks:
            trajectory = clock.plan.unwrap()[1]
            own = times.reshape(-1) - clock.start
            moves = (own >= 0.0) & (own <= trajectory.duration)
            rows = trajectory(own[moves], order)
            for columns in map(np.array, clock.columns):
                out[np.ix_(moves, columns)] = rows if len(clock.arms) == 1 else rows[:, columns]
        return out.reshape(*times.shape, -1)

    def s(self, t: ArrayLike) -> FloatArray:
        """How far it has come: there is no path of all arms, so the time."""
        return np.asarray(t, dtype=np.float64)


def playback_of(service: PlannerService, plan: CellPlan) -> Playback | None:
    """The motions of all arms as a service of all of them sees them; None without a plan."""
    if plan.failure is not None:
        return None
    tools = () if plan.layout is None else tuple(tool_ways(Cell.laid_out(plan.layout), plan))
    rows = tuple((name, tuple(_spans(clock))) for clock in plan.clocks for name in clock.arms)
    return Playback((Clip("plan", service, _AllArms(plan), (), 0.0, None),), tools, rows)


def _spans(clock: OwnClock) -> Iterator[Span]:
    """When an arm moves and waits, in order; it stands after its end."""
    at = 0.0
    for begin, end in (*([(0.0, clock.start)] if clock.start > 0.0 else []), *waits_of(clock)):
        if begin > at:
            yield Span(at, begin, waits=False)
        yield Span(begin, end, waits=True)
        at = end
    if clock.end > at:
        yield Span(at, clock.end, waits=False)


def segments_of(plan: CellPlan, width: float) -> tuple[Segment, ...]:
    """The motion of each clock by the names of its arms, with when it moves and waits, and what is proven of it.

    Args:
        width: Of the gripper, which does not move.
    """
    late = "one arm moves" if plan.tolerates == math.inf else f"each arm may be {plan.tolerates:.3f} s late"
    notes = [*plan.notes, f"proven over all clocks: {late}"]
    out = []
    for clock in plan.clocks:
        name = " and ".join(clock.arms)
        waits = "".join(f", waits from {a:.2f} to {b:.2f} s" for a, b in waits_of(clock))
        notes.append(f"{name}: from {clock.start:.2f} to {clock.end:.2f} s{waits}")
        out.append(Segment(name, replace(clock.plan, notes=()), width))
    if out:
        out[-1] = replace(out[-1], result=replace(out[-1].result, notes=tuple(notes)))
    return tuple(out)
