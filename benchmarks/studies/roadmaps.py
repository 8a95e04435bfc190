"""Queries of a roadmap that was built before, or of a memory of paths, next to searches for the same queries."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from unittest import mock

from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, p50, spread, table_of
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service.search.problem import Planner

__all__ = ["DEFAULT", "FRESH", "PROMISED", "asked", "experienced", "fell_back", "promises", "run"]

SEARCHES: tuple[Planner, ...] = (ps.BalancedRRTConnect(), ps.RRTConnect())
"""What roadmaps are compared with: the default, which the promises are about, and OMPL's."""

DEFAULT = SEARCHES[0].name

SCENES = ("bin", "shelf", "post", "clutter")
PROMISED = ("bin", "shelf")
"""Scenes of the promises; the others are shown, with the first seed."""

SEEDS = (0, 1, 2)
BEFORE = (10, 20)
"""Other queries that a roadmap has planned before, drawn with this seed."""

TRAINING_SEED = 77
TURNS = 2

STATES_P50, SHARE, MS_P50 = 150, 1 / 5, 0.3
"""Promised of a warm query."""

FRESH = "fresh"


def asked(service: ps.PlannerService, planner: Planner, some: Iterable[Query], turns: int = TURNS) -> Row:
    """Each query planned ``turns`` times: states and CPU ms of its search, those of growing a roadmap included."""
    row: Row = {"states": [], "ms": [], "fell_back": 0, "solved": 0, "asked": 0}
    for query in some:
        with mock.patch("time.perf_counter", time.process_time):  # the clock of the stages
            found = [plan(service, query, planner=planner) for _ in range(turns)]
        parts = [result.stage(stage) for result in found[:1] for stage in (ps.Stage.ROADMAP, ps.Stage.SEARCH)]
        row["states"].append(sum(part.counts.states for part in parts))
        row["ms"].append(min(1e3 * result.stage(ps.Stage.SEARCH).seconds for result in found))
        row["fell_back"] += fell_back(found[0])
        row["solved"] += found[0].ok
        row["asked"] += 1
    return row


def fell_back(result: ps.PlanResult) -> bool:
    """Whether the roadmap had no path."""
    return any(planner.name in result.stage(ps.Stage.SEARCH).note for planner in SEARCHES)


def experienced(service: ps.PlannerService, roadmap: ps.Roadmap, count: int) -> ps.Roadmap:
    """A roadmap that has planned other queries of the scene and remembers their paths."""
    found = replace(roadmap, remember=True)
    for query in queries.draw(service.scene.name, count, seed=TRAINING_SEED):
        found = plan(service, query, planner=found).roadmap or found
    return replace(found, remember=False)


def _rows() -> Iterator[Row]:
    """A row for each scene and planner."""
    for scene in SCENES:
        service, some = ps.PlannerService(queries.ROBOT, scene), queries.load(scene)
        for planner in SEARCHES:
            yield {"scene": scene, "what": planner.name, "seed": 0} | asked(service, planner, some)
        for seed in SEEDS if scene in PROMISED else SEEDS[:1]:
            built = service.build_roadmap(ps.PRM(milestones=1000, neighbours=10), seed=seed, progress=False)
            states = 0 if built.built is None else built.built.counts.states
            row = {"scene": scene, "seed": seed, "build": states}
            yield row | {"what": FRESH} | asked(service, built, some)
            for count in BEFORE:
                yield row | {"what": f"after {count}"} | asked(service, experienced(service, built, count), some)
        for count in BEFORE:
            known = experienced(service, service.path_memory(), count)
            yield {"scene": scene, "seed": 0, "what": f"memory of {count}"} | asked(service, known, some)


def run() -> Report:
    """Measure; about two minutes."""
    rows = tuple(_rows())
    return Report("roadmaps", rows, (_table(rows),), promises(rows))


def _tree(rows: Iterable[Row], scene: str) -> Row:
    """The default search's row of a scene."""
    return next(row for row in rows if (row["scene"], row["what"]) == (scene, DEFAULT))


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What a warm query was to cost, of each kind of roadmap on its own."""
    found: list[Promise] = []
    searches = {planner.name for planner in SEARCHES}
    for what in dict.fromkeys(row["what"] for row in rows if row["what"] not in searches):
        for scene in PROMISED:
            here, tree = [r for r in rows if (r["scene"], r["what"]) == (scene, what)], _tree(rows, scene)
            states = [p50(row["states"]) for row in here]
            shares = [states / p50(tree["states"]) for states in states]
            search = [p50(row["ms"]) for row in here]
            solved = [row["solved"] for row in here]
            name, no_less = f"warm query, {what}, {scene}", min(solved) >= tree["solved"]
            counts = f"{_listed(solved, 0)} of {tree['asked']}; {DEFAULT} {tree['solved']}"
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
    lines = (
        {
            "scene": row["scene"],
            "roadmap": row["what"],
            "seed": row["seed"] if "build" in row else "-",
            "build states": f"{row['build']:,}" if "build" in row else "-",
            "search states": spread(row["states"]),
            "share": f"{p50(row['states']) / p50(_tree(rows, row['scene'])['states']):.2f}",
            "search ms": spread(row["ms"], 2),
            "fell back": row["fell_back"],
            "solved": f"{row['solved']}/{row['asked']}",
        }
        for row in rows
    )
    caption = (
        f"PRM(1000, 10); 20 stored queries, p50 / p95, default edge step. Share: of {DEFAULT}'s p50. CPU ms, the less "
        f"of {TURNS} turns. after N: has planned N other queries and remembers their paths; memory of N: of nothing "
        "but N such paths."
    )
    return table_of("Warm queries", lines, caption=caption)
