"""What is stored with the code, made again: the queries, and what planning them costs."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.harness.report import p50, p95
from benchmarks.studies.states import SHOWN, STEPS, plan
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service import PlannerService, PlanResult, Trapezoidal
from planner_service.files.writing import write_whole

__all__ = [
    "GOLDEN",
    "REGENERATE",
    "differences",
    "fingerprint",
    "golden",
    "golden_rows",
    "load_golden",
    "main",
    "spread_of",
    "text_of",
]

GOLDEN = Path(__file__).parents[2] / "tests" / "golden" / "states.json"

REGENERATE = "python -m benchmarks golden --write"
"""What stores a change of counts that is meant."""

Row = dict[str, Any]


def fingerprint(result: PlanResult) -> Row:
    """Counts by stage as [states, edges, distances], and a hash of every bit of the path's waypoints and blends."""
    points = None if result.path is None else result.path.waypoints.tolist()
    bits = None
    if result.path is not None:
        values = [*result.path.waypoints.ravel().tolist(), *result.path.blends.tolist()]
        bits = hashlib.sha256(" ".join(value.hex() for value in values).encode()).hexdigest()
    return {
        "outcome": "planned" if result.failure is None else result.failure.reason.value,
        "stages": {r.stage.value: [r.counts.states, r.counts.edges, r.counts.distances] for r in result.stages},
        "waypoints": 0 if points is None else len(points),
        "path": bits,
    }


def golden_rows(step: str, scene: str, chosen: Iterable[Query]) -> dict[str, Row]:
    """Fingerprints by query name. The timing law does not touch counts or geometry: the quickest will do."""
    service = PlannerService(queries.ROBOT, scene, edge_step=STEPS[step])
    return {query.name: fingerprint(plan(service, query, timing=Trapezoidal())) for query in chosen}


def golden() -> Row:
    """All stored queries with both steps, and p50 and p95 of the states by stage."""
    content: Row = {}
    for step in STEPS:
        rows = {scene: golden_rows(step, scene, queries.load(scene)) for scene in queries.SCENES}
        content[step] = {
            "p50_p95": {scene: spread_of(here) for scene, here in rows.items()},
            "queries": {name: row for here in rows.values() for name, row in here.items()},
        }
    return content


def spread_of(rows: Mapping[str, Row]) -> dict[str, list[float]]:
    """[p50, p95] of the states of each stage and of all of them."""
    per_stage = {stage.value: [row["stages"].get(stage.value, [0])[0] for row in rows.values()] for stage in SHOWN}
    per_stage["total"] = [sum(counts[0] for counts in row["stages"].values()) for row in rows.values()]
    return {stage: [round(p50(values), 2), round(p95(values), 2)] for stage, values in per_stage.items()}


def differences(stored: Mapping[str, Row], now: Mapping[str, Row]) -> list[str]:
    """What changed, stage by stage, in words; only the queries of ``now`` are compared."""
    found = []
    for name, row in now.items():
        old = stored.get(name)
        if old is None:
            found.append(f"{name}: not stored")
            continue
        for stage in dict.fromkeys([*old["stages"], *row["stages"]]):
            before, after = old["stages"].get(stage), row["stages"].get(stage)
            if before != after:
                found.append(f"{name}: {stage} [states, edges, distances] {before} -> {after}")
        found += [f"{name}: {key} {old[key]} -> {row[key]}" for key in ("outcome", "waypoints") if old[key] != row[key]]
        if old["path"] != row["path"]:
            found.append(f"{name}: the path's bits changed")
    return found


def text_of(content: Row) -> str:
    """The stored file: one query a line, so that a change reads well in a diff."""
    parts = []
    for step, told in content.items():
        sections = []
        for key, rows in told.items():
            lines = ",\n".join(f"   {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items())
            sections.append(f"  {json.dumps(key)}: {{\n{lines}\n  }}")
        parts.append(f" {json.dumps(step)}: {{\n" + ",\n".join(sections) + "\n }")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def load_golden() -> Row:
    """The stored file."""
    content: Row = json.loads(GOLDEN.read_text("utf-8"))
    return content


def main(what: str, *, write: bool, console: Console) -> int:
    """Store, or compare with what is stored; 0 if equal or stored."""
    made = {path: text for path, text in _made(what).items() if not path.exists() or path.read_text("utf-8") != text}
    for path, text in made.items():
        if write:
            write_whole(path, text)
            console.print(f"stored {path.name}")
        else:
            old = path.read_text("utf-8").splitlines() if path.exists() else []
            for line in difflib.unified_diff(old, text.splitlines(), path.name, "now", lineterm="", n=0):
                console.print(line, markup=False, highlight=False, soft_wrap=True)
    if not made:
        console.print(f"{what}: equal to what is stored")
    elif not write:
        console.print(f"store it with: python -m benchmarks {what} --write")
    return 1 if made and not write else 0


def _made(what: str) -> dict[Path, str]:
    if what == "golden":
        from benchmarks.harness import stored_roadmaps  # which tells its queries as this module does

        return {
            GOLDEN: text_of(golden()),
            stored_roadmaps.GOLDEN: stored_roadmaps.text_of(stored_roadmaps.golden()),
        }
    return {queries.FOLDER / f"{scene}.json": queries.text_of(queries.draw(scene)) for scene in queries.SCENES}
