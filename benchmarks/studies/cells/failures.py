"""Whether the report of a task that cannot be done names the step at which it fails, and the cause."""

from __future__ import annotations

import time

import planner_service as ps
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.worlds.impossible import Impossible, impossible

__all__ = ["run"]

SHOWN = 150
"""Characters of a report in the table."""


def run(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """Each task once.

    Args:
        queries: The first of them; all if None.
        seed: Of the planner.
        robot: The only one whose tasks are taken; all if None.
    """
    tasks = [each for each in impossible() if robot in (None, each.robot)][:queries]
    rows = [_row(each, seed) for each in tasks]
    lines = [
        {
            "task": row["task"],
            "report": row["report"][:SHOWN],
            "step": "yes" if row["names_step"] else "NO",
            "cause": "yes" if row["names_cause"] else "NO",
            "CPU ms": f"{row['ms']:,.0f}",
        }
        for row in rows
    ]
    solved = [row["task"] for row in rows if not row["failed"]]
    named = [row for row in rows if row["names_step"] and row["names_cause"]]
    promises = (
        Promise("tasks that cannot be done: none is", f"{len(solved)} of {len(rows)}", not solved),
        Promise("reports that name step and cause", f"{len(named)} of {len(rows)}", len(named) == len(rows)),
    )
    return Report("cells failures", tuple(rows), (table_of("Tasks that cannot be done", lines),), promises)


def _row(each: Impossible, seed: int) -> Row:
    robot = ps.load_robot(each.robot)
    start = robot.home if each.start is None else each.start
    request = ps.PlanRequest(start, start, seed=seed, time_limit=None, max_checks=each.max_checks)
    began = time.process_time()
    try:
        done = ps.PlannerService(robot, each.scene).solve(each.task, start, request=request, searches=each.searches)
        failed, report = not done.ok, str(done.failure)
    except ps.InvalidRequest as refused:
        failed, report = True, str(refused)
    return {
        "part": "failures",
        "task": each.name,
        "why": each.why,
        "failed": failed,
        "report": report,
        "names_step": each.step in report,
        "names_cause": all(word in report for word in each.says),
        "ms": (time.process_time() - began) * 1e3,
    }
