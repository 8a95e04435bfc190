"""Plans that keep constraints along the whole motion, on stored queries, judged by kinematics that are not ours."""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

from rich.table import Table

import planner_service as ps
from auditor.checker import IndependentChecker
from auditor.constraints import MOTION_STEP, Deviation, deviations
from benchmarks.harness.audit import audited, independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from benchmarks.worlds.constrained import REGIONS, ROBOTS, UPRIGHT, ConstrainedQuery, load

__all__ = ["CASES", "PARTS", "Case", "measured", "run"]

LONG = 60.0
"""Seconds for a query that the default request does not solve: whether any method does."""

LIMIT_MS = {"panda": 30.0, **dict.fromkeys(("bin", "shelf", "clutter", "carried"), 15.0)}
REGION_MS = 150.0
CUPS_SOLVED, REGIONS_SOLVED = 0.98, 0.95
SLOWER = 1.5
"""Promised: p50 of milliseconds, solved shares, and seconds per rad over those of unconstrained plans."""

TIGHT, NEGLIGIBLE, ROUNDING = 1.3, 0.2, 2e-9
"""Promised of certified bounds: how many times the sampled deviation, or which part of the tolerance, they are at most;
and metres or radians by which two programs may round differently."""


@dataclass(frozen=True)
class Case:
    """A set of queries, and how far a cup may lean in it."""

    set: str
    tolerance: float | None = None

    @property
    def name(self) -> str:
        """Such as ``bin 0.02``."""
        return self.set if self.tolerance is None else f"{self.set} {self.tolerance:g}"

    @property
    def part(self) -> str:
        """Of the study."""
        return "panda" if self.set == "panda" else "wxai" if self.set in UPRIGHT else "regions"


PARTS = ("panda", "wxai", "regions")

CASES = (*(Case(name, angle) for name in UPRIGHT for angle in (0.1, 0.02)), *map(Case, REGIONS))


def measured(case: Case, query: ConstrainedQuery) -> Row:
    """A query planned, with and without its constraints, and the motion judged."""
    service = _service(ROBOTS[query.set], query.scene)
    request = _request(case, query)
    gc.collect()  # of what judging left behind
    ms, result = cpu_ms(lambda: service.plan(request))
    row: Row = {
        "case": case.name,
        "query": query.name,
        "ms": ms,
        "states": result.counts.states,
        "projections": result.counts.projections,
        "failure": None if result.failure is None else result.failure.reason.value,
        "solvable": result.ok or service.plan(replace(request, seed=1, time_limit=LONG)).ok,
    }
    if result.ok:
        row |= _judged(query, case, service, result)
    return row


@lru_cache(maxsize=4)
def _service(robot: str, scene: ps.Scene) -> ps.PlannerService:
    return ps.PlannerService(ps.load_robot(robot), scene)


@cache
def _second(robot: str, scene: ps.Scene) -> IndependentChecker:
    return independent(robot, scene)


def _judged(query: ConstrainedQuery, case: Case, service: ps.PlannerService, result: ps.PlanResult) -> Row:
    path, trajectory = result.path, result.trajectory
    if path is None or trajectory is None:
        return {}
    seen, found = _seen(query, case, path)
    free = service.plan(ps.PlanRequest(query.start, path.waypoints[-1]))
    row: Row = {
        "waypoints": len(path.waypoints),
        "length": path.length,
        **seen,
        "bounds": _bounds(result, found),
        "slower": None,
        "slower s-curve": None,
    }
    if free.path is not None and free.trajectory is not None:
        row["slower"] = trajectory.duration / path.length / (free.trajectory.duration / free.path.length)
        row["slower s-curve"] = _pace(service, path) / _pace(service, free.path)
    return row


def _seen(query: ConstrainedQuery, case: Case, path: ps.JointPath) -> tuple[Row, list[Deviation]]:
    """What the second checker finds along a path: part of a row, and the largest deviations."""
    second, robot = _second(ROBOTS[query.set], query.scene), ps.load_robot(ROBOTS[query.set])
    samples = second.along(path, path.length, MOTION_STEP)
    found = deviations(second, samples, [audited(robot, each) for each in query.constraints(case.tolerance)])
    share, touch = max(_share(item) for item in found), touch_on_curve(second, path, MOTION_STEP)
    return {"samples": len(samples), "share": share, "touch": touch}, found


def _share(item: Deviation) -> float:
    """The part of a tolerance that is used; of what is bounded on one side alone, 1 plus the metres beyond it."""
    if item.quantity.startswith(("+", "-")):
        return 1.0 + item.amount - item.tolerance
    return item.amount / item.tolerance


def _bounds(result: ps.PlanResult, found: Sequence[Deviation]) -> list[tuple[float, float, float]]:
    """Of all that is proven the bound, the largest deviation among the samples, and the tolerance."""
    kept = () if result.certificate is None else result.certificate.kept
    bounds = [bound for each in kept for bound in each.bounds]
    return [(bound.bound, item.amount, item.tolerance) for bound, item in zip(bounds, found, strict=True)]


def _pace(service: ps.PlannerService, path: ps.JointPath) -> float:
    """Seconds per radian by the jerk-limited law."""
    return ps.SCurve().time_path(path, service.robot.limits).duration / path.length


