"""Plans to be proven to others: four robots among drawn obstacles, with and without something in the hand, and plans
that keep constraints."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import chain, islice

import planner_service as ps
from benchmarks.worlds.constrained import load
from benchmarks.worlds.drawn import blocked_ends, draw_objects
from planner_service.geometry.arrays import FloatArray
from planner_service.records import SavedPlan

__all__ = ["ROBOTS", "plans"]

ROBOTS = ("wxai", "panda_mbm", "ur5", "wxai_dual")
SETS = ("bin", "carried", "box", "hands", "panda")
"""Stored queries with constraints; those of the set ``panda`` with the Panda."""

IN_SCENE, OBJECTS, LEAN = 5, (3, 10), 0.1
HELD = 3
"""In every third scene something is held, away from the hand so that the hand may stay closed around nothing."""


def plans(count: int, seed: int) -> Iterator[tuple[str, ps.PlannerService, SavedPlan]]:
    """Plans that were found: a quarter of them with constraints, the rest of all robots in turn."""
    sources = [*(_drawn(name, seed) for name in ROBOTS), *([_constrained()] if seed == 0 else [])]
    return islice(chain.from_iterable(zip(*sources, strict=False)), count)


def _drawn(name: str, seed: int) -> Iterator[tuple[str, ps.PlannerService, SavedPlan]]:
    robot, number = ps.load_robot(name), 0
    while True:
        chance = random.Random(f"evidence {name} {seed} {number}")
        scene = ps.Scene(tuple(draw_objects(chance, chance.randint(*OBJECTS))))
        if number % HELD == 0:
            scene = scene.with_attached(ps.Attached("held", ps.Box((0.03, 0.05, 0.07)), ps.Pose(_ahead(robot))))
        service = ps.PlannerService(robot, scene)
        for start, goal in _ends(service, chance):
            result = service.plan(ps.PlanRequest(start, goal, seed=number, time_limit=None, max_checks=100_000))
            if result.ok:
                yield name, service, SavedPlan.of(result)
        number += 1


def _ends(service: ps.PlannerService, chance: random.Random) -> list[tuple[FloatArray, FloatArray]]:
    """None in a scene that leaves no room."""
    try:
        return list(islice(blocked_ends(service.checker, chance), IN_SCENE))
    except ps.BrokenInvariant:
        return []


def _ahead(robot: ps.Robot) -> tuple[float, float, float]:
    if robot.gripper is None:
        return (0.0, 0.0, 0.1)
    x, y, z = robot.gripper.approach
    return (0.1 * x, 0.1 * y, 0.1 * z)


def _constrained() -> Iterator[tuple[str, ps.PlannerService, SavedPlan]]:
    for name in SETS:
        robot = ps.load_robot({"panda": "panda_mbm", "hands": "wxai_dual"}.get(name, "wxai"))
        for query in load(name):
            service = ps.PlannerService(robot, query.scene)
            kept = query.constraints(LEAN)
            result = service.plan(ps.PlanRequest(query.start, query.goals, constraints=kept, max_checks=100_000))
            if result.ok:
                yield f"{name}, constrained", service, SavedPlan.of(result)
