"""Stored queries asked of a planner: what the search judged and took, and what all that comes before the proof took."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from unittest import mock

from benchmarks.harness.report import Row
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service import BalancedRRTConnect, PlannerService, PlanResult, Roadmap, RRTConnect, Stage
from planner_service.search.problem import Planner

__all__ = [
    "DEFAULT",
    "SEARCHES",
    "TRAINING_SEED",
    "asked",
    "built_states",
    "chained",
    "experienced",
    "fell_back",
    "search_states",
    "timed",
]

SEARCHES: tuple[Planner, ...] = (BalancedRRTConnect(), RRTConnect())
"""What roadmaps are compared with: the default, which the promises are about, and OMPL's."""

DEFAULT = SEARCHES[0].name

TRAINING_SEED = 77
"""Of the queries that a roadmap has planned before it is asked the stored ones."""

PROVEN = (Stage.CERTIFY, Stage.TIMING)


def asked(service: PlannerService, planner: Planner, some: Iterable[Query], *, turns: int) -> Row:
    """Each query planned ``turns`` times: states of the search with those of growing, ms the least of the turns."""
    return _row([timed(service, planner, query) for _ in range(turns)] for query in some)


def chained(service: PlannerService, roadmap: Roadmap, some: Iterable[Query]) -> tuple[Row, Roadmap]:
    """The same, each query asked once of the roadmap that the one before left, and what the last one leaves."""
    found = []
    for query in some:
        found.append([timed(service, roadmap, query)])
        roadmap = found[-1][0][0].roadmap or roadmap
    return _row(found), roadmap


def _row(found: Iterable[Sequence[tuple[PlanResult, float, float]]]) -> Row:
    row: Row = {"states": [], "search_ms": [], "before_ms": [], "fell_back": 0, "solved": 0, "asked": 0}
    for turns in found:
        result = turns[0][0]
        row["states"].append(search_states(result))
        row["search_ms"].append(min(ms for _, ms, _ in turns))
        row["before_ms"].append(min(ms for _, _, ms in turns))
        row["fell_back"] += fell_back(result)
        row["solved"] += result.ok
        row["asked"] += 1
    return row


def timed(service: PlannerService, planner: Planner, query: Query) -> tuple[PlanResult, float, float]:
    """A plan, and CPU ms of its search and of all that comes before proof and timing."""
    # Stages are told by a clock that counts what others do on the same cores, too.
    with mock.patch("time.perf_counter", time.process_time):
        result = plan(service, query, planner=planner)
    before = math.fsum(report.seconds for report in result.stages if report.stage not in PROVEN)
    return result, result.stage(Stage.SEARCH).seconds * 1e3, before * 1e3


def built_states(roadmap: Roadmap) -> int:
    """States that growing it asked for."""
    return 0 if roadmap.built is None else roadmap.built.counts.states


def search_states(result: PlanResult) -> int:
    """States of growing a roadmap and of the search."""
    return result.stage(Stage.ROADMAP).counts.states + result.stage(Stage.SEARCH).counts.states


def fell_back(result: PlanResult) -> bool:
    """Whether the roadmap had no path."""
    return any(planner.name in result.stage(Stage.SEARCH).note for planner in SEARCHES)


def experienced(service: PlannerService, roadmap: Roadmap, count: int) -> Roadmap:
    """A roadmap that has planned other queries of the scene and remembers their paths."""
    found = replace(roadmap, remember=True)
    for query in queries.draw(service.scene.name, count, seed=TRAINING_SEED):
        found = plan(service, query, planner=found).roadmap or found
    return replace(found, remember=False)
