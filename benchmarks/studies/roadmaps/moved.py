"""One of ten obstacles moves: what a roadmap asks again, and whether anything it then says is out of date.

Every path planned over it is put before the independent checker, every verdict before a judge who remembers nothing.
"""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

import planner_service as ps
from benchmarks.harness.audit import JOINT_STEP, NOT_ASKED, Auditor, along
from benchmarks.harness.report import Promise, Report, Row, p50, p95, spread, table
from benchmarks.studies.roadmaps.asked import DEFAULT, SEARCHES, built_states, fell_back, search_states
from benchmarks.worlds import queries
from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.roadmap_work import RoadmapUpdate
from planner_service.roadmap import Verdict
from planner_service.scene.scene import load_scene
from planner_service.search.problem import Planner

__all__ = ["measured", "moved_scene", "promises", "ten_obstacles", "untrue"]

OBJECTS = 9
"""Things on and above the table, which is the tenth obstacle."""

DISTANCES = (0.05, 0.25)
"""Metres that one of them moves sideways."""

QUERIES = 500
SHARE = 0.15
"""Of the states of the build that telling it of one moved obstacle may take."""

TOLD, NOT_TOLD = "told", "not told"


def ten_obstacles() -> ps.Scene:
    """A table and nine things on and above it."""
    scene = load_scene("table")
    for obstacle in draw_objects(random.Random(f"{queries.SEED} ten obstacles"), OBJECTS):
        scene = scene.with_obstacle(obstacle)
    return scene


def moved_scene(scene: ps.Scene, number: int, distance: float) -> ps.Scene:
    """The scene with one of the nine things moved by so many metres, in a direction of its own."""
    angle = random.Random(f"{queries.SEED} moved {number} {distance}").uniform(-math.pi, math.pi)
    pose = scene.obstacle(f"object_{number}").pose
    x, y, z = pose.position
    there = (x + distance * math.cos(angle), y + distance * math.sin(angle), z)
    return scene.moved(f"object_{number}", ps.Pose(there, pose.quaternion))


@dataclass(frozen=True, eq=False)
class _Case:
    """A scene with something moved, and the roadmap before and after it was told."""

    service: ps.PlannerService
    before: ps.Roadmap
    update: RoadmapUpdate
    distance: float
    seconds: float


def _cases(roadmap: ps.Roadmap, scene: ps.Scene) -> Iterator[_Case]:
    for distance in DISTANCES:
        for number in range(OBJECTS):
            service = ps.PlannerService(queries.ROBOT, moved_scene(scene, number, distance))
            clock = time.process_time()
            update = service.update_roadmap(roadmap)
            yield _Case(service, roadmap, update, distance, time.process_time() - clock)


def untrue(roadmap: ps.Roadmap, checker: ps.CollisionChecker, edges: NDArray[np.int64] | None = None) -> int:
    """Of edges, all if not given, those of which a roadmap says what a judge with the same padding does not.

    What the roadmap leaves open is not told.
    """
    judge = checker.variant(padding=0.0 if roadmap.terms is None else roadmap.terms.padding)
    known = np.isin(roadmap.verdicts, (Verdict.FREE, Verdict.BLOCKED))
    chosen = np.flatnonzero(known) if edges is None else edges[known[edges]]
    wrong = 0
    for edge in chosen.tolist():
        a, b = roadmap.milestones[roadmap.edges[edge]]
        wrong += judge.edge_is_free(a, b) != bool(roadmap.verdicts[edge] == Verdict.FREE)
    return wrong


def _update_row(case: _Case, build: int) -> Row:
    update = case.update
    return {
        "part": "update",
        "changed": list(update.changed),
        "distance": case.distance,
        "seconds": case.seconds,
        "states": update.counts.states,
        "share": update.counts.states / build,
        "distances": update.counts.distances,
        **{key: getattr(update, key) for key in ("kept", "judged", "fell", "rose")},
        "untrue": untrue(update.roadmap, case.service.checker),
    }


def _query_rows(cases: Sequence[_Case], count: int) -> Iterator[Row]:
    """Random queries of the roadmap that was told, of the one that was not, and of searches."""
    for k, case in enumerate(cases):
        service, auditor = case.service, Auditor(queries.ROBOT, case.service.scene)
        some = blocked_ends(service.checker, random.Random(f"{queries.SEED} ends {k}"))
        told = replace(case.update.roadmap, remember=True)
        asked: dict[str, Planner] = {TOLD: told, NOT_TOLD: case.before, **{each.name: each for each in SEARCHES}}
        for _, ends in zip(range(k, count, len(cases)), some, strict=False):
            for what, planner in asked.items():
                row, result = _asked(service, ends, planner)
                yield {"part": "query", "what": what} | row | _judged(service.checker, auditor, planner, result)


def _asked(
    service: ps.PlannerService, ends: tuple[FloatArray, FloatArray], planner: Planner
) -> tuple[Row, ps.PlanResult]:
    clock = time.process_time()
    result = service.plan(ps.PlanRequest(*ends, planner=planner, seed=0, time_limit=None))
    row: Row = {
        "ms": (time.process_time() - clock) * 1e3,
        "ok": result.ok,
        "fell_back": fell_back(result),
        "states": search_states(result),
        "distances": result.stage(ps.Stage.SEARCH).counts.distances,
    }
    return row, result