def _rows(cases: Sequence[Case], queries: int | None) -> Iterator[Row]:
    for case in cases:
        asked = load(case.set)[:queries]
        if asked:  # what is imported and built once is not a query's own
            _service(ROBOTS[case.set], asked[0].scene).plan(_request(case, asked[0]))
        for query in asked:
            yield measured(case, query)


def _request(case: Case, query: ConstrainedQuery) -> ps.PlanRequest:
    """The default one."""
    return ps.PlanRequest(query.start, query.goals, constraints=query.constraints(case.tolerance))


def run(part: str | None = None, queries: int | None = None) -> Report:
    """Plan all queries of a part, or of all; judge.

    Args:
        part: One of ``PARTS``.
        queries: Of each set; all if None.
    """
    rows = tuple(_rows([case for case in CASES if part in (None, case.part)], queries))
    return Report("constrained", rows, (_outcome_table(rows),), _promises(rows))


def _done(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["failure"] is None]


def _values(rows: Sequence[Row], key: str) -> list[float]:
    return [row[key] for row in rows if row.get(key) is not None]


def _spread(rows: Sequence[Row], key: str, digits: int = 0) -> str:
    values = _values(rows, key)
    return spread(values, digits) if values else "-"


def _outcome(case: str, rows: Sequence[Row]) -> Row:
    done = _done(rows)
    return {
        "set": case,
        "solved": f"{len(done)}/{len(rows)}",
        "of solvable": f"{len(done) / max(1, sum(row['solvable'] for row in rows)):.0%}",
        "CPU ms": spread(_values(rows, "ms"), 1),
        "states": spread(_values(rows, "states")),
        "projections": spread(_values(rows, "projections")),
        "waypoints": _spread(done, "waypoints"),
        "length rad": _spread(done, "length", 2),
        "s/rad ratio": _spread(done, "slower", 2),
        "s-curve": _spread(done, "slower s-curve", 2),
        "share": f"{max(_values(done, 'share'), default=math.nan):.3f}",
        "touches": sum(row["touch"] is not None for row in done),
    }


def _outcome_table(rows: Sequence[Row]) -> Table:
    caption = (
        "p50 / p95. The default request, proven free and timed; ms: CPU of the whole plan, failures with what they "
        "spent, by one service for all queries of a scene in turn; the Panda's have a scene each, and their plans are "
        f"the first of their service. Solvable: by the default request, or one of {LONG:g} s. "
        "Seconds per rad: over those of the unconstrained plan between the same ends. Share: the largest "
        f"part of a tolerance that is used, by Pinocchio at {MOTION_STEP * 1e3:g} mm motion steps; touches: by Coal, "
        "there."
    )
    return table_of("Under constraints", (_outcome(*each) for each in grouped(rows, "case").items()), caption=caption)


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    promises = []
    cases = {case.name: case for case in CASES}
    for name, here in grouped(rows, "case").items():
        case, done = cases[name], _done(here)
        cup = case.tolerance is not None
        share, most = (CUPS_SOLVED, LIMIT_MS[case.set]) if cup else (REGIONS_SOLVED, REGION_MS)
        among = sum(row["solvable"] for row in here) if cup else len(here)
        text = f"{name}: at least {share:.0%} solved" + (" of those that a longer request solves" if cup else "")
        promises.append(Promise(text, f"{len(done)} of {among}", len(done) >= share * among))
        ms = p50(_values(here, "ms"))
        promises.append(Promise(f"{name}: p50 at most {most:g} ms", f"{ms:.1f} ms", ms <= most))
        for key, law in (("slower", "TOPP-RA"), ("slower s-curve", "S-curve")):
            values = _values(done, key)
            ratio = p50(values) if values else math.nan
            text = f"{name}: seconds per rad at most {SLOWER:g} times unconstrained, p50, {law}"
            promises.append(Promise(text, f"{ratio:.2f}", ratio <= SLOWER))
    bounds = [bound for row in _done(rows) for bound in row["bounds"]]
    low = sum(bound < found - ROUNDING for bound, found, _ in bounds)
    promises.append(Promise("no certified bound is below a sampled deviation", f"{low} of {len(bounds)}", not low))
    loose = p50([bound / max(TIGHT * found, NEGLIGIBLE * most) for bound, found, most in bounds]) if bounds else 0.0
    text = f"certified bounds at most max({TIGHT:g} times the sampled deviation, {NEGLIGIBLE:g} of the tolerance), p50"
    promises.append(Promise(text, f"{loose:.2f} of it", loose <= 1.0))
    left = [f"{row['query']}: {row['share']:.3f}" for row in _done(rows) if row["share"] > 1.0]
    touches = [f"{row['query']}: {row['touch']}" for row in _done(rows) if row["touch"] is not None]
    step = f"{MOTION_STEP * 1e3:g} mm motion steps"
    promises.append(Promise(f"no curve leaves a tolerance at {step}", "; ".join(left) or "none", not left))
    promises.append(Promise(f"no curve touches anything at {step}", "; ".join(touches) or "none", not touches))
    return tuple(promises)
