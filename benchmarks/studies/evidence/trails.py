"""Are the trails of plans valid, how large are they, and what do they cost to write and to check?"""

from __future__ import annotations

import json
import time
from typing import Any

from rich.table import Table

from auditor.schema import Invalid
from auditor.verify import verify
from benchmarks.harness.report import Promise, Report, Row, grouped, least_seconds, p50, spread, table_of
from benchmarks.studies.evidence.worlds import plans
from planner_service.records import SavedPlan
from planner_service.records.evidence import EVIDENCE, with_evidence
from planner_service.records.recertify import recertify

__all__ = ["run"]

PLANS = 500
RATIO = 3.0
"""Promised: writing a trail takes at most so many times what proving the plan takes."""


def run(queries: int | None, seed: int) -> Report:
    """Measure so many plans."""
    rows = [_row(name, plan) for name, _, plan in plans(queries or PLANS, seed)]
    refused = [row for row in rows if row["invalid"] is not None]
    ratio = p50(row["write"] / row["prove"] for row in rows)
    promises = (
        Promise(f"all of {len(rows)} trails are valid", f"{len(refused)} are not", not refused),
        Promise(f"a trail takes at most {RATIO:g} times its proof", f"{ratio:.2f} times at p50", ratio <= RATIO),
    )
    return Report("evidence", tuple(rows), (_table(rows), _why(refused)) if refused else (_table(rows),), promises)


def _row(name: str, plan: SavedPlan) -> Row:
    (prove, recertified), (write, shown) = (
        least_of(lambda: recertify(plan, allowed=plan.allowed)),
        least_of(lambda: with_evidence(plan)),
    )
    text = shown.file_text()
    document = json.loads(text)
    clock, invalid = time.process_time(), None
    try:
        kept = sum("constraints kept" in line for line in verify(document))
    except Invalid as why:
        kept, invalid = 0, str(why)
    return {
        "plans": name,
        "prove": prove * 1e3,
        "write": write * 1e3,
        "check": (time.process_time() - clock) * 1e3,
        "kilobytes": len(json.dumps(document["sections"][EVIDENCE])) / 1e3,
        "clearance": recertified.motions[0].certificate.clearance,
        "kept": kept,
        "held": len(plan.scene.attached),
        "blends": int((recertified.motions[0].motion.trajectory.path.blends > 0).sum()),
        "invalid": invalid,
    }


def least_of(work: Any) -> tuple[float, Any]:
    """Seconds of CPU of the faster of two runs, and its result."""
    clock = time.process_time()
    made = work()
    first = time.process_time() - clock
    (second,) = least_seconds(work, turns=1)
    return min(first, second), made


def _table(rows: list[Row]) -> Table:
    lines = [
        {
            "plans": name,
            "count": str(len(group)),
            "valid": str(sum(row["invalid"] is None for row in group)),
            "held": str(sum(row["held"] > 0 for row in group)),
            "with blends": str(sum(row["blends"] > 0 for row in group)),
            "kB": spread([row["kilobytes"] for row in group], 1),
            "proof ms": spread([row["prove"] for row in group], 1),
            "trail ms": spread([row["write"] for row in group], 1),
            "check ms": spread([row["check"] for row in group]),
        }
        for name, group in grouped(rows, "plans").items()
    ]
    caption = "p50 / p95 of CPU time: proving again what a file claims, the same with its trail, and verify.py"
    return table_of("Trails of proofs", lines, caption=caption)


def _why(refused: list[Row]) -> Table:
    return table_of("Not valid", [{"plans": row["plans"], "why": row["invalid"]} for row in refused[:20]])
