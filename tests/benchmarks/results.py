"""Rows and results files that tests make up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.harness.rows import Row, line_of

HEADER: dict[str, Any] = {
    "version": 1,
    "suite": "some",
    "environment": {"python": "3.12.1", "platform": "Linux", "cpu": "a <fast> one", "cores": 2}
    | {"versions": {"ompl": "2.0.1"}, "commit": "abc123", "instruction_set": "avx2"},
    "command": ["run", "--suite", "some"],
}
FREE = {"step": 0.01, "verdict": "free", "depth": None, "pair": None}
UNASKED = {"step": None, "verdict": "not_asked", "depth": None, "pair": None}


def row(problem: str, seed: int = 0, **changes: Any) -> Row:
    """A row with a path."""
    made: Row = {"suite": "some", "problem": problem, "kind": problem[0], "robot": "r", "tool": "planner_service"}
    made |= {"planner": "a", "seed": seed, "ok": True, "failure": None, "detail": "", "seconds": {}}
    made |= {"total_seconds": 0.1, "cpu_seconds": 0.1, "raw_length": 3.0, "length": 2.0, "duration": 1.0}
    made |= {"clearance": 0.001, "peaks": None, "path_hash": "x", "audit": FREE, "checks": counted(100, certify=9)}
    return made | changes


def counted(states: int, certify: int = 0) -> dict[str, Any]:
    """Checks of a search, and the bounds of a certificate."""
    checks = {"search": {"states": states, "edges": 10, "distances": 0}}
    return checks | ({"certify": {"states": 0, "edges": 0, "distances": certify}} if certify else {})


def results_file(path: Path, *found: Row, tail: str = "") -> Path:
    """A results file of some rows."""
    path.write_text("".join(map(line_of, [{"header": HEADER}, *found])) + tail, "utf-8")
    return path
