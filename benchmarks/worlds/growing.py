"""Worlds that grow: arms of more and more joints in a plane, and scenes of more and more obstacles."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.harness.audit import between
from benchmarks.studies.states import run_lesson
from benchmarks.worlds.drawn import turned
from benchmarks.worlds.queries import SEED, Query
from planner_service.collision import CollisionChecker
from planner_service.errors import BrokenInvariant
from planner_service.geometry.shapes import Box, Cylinder, Pose, Shape, Sphere
from planner_service.robot.model import load_robot
from planner_service.scene.scene import Obstacle, Scene, load_scene

__all__ = ["MOST_JOINTS", "MOST_OBSTACLES", "crowd", "planar_robot"]

MOST_JOINTS = 30
MOST_OBSTACLES = 1000

REACH = 1.5
"""Metres of a planar arm from its base to its tip, however many links it has: that of the textbooks' two-link arm."""

CANDIDATES = 1200
"""Obstacles drawn, of which those are kept that leave a known way free."""

ROOM = 0.02
"""Metres that an obstacle keeps from the known way."""

WAY_STEP = 0.05
"""Radians between configurations of the known way at which that is judged."""

SEEDS = 20
"""Seeds in vain after which there is no way."""


@cache
def _folder() -> TemporaryDirectory[str]:
    """Where planar arms are written; gone when the process ends."""
    return TemporaryDirectory(prefix="planar-arms-")


@cache
def planar_robot(joints: int) -> str:
    """The path of the robot.toml of an arm in the plane z = 0: links of equal length that may pass over one another."""
    folder = Path(_folder().name) / str(joints)
    folder.mkdir()
    length, names = REACH / joints, [f"joint_{k}" for k in range(joints)]
    links = ['<link name="base"/>', '<link name="tip"/>', _joint("tip_joint", "fixed", (joints - 1, length), "tip")]
    for k in range(joints):
        links.append(_link(k, length))
        links.append(_joint(names[k], "revolute", (k - 1, length if k else 0.0), f"link_{k}"))
    (folder / "planar.urdf").write_text(f'<robot name="planar{joints}">{"".join(links)}</robot>\n', "utf-8")
    pairs = [(f"link_{i}", f"link_{k}") for k in range(joints) for i in range(k)]
    contacts = "".join(f'[[allowed_contacts]]\nlinks = ["{a}", "{b}"]\nreason = "in a plane"\n' for a, b in pairs)
    file = folder / "robot.toml"
    file.write_text(
        f'name = "planar{joints}"\nurdf = "planar.urdf"\njoints = {names!r}\ntool_frame = "tip"\n'
        f'base_links = ["base"]\n[poses]\nhome = {[0.0] * joints}\n{_limits(joints)}{contacts}',
        "utf-8",
    )
    return str(file)


def _link(k: int, length: float) -> str:
    shape = f'<geometry><cylinder radius="0.01" length="{length!r}"/></geometry>'
    origin = f'<origin xyz="{length / 2!r} 0 0" rpy="0 {math.pi / 2!r} 0"/>'
    return f'<link name="link_{k}"><collision>{origin}{shape}</collision></link>'


def _joint(name: str, kind: str, after: tuple[int, float], child: str) -> str:
    parent = "base" if after[0] < 0 else f"link_{after[0]}"
    limits = f'<axis xyz="0 0 1"/><limit lower="{-math.pi!r}" upper="{math.pi!r}" velocity="1" effort="1"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{after[1]!r} 0 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{limits if kind == "revolute" else ""}</joint>'


def _limits(joints: int) -> str:
    kinds = {"velocity": 1.0, "acceleration": 2.0, "jerk": 50.0}
    tables = [f"[limits.position]\nlower = {[-math.pi] * joints}\nupper = {[math.pi] * joints}\nsource = 'as planar2'"]
    tables += [f"[limits.{kind}]\nvalues = {[value] * joints}\nsource = 'as planar2'" for kind, value in kinds.items()]
    return "\n".join(tables) + "\n"


@cache
def _candidates(query: Query) -> tuple[Obstacle, ...]:
    """Obstacles that leave the textbook's way from a query's start to its goal free."""
    robot, scene = load_robot("wxai"), load_scene(query.scene)
    checker = CollisionChecker(robot, scene)
    tries = (run_lesson(checker, replace(query, number=seed)).path for seed in range(SEEDS))
    way = next((path for path in tries if path is not None), None)
    if way is None:
        raise BrokenInvariant(f"{query.name}: the lesson's program finds no way with {SEEDS} seeds")
    chance = random.Random(f"{SEED} crowd {query.name}")
    drawn = [_obstacle(k, chance) for k in range(CANDIDATES)]
    judge = CollisionChecker(robot, Scene(tuple(drawn)), padding=ROOM)
    touched = {contact.b for q in between(way, WAY_STEP) for contact in judge.contacts(q)}
    return tuple(obstacle for obstacle in drawn if obstacle.name not in touched)


def _obstacle(number: int, chance: random.Random) -> Obstacle:
    position = (chance.uniform(-0.7, 0.7), chance.uniform(-0.7, 0.7), chance.uniform(0.03, 0.8))
    size = [chance.uniform(0.01, 0.04) for _ in range(3)]
    shapes: tuple[Shape, ...] = (Box((size[0], size[1], size[2])), Sphere(size[0] / 2), Cylinder(size[0] / 2, size[1]))
    return Obstacle(f"piece_{number}", chance.choice(shapes), Pose(position, turned(chance)))


def crowd(query: Query, count: int) -> Scene:
    """The scene of a query with so many small obstacles more in the air around the arm.

    They leave a known way free, with 2 cm of room; a larger crowd holds the smaller ones.
    """
    found = _candidates(query)
    if len(found) < count:
        raise BrokenInvariant(f"{query.name}: only {len(found)} of {CANDIDATES} obstacles leave the known way free")
    scene = load_scene(query.scene)
    return Scene((*scene.obstacles, *found[:count]), name=f"{query.name} with {count} more obstacles")
