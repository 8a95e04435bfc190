"""Does what ``explain`` suggests help? Deliberate failures; the first suggestion for each is applied and checked."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import islice

from rich.table import Table

from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, table_of
from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service import Box, Obstacle, PlannerService, PlanRequest, Pose, Robot, Scene
from planner_service.constraints import ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import load_robot

__all__ = ["run"]

FAILURES, SOLVED = 50, 0.9
ROBOTS = ("wxai", "ur5", "panda_mbm")
CHECKS = 20_000
CURVE_STEP = 0.001
"""Metres that any point moves at most between two judged samples."""


def run(queries: int | None, seed: int) -> Report:
    """Measure so many failures."""
    rows = list(islice(_rows(seed), queries or FAILURES))
    solved = sum(row["solved"] for row in rows)
    promise = f"at least {SOLVED:.0%} of {len(rows)} failures are solved by the first suggestion"
    promises = (Promise(promise, f"{solved}", solved >= SOLVED * len(rows)),)
    return Report("evidence", tuple(rows), (_table(rows),), promises)


def _rows(seed: int) -> Iterator[Row]:
    number = 0
    while True:
        chance = random.Random(f"explain {seed} {number}")
        robot = load_robot(ROBOTS[number % len(ROBOTS)])
        made = (_block_at_goal, _block_at_pose, _wall, _upright)[number // len(ROBOTS) % 4](robot, chance)
        number += 1
        if made is not None:
            row = _explained(*made)
            if row is not None:
                yield row


Made = tuple[str, PlannerService, PlanRequest]


def _explained(kind: str, service: PlannerService, request: PlanRequest) -> Row | None:
    """None if there is a plan."""
    found = service.explain(request, plans=60)
    if found.result.ok:
        return None
    row: Row = {"kind": kind, "robot": service.robot.name, "reason": str(found.result.failure)[:100]}
    row |= {"proven": found.proven, "plans": found.plans, "remedies": [str(remedy) for remedy in found.remedies]}
    if not found.remedies:
        return row | {"solved": False}
    first = found.remedies[0]
    result = PlannerService(service.robot, first.scene).plan(first.request)
    second = independent(service.robot.name, first.scene)
    touched = None if result.path is None else touch_on_curve(second, result.path, CURVE_STEP)
    return row | {"solved": result.ok and touched is None}


def _ends(robot: Robot, chance: random.Random) -> tuple[Scene, FloatArray, FloatArray]:
    """A drawn scene, and two configurations between which something stands."""
    scene = Scene(tuple(draw_objects(chance, chance.randint(2, 6))))
    start, goal = next(blocked_ends(PlannerService(robot, scene).checker, chance))
    return scene, start, goal


def _asked(scene: Scene, robot: Robot, request: PlanRequest, kind: str) -> Made:
    return kind, PlannerService(robot, scene), request


def _block_at_goal(robot: Robot, chance: random.Random) -> Made:
    scene, start, goal = _ends(robot, chance)
    scene = scene.with_obstacle(_block(robot, goal, chance))
    return _asked(scene, robot, PlanRequest(start, goal, max_checks=CHECKS, time_limit=None), "a block at the goal")


def _block_at_pose(robot: Robot, chance: random.Random) -> Made:
    scene, start, goal = _ends(robot, chance)
    scene = scene.with_obstacle(_block(robot, goal, chance))
    pose = Pose.from_matrix(robot.tool_pose(goal))
    return _asked(scene, robot, PlanRequest(start, pose, max_checks=CHECKS, time_limit=None), "a block at a tool pose")


def _wall(robot: Robot, chance: random.Random) -> Made | None:
    """A wall across the way of the tool, so large that few ways lead round it."""
    scene, start, goal = _ends(robot, chance)
    a, b = (robot.tool_pose(q)[:3, 3] for q in (start, goal))
    x, y, z = (0.5 * (a + b)).tolist()
    wall = Obstacle("wall", Box((0.02, 2.0, 2.0)), Pose((x, y, z)))
    made = scene.with_obstacle(wall)
    if not PlannerService(robot, made).checker.states_are_free([start, goal]).all():
        return None
    return _asked(made, robot, PlanRequest(start, goal, max_checks=CHECKS, time_limit=None), "a wall between")


def _upright(robot: Robot, chance: random.Random) -> Made:
    """The tool is to stay as it is at the start, and leans at the goal."""
    scene, start, _ = _ends(robot, chance)
    lean = start.copy()
    lean[robot.n // 2] += 0.15
    kept = ToolRegion(frame=Pose.from_matrix(robot.tool_pose(start)), tilt=0.05, name="upright")
    low, high = robot.limits.lower, robot.limits.upper
    goal = lean.clip(low, high)
    request = PlanRequest(start, goal, constraints=(kept,), max_checks=CHECKS, time_limit=None)
    return _asked(scene, robot, request, "a lean that is not allowed")


def _block(robot: Robot, q: FloatArray, chance: random.Random) -> Obstacle:
    x, y, z = robot.tool_pose(q)[:3, 3].tolist()
    size = chance.uniform(0.06, 0.14)
    return Obstacle("block", Box((size, size, size)), Pose((x, y, z)))


def _table(rows: list[Row]) -> Table:
    lines = [
        {
            "failure": kind,
            "count": str(len(group)),
            "with a suggestion": str(sum(bool(row["remedies"]) for row in group)),
            "solved by the first": str(sum(row["solved"] for row in group)),
            "proven": str(sum(row["proven"] for row in group)),
            "plans tried": f"{p50(row['plans'] for row in group):.0f}",
            "such as": next((row["remedies"][0] for row in group if row["remedies"]), "-")[:60],
        }
        for kind, group in grouped(rows, "kind").items()
    ]
    return table_of("Failures explained", lines, caption="plans tried: p50")
