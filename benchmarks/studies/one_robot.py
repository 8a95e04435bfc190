"""What ``robots`` starts: a process that meets one robot, as a new user's would, and prints a row about it.

From the file to the first proven plan, then random queries among random objects, then what another judge says.
"""

from __future__ import annotations

import json
import random
import resource
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from planner_service import CollisionChecker, Obstacle, PlannerService, PlanRequest, Pose, Robot, Scene
from planner_service.geometry.arrays import FloatArray
from planner_service.infeasibility import prove_no_path
from planner_service.planning.result import PlanResult, Reason, Stage
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot_setup.loading import load_robot

POSES = 0.25
"""Part of the queries whose goal is a pose of the tool."""

TRIES = 5
"""Random goals asked for until there is a first plan."""

OBJECTS = 6
DRAWS = 20
"""Draws for a free end, the last of which is taken as it is."""

ENDS = (Reason.START_IN_COLLISION, Reason.GOAL_IN_COLLISION, Reason.NOT_CERTIFIED)
"""Why an end is refused, before any search: it collides, or it is too near to something to be proven."""

CURVE_STEP = 0.002
"""Metres that any point of the robot moves at most from one audited configuration to the next."""

LOOKS = 10_000
"""Configurations audited on a plan, about: of a robot of 48 joints they would be many more, and are farther apart."""


def main(source: str, queries: int, states: int, seed: int) -> None:
    """Print a row about the robot of ``source``."""
    robot = load_robot(source)
    loaded = _spent()
    service = PlannerService(robot, Scene())
    chance = random.Random(f"{seed} {robot.name}")
    for _ in range(TRIES):
        first = service.plan(PlanRequest(robot.home, _end(service, chance), seed=seed))
        if first.ok:
            break
    told: dict[str, Any] = {"joints": robot.n, "shapes": len(robot.shapes), "tool": robot.tool_frame}
    told |= {"load_s": loaded, "first_s": _spent(), "first": str(first.failure or "proven")}
    service = PlannerService(robot, _scene(robot, chance))
    requests = list(_requests(service, chance, queries))
    results = [service.plan(request) for request in requests]
    impossible = [_impossible(service, *pair) for pair in zip(requests, results, strict=True)]
    told["solved"] = sum(result.ok for result in results)
    told["ends"] = sum(_refused_end(result) for result in results)
    told["impossible"] = sum(impossible)
    told["given up"] = [
        str(result.failure)
        for result, proven in zip(results, impossible, strict=True)
        if not (result.ok or proven or _refused_end(result))
    ]
    told["ms"] = [result.seconds * 1e3 for result in results]
    print(json.dumps(told), flush=True)
    print(json.dumps(told | _judged(service, source, results, states, seed)), flush=True)


def _spent() -> float:
    """Seconds that processors have worked for this process and those it has ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def _refused_end(result: PlanResult) -> bool:
    failure = result.failure
    return failure is not None and failure.stage is Stage.ENDPOINTS and failure.reason in ENDS


def _impossible(service: PlannerService, request: PlanRequest, result: PlanResult) -> bool:
    """Whether a query that was not solved is proven to have no solution."""
    goals = [goal for goal in request.goals(service.robot) if isinstance(goal, np.ndarray)]
    if result.ok or _refused_end(result) or not goals:
        return False
    return prove_no_path(service.robot, service.scene, np.array(request.start), goals) is not None


def _end(service: PlannerService, chance: random.Random) -> list[float]:
    """A configuration, uniform in the limits and free if draws give one."""
    limits = service.robot.limits
    ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), strict=True))
    q = list[float]()
    for _ in range(DRAWS):
        q = [chance.uniform(low, high) for low, high in ranges]
        if service.checker.state_is_free(q):
            break
    return q


def _requests(service: PlannerService, chance: random.Random, count: int) -> Iterator[PlanRequest]:
    for _ in range(count):
        start, end = _end(service, chance), _end(service, chance)
        pose = chance.random() < POSES
        goal = Pose.from_matrix(service.robot.tool_pose(end)) if pose else end
        yield PlanRequest(start, goal, seed=chance.randrange(2**32))


def _scene(robot: Robot, chance: random.Random) -> Scene:
    """Objects at arm's length, a tenth as large as the workspace, none of which touches the robot at home.

    What stands at the shoulder cuts the free space in parts, and whether a query is possible is anybody's guess.
    """
    from benchmarks.worlds.drawn import turned
    from planner_service import Box, Cylinder, Sphere
    from planner_service.geometry.shapes import Shape

    limits, places = robot.limits, list[FloatArray]()
    for _ in range(200):
        q = [chance.uniform(low, high) for low, high in zip(limits.lower, limits.upper, strict=True)]
        places.append(robot.tool_pose(q)[:3, 3])
    size = 0.1 * float(np.ptp(places, axis=0).max())
    away = np.linalg.norm(np.array(places) - _shoulder(robot), axis=1)
    scene = Scene()
    for k in np.flatnonzero(away > np.median(away)).tolist():
        place = places[k]
        a, b, c = (chance.uniform(0.5, 1.5) * size for _ in range(3))
        shapes: list[Shape] = [Box((a, b, c)), Cylinder(a / 2, b), Sphere(a / 2)]
        shape = chance.choice(shapes)
        position = tuple(place.tolist())
        more = scene.with_obstacle(Obstacle(f"object_{len(scene.obstacles)}", shape, Pose(position, turned(chance))))
        if CollisionChecker(robot, more).state_is_free(robot.home):
            scene = more
        if len(scene.obstacles) == OBJECTS:
            break
    return scene


def _shoulder(robot: Robot) -> FloatArray:
    """Where the first body that carries the tool begins, at home."""
    body = chain_to_base(robot.bodies, robot.tool_body)[-1]
    return np.array(robot.body_poses(robot.home)[body][9:])


def _judged(service: PlannerService, source: str, results: list[PlanResult], states: int, seed: int) -> dict[str, Any]:
    """What Pinocchio and Coal, reading the file themselves, say of random configurations and of the plans.

    They judge hulls as hulls, and the plans of a robot with links cut into pieces on the triangles of the meshes. On a
    way out of a contact the plan's own pairs may touch.
    """
    from auditor.checker import IndependentChecker, tables_of
    from benchmarks.harness.audit import touch_of_plan
    from benchmarks.worlds.contacts import compared, random_states
    from benchmarks.worlds.foreign import table_of_robot

    hulls = load_robot(source, cut_meshes=False)
    with TemporaryDirectory() as place:
        world = tables_of(service.scene)
        table = table_of_robot(hulls, source, Path(place))
        second = IndependentChecker(table, world)
        Q = random_states(hulls, states, np.random.default_rng(seed))
        row = compared(CollisionChecker(hulls, service.scene), second, Q)
        if hulls.hash != service.robot.hash:
            table = table_of_robot(service.robot, source, Path(place)) | {"surfaces": True}
        judge = cache(lambda pairs: IndependentChecker(table, world, allowed=pairs))
        paths = [result.path for result in results if result.path is not None]
        looks = [len(judge(()).along(path, path.length, CURVE_STEP)) for path in paths]
        step = CURVE_STEP * max(1.0, max(looks, default=0) / LOOKS)
        touched = [touch for each in results if (touch := touch_of_plan(judge, each, step)) is not None]
    larger = max(getattr(item.shape, "growth", 0.0) for item in service.robot.shapes)
    return {"states": len(Q), "differ": row["disagreements"], "apart": row["apart"], "deep": row["deep"]} | {
        "larger": larger,
        "curve step": step,
        "judged plans": len(paths),
        "touched": touched,
    }


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]))
