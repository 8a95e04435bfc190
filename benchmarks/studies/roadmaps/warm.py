"""Queries of a roadmap that was built before, next to searches for the same queries."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, p50, spread, table_of
from benchmarks.studies.roadmaps.asked import DEFAULT, SEARCHES, asked, built_states, experienced
from benchmarks.worlds import queries
from planner_service import PRM, PlannerService

__all__ = ["FRESH", "PROMISED", "measured", "promises", "warm_rows"]

SCENES = ("bin", "shelf", "post", "clutter")
PROMISED = ("bin", "shelf")
"""Scenes of the promises; the others are told, of the first seed."""

SEEDS = (0, 1, 2)
BEFORE = (10, 20)
"""Other queries that a roadmap has planned before it is asked."""

TURNS = 2

STATES_P50, SHARE, MS_P50 = 150, 1 / 5, 0.4
"""Promised of a warm query."""

FRESH = "fresh"


def warm_rows(
    scenes: Sequence[str] = SCENES, seeds: Sequence[int] = SEEDS, before: Sequence[int] = BEFORE, *, turns: int = TURNS
) -> Iterator[Row]:
    """A row for each scene and planner; a roadmap is one that was built, or a memory of paths alone."""
    for scene in scenes:
        service, some = PlannerService(queries.ROBOT, scene), queries.load(scene)
        for planner in SEARCHES:
            yield {"scene": scene, "what": planner.name, "seed": 0} | asked(service, planner, some, turns=turns)
        for seed in seeds if scene in PROMISED else seeds[:1]:
            built = service.build_roadmap(PRM(milestones=1000, neighbours=10), seed=seed, progress=False)
            told = {"scene": scene, "seed": seed, "build": built_states(built)}
            yield told | {"what": FRESH} | asked(service, built, some, turns=turns)
            for count in before:
                known = experienced(service, built, count)
                yield told | {"what": f"after {count}"} | asked(service, known, some, turns=turns)
        for count in before:
            known = experienced(service, service.path_memory(), count)
            told = {"scene": scene, "seed": 0, "what": f"memory of {count}"}
            yield told | asked(service, known, some, turns=turns)


def measured() -> Report:
    """Measure."""
    rows = tuple(warm_rows())
    return Report("warm", rows, (_table(rows),), promises(rows))


def _is_search(row: Row) -> bool:
    return row["what"] in {planner.name for planner in SEARCHES}


def _kinds(rows: Iterable[Row]) -> list[str]:
    return list(dict.fromkeys(row["what"] for row in rows if not _is_search(row)))


def _tree(rows: Iterable[Row], scene: str) -> Row:
    """The default search's row of a scene."""
    return next(row for row in rows if (row["scene"], row["what"]) == (scene, DEFAULT))


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What a warm query was to cost, of each kind of roadmap on its own."""
    found: list[Promise] = []
    for what in _kinds(rows):
        for scene in PROMISED:
            here, tree = [r for r in rows if (r["scene"], r["what"]) == (scene, what)], _tree(rows, scene)
            states = [p50(row["states"]) for row in here]
            shares = [p50(row["states"]) / p50(tree["states"]) for row in here]
            search = [p50(row["search_ms"]) for row in here]
            solved = [row["solved"] for row in here]
            name = f"warm query, {what}, {scene}"
            counts = f"{_listed(solved, 0)} of {tree['asked']}; {DEFAULT} {tree['solved']}"
            no_less = min(solved) >= tree["solved"]
            found += [
                Promise(f"{name}: at most {STATES_P50} states p50", _listed(states, 0), max(states) <= STATES_P50),
                Promise(f"{name}: at most {SHARE:g} of {DEFAULT}'s", _listed(shares, 2), max(shares) <= SHARE),
                Promise(f"{name}: a search of at most {MS_P50:g} ms p50", _listed(search, 2), max(search) <= MS_P50),
                Promise(f"{name}: solved no less often than by {DEFAULT}", counts, no_less),
            ]
    return tuple(found)


def _listed(values: Iterable[float], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def _table(rows: Sequence[Row]) -> Table:
    def line(row: Row) -> Row:
        return {
            "scene": row["scene"],
            "roadmap": row["what"],
            "seed": row["seed"] if "build" in row else "-",
            "build states": f"{row['build']:,}" if "build" in row else "-",
            "search states": spread(row["states"]),
            "share": f"{p50(row['states']) / p50(_tree(rows, row['scene'])['states']):.2f}",
            "search ms": spread(row["search_ms"], 2),
            "before proof ms": spread(row["before_ms"], 2),
            "fell back": "-" if _is_search(row) else row["fell_back"],
            "solved": f"{row['solved']}/{row['asked']}",
        }

    caption = (
        f"PRM(1000, 10); 20 stored queries, p50 / p95, default edge step. Share: of {DEFAULT}'s p50. Before proof: "
        f"ends, straight line, search, shortcut and blends. CPU ms, the less of {TURNS} turns, caches warm. after N: "
        "has planned N other queries and remembers their paths; memory of N: of nothing but N such paths."
    )
    return table_of("Warm queries", map(line, rows), caption=caption)
