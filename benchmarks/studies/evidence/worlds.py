"""Plans to be proven to others: four robots among drawn obstacles, with and without something in the hand, and plans
that keep constraints."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import chain, islice

from benchmarks.worlds.constrained import load
from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service import Attached, Box, PlannerService, PlanRequest, Pose, Robot, Scene
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray
from planner_service.records.plan_file import SavedPlan
from planner_service.robot_setup.loading import load_robot

__all__ = ["ROBOTS", "plans"]

ROBOTS = ("wxai", "panda_mbm", "ur5", "wxai_dual")
SETS = ("bin", "carried", "box", "hands", "panda")
"""Stored queries with constraints; those of the set ``panda`` with the Panda."""

IN_SCENE, OBJECTS, LEAN = 5, (3, 10), 0.1
HELD = 3
"""In every third scene something is held, away from the hand so that the hand may stay closed around nothing."""


def plans(count: int, seed: int) -> Iterator[tuple[str, PlannerService, SavedPlan]]:
    """Plans that were found: a quarter of them with constraints, the rest of all robots in turn."""
    sources = [*(_drawn(name, seed) for name in ROBOTS), *([_constrained()] if seed == 0 else [])]
    return islice(chain.from_iterable(zip(*sources, strict=False)), count)


def _drawn(name: str, seed: int) -> Iterator[tuple[str, PlannerService, SavedPlan]]:
    robot, number = load_robot(name), 0
    while True:
        chance = random.Random(f"evidence {name} {seed} {number}")
        scene = Scene(tuple(draw_objects(chance, chance.randint(*OBJECTS))))
        if number % HELD == 0:
            scene = scene.with_attached(Attached("held", Box((0.03, 0.05, 0.07)), Pose(_ahead(robot))))
        service = PlannerService(robot, scene)
        for start, goal in _ends(service, chance):
            result = service.plan(PlanRequest(start, goal, seed=number, time_limit=None, max_checks=100_000))
            if result.ok:
                yield name, service, SavedPlan.of(result)
        number += 1


def _ends(service: PlannerService, chance: random.Random) -> list[tuple[FloatArray, FloatArray]]:
    """None in a scene that leaves no room."""
    try:
        return list(islice(blocked_ends(service.checker, chance), IN_SCENE))
    except BrokenInvariant:
        return []


def _ahead(robot: Robot) -> tuple[float, float, float]:
    if robot.gripper is None:
        return (0.0, 0.0, 0.1)
    x, y, z = robot.gripper.approach
    return (0.1 * x, 0.1 * y, 0.1 * z)


def _constrained() -> Iterator[tuple[str, PlannerService, SavedPlan]]:
    for name in SETS:
        robot = load_robot({"panda": "panda_mbm", "hands": "wxai_dual"}.get(name, "wxai"))
        for query in load(name):
            service = PlannerService(robot, query.scene)
            kept = query.constraints(LEAN)
            result = service.plan(PlanRequest(query.start, query.goals, constraints=kept, max_checks=100_000))
            if result.ok:
                yield f"{name}, constrained", service, SavedPlan.of(result)
