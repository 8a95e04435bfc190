"""What building a planner costs and what asking it then costs, apart: of roadmaps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from benchmarks.harness.report import p50, p95, spread
from benchmarks.harness.rows import Row, states_of
from benchmarks.pages.page_numbers import OURS, Group, Sheet, seconds, stage_seconds
from benchmarks.pages.page_tables import NOTHING, Cell, Sheaf
from planner_service import BalancedRRTConnect, RRTConnect, Stage

__all__ = ["builds"]

GROWING = Stage.ROADMAP.value
BESIDE = BalancedRRTConnect.name
"""The planner beside which a roadmap has to pay: the default."""


def builds(sheet: Sheet) -> Sheaf | None:
    """A row for each contender that builds something, then the default and OMPL's RRTConnect; None if none does."""
    found = [group for group in sheet.present if group.tool == OURS and any(map(_builds, group.rows))]
    if not found:
        return None
    ours = {group.planner: group for group in sheet.present if group.tool == OURS}
    lines = [_line(group, ours.get(BESIDE)) for group in found]
    lines += [_line(ours[name], None) for name in (BESIDE, RRTConnect.name) if name in ours]
    caption = (
        "A roadmap is built once for each scene and seed, before the queries, whose other figures leave it out; what a "
        "planner grows within a plan is in these. Query: the plan without growing, failures with what they spent. "
        "Pays: where the p50 of states of so many queries and one build is less."
    )
    return Sheaf.of("Building and asking", lines, caption)


def _builds(row: Row) -> bool:
    return "built" in row or GROWING in row["checks"]


def _line(group: Group, beside: Group | None) -> dict[Cell | str, Cell | str]:
    once = [row for row in group.rows if "built" in row]
    each = [row for row in group.rows if GROWING in row["checks"]]
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
        saved = p50(map(_asking, beside.rows)) - p50(map(_asking, group.rows))
        pays = f"{p50(states) / saved:,.0f}" if saved > 0.0 else "never"
    query_ms = (1e3 * (seconds(row) - stage_seconds(row, GROWING)) for row in group.rows)
    return {
        "built": group.name,
        "how often": often,
        Cell("states of a build", "p50"): _middle(states),
        Cell("ms of a build", "p50"): _middle(ms),
        Cell("states of a query", "p50 / p95"): _spread(_asking(row) for row in group.rows),
        Cell("in its search", "p50 / p95"): _spread(states_of(row, Stage.SEARCH.value) for row in group.rows),
        Cell("ms of a query", "p50 / p95"): _spread(query_ms),
        Cell("pays after", f"queries, beside {BESIDE}"): pays,
    }


def _asking(row: Row) -> int:
    """States of a plan without growing."""
    return states_of(row) - states_of(row, GROWING)


def _middle(values: Sequence[float]) -> str:
    return f"{p50(values):,.0f}" if values else NOTHING


def _spread(values: Iterable[float]) -> str:
    found = list(values)
    return spread(found, 0 if p95(found) >= 100.0 else 1)
