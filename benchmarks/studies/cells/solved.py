"""Whether every object of every cell gets to its place: by plans that are proven, and that the auditor finds free."""

from __future__ import annotations

import time

import planner_service as ps
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, p50, spread, table_of
from benchmarks.studies.cells.work import Work, kept_rows, objections, solved
from benchmarks.worlds.cells import Cell

__all__ = ["run"]

MORE = 100
"""Times the budget with which it is decided whether what has no plan has one."""

CHECKS = 300_000
"""States of each motion, at most."""


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """Each cell from its first object to its last."""
    rows = kept_rows("solved", _rows, queries, seed, robot, kept)
    lines = []
    for name in dict.fromkeys(row["cell"] for row in rows):
        mine = [row for row in rows if row["cell"] == name]
        done = [row for row in mine if row["ok"]]
        lines.append(
            {
                "cell": name,
                "solved": f"{len(done)} of {len(mine)}",
                "solvable": sum(row["solvable"] for row in mine),
                "motions": f"{sum(row['motions'] for row in mine):,}",
                "rejected": sum(bool(row["objections"]) for row in mine),
                "states": spread([row["states"] for row in mine]),
                "CPU ms": spread([row["ms"] for row in mine]),
                "motion s": f"{p50(row['seconds'] for row in done):.1f}" if done else "-",
            }
        )
    solvable = [row for row in rows if row["solvable"]]
    missed = [row for row in solvable if not row["ok"]]
    rejected = [row for row in rows if row["objections"]]
    promises = (
        Promise("of what can be done, all is", f"{len(solvable) - len(missed)} of {len(solvable)}", not missed),
        Promise("motions that the auditor finds touching", f"{len(rejected)} of {len(rows)} jobs", not rejected),
    )
    caption = f"p50 / p95 of a job. Solvable: by {MORE} times the budget where it was not solved."
    return Report("cells solved", tuple(rows), (table_of("Cells", lines, caption=caption),), promises)


def _rows(cell: Cell, queries: int | None) -> list[Row]:
    work, rows = Work.begun(cell), []
    for job in cell.jobs[:queries]:
        work = work.facing(job)
        request = ps.PlanRequest(work.q, work.q, max_checks=CHECKS, time_limit=None)
        began = time.process_time()
        done = solved(work, job, request)
        spent = time.process_time() - began
        row: Row = {
            "part": "solved",
            "cell": cell.name,
            "job": job.name,
            "ok": done.ok,
            "solvable": done.ok,
            "failure": str(done.failure or ""),
            "motions": len(done.segments),
            "objections": objections(cell.robot, done),
            "states": done.counts.states,
            "ms": spent * 1e3,
            "seconds": done.duration,
        }
        if not done.ok:
            done = solved(work, job, request, times=MORE)
            row["solvable"] = done.ok
        rows.append(row)
        if done.ok:
            work = work.after(done)
    return rows
