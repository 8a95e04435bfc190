"""How long a caller waits: whole plans, proof and timing included, and plans whose straight line is free.

By a service that has planned once before, in CPU milliseconds, the least of a few turns; the first plan is told apart.
Whole plans next to those of 0.1.0, problem by problem. And how long a process takes to start, with its bytecode cached.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

import planner_service as ps
from benchmarks.baselines.peers.child import Reply
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.versions import TURNS as WHOLE_TURNS
from benchmarks.baselines.peers.versions import replies, version_here, version_then
from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import Promise, Report, Row, grouped, least_ms, p50, p95, spread, table_of
from benchmarks.studies.states import STEPS
from benchmarks.worlds import queries
from benchmarks.worlds.contacts import random_states
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import straight_tool_line
from planner_service.kinematics.cartesian_waypoints import thinned
from planner_service.planning.task_result import TaskResult
from planner_service.tasks import plan_pick_place

__all__ = [
    "SCENES",
    "free_lines",
    "plan_rows",
    "promises",
    "run",
    "start_rows",
    "straight_rows",
    "task_promise",
    "task_row",
    "tool_lines",
]

SCENES = ("bin", "shelf", "post", "clutter")
TURNS = 3

LINES, SHORTEST, LONGEST = 20, 0.3, 1.2
"""Free straight lines of a scene, and their length in joint space (rad)."""

RISE = 0.05
"""Metres that the tool is moved along its approach, backwards."""

MOVED = 0.02
"""Metres that the object of a task is moved at most along x and y, so that no task is the one before."""

PART_P50, STRAIGHT_P50, STRAIGHT_PLAN_P50, TOOL_LINE_P50, TASK_P50 = 0.35, 1.0, 0.25, 1.0, 30.0
"""Promised: part of what 0.1.0 takes in the same run; milliseconds."""

_PLANNED = ("plan", "--robot", queries.ROBOT, "--scene", "table", "--start", "home", "--goal", "ready")

STARTS = {
    "python": ("-c", "pass"),
    "import planner_service": ("-c", "import planner_service"),
    "planner-service plan": ("-m", "planner_service", *_PLANNED),
}
START_TURNS = 7
IMPORT_SECONDS, COLD_SECONDS = 0.3, 0.8
"""Promised, of a whole process, from its start to its end."""


def _request(start: FloatArray, goal: FloatArray, seed: int) -> ps.PlanRequest:
    return ps.PlanRequest(start, goal, seed=seed, time_limit=None)


def plan_rows(
    versions: Sequence[Environment],
    scenes: Sequence[str] = SCENES,
    count: int = queries.PER_SCENE,
    steps: Sequence[str] = tuple(STEPS),
) -> Iterator[Row]:
    """Plans of the stored queries by two versions in turn, the older last; a row for each scene and step."""
    cases = [(step, scene) for step in steps for scene in scenes]
    problems = [_problem(query, step) for step, scene in cases for query in queries.load(scene)[:count]]
    asked = [replies(version, queries.ROBOT, [_WARM, *problems]) for version in versions]
    told = [[_told(reply) for reply in together] for together in zip(*asked, strict=True)][1:]
    for k, (step, scene) in enumerate(cases):
        here = told[k * count : (k + 1) * count]
        ms, then = ([both[v]["cpu_seconds"] * 1e3 for both in here] for v in (0, -1))
        first = here[0][0]["stage_cpu_seconds"]["setup"] * 1e3
        yield {"step": step, "scene": scene, "first": first, "ms": ms, "then": then}


def _problem(query: queries.Query, step: str) -> Row:
    kind, _, value = step.rstrip(")").partition("(")
    ends = {"start": query.start.tolist(), "goals": [query.goal.tolist()]}
    return {"problem": query.name, "seed": query.number, "scene": query.scene, "edge_step": [kind, float(value)]} | ends


_WARM = _problem(queries.load("narrow")[0], "JointStep(0.02)")
"""Asked first, and not told: what a process imports and builds once."""


def _told(reply: Reply) -> Mapping[str, Any]:
    if reply.answer is None or reply.answer["error"]:
        raise AssertionError(f"{reply.problem['problem']}: {reply.detail or reply.answer}")
    return reply.answer


def free_lines(checker: ps.CollisionChecker, count: int) -> list[tuple[FloatArray, FloatArray]]:
    """Straight lines in joint space, free with the padding of a request; the same in every call."""
    robot, rng = checker.robot, np.random.default_rng(queries.SEED)
    roomy = checker.variant(padding=ps.PlanRequest(robot.home, robot.home).padding)
    found: list[tuple[FloatArray, FloatArray]] = []
    while len(found) < count:
        a = random_states(robot, 1, rng)[0]
        way = rng.normal(size=robot.n)
        length = rng.uniform(SHORTEST, LONGEST) / math.sqrt(math.fsum((way * way).tolist()))
        b = np.clip(a + way * length, robot.limits.lower, robot.limits.upper)
        if roomy.edge_is_free(a, b):
            found.append((a, b))
    return found


def tool_lines(service: ps.PlannerService, count: int) -> list[tuple[FloatArray, ps.Pose]]:
    """Starts of stored queries, and the tool poses straight behind them that can be reached on a free line."""
    found: list[tuple[FloatArray, ps.Pose]] = []
    for query in queries.load(service.scene.name):
        for q in (query.start, query.goal):
            tool = ps.Pose.from_matrix(service.robot.tool_pose(q))
            behind = tool @ ps.Pose((-RISE, 0.0, 0.0))
            if len(found) < count and ps.move_linear(service, q, behind).ok:
                found.append((q, behind))
    return found


def straight_rows(scenes: Sequence[str] = SCENES, count: int = LINES, turns: int = TURNS) -> Iterator[Row]:
    """Plans whose straight line is free, and straight tool lines: milliseconds of the whole and of its parts."""
    for scene in scenes:
        service = ps.PlannerService(queries.ROBOT, scene, edge_step=ps.JointStep(0.02))
        lines, tools = free_lines(service.checker, count), tool_lines(service, count)
        service.plan(_request(*lines[0], 0))
        for kind, measured in (
            ("plan", [_planned(service, *line, turns) for line in lines]),
            ("move_linear", [_moved(service, *line, turns) for line in tools]),
        ):
            yield {"kind": kind, "scene": scene, "ms": {key: [one[key] for one in measured] for key in measured[0]}}


def _planned(service: ps.PlannerService, start: FloatArray, goal: FloatArray, turns: int) -> dict[str, float]:
    request = _request(start, goal, 0)
    return _parts(*least_ms(lambda: service.plan(request), turns), 0.0)


def _moved(service: ps.PlannerService, q: FloatArray, to: ps.Pose, turns: int) -> dict[str, float]:
    kinematics, _ = least_ms(lambda: thinned(service.robot, straight_tool_line(service.robot, q, to).waypoints), turns)
    return _parts(*least_ms(lambda: ps.move_linear(service, q, to), turns), kinematics)


def _parts(whole: float, results: Sequence[ps.PlanResult], kinematics: float) -> dict[str, float]:
    """The least milliseconds of each stage, of what decides that the line is free, and of the whole."""
    stages = {stage.value: min(r.stage(stage).seconds for r in results) * 1e3 for stage in ps.Stage}
    decided = kinematics + stages[ps.Stage.ENDPOINTS.value] + stages[ps.Stage.STRAIGHT_LINE.value]
    return stages | {"kinematics": kinematics, "decided": decided, "whole": whole}


def start_rows(turns: int = START_TURNS) -> Iterator[Row]:
    """Seconds of processes from start to end, by CPU and by the clock; the least of some turns, after a first one."""
    with tempfile.TemporaryDirectory(prefix="bytecode-") as folder:
        surroundings = {**os.environ, "PYTHONPYCACHEPREFIX": folder}
        surroundings.pop("PYTHONDONTWRITEBYTECODE", None)
        for what, command in STARTS.items():
            spent = [_started(command, surroundings) for _ in range(turns + 1)][1:]
            cpu, wall = (min(column) for column in zip(*spent, strict=True))
            yield {"start": what, "cpu_seconds": cpu, "wall_seconds": wall}


def _started(command: Sequence[str], surroundings: Mapping[str, str]) -> tuple[float, float]:
    """CPU and wall seconds of a process."""
    clock, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *command], cwd=ROOT, env=surroundings, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.perf_counter() - clock


def task_row(count: int = 20, turns: int = TURNS) -> Row:
    """Milliseconds of whole pick-and-place tasks, each with the object somewhere else, the new service included."""
    service, rng = ps.PlannerService(queries.ROBOT, "bin"), np.random.default_rng(queries.SEED)
    home, pose = service.robot.home, service.scene.obstacle("blue_block").pose
    request, ms = ps.PlanRequest(home, home, time_limit=None), []
    for _ in range(count):
        x, y = rng.uniform(-MOVED, MOVED, 2).tolist()
        scene = service.scene.moved("blue_block", ps.Pose((x, y, 0.0)) @ pose)

        def planned(scene: ps.Scene = scene) -> TaskResult:
            return plan_pick_place(service.with_scene(scene), "blue_block", "tray", request)

        spent, (task, *_) = least_ms(planned, turns)
        if not task.ok:
            raise AssertionError(task.failure)
        ms.append(spent)
    return {"kind": "pick and place", "ms": ms}


def run(against: Path | None = None) -> Report:
    """Measure it all; about three minutes, and two more to install 0.1.0 where it is not.

    Args:
        against: The python of an environment with the version to compare with; 0.1.0 if None.

    Raises:
        InvalidRequest: there is no such version, and it cannot be installed.
    """
    starts = list(start_rows())
    plans, straight = list(plan_rows((version_here(), version_then(against)))), list(straight_rows())
    tables = (_plan_table(plans), _straight_table(straight), _start_table(starts))
    task = task_row()
    kept = (*promises(plans, straight, starts), task_promise(task))
    return Report("latency", (*plans, *straight, *starts, task), tables, kept)


def task_promise(row: Row) -> Promise:
    """What a whole task was to take."""
    text = f"pick and place in a new scene, its motions and the gripper's proven and timed, in {TASK_P50:g} ms at p50"
    return Promise(text, spread(row["ms"], 1), p50(row["ms"]) <= TASK_P50)


def promises(plans: Sequence[Row], straight: Sequence[Row], starts: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    found = []
    for step, rows in grouped(plans, "step").items():
        parts = [p50(row["ms"]) / p50(row["then"]) for row in rows]
        text = f"{step}, whole plans in each of {len(rows)} scenes: p50 at most {PART_P50:g} of 0.1.0's CPU time"
        told = "; ".join(f"{row['scene']} {part:.2f}" for row, part in zip(rows, parts, strict=True))
        found.append(Promise(text, told, max(parts) <= PART_P50))
    lines = grouped(straight, "kind")
    for kind, part, most, text in (
        ("plan", "decided", STRAIGHT_P50, "a straight line in joint space is found to be free"),
        ("plan", "whole", STRAIGHT_PLAN_P50, "a free straight line in joint space is planned, proven and timed"),
        ("move_linear", "whole", TOOL_LINE_P50, "a straight tool line with its inverse kinematics, proven and timed,"),
    ):
        ms = [p50(row["ms"][part]) for row in lines[kind]]
        told = "; ".join(f"{value:.2f}" for value in ms)
        found.append(Promise(f"{text} in at most {most:g} ms at p50", told, max(ms) <= most))
    for what, most in zip(list(STARTS)[1:], (IMPORT_SECONDS, COLD_SECONDS), strict=True):
        (row,) = (row for row in starts if row["start"] == what)
        seconds = row["cpu_seconds"], row["wall_seconds"]
        told = f"{seconds[0]:.2f} s of CPU, {seconds[1]:.2f} s by the clock"
        found.append(Promise(f"{what}: a whole process in at most {most:g} s of either", told, max(seconds) <= most))
    return tuple(found)


def _plan_table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "edge step": row["step"],
            "scene": row["scene"],
            "queries": len(row["ms"]),
            "ms": spread(row["ms"], 1),
            "ms of 0.1.0": spread(row["then"], 1),
            "ratio": f"{p50(row['ms']) / p50(row['then']):.2f} / {p95(row['ms']) / p95(row['then']):.2f}",
            "first ms": f"{row['first']:.0f}",
        }
        for row in rows
    )
    caption = (
        "Search, shortcut, blends, proof and TOPP-RA; p50 / p95 of CPU ms over the stored queries, by both versions in "
        f"turn, each in a process of its own, the least of {WHOLE_TURNS} turns of a service that has planned once. "
        "First: making the service and its first plan."
    )
    return table_of("Whole plans", lines, caption=caption)


def _straight_table(rows: Sequence[Row]) -> Table:
    stages = [ps.Stage.ENDPOINTS, ps.Stage.STRAIGHT_LINE, ps.Stage.POLISH, ps.Stage.CERTIFY, ps.Stage.TIMING]
    keys = ["kinematics", *(stage.value for stage in stages), "decided", "whole"]
    lines = (
        {"": row["kind"], "scene": row["scene"], "lines": len(row["ms"]["whole"])}
        | {key: f"{p50(row['ms'][key]):.2f}" for key in keys}
        for row in rows
    )
    caption = (
        f"p50 in ms. plan: joint lines of {SHORTEST:g} to {LONGEST:g} rad, JointStep(0.02). move_linear: the tool "
        f"{RISE * 100:g} cm back. Decided: inverse kinematics of the line's points, ends and edges, before blends, "
        "proof and timing. Stages by the clock, kinematics and whole in CPU time."
    )
    return table_of("Free straight lines", lines, caption=caption)


def _start_table(rows: Sequence[Row]) -> Table:
    lines = (
        {"": row["start"], "CPU s": f"{row['cpu_seconds']:.2f}", "s by the clock": f"{row['wall_seconds']:.2f}"}
        for row in rows
    )
    caption = (
        f"Whole processes, the least of {START_TURNS} after one that writes the bytecode. The plan: its straight line "
        "is free; with its table."
    )
    return table_of("Starting", lines, caption=caption)