def _judged(checker: ps.CollisionChecker, auditor: Auditor, before: Planner, result: ps.PlanResult) -> Row:
    """What the independent checker says of a path, and how much of what the query learned is untrue."""
    told = NOT_ASKED if result.path is None else auditor.judge(along(result.path, 0.0, result.path.length))
    after = result.roadmap
    if after is None or not isinstance(before, ps.Roadmap):
        return {"verdict": told["verdict"], "untrue": 0}
    old = np.concatenate([before.verdicts, np.zeros(len(after.edges) - len(before.edges), dtype=np.int8)])
    return {"verdict": told["verdict"], "untrue": untrue(after, checker, np.flatnonzero(after.verdicts != old))}


def measured() -> Report:
    """Build, move, tell, ask."""
    scene = ten_obstacles()
    service = ps.PlannerService(queries.ROBOT, scene)
    clock = time.process_time()
    roadmap = service.build_roadmap(ps.PRM(milestones=1000, neighbours=10), seed=0, progress=False)
    built: Row = {"part": "build", "seconds": time.process_time() - clock, "states": built_states(roadmap)}
    built["edges"] = len(roadmap.edges)
    roadmap = replace(roadmap, remember=True)
    cases = list(_cases(roadmap, scene))
    updates = [_update_row(case, built["states"]) for case in cases]
    asked = list(_query_rows(cases, QUERIES))
    tables = (_update_table(built, updates), _query_table(asked))
    return Report("moved", (built, *updates, *asked), tables, promises(updates, asked))


def promises(updates: Sequence[Row], asked: Sequence[Row]) -> tuple[Promise, ...]:
    """What a moved obstacle was to cost, and that nothing said afterwards is out of date."""
    shares = [row["share"] for row in updates]
    stale = [row for row in _rejected(asked) if row["what"] in (TOLD, NOT_TOLD)]
    untrue_edges = sum(row["untrue"] for row in (*updates, *asked))
    paths = {what: sum(row["ok"] for row in asked if row["what"] == what) for what in (TOLD, NOT_TOLD, DEFAULT)}
    moved = f"one of ten obstacles moved: at most {SHARE:.0%} of the build's states"
    told = f"p50 {p50(shares):.1%}, p95 {p95(shares):.1%}, most {max(shares):.1%}"
    out_of_date = f"{len(stale)} of {paths[TOLD]} over told roadmaps and of {paths[NOT_TOLD]} over one not told"
    counts = f"{paths[TOLD]} told, {paths[NOT_TOLD]} not told; {DEFAULT} {paths[DEFAULT]}"
    no_fewer = min(paths[TOLD], paths[NOT_TOLD]) >= paths[DEFAULT]
    return (
        Promise(moved, told, max(shares) <= SHARE),
        Promise("0 stale paths, by the independent checker", out_of_date, not stale),
        Promise(f"no fewer of these queries planned than by {DEFAULT}", counts, no_fewer),
        Promise("no verdict on an edge that a new judge contradicts", f"{untrue_edges}", untrue_edges == 0),
    )


def _update_table(built: Row, rows: Sequence[Row]) -> Table:
    def cells(distance: float) -> list[str]:
        here = [row for row in rows if row["distance"] == distance]
        counts = [
            spread([row[key] for row in here]) for key in ("states", "distances", "kept", "judged", "fell", "rose")
        ]
        shares = [row["share"] for row in here]
        seconds = spread([row["seconds"] for row in here], 2)
        return [f"{distance:g} m", str(len(here)), *counts, f"{p50(shares):.1%}", f"{max(shares):.1%}", seconds]

    columns = ("moved by", "moves", "states", "bounds", "kept", "judged", "fell", "rose", "share p50", "most", "CPU s")
    caption = (
        f"PRM(1000, 10) among ten obstacles: {built['states']:,} states, {built['edges']:,} edges, "
        f"{built['seconds']:.2f} s of CPU; each of nine things moved, p50 / p95. Kept: edges proven out of the way by "
        "bounds; share: of the build's states."
    )
    return table("One obstacle moved", columns, map(cells, DISTANCES), caption=caption)


def _query_table(rows: Sequence[Row]) -> Table:
    def cells(what: str) -> list[str]:
        here = [row for row in rows if row["what"] == what]
        return [
            *(what, f"{sum(row['ok'] for row in here)}/{len(here)}", spread([row["states"] for row in here])),
            spread([row["distances"] for row in here]),
            spread([row["ms"] for row in here], 1),
            str(sum(row["fell_back"] for row in here)) if what in (TOLD, NOT_TOLD) else "-",
            str(len(_rejected(here))),
        ]

    columns = ("roadmap", "planned", "search states", "bounds", "whole plan ms", "fell back", "rejected by Coal")
    caption = (
        "Random free ends, no straight line between them, after each of the moves; p50 / p95. Not told: the "
        f"roadmap of the scene before, which finds out as a path needs it. Bounds: of the search. "
        f"Audited at {JOINT_STEP:g} rad."
    )
    whats = (TOLD, NOT_TOLD, *(planner.name for planner in SEARCHES))
    return table("Queries after a move", columns, map(cells, whats), caption=caption)


def _rejected(rows: Iterable[Row]) -> list[Row]:
    """Those whose path the independent checker does not find free."""
    return [row for row in rows if row["verdict"] not in ("free", "not_asked")]
