"""Does what ``explain`` suggests help? Stored failures; the first suggestion for each is applied and checked."""

from __future__ import annotations

from rich.table import Table

from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, table_of
from benchmarks.worlds.unsolvable import StoredFailure, load_failures
from planner_service import PlannerService

__all__ = ["run"]

SOLVED = 0.9
"""Promised: this part is solved by the first suggestion."""

PLANS = 60
"""Tried for each failure."""

CURVE_STEP = 0.001
"""Metres that any point moves at most between two judged samples."""


def run(queries: int | None, seed: int) -> Report:
    """Measure the first so many stored failures."""
    rows = [_explained(failure) for failure in load_failures()[:queries]]
    solved = sum(row["solved"] for row in rows)
    promise = f"at least {SOLVED:.0%} of {len(rows)} failures are solved by the first suggestion"
    promises = (Promise(promise, f"{solved}", solved >= SOLVED * len(rows)),)
    return Report("evidence", tuple(rows), (_table(rows),), promises)


def _explained(failure: StoredFailure) -> Row:
    service = PlannerService(failure.robot, failure.scene)
    found = service.explain(failure.request, plans=PLANS)
    row: Row = {"kind": failure.kind, "robot": failure.robot, "reason": str(found.result.failure)[:100]}
    row |= {"proven": found.proven, "plans": found.plans, "remedies": [str(remedy) for remedy in found.remedies]}
    if not found.remedies:
        return row | {"solved": False}
    first = found.remedies[0]
    result = PlannerService(service.robot, first.scene).plan(first.request)
    second = independent(service.robot.name, first.scene)
    touched = None if result.path is None else touch_on_curve(second, result.path, CURVE_STEP)
    return row | {"solved": result.ok and touched is None}


def _table(rows: list[Row]) -> Table:
    lines = [
        {
            "failure": kind,
            "count": str(len(group)),
            "with a suggestion": str(sum(bool(row["remedies"]) for row in group)),
            "solved by the first": str(sum(row["solved"] for row in group)),
            "proven": str(sum(row["proven"] for row in group)),
            "plans tried": f"{p50(row['plans'] for row in group):.0f}",
            "such as": next((row["remedies"][0] for row in group if row["remedies"]), "-")[:60],
        }
        for kind, group in grouped(rows, "kind").items()
    ]
    return table_of("Failures explained", lines, caption="plans tried: p50")
