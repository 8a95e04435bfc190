"""How many problems that nobody chose the default request solves, clock and all, and whether its plans are free.

Random queries of the WidowX AI in random scenes, and the public Panda problems with several seeds.

Then random queries among obstacles as large as the arm, many of which have no plan: each is solved, proven impossible,
or unknown. These end by a number of checks, not by a clock, and the auditor verifies each proof.
"""

from __future__ import annotations

import itertools
import json
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

import planner_service as ps
from auditor import verify_no_path
from auditor.checker import IndependentChecker
from auditor.schema import Invalid
from benchmarks.harness.audit import independent, touch_in_time, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, grouped, spread, table, table_of
from benchmarks.studies.problems import ROBOT as PANDA
from benchmarks.studies.problems import kind_of, public_problems
from benchmarks.worlds.drawn import draw_crowd, draw_objects
from benchmarks.worlds.queries import ROBOT as WXAI
from planner_service.records.exports.no_path_file import no_path_document

__all__ = ["draw_queries", "draw_scene", "run"]

QUERIES, SEEDS, CROWDED = 1000, 10, 500
PER_SCENE = 10
PARTS = {"random": QUERIES, "panda": 0, "crowded": CROWDED}
"""How many random queries each has."""

CROWDED_PER_SCENE, CROWDED_CHECKS, DRAWS = 5, 1_000_000, 2_000
"""Queries in each crowded scene, the states that each may check, and the draws of free ends for all of them."""

UNKNOWN = 0.01
"""Part of the crowded queries that may stay unknown."""

OBJECTS = (3, 20)
POSES = 0.25
"""Part of the queries whose goal is a pose of the tool."""

CROWD = f"{WXAI}, among large obstacles"
IMPOSSIBLE, LEFT = "proven impossible", "unknown"

SOLVED = 0.995
CURVE_STEP = 0.001
"""Metres that any point of the robot moves at most from one audited configuration to the next."""


@dataclass(frozen=True, eq=False)
class _Query:
    """A request with a name, and how many configurations drawn for its ends were in collision."""

    name: str
    request: ps.PlanRequest
    infeasible: int = 0


def draw_scene(chance: random.Random) -> ps.Scene:
    """A table with boxes, cylinders, spheres, capsules and meshes within reach of the arm."""
    scene = ps.load_scene("table")
    for k, obstacle in enumerate(draw_objects(chance, chance.randint(*OBJECTS))):
        if k % 4 == 3:
            points = [[chance.uniform(-0.1, 0.1) for _ in range(3)] for _ in range(chance.randint(4, 40))]
            obstacle = replace(obstacle, shape=ps.Mesh(np.array(points)))
        scene = scene.with_obstacle(obstacle)
    return scene


def draw_queries(chance: random.Random, service: ps.PlannerService, count: int) -> Iterator[tuple[ps.PlanRequest, int]]:
    """Requests between free configurations, uniform in the joint limits, and how many drawn for each were not free."""
    limits = service.robot.limits
    ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), strict=True))
    for _ in range(count):
        ends, drawn = list[list[float]](), 0
        while len(ends) < 2:
            q, drawn = [chance.uniform(low, high) for low, high in ranges], drawn + 1
            if service.checker.state_is_free(q):
                ends.append(q)
        pose = chance.random() < POSES
        goal = ps.Pose.from_matrix(service.robot.tool_pose(ends[1])) if pose else ends[1]
        yield ps.PlanRequest(ends[0], goal, seed=chance.randrange(2**32)), drawn - 2


def run(part: str | None = None, queries: int | None = None, seeds: int = SEEDS, seed: int = 0) -> Report:
    """Plan and audit; some minutes.

    Args:
        part: A name of ``PARTS``; None for all.
        queries: How many of each random part; as many as it promises if None.
    """
    asked = {name: most if queries is None else queries for name, most in PARTS.items()}
    count = {name: most if part in (None, name) else 0 for name, most in asked.items()}
    rows = (*_wxai_rows(count["random"], seed), *_panda_rows(seeds if part in (None, "panda") else 0, seed))
    among = tuple(_crowded_rows(count["crowded"], seed))
    tables = (*((_table(rows), _left_table(rows)) if rows else ()), *((_crowded_table(among),) if among else ()))
    promises = (*(_promises(rows) if rows else ()), *(_crowded_promises(among) if among else ()))
    return Report("solved", (*rows, *among), tables, promises)


def _wxai_rows(queries: int, seed: int) -> Iterator[Row]:
    robot, chance = ps.load_robot(WXAI), random.Random(f"{seed} solved")
    for first in range(0, queries, PER_SCENE):
        service = ps.PlannerService(robot, draw_scene(chance))
        second = independent(WXAI, service.scene)
        for k, (request, infeasible) in enumerate(draw_queries(chance, service, min(PER_SCENE, queries - first))):
            query = _Query(f"{WXAI} {seed}/{first + k}", request, infeasible)
            yield {"kind": f"{WXAI}, random"} | _row(service, second, query)


def _crowded_rows(queries: int, seed: int) -> Iterator[Row]:
    robot, left = ps.load_robot(WXAI), queries
    for number in itertools.count():
        if left <= 0:
            return
        chance = random.Random(f"{seed} crowded {number}")
        service = ps.PlannerService(robot, draw_crowd(chance))
        second = independent(WXAI, service.scene)
        for k, (start, goal) in enumerate(_free_ends(chance, service)[:left]):
            left -= 1
            asked = ps.PlanRequest(
                start, goal, seed=chance.randrange(2**32), time_limit=None, max_checks=CROWDED_CHECKS
            )
            yield {"kind": CROWD, "query": f"{WXAI} {seed}/{number}/{k}"} | _crowded_row(service, second, asked)


