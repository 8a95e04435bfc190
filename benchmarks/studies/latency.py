"""How long a caller waits: whole plans, proof and timing included, and plans whose straight line is free.

By a service that has planned once before, in CPU milliseconds, the least of a few turns; the first plan is told apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, least_ms, p50, p95, spread, table_of
from benchmarks.studies.agreement import random_states
from benchmarks.studies.states import STEPS
from benchmarks.worlds import queries
from planner_service import CollisionChecker, JointStep, PlannerService, PlanRequest, PlanResult, Stage, move_linear
from planner_service.collision import EdgeStep
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.cartesian_waypoints import thinned
from planner_service.kinematics.inverse import straight_tool_line

__all__ = ["SCENES", "free_lines", "plan_rows", "promises", "run", "straight_rows", "tool_lines"]

SCENES = ("bin", "shelf", "post", "clutter")
TURNS = 3

LINES, SHORTEST, LONGEST = 20, 0.3, 1.2
"""Free straight lines of a scene, and their length in joint space (rad)."""

RISE = 0.05
"""Metres that the tool is moved along its approach, backwards."""

WHOLE_P50, WHOLE_P95, STRAIGHT_P50 = 15.0, 60.0, 1.0
"""Promised milliseconds."""


def _request(start: FloatArray, goal: FloatArray, seed: int) -> PlanRequest:
    return PlanRequest(start, goal, seed=seed, time_limit=None)


def plan_rows(
    scenes: Sequence[str] = SCENES, count: int = queries.PER_SCENE, turns: int = TURNS, steps: Sequence[str] = ()
) -> Iterator[Row]:
    """Plans of the stored queries, a row for each scene and step."""
    for name in steps or STEPS:
        for scene in scenes:
            asked = [_request(query.start, query.goal, query.number) for query in queries.load(scene)[:count]]
            first, service = cpu_ms(lambda: _after_one(scene, STEPS[name], asked[0]))  # noqa: B023
            took = [least_ms(lambda: service.plan(request), turns)[0] for request in asked]  # noqa: B023
            yield {"step": name, "scene": scene, "first": first, "ms": took}


def _after_one(scene: str, step: EdgeStep, request: PlanRequest) -> PlannerService:
    """A service that has planned that."""
    service = PlannerService(queries.ROBOT, scene, edge_step=step)
    service.plan(request)
    return service


def free_lines(checker: CollisionChecker, count: int) -> list[tuple[FloatArray, FloatArray]]:
    """Straight lines in joint space, free with the padding of a request; the same in every call."""
    robot, rng = checker.robot, np.random.default_rng(queries.SEED)
    roomy = checker.variant(padding=PlanRequest(robot.home, robot.home).padding)
    found: list[tuple[FloatArray, FloatArray]] = []
    while len(found) < count:
        a = random_states(robot, 1, rng)[0]
        way = rng.normal(size=robot.n)
        length = rng.uniform(SHORTEST, LONGEST) / math.sqrt(math.fsum((way * way).tolist()))
        b = np.clip(a + way * length, robot.limits.lower, robot.limits.upper)
        if roomy.edge_is_free(a, b):
            found.append((a, b))
    return found


def tool_lines(service: PlannerService, count: int) -> list[tuple[FloatArray, Pose]]:
    """Starts of stored queries, and the tool poses straight behind them that can be reached on a free line."""
    found: list[tuple[FloatArray, Pose]] = []
    for query in queries.load(service.scene.name):
        for q in (query.start, query.goal):
            tool = Pose.from_matrix(service.robot.tool_pose(q))
            behind = tool @ Pose((-RISE, 0.0, 0.0))
            if len(found) < count and move_linear(service, q, behind).ok:
                found.append((q, behind))
    return found


def straight_rows(scenes: Sequence[str] = SCENES, count: int = LINES, turns: int = TURNS) -> Iterator[Row]:
    """Plans whose straight line is free, and straight tool lines: milliseconds of the whole and of its parts."""
    for scene in scenes:
        service = PlannerService(queries.ROBOT, scene, edge_step=JointStep(0.02))
        lines, tools = free_lines(service.checker, count), tool_lines(service, count)
        service.plan(_request(*lines[0], 0))
        for kind, measured in (
            ("plan", [_planned(service, *line, turns) for line in lines]),
            ("move_linear", [_moved(service, *line, turns) for line in tools]),
        ):
            yield {"kind": kind, "scene": scene, "ms": {key: [one[key] for one in measured] for key in measured[0]}}


def _planned(service: PlannerService, start: FloatArray, goal: FloatArray, turns: int) -> dict[str, float]:
    request = _request(start, goal, 0)
    return _parts(*least_ms(lambda: service.plan(request), turns), 0.0)


def _moved(service: PlannerService, q: FloatArray, to: Pose, turns: int) -> dict[str, float]:
    kinematics, _ = least_ms(lambda: thinned(service.robot, straight_tool_line(service.robot, q, to).waypoints), turns)
    return _parts(*least_ms(lambda: move_linear(service, q, to), turns), kinematics)


def _parts(whole: float, results: Sequence[PlanResult], kinematics: float) -> dict[str, float]:
    """The least milliseconds of each stage, of what decides that the line is free, and of the whole."""
    stages = {stage.value: min(r.stage(stage).seconds for r in results) * 1e3 for stage in Stage}
    decided = kinematics + stages[Stage.ENDPOINTS.value] + stages[Stage.STRAIGHT_LINE.value]
    return stages | {"kinematics": kinematics, "decided": decided, "whole": whole}


def run() -> Report:
    """Measure it all; about two minutes."""
    plans, straight = list(plan_rows()), list(straight_rows())
    tables = (_plan_table(plans), _straight_table(straight))
    return Report("latency", (*plans, *straight), tables, promises(plans, straight))


def promises(plans: Sequence[Row], straight: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    found = []
    for step, rows in grouped(plans, "step").items():
        text = (
            f"{step}, whole plans in each of {len(SCENES)} scenes: at most {WHOLE_P50:g} ms p50, {WHOLE_P95:g} ms p95"
        )
        told = "; ".join(f"{row['scene']} {spread(row['ms'], 1)}" for row in rows)
        found.append(Promise(text, told, all(_kept(row["ms"]) for row in rows)))
    for kind, rows in grouped(straight, "kind").items():
        decided = [p50(row["ms"]["decided"]) for row in rows]
        text = f"{kind}: a straight line is found to be free in less than {STRAIGHT_P50:g} ms at p50"
        found.append(Promise(text, "; ".join(f"{ms:.2f}" for ms in decided), max(decided) < STRAIGHT_P50))
    return tuple(found)


def _kept(ms: Sequence[float]) -> bool:
    return p50(ms) <= WHOLE_P50 and p95(ms) <= WHOLE_P95


def _plan_table(rows: Sequence[Row]) -> Table:
    lines = (
        {"edge step": row["step"], "scene": row["scene"], "queries": len(row["ms"])}
        | {"ms": spread(row["ms"], 1), "first ms": f"{row['first']:.0f}"}
        for row in rows
    )
    caption = (
        f"Search, shortcut, blends, proof and TOPP-RA; p50 / p95 of CPU ms over the stored queries, each the least of "
        f"{TURNS} turns of a service that has planned once. First: making the service and its first plan."
    )
    return table_of("Whole plans", lines, caption=caption)


def _straight_table(rows: Sequence[Row]) -> Table:
    stages = [Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.POLISH, Stage.CERTIFY, Stage.TIMING]
    keys = ["kinematics", *(stage.value for stage in stages), "decided", "whole"]
    lines = (
        {"": row["kind"], "scene": row["scene"], "lines": len(row["ms"]["whole"])}
        | {key: f"{p50(row['ms'][key]):.2f}" for key in keys}
        for row in rows
    )
    caption = (
        f"p50 in ms. plan: joint lines of {SHORTEST:g} to {LONGEST:g} rad, JointStep(0.02). move_linear: the tool "
        f"{RISE * 100:g} cm back. Decided: inverse kinematics of the line's points, ends and edges, before blends, "
        "proof and timing; it is what the promise is about. Stages by the clock, kinematics and whole in CPU time."
    )
    return table_of("Free straight lines", lines, caption=caption)
