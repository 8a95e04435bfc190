"""Requests that have no plan, for ``explain``: blocks at goals, walls on the way, leans that a constraint forbids.

Each was planned once and failed. ``python -m benchmarks.worlds.failures`` draws and stores them.
"""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service import Box, Obstacle, PlannerService, PlanRequest, Pose, Robot, Scene
from planner_service.constraints import ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.records.request import RequestRecord
from planner_service.records.scene import SceneRecord
from planner_service.robot_setup.loading import load_robot

__all__ = ["COUNT", "FILE", "KINDS", "StoredFailure", "draw", "load", "text_of"]

FILE = Path(__file__).parents[1] / "queries" / "failures.json"

COUNT, SEED, CHECKS = 50, 2026, 20_000
ROBOTS = ("wxai", "ur5", "panda_mbm")


@dataclass(frozen=True, eq=False)
class StoredFailure:
    """A request without a plan, and what was done to it."""

    kind: str
    robot: str
    scene: Scene
    request: PlanRequest


def draw() -> Iterator[StoredFailure]:
    """Failures of all kinds and robots in turn, without end."""
    for number in itertools.count():
        chance = random.Random(f"{SEED} failure {number}")
        robot = load_robot(ROBOTS[number % len(ROBOTS)])
        kind, made = KINDS[number // len(ROBOTS) % len(KINDS)]
        scene, start, goal = _ends(robot, chance)
        scene, request = made(robot, scene, start, goal, chance)
        service = PlannerService(robot, scene)
        if service.checker.state_is_free(start) and not service.plan(request).ok:
            yield StoredFailure(kind, robot.name, scene, request)


def _ends(robot: Robot, chance: random.Random) -> tuple[Scene, FloatArray, FloatArray]:
    """A drawn scene, and two configurations between which something stands."""
    scene = Scene(tuple(draw_objects(chance, chance.randint(2, 6))))
    start, goal = next(blocked_ends(PlannerService(robot, scene).checker, chance))
    return scene, start, goal


Made = tuple[Scene, PlanRequest]


def _asked(start: FloatArray, goal: FloatArray | Pose, *kept: ToolRegion) -> PlanRequest:
    return PlanRequest(start, goal, constraints=kept, max_checks=CHECKS, time_limit=None)


def _block_at_goal(robot: Robot, scene: Scene, start: FloatArray, goal: FloatArray, chance: random.Random) -> Made:
    return scene.with_obstacle(_block(robot, goal, chance)), _asked(start, goal)


def _block_at_pose(robot: Robot, scene: Scene, start: FloatArray, goal: FloatArray, chance: random.Random) -> Made:
    pose = Pose.from_matrix(robot.tool_pose(goal))
    return scene.with_obstacle(_block(robot, goal, chance)), _asked(start, pose)


def _wall(robot: Robot, scene: Scene, start: FloatArray, goal: FloatArray, chance: random.Random) -> Made:
    """A wall across the way of the tool, so large that few ways lead round it."""
    a, b = (robot.tool_pose(q)[:3, 3] for q in (start, goal))
    x, y, z = (0.5 * (a + b)).tolist()
    return scene.with_obstacle(Obstacle("wall", Box((0.02, 2.0, 2.0)), Pose((x, y, z)))), _asked(start, goal)


def _upright(robot: Robot, scene: Scene, start: FloatArray, goal: FloatArray, chance: random.Random) -> Made:
    """The tool is to stay as it is at the start, and leans at the goal."""
    lean = start.copy()
    lean[robot.n // 2] += 0.15
    kept = ToolRegion(frame=Pose.from_matrix(robot.tool_pose(start)), tilt=0.05, name="upright")
    return scene, _asked(start, lean.clip(robot.limits.lower, robot.limits.upper), kept)


def _block(robot: Robot, q: FloatArray, chance: random.Random) -> Obstacle:
    x, y, z = robot.tool_pose(q)[:3, 3].tolist()
    size = chance.uniform(0.06, 0.14)
    return Obstacle("block", Box((size, size, size)), Pose((x, y, z)))


KINDS = (
    ("a block at the goal", _block_at_goal),
    ("a block at a tool pose", _block_at_pose),
    ("a wall between", _wall),
    ("a lean that is not allowed", _upright),
)


def text_of(failures: Sequence[StoredFailure]) -> str:
    """The content of the stored file: one failure a line."""
    rows = []
    for one in failures:
        request = RequestRecord.find(one.request)
        assert request is not None
        row = {"kind": one.kind, "robot": one.robot, "scene": SceneRecord.of(one.scene).document()}
        rows.append(json.dumps(row | {"request": request.document()}))
    body = ",\n    ".join(rows)
    return f'{{\n  "seed": {SEED},\n  "failures": [\n    {body}\n  ]\n}}\n'


def load() -> tuple[StoredFailure, ...]:
    """The stored failures."""
    return tuple(
        StoredFailure(
            row["kind"],
            row["robot"],
            SceneRecord.model_validate(row["scene"]).value,
            RequestRecord.model_validate(row["request"]).value,
        )
        for row in json.loads(FILE.read_text("utf-8"))["failures"]
    )


if __name__ == "__main__":
    FILE.write_text(text_of(list(itertools.islice(draw(), COUNT))), "utf-8")