def _free_ends(chance: random.Random, service: ps.PlannerService) -> list[tuple[list[float], list[float]]]:
    """Pairs of free configurations, fewer where a scene leaves little room."""
    limits, free = service.robot.limits, list[list[float]]()
    ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), strict=True))
    for _ in range(DRAWS):
        q = [chance.uniform(low, high) for low, high in ranges]
        if len(free) < 2 * CROWDED_PER_SCENE and service.checker.state_is_free(q):
            free.append(q)
    return list(zip(free[::2], free[1::2], strict=False))


def _crowded_row(service: ps.PlannerService, second: IndependentChecker, request: ps.PlanRequest) -> Row:
    begun = time.process_time()
    result = service.plan(request)
    seconds, rejected = time.process_time() - begun, _rejected(second, result)
    if result.no_path is not None:
        document = no_path_document(result.no_path, service.world, request.start, request.goals(service.robot))
        try:
            list(verify_no_path.verify(json.loads(json.dumps(document))))
        except Invalid as invalid:
            rejected = str(invalid)
    return {
        "outcome": _outcome(result, request.padding),
        "failure": None if result.failure is None else str(result.failure),
        "seconds": seconds,
        "states": result.counts.states,
        "distances": result.counts.distances,
        "rejected": rejected,
    }


def _outcome(result: ps.PlanResult, padding: float) -> str:
    if result.failure is not None:
        return IMPOSSIBLE if result.failure.proven else LEFT
    return "solved" if result.padding >= padding else "solved, less padding"


def _panda_rows(seeds: int, seed: int) -> Iterator[Row]:
    robot = ps.load_robot(PANDA)
    for problem in public_problems().problems if seeds else ():
        service, second = ps.PlannerService(robot, problem.scene), independent(PANDA, problem.scene)
        for own in range(seed * seeds, (seed + 1) * seeds):
            query = _Query(f"{problem.id}, seed {own}", problem.request(robot, seed=own))
            yield {"kind": f"panda, {kind_of(problem)}"} | _row(service, second, query)


def _row(service: ps.PlannerService, second: IndependentChecker, query: _Query) -> Row:
    result = service.plan(query.request)
    return {
        "query": query.name,
        "solved": result.ok,
        "failure": None if result.failure is None else str(result.failure),
        "seconds": result.seconds,
        "states": result.counts.states,
        "attempts": result.attempts,
        "infeasible ends": query.infeasible,
        "rejected": _rejected(second, result),
    }


def _rejected(second: IndependentChecker, result: ps.PlanResult) -> str | None:
    """What Coal finds touching, in time or along the curve; None if nothing."""
    if result.path is None or result.trajectory is None:
        return None
    return touch_in_time(second, result.trajectory) or touch_on_curve(second, result.path, CURVE_STEP)


def _table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "problems": kind,
            "solved": f"{sum(row['solved'] for row in here)}/{len(here)}",
            "rejected": sum(row["rejected"] is not None for row in here),
            "ms": spread([row["seconds"] * 1e3 for row in here]),
            "most s": f"{max(row['seconds'] for row in here):.2f}",
            "states": spread([row["states"] for row in here]),
            "most tries": max(row["attempts"] for row in here),
            "ends not free": sum(row["infeasible ends"] for row in here),
        }
        for kind, here in grouped(rows, "kind").items()
    )
    caption = (
        "The default request. Rejected: by Coal, in time and along the curve. p50 / p95, failures included. Ends not "
        "free: drawn as well, and put aside before anything was planned."
    )
    return table_of("Solved by default", lines, caption=caption)


def _left_table(rows: Sequence[Row]) -> Table:
    cells = ((row["query"], row["failure"]) for row in rows if not row["solved"])
    return table("Not solved by default", ("query", "failure"), cells)


def _crowded_table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "outcome": outcome,
            "queries": f"{len(here)}/{len(rows)}",
            "rejected": sum(row["rejected"] is not None for row in here),
            "CPU ms": spread([row["seconds"] * 1e3 for row in here]),
            "most s": f"{max(row['seconds'] for row in here):.2f}",
            "states": spread([row["states"] for row in here]),
            "distances": spread([row["distances"] for row in here]),
        }
        for outcome, here in grouped(rows, "outcome").items()
    )
    caption = (
        f"{CROWD}: one to eight, up to 0.5 m large. No time limit, {CROWDED_CHECKS:,} checks. Rejected: plans by Coal, "
        "proofs by the auditor. p50 / p95."
    )
    return table_of("Solved, proven impossible, unknown", lines, caption=caption)


def _crowded_promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    left = [row["query"] for row in rows if row["outcome"] == LEFT]
    rejected = [row["query"] for row in rows if row["rejected"] is not None]
    told = f"{len(left)} of {len(rows)}" + (f": {', '.join(left)}" if left else "")
    return (
        Promise(f"at most {UNKNOWN:.0%} unknown among large obstacles", told, len(left) <= UNKNOWN * len(rows)),
        Promise("0 plans and proofs among large obstacles rejected", ", ".join(rejected) or "none", not rejected),
    )


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    solved, rejected = sum(row["solved"] for row in rows), [row["query"] for row in rows if row["rejected"] is not None]
    share = f"{solved} of {len(rows)} ({solved / len(rows):.2%})"
    return (
        Promise(f"at least {SOLVED:.1%} solved by the default request", share, solved >= SOLVED * len(rows)),
        Promise("0 rejected by Coal", ", ".join(rejected) or "none", not rejected),
    )
