"""What building a planner costs and what asking it then costs, apart: of roadmaps."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks.harness.rows import Row, states_of
from benchmarks.pages.page_numbers import OURS, Group, Sheet, seconds, stage_seconds
from benchmarks.pages.page_tables import NOTHING, Cell, Sheaf
from planner_service import Stage

__all__ = ["builds"]

GROWING = Stage.ROADMAP.value
BESIDE = "rrtconnect"
"""The planner beside which a roadmap has to pay."""


def builds(sheet: Sheet) -> Sheaf | None:
    """A row for each contender that builds something, and the planner beside which it has to pay; None if none does."""
    found = [group for group in sheet.present if group.tool == OURS and any(map(_builds, group.rows))]
    if not found:
        return None
    beside = next((group for group in sheet.present if (group.tool, group.planner) == (OURS, BESIDE)), None)
    heads = (
        Cell("built"),
        Cell("how often"),
        Cell("states of a build", "p50"),
        Cell("ms of a build", "p50"),
        Cell("states of a query", "p50 / p95"),
        Cell("in its search", "p50 / p95"),
        Cell("ms of a query", "p50 / p95"),
        Cell("pays after", f"queries, beside {BESIDE}"),
    )
    rows = [_row(group, beside) for group in found]
    if beside is not None:
        rows.append(_row(beside, None))
    caption = (
        "A roadmap is built once for each scene and seed, before the queries, whose other figures leave it out; what a "
        "planner grows within a plan is in these. Query: the plan without growing, failures with what they spent. "
        "Pays: where the p50 of states of so many queries and one build is less."
    )
    return Sheaf("Building and asking", heads, tuple(rows), caption)


def _builds(row: Row) -> bool:
    return "built" in row or GROWING in row["checks"]


def _row(group: Group, beside: Group | None) -> tuple[Cell, ...]:
    once = [row for row in group.rows if "built" in row]
    each = [row for row in group.rows if GROWING in row["checks"]]
    middle = np.percentile([_asking(row) for row in group.rows], 50)
    if once:
        distinct = {(row["kind"], row["seed"], row["built"]["cpu_seconds"]): row["built"] for row in once}
        often = f"{len(distinct)} for {len(once)} plans"
        states = [built["states"] for built in distinct.values()]
        ms = [1e3 * built["cpu_seconds"] for built in distinct.values()]
    else:
        often = "each plan" if each else NOTHING
        states = [states_of(row, GROWING) for row in each]
        ms = [1e3 * stage_seconds(row, GROWING) for row in each]
    pays = NOTHING
    if beside is not None and once:
        saved = np.percentile([_asking(row) for row in beside.rows], 50) - middle
        pays = f"{np.percentile(states, 50) / saved:,.0f}" if saved > 0.0 else "never"
    return (
        Cell(group.name),
        Cell(often),
        _middle(states),
        _middle(ms),
        _spread(_asking(row) for row in group.rows),
        _spread(states_of(row, Stage.SEARCH.value) for row in group.rows),
        _spread(1e3 * (seconds(row) - stage_seconds(row, GROWING)) for row in group.rows),
        Cell(pays),
    )


def _asking(row: Row) -> int:
    """States of a plan without growing."""
    return states_of(row) - states_of(row, GROWING)


def _middle(values: Iterable[float]) -> Cell:
    found = list(values)
    return Cell(f"{np.percentile(found, 50):,.0f}" if found else NOTHING)


def _spread(values: Iterable[float]) -> Cell:
    found = list(values)
    low, high = np.percentile(found, [50, 95])
    return Cell(f"{low:,.0f} / {high:,.0f}" if high >= 100.0 else f"{low:,.1f} / {high:,.1f}")
