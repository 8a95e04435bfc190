"""Suites of problems by several planners, every path judged by Coal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

import planner_service as ps
from benchmarks.harness.attempts import states_of
from benchmarks.harness.report import Report, Row, grouped, merged, p50, spread, table_of
from benchmarks.harness.runner import jobs_of, made
from benchmarks.harness.suite import SUITES, Suite, published

__all__ = ["PARTS", "run"]

PARTS = tuple(SUITES)


def run(
    part: str | None = None, seeds: int | None = None, problems: Path | None = None, robot: str | None = None
) -> Report:
    """Plan one suite, or all; the planners are those that it names.

    Args:
        seeds: Plans of each problem by each planner; as many as the suite says if None.
        problems: A published problem set to plan instead, with a robot that comes with the package.
    """
    if problems is not None:
        if robot is None:
            raise ps.InvalidRequest("--robot", None, "the robot that the problems are for, such as panda_mbm")
        return _suite(published(problems, robot), seeds)
    return merged(
        "suites" if part is None else part, [_suite(SUITES[name], seeds) for name in PARTS if part in (None, name)]
    )


def _suite(suite: Suite, seeds: int | None) -> Report:
    rows = tuple(made(jobs_of(suite, seeds=() if seeds is None else range(seeds)), Console(stderr=True)))
    return Report(suite.name, rows, (_table(suite.about, rows), _kinds(rows)))


def _table(title: str, rows: Sequence[Row]) -> Table:
    """A line for each planner."""

    def line(planner: str, here: Sequence[Row]) -> Row:
        done = [row for row in here if row["ok"]]
        return {
            "planner": planner,
            "solved": f"{len(done)}/{len(here)}",
            "rejected": sum(row["audit"]["verdict"] != "free" for row in done),
            "states": spread([states_of(row) for row in here]),
            "CPU ms": spread([1e3 * row["cpu_seconds"] for row in here], 1),
            "rad": _middle(done, "length"),
            "motion s": _middle(done, "duration"),
            "least mm clear": f"{1e3 * min(clear):.2f}" if (clear := _values(done, "clearance")) else "-",
        }

    caption = (
        "p50 / p95, failures with what they spent; rad, s and mm of paths that were found. Rejected: by Coal, every "
        "0.01 rad."
    )
    return table_of(title, (line(*group) for group in grouped(rows, "planner").items()), caption=caption)


def _values(rows: Sequence[Row], key: str) -> list[float]:
    return [row[key] for row in rows if row[key] is not None]


def _middle(rows: Sequence[Row], key: str) -> str:
    values = _values(rows, key)
    return f"{p50(values):.2f}" if values else "-"


def _kinds(rows: Sequence[Row]) -> Table:
    """How many problems of each kind are solved, and the median time of a plan."""

    def cell(here: Sequence[Row]) -> str:
        return f"{sum(row['ok'] for row in here)}/{len(here)}, {p50(1e3 * row['cpu_seconds'] for row in here):.3g} ms"

    lines = (
        {"solved, CPU ms p50": planner} | {kind: cell(some) for kind, some in grouped(here, "kind").items()}
        for planner, here in grouped(rows, "planner").items()
    )
    return table_of("By kind of problem", lines)
