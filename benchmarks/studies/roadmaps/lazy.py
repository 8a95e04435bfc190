"""A roadmap of which nothing is judged, built for a single query, next to searches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, p50, spread, table_of
from benchmarks.studies.roadmaps.asked import DEFAULT, SEARCHES, asked
from benchmarks.worlds import queries
from planner_service import LazyPRM, PlannerService

__all__ = ["lazy_rows", "measured", "promises"]

SCENES = ("post", "bin", "shelf", "clutter")
PROMISED = ("post", "bin")
ROUNDS = (0, 1, 2)
"""Rounds of the stored queries, each with other seeds."""

LAZY = LazyPRM.name


def lazy_rows(scenes: Sequence[str] = SCENES, rounds: Sequence[int] = ROUNDS) -> Iterator[Row]:
    """A row for each scene and planner."""
    for scene in scenes:
        service, stored = PlannerService(queries.ROBOT, scene), queries.load(scene)
        some = [replace(query, number=query.number + turn * len(stored)) for turn in rounds for query in stored]
        for planner in (LazyPRM(), *SEARCHES):
            yield {"scene": scene, "what": planner.name} | asked(service, planner, some, turns=1)


def measured() -> Report:
    """Measure."""
    rows = tuple(lazy_rows())
    return Report("lazy", rows, (_table(rows),), promises(rows))


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What a single problem was to cost."""
    found = []
    for scene in PROMISED:
        middle = {row["what"]: p50(row["states"]) for row in rows if row["scene"] == scene}
        text = f"lazy build and query of a single problem, {scene}: no more states p50 than {DEFAULT}"
        told = f"{middle[LAZY]:.0f}; {DEFAULT} {middle[DEFAULT]:.0f}"
        found.append(Promise(text, told, middle[LAZY] <= middle[DEFAULT]))
    return tuple(found)


def _table(rows: Sequence[Row]) -> Table:
    lines = (
        {"scene": row["scene"], "planner": row["what"], "roadmap and search states": spread(row["states"])}
        | {"search ms": spread(row["search_ms"], 2), "not solved": f"{row['asked'] - row['solved']} of {row['asked']}"}
        for row in rows
    )
    caption = (
        f"Stored queries, each with {len(ROUNDS)} seeds; p50 / p95. States of growing (none) and of the search; "
        "failures with what they spent: there is no fallback here."
    )
    return table_of("A single problem", lines, caption=caption)
