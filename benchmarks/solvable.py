"""Whatever any planner solves within a million states, the default solves within its own budget."""

from __future__ import annotations

from typing import Any

from benchmarks import queries
from benchmarks.queries import Query
from benchmarks.report import Promise, Report, table
from benchmarks.states import plan
from planner_service import PlannerService
from planner_service.pipeline import SEARCH_SHARE
from planner_service.planners import PLANNERS

__all__ = ["run"]

STATES = 1_000_000


def run() -> Report:
    """Ask the default about every query, and all others about those it leaves."""
    rows: list[dict[str, Any]] = []
    for scene in queries.SCENES:
        service = PlannerService(queries.ROBOT, scene)
        for query in queries.load(scene):
            result = plan(service, query)
            found = "rrtconnect" if result.ok else _solver(service, query)
            row = {"query": query.name, "default": result.ok, "attempts": result.attempts}
            rows.append(row | {"states": result.counts.states, "solved_by": found})
    lost = [row["query"] for row in rows if not row["default"] and row["solved_by"]]
    open_ = [row["query"] for row in rows if not row["solved_by"]]
    by_tries = {tries: sum(row["default"] and row["attempts"] == tries for row in rows) for tries in range(5)}
    cells = [("straight line" if tries == 0 else f"try {tries}", str(count)) for tries, count in by_tries.items()]
    cells += [("not by the default, but by another", str(len(lost))), ("by no planner", str(len(open_)))]
    text = f"what any planner solves within {STATES:,} states, the default solves within its own budget"
    measured = ", ".join(lost) or f"all of {len(rows) - len(open_)}"
    return Report(
        "solvable",
        tuple(rows),
        (table("Queries by how they were solved, MotionStep(0.010)", ("solved", "queries"), cells),),
        (Promise(text, measured, not lost),),
    )


def _solver(service: PlannerService, query: Query) -> str | None:
    """The first planner that solves a query within the million."""
    for name, planner in PLANNERS.items():
        if plan(service, query, planner=planner(), max_checks=int(STATES / SEARCH_SHARE), retries=0).ok:
            return name
    return None
