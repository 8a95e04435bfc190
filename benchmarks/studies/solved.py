"""How many problems that nobody chose the default request solves, clock and all, and whether its plans are free.

Random queries of the WidowX AI in random scenes, and the public Panda problems with several seeds. What is left is
asked again with ten times the time, and of other planners.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.table import Table

from auditor.checker import IndependentChecker
from benchmarks.harness.audit import independent, touch_in_time, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, grouped, spread, table, table_of
from benchmarks.studies.problems import ROBOT as PANDA
from benchmarks.studies.problems import kind_of, public_problems
from benchmarks.worlds.drawn import draw_objects
from benchmarks.worlds.queries import ROBOT as WXAI
from planner_service import Mesh, PlannerService, PlanRequest, PlanResult, Pose, Scene
from planner_service.planners import BKPIECE1, LBKPIECE1, BalancedRRTConnect, Planner, RRTConnect
from planner_service.robot.model import load_robot
from planner_service.scene.scene import load_scene

__all__ = ["draw_queries", "draw_scene", "run"]

QUERIES, SEEDS = 1000, 10
PER_SCENE = 10
OBJECTS = (3, 20)
POSES = 0.25
"""Part of the queries whose goal is a pose of the tool."""

SOLVED = 0.995
MORE_TIME = 10.0
OTHERS: tuple[tuple[Planner, float], ...]
OTHERS = ((BalancedRRTConnect(), 1.0), (RRTConnect(), 1.0), (RRTConnect(), 0.0), (BKPIECE1(), 1.0), (LBKPIECE1(), 1.0))
"""Who is asked about what is left, for so many times as long, with which part of the padding."""

CURVE_STEP = 0.001
"""Metres that any point of the robot moves at most from one audited configuration to the next."""


@dataclass(frozen=True, eq=False)
class _Query:
    """A request with a name, and how many configurations drawn for its ends were in collision."""

    name: str
    request: PlanRequest
    infeasible: int = 0


def draw_scene(chance: random.Random) -> Scene:
    """A table with boxes, cylinders, spheres, capsules and meshes within reach of the arm."""
    scene = load_scene("table")
    for k, obstacle in enumerate(draw_objects(chance, chance.randint(*OBJECTS))):
        if k % 4 == 3:
            points = [[chance.uniform(-0.1, 0.1) for _ in range(3)] for _ in range(chance.randint(4, 40))]
            obstacle = replace(obstacle, shape=Mesh(np.array(points)))
        scene = scene.with_obstacle(obstacle)
    return scene


def draw_queries(chance: random.Random, service: PlannerService, count: int) -> Iterator[tuple[PlanRequest, int]]:
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
        goal = Pose.from_matrix(service.robot.tool_pose(ends[1])) if pose else ends[1]
        yield PlanRequest(ends[0], goal, seed=chance.randrange(2**32)), drawn - 2


def run(queries: int = QUERIES, seeds: int = SEEDS, seed: int = 0) -> Report:
    """Plan and audit; some minutes."""
    rows = (*_wxai_rows(queries, seed), *_panda_rows(seeds, seed))
    return Report("solved", rows, (_table(rows), _left_table(rows)), _promises(rows))


def _wxai_rows(queries: int, seed: int) -> Iterator[Row]:
    robot, chance = load_robot(WXAI), random.Random(f"{seed} solved")
    for first in range(0, queries, PER_SCENE):
        service = PlannerService(robot, draw_scene(chance))
        second = independent(WXAI, service.scene)
        for k, (request, infeasible) in enumerate(draw_queries(chance, service, min(PER_SCENE, queries - first))):
            query = _Query(f"{WXAI} {seed}/{first + k}", request, infeasible)
            yield {"kind": f"{WXAI}, random"} | _row(service, second, query)


def _panda_rows(seeds: int, seed: int) -> Iterator[Row]:
    robot = load_robot(PANDA)
    for problem in public_problems().problems if seeds else ():
        service, second = PlannerService(robot, problem.scene), independent(PANDA, problem.scene)
        for own in range(seed * seeds, (seed + 1) * seeds):
            query = _Query(f"{problem.id}, seed {own}", problem.request(robot, seed=own))
            yield {"kind": f"panda, {kind_of(problem)}"} | _row(service, second, query)


def _row(service: PlannerService, second: IndependentChecker, query: _Query) -> Row:
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
        "with more": None if result.ok else _with_more(service, second, query.request),
    }


def _rejected(second: IndependentChecker, result: PlanResult) -> str | None:
    """What Coal finds touching, in time or along the curve; None if nothing."""
    if result.path is None or result.trajectory is None:
        return None
    return touch_in_time(second, result.trajectory) or touch_on_curve(second, result.path, CURVE_STEP)


def _with_more(service: PlannerService, second: IndependentChecker, request: PlanRequest) -> str:
    """What more time and other planners make of a request that was left."""
    seconds = MORE_TIME * (request.time_limit or math.inf)
    for planner, part in OTHERS:
        padding = part * request.padding
        more = replace(request, planner=planner, time_limit=seconds, max_checks=10**9, padding=padding)
        result = service.plan(more)
        if result.ok:
            told = f"by {planner.name} in {result.seconds:.1f} s with {padding * 1000:g} mm of padding"
            return f"solved {told}; rejected: {_rejected(second, result)}"
    names = dict.fromkeys(planner.name for planner, _ in OTHERS)
    return f"not solved by {', '.join(names)} in {seconds:g} s each, nor without padding"


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
    cells = ((row["query"], row["failure"], row["with more"]) for row in rows if not row["solved"])
    return table("Not solved by default", ("query", "failure", "with more time, by others"), cells)


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    solved, rejected = sum(row["solved"] for row in rows), [row["query"] for row in rows if row["rejected"] is not None]
    share = f"{solved} of {len(rows)} ({solved / len(rows):.2%})"
    return (
        Promise(f"at least {SOLVED:.1%} solved by the default request", share, solved >= SOLVED * len(rows)),
        Promise("0 rejected by Coal", ", ".join(rejected) or "none", not rejected),
    )
