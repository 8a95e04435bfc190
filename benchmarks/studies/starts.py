"""Starts 0.1 to 3 mm deep in something: how many have a plan, and whether any depth grows on the way out, by Coal.

A start is where a straight line from a free configuration to a colliding one has got so deep. The goal is the free one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from rich.table import Table

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from planner_service.certify import MARGIN, Certifier
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray

__all__ = ["QUERIES", "run", "starts_of"]

QUERIES = 1_000
"""Starts of all kinds together."""

KINDS = (
    *(("table", "wxai", "table"), ("shelf", "wxai", "shelf"), ("bin", "wxai", "bin"), ("itself", "wxai", "empty")),
    *(("table", "ur5", "table"), ("shelf", "panda", "shelf"), ("bin", "panda", "bin"), ("itself", "panda", "empty")),
    *(("table", "wxai_dual", "table"), ("itself", "ur5", "empty")),
)
"""What is touched, by which robot, in which scene."""

SHALLOW, DEEP = 1e-4, 3e-3
"""Metres."""

SAMPLES = 200
"""Of a way out, by Coal."""

GROWN = 1e-6
"""Metres by which a depth may grow between two samples: Coal's are right to about so much."""

SOLVED = 0.98
"""Of the starts that are promised to have a plan."""

CHECKS = 200_000
"""States of a plan: that it has none would not be for want of a way out."""


def starts_of(
    service: ps.PlannerService, certifier: Certifier, rng: np.random.Generator, *, itself: bool
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Starts, endlessly, each with a free configuration to go to.

    Args:
        itself: The robot touches itself, and nothing else.
    """
    lower, upper = service.robot.limits.lower, service.robot.limits.upper
    scene = set(service.scene.names)
    while True:
        free, other = rng.uniform(lower, upper, (2, len(lower)))
        if not service.checker.state_is_free(free):
            continue
        depth = rng.uniform(SHALLOW, DEEP)
        hit = service.checker.edge_hit(free, other)
        if hit is None:
            continue
        low, high = free, free + min(hit.fraction + 0.01, 1.0) * (other - free)
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if _depth(certifier, middle) >= depth else (middle, high)
        (pairs,) = certifier.overlaps(high[None])
        touched = {name.removesuffix(" (object)") in scene for pair in pairs for name in pair[1:]}
        if pairs and SHALLOW <= max(pairs.values()) <= DEEP and touched == {not itself}:
            yield high, free


def _depth(certifier: Certifier, q: FloatArray) -> float:
    return max(certifier.overlaps(q[None])[0].values(), default=0.0)


def run(queries: int = QUERIES, seed: int = 0) -> Report:
    """Plan from that many starts."""
    rows: list[Row] = []
    for number, (kind, robot, scene) in enumerate(KINDS):
        service = ps.PlannerService(robot, scene)
        certifier = Certifier(service.robot, service.scene)
        judge = IndependentChecker(data_folder("robots") / robot, tables_of(service.scene))
        starts = starts_of(service, certifier, np.random.default_rng([seed, number]), itself=kind == "itself")
        for k in range(queries * (number + 1) // len(KINDS) - queries * number // len(KINDS)):
            start, goal = next(starts)
            request = ps.PlanRequest(start, goal, seed=k, time_limit=None, max_checks=CHECKS)
            ms, result = cpu_ms(partial(service.plan, request))
            (depths,) = certifier.overlaps(start[None])
            rows.append(
                {
                    "kind": kind,
                    "robot": robot,
                    "mm": 1e3 * max(depths.values()),
                    "pairs": len(depths),
                    "ms": ms,
                    "first ms": 1e3 * result.stages[0].seconds,
                    "ok": result.ok,
                    "proven": result.certificate is not None and result.certificate.certified,
                    "why": "" if result.failure is None else str(result.failure),
                    "start": start.tolist(),
                    **_judged(judge, result),
                }
            )
    return Report("starts", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def _judged(judge: IndependentChecker, result: ps.PlanResult) -> Row:
    """By how much a depth grows at most on the way out, in mm, and whether a pair touches that did not at first."""
    if result.path is None or not result.exempt:
        return {"grown": 0.0, "new": 0}
    end = max(stretch.s_end for stretch in result.exempt)
    before = judge.gaps(result.path.waypoints[0])
    touching = {frozenset(pair) for stretch in result.exempt for pair in stretch.pairs}
    grown, new = 0.0, 0
    for q in result.path(np.linspace(0.0, end, SAMPLES + 1))[1:]:
        gaps = judge.gaps(q)
        for pair, gap in gaps.items():
            if min(gap, before[pair]) < -MARGIN:
                grown = max(grown, min(before[pair], 0.0) - gap)
                new += frozenset(pair) not in touching
        before = gaps
    return {"grown": 1e3 * grown, "new": new}


def _table(rows: Sequence[Row]) -> Table:
    def line(kind: str, here: Sequence[Row]) -> Row:
        return {
            "deep in": kind,
            "robots": ", ".join(sorted({row["robot"] for row in here})),
            "starts": len(here),
            "with a plan": sum(row["ok"] for row in here),
            "mm deep": spread([row["mm"] for row in here], 1),
            "pairs": f"{min(row['pairs'] for row in here)} to {max(row['pairs'] for row in here)}",
            "ends, ms": spread([row["first ms"] for row in here], 1),
            "plan, CPU ms": spread([row["ms"] for row in here], 1),
        }

    caption = "Plans from starts in collision. ends: the ENDPOINTS stage, which finds the way out; p50 / p95."
    lines = [line(*each) for each in grouped(rows, "kind").items()]
    return table_of("Starts in collision", [*lines, line("all", rows)], caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    solved = sum(row["ok"] and row["proven"] for row in rows)
    grown = sum(row["grown"] > 1e3 * GROWN for row in rows)
    new = sum(row["new"] > 0 for row in rows)
    share = f"{solved / max(len(rows), 1):.1%}"
    yield Promise(f"{SOLVED:.0%} of {len(rows):,} starts have a proven plan", share, solved >= SOLVED * len(rows))
    yield Promise(f"no depth grows by more than {1e6 * GROWN:g} um between samples", f"{grown} do", grown == 0)
    yield Promise("no other pair touches", f"{new} do", new == 0)
    yield Promise("the time of a plan", f"p50 {p50([row['ms'] for row in rows]):.1f} ms", True)
