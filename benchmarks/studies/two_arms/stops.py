"""Joint stops: whatever arms do that is within what a stop rests on, none touches, by Coal.

Ten plans of two WidowX AI whose ways cross are carried out with the clocks that drive real arms (``JointClock``). In
each execution the lags, the rate and the moments of ticks are drawn; ticks are lost, readings are old, arms stall, for
a while or for good, and a stop may be asked for. An arm is anywhere between where it was and what it was commanded,
lag included. After each step of each arm two things are judged: that neither is later than the plan tolerates, and by
Coal that they do not touch.

Faults are planted: clocks without a joint stop, where Coal has to find contacts, and clocks that stop too late by the
way of a stop, or take arms to have no lag, where arms have to be found later than is proven.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich.progress import track
from rich.table import Table

import planner_service as ps
from benchmarks.harness.audit import Auditor
from benchmarks.harness.report import Promise, Report, Row, grouped, spread, table_of
from benchmarks.studies.two_arms.plans import dual
from planner_service.cell import Cell, CellPlan
from planner_service.execute.cells.joint_clock import Course, JointClock
from planner_service.geometry.arrays import FloatArray

__all__ = ["EXECUTIONS", "run"]

EXECUTIONS, PLANS = 10_000, 10

DELAY, MOST = 0.25, 0.9
"""Seconds that plans are asked to tolerate; those that tolerate more than ``MOST`` hardly meet."""

TICK = 0.02
"""Seconds between two commands, more or less."""

LAG = 0.15
"""Seconds, at most."""

RATES = (0.15, 0.3, 0.45, 0.6)
"""Parts of the planned speed."""

APART = 0.01
"""Seconds of the plan between two configurations that Coal judges."""

ROUNDING = 1e-9

KINDS = ("as they are", "no joint stop", "stop too late", "no lags")
"""Of clocks; all but the first are planted."""


@dataclass(frozen=True)
class _Drivable:
    """A plan at a rate at which an arm can stop within its delay."""

    plan: CellPlan
    rate: float
    courses: Mapping[str, Course]

    def clock(self, kind: str, lags: Mapping[str, float]) -> JointClock:
        """The clock of an execution, with its fault."""
        delay = self.plan.tolerates
        if kind == "no joint stop":
            delay = math.inf
        elif kind == "stop too late":
            delay += max(course.longest_way for course in self.courses.values())
        elif kind == "no lags":
            lags = dict.fromkeys(lags, 0.0)
        return JointClock(self.courses, delay, self.rate, lags)


def run(queries: int | None, seed: int) -> Report:
    """Carry out that many, and a tenth as many (50 at least) with each planted fault."""
    executions = EXECUTIONS if queries is None else queries
    cell, rng = dual("table"), np.random.default_rng(seed)
    auditor, drivable = Auditor("wxai_dual", cell.scene), list(_drivable(cell, rng))
    kinds = [KINDS[0]] * executions + [kind for kind in KINDS[1:] for _ in range(max(50, executions // 10))]
    rows = [
        _execution(cell, drivable[rng.integers(len(drivable))], kind, rng, auditor)
        for kind in track(kinds, description="stops", transient=True)
    ]
    return Report("two-arms", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def _drivable(cell: Cell, rng: np.random.Generator) -> Iterator[_Drivable]:
    """Plans in which the left arm leaves the middle and the right one comes in, at each rate that is allowed."""
    plans = list[CellPlan]()
    while len(plans) < PLANS:
        left, right = (rng.uniform(*span) for span in (((-1.0, 0.2), (-0.5, 0.6)), ((-0.5, 0.5), (-0.2, 1.0))))
        a, b, c, d = ([yaw, *rng.uniform((1.0, 0.8, -1.0, -0.4), (1.7, 1.6, 0.0, 0.4)), 0.0] for yaw in (*left, *right))
        requests = {"left": ps.PlanRequest(a, b), "right": ps.PlanRequest(c, d)}
        plan = cell.plan(requests, delay=DELAY)
        if plan.ok and len(plan.clocks) == 2 and plan.tolerates < MOST:
            plans.append(plan)
    for plan in plans:
        for rate in RATES:
            courses = {}
            for clock in plan.clocks:
                (name,) = clock.arms
                braking = cell.arm(name).robot.limits.acceleration
                courses[name] = Course(clock.plan.unwrap()[1], None, clock.start, braking, rate, TICK)
            needed = max(course.longest_way for course in courses.values()) + rate * (LAG + 2.0 * TICK)
            if needed < plan.tolerates:
                yield _Drivable(plan, rate, courses)


def _execution(cell: Cell, what: _Drivable, kind: str, rng: np.random.Generator, auditor: Auditor) -> Row:
    """Carry out a plan, and judge where the arms were."""
    delay, courses = what.plan.tolerates, what.courses
    lags = {name: rng.uniform(0.0, LAG) for name in courses}
    clock = what.clock(kind, lags)
    places = np.array(list(_places(clock, lags, what.plan.duration, rng)))
    apart = max(_gap(courses, places[:, 0], places[:, 1]), _gap(courses, places[:, 1], places[:, 0], back=True))
    kept = [0]
    for k in range(1, len(places)):
        if np.abs(places[k] - places[kept[-1]]).max() > APART:
            kept.append(k)
    shown = places[[*kept, -1]]
    Q = np.repeat(what.plan.still[None], len(shown), axis=0)
    for own in what.plan.clocks:
        (name,) = own.arms
        Q[:, own.columns[0]] = courses[name].at(shown[:, list(courses).index(name)])[0]
    verdict = auditor.judge(Q)["verdict"]
    row: Row = {"clocks": kind, "rate": what.rate, "tolerates": delay, "apart": apart / delay, "judged": len(Q)}
    return row | {"stopped": bool(clock.stopped), "audit": verdict}


def _places(
    clock: JointClock, lags: Mapping[str, float], duration: float, rng: np.random.Generator
) -> Iterator[tuple[float, ...]]:
    """Where the arms are after each step of one, in seconds of the plan, until all rest or are through."""
    names, rate = list(clock.courses), clock.rate
    at = dict.fromkeys(names, 0.0)
    stall = {name: rng.uniform(0.0, duration) / rate if rng.uniform() < 0.7 else math.inf for name in names}
    back = {name: stall[name] + (rng.uniform(0.1, 3.0) / rate if rng.uniform() < 0.7 else math.inf) for name in names}
    asked = rng.uniform(0.0, duration) / rate if rng.uniform() < 0.3 else math.inf
    stale = {name: rng.uniform() < 0.3 for name in names}
    t, rests = 0.0, set[str]()
    yield tuple(at.values())
    while t < (duration + 1.0) / rate and len(rests) < len(names):
        t += TICK * rng.uniform(0.5, 1.5)
        if t > asked:
            clock.stop("asked")
        for name in (names, names[::-1])[rng.integers(2)]:
            lag, course = rate * lags[name], clock.courses[name]
            if stall[name] < t < back[name] or rng.uniform() < 0.1:
                if stall[name] < t and back[name] == math.inf and clock.stopped:
                    rests.add(name)
                continue
            step = clock.advance(name, t)
            before = at[name]
            at[name] = max(before, min(step.u + rng.uniform(-2.0, 1.0) * lag, course.end))
            clock.seen(name, course.at(before if stale[name] else at[name])[0])
            if step.stopping and step.rate == 0.0:
                rests.add(name)
            yield tuple(at.values())


def _gap(courses: Mapping[str, Course], ahead: FloatArray, behind: FloatArray, *, back: bool = False) -> float:
    """Seconds by which an arm is ahead of the other at most; one that has not started, or is through, is in time."""
    first, second = list(courses.values())[:: -1 if back else 1]
    gap = np.where((ahead <= first.start) | (behind >= second.end), 0.0, ahead - behind)
    return float(gap.max(initial=0.0))


def _table(rows: Sequence[Row]) -> Table:
    lines = [
        {
            "clocks": kind,
            "executions": len(here),
            "stopped": sum(row["stopped"] for row in here),
            "touching, by Coal": sum(row["audit"] != "free" for row in here),
            "apart, of what is tolerated": spread([row["apart"] for row in here], 3),
            "most": f"{max((row['apart'] for row in here), default=0.0):.3f}",
            "later than that": _late(here),
            "configurations": f"{sum(row['judged'] for row in here):,}",
        }
        for kind, here in grouped(rows, "clocks").items()
    ]
    caption = "p50 / p95. All kinds but the first are planted faults."
    return table_of("Joint stops", lines, caption=caption)


def _late(rows: Sequence[Row]) -> int:
    return sum(row["apart"] > 1.0 + ROUNDING for row in rows)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    of = grouped(rows, "clocks")
    own, bare = (of.get(kind, ()) for kind in KINDS[:2])
    touched, late = sum(row["audit"] != "free" for row in own), _late(own)
    yield Promise("no execution touches, by Coal", f"{touched} of {len(own):,}", not touched)
    yield Promise("no arm is later than is proven", f"{late} of {len(own):,}", not late)
    found = sum(row["audit"] != "free" for row in bare)
    yield Promise("without a joint stop contacts are found", f"{found} of {len(bare):,}", found > 0)
    for kind in KINDS[2:]:
        found = _late(of[kind])
        yield Promise(f"{kind}: arms are found later than is proven", f"{found} of {len(of[kind]):,}", found > 0)
