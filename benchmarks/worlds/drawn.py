"""Tabletop scenes that nobody arranged, and pairs of free ends with something in between: drawn from a seed."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from itertools import islice

import planner_service as ps
from benchmarks.worlds.queries import ROBOT, SEED, Query
from planner_service.geometry import Shape
from planner_service.geometry.arrays import FloatArray, read_only

__all__ = ["COUNT", "PER_SCENE", "blocked_ends", "draw_crowd", "draw_objects", "draw_queries", "draw_scene", "turned"]

COUNT, PER_SCENE = 20, 10
"""Scenes, and queries in each."""

OBJECTS = (3, 8)

STANDING = 0.7
"""Part of the objects that stand upright on the table; the others hang in the air, turned anyhow."""

DRAWS = 100_000
"""Draws in vain after which a scene leaves no room."""


def draw_scene(number: int) -> ps.Scene:
    """A table with three to eight boxes, cylinders, spheres and capsules within reach of the arm."""
    chance = random.Random(f"{SEED} drawn scene {number}")
    scene = ps.load_scene("table")
    for obstacle in draw_objects(chance, chance.randint(*OBJECTS)):
        scene = scene.with_obstacle(obstacle)
    return scene


def draw_objects(chance: random.Random, count: int) -> Iterator[ps.Obstacle]:
    """Boxes, cylinders, spheres and capsules within reach of the arm, ``object_0`` and so on."""
    for k in range(count):
        shape, height = _shape(chance)
        azimuth, distance = chance.uniform(-math.pi, math.pi), chance.uniform(0.24, 0.55)
        standing = chance.random() < STANDING
        z = height / 2 if standing else chance.uniform(0.1, 0.6)
        yaw = chance.uniform(-math.pi, math.pi)
        quaternion = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)) if standing else turned(chance)
        position = (distance * math.cos(azimuth), distance * math.sin(azimuth), z)
        yield ps.Obstacle(f"object_{k}", shape, ps.Pose(position, quaternion))


def draw_crowd(chance: random.Random) -> ps.Scene:
    """One to eight boxes, spheres and cylinders as large as the arm, anywhere around its base and turned anyhow."""

    def side(low: float, high: float) -> float:
        return chance.uniform(low, high)

    scene = ps.Scene()
    for k in range(chance.randint(1, OBJECTS[1])):
        kind = chance.randrange(3)
        shape: Shape
        if kind == 0:
            shape = ps.Box((side(0.05, 0.4), side(0.05, 0.4), side(0.05, 0.4)))
        elif kind == 1:
            shape = ps.Sphere(side(0.03, 0.15))
        else:
            shape = ps.Cylinder(side(0.03, 0.12), side(0.1, 0.5))
        pose = ps.Pose((side(-0.5, 0.5), side(-0.5, 0.5), side(-0.1, 0.6)), turned(chance))
        scene = scene.with_obstacle(ps.Obstacle(f"object_{k}", shape, pose))
    return scene


def draw_queries(number: int, scene: ps.Scene) -> Iterator[Query]:
    """Pairs of free configurations, uniform in the joint limits, that no straight line joins."""
    ends = blocked_ends(ps.CollisionChecker(ps.load_robot(ROBOT), scene), random.Random(f"{SEED} drawn ends {number}"))
    for k, (start, goal) in enumerate(islice(ends, PER_SCENE)):
        yield Query(f"drawn-{number:02d}", k, start, goal, straight=False)


def blocked_ends(checker: ps.CollisionChecker, chance: random.Random) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Pairs of free configurations, uniform in the joint limits, that no straight line joins; without end."""
    limits = checker.robot.limits
    ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), strict=True))
    free: list[FloatArray] = []
    vain = 0
    while vain < DRAWS:
        vain += 1
        q = read_only([chance.uniform(low, high) for low, high in ranges])
        if checker.state_is_free(q):
            free.append(q)
        if len(free) == 2:
            if not checker.edge_is_free(*free):
                vain = 0
                yield free[0], free[1]
            free = []
    name = f"{checker.robot.name} in {checker.scene.name or 'a drawn scene'}"
    raise ps.BrokenInvariant(f"{name}: no two free configurations with something in between")


def turned(chance: random.Random) -> tuple[float, float, float, float]:
    """A uniform rotation, as a unit quaternion."""
    q = [chance.gauss(0.0, 1.0) for _ in range(4)]
    norm = math.sqrt(math.fsum(v * v for v in q))
    w, x, y, z = (v / norm for v in q)
    return (w, x, y, z)


def _shape(chance: random.Random) -> tuple[Shape, float]:
    """A shape and its height along z."""
    kind = chance.randrange(4)
    wide, tall = chance.uniform(0.02, 0.08), chance.uniform(0.05, 0.35)
    if kind == 0:
        return ps.Box((2 * wide, chance.uniform(0.03, 0.2), tall)), tall
    if kind == 1:
        return ps.Cylinder(wide, tall), tall
    if kind == 2:
        return ps.Sphere(wide), 2 * wide
    return ps.Capsule(wide, tall), tall + 2 * wide
