"""Queries under constraints, drawn from seeds without asking any planner, and stored.

Ends are free and keep their constraints. Goals are all configurations found for the same tool pose, as a person would
ask for a pose: one configuration may be on a branch that no motion reaches. Whether a way exists is not known;
in space a straight joint line is none.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.studies.problems import public_problems
from benchmarks.worlds.drawn import draw_objects
from benchmarks.worlds.queries import DECIMALS, DRAWS, SCENES, SEED, Region
from planner_service.collision import CollisionChecker
from planner_service.constraints import Constraint, InBox, KeepUpright, OnLine, OnPlane, RelativePose, ToolRegion
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, Vector, read_only, vector
from planner_service.geometry.shapes import Box, Pose
from planner_service.kinematics.constraint_set import ConstraintSet
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.projection import Projector, projector_of
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = ["FOLDER", "REGIONS", "ROBOTS", "UPRIGHT", "ConstrainedQuery", "draw", "load", "stored_text", "text_of"]

FOLDER = Path(__file__).parents[1] / "queries" / "constrained"

UPRIGHT = ("panda", "bin", "shelf", "clutter", "carried")
"""Sets of queries with a cup; the same for every tolerance."""

REGIONS = ("plane", "line", "box", "hands")

ROBOTS: Mapping[str, str] = {
    **dict.fromkeys(("bin", "shelf", "clutter", "carried", "line", "box"), "wxai"),
    **dict.fromkeys(("panda", "plane"), "panda_mbm"),
    "hands": "wxai_dual",
}

CUPS, PER_WORLD, WORLDS = 20, 5, 10
"""Queries of a scene with a cup, and queries in each of so many drawn worlds."""

TIGHT = 0.02
"""Radians: the ends with a cup are upright within this."""

AXES: tuple[Vector, ...] = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1))

NEAR, NEAR_DRAWS = (0.0, 0.05, 0.1, 0.2, 0.4), 20
"""Standard deviations (rad) about an end of a public problem from which it is projected, in turn."""

APART, CARRIED = 0.01, 0.15
"""Radians in some joint between two goals, and metres that a tray is carried at least."""

GRIP = 0.14
"""Metres from the middle of the tray to each hand."""

LEAST_HEIGHT = 0.055
"""Metres of a tool with a cup over the table: what it carries ends 4 cm below it, and a tray is 1 cm high."""

DOWN = (-1.0, 0.0, 0.0)
"""The tool's back, up when it reaches down from above; a tool that reaches forward has its z axis up."""

FLIPPED = (0.0, 1.0, 0.0, 0.0)
"""A half turn about x."""


@dataclass(frozen=True, eq=False)
class ConstrainedQuery:
    """From ``start`` (n,) to any of ``goals`` (m, n), constraints kept.

    Attributes:
        axis: The axis of the tool that stays up; None in a set without a cup.
        held: The constraints without a cup's.
    """

    set: str
    number: int
    scene: Scene
    start: FloatArray
    goals: FloatArray
    axis: Vector | None = None
    held: tuple[Constraint, ...] = ()

    @property
    def name(self) -> str:
        """Such as ``line-07``."""
        return f"{self.set}-{self.number:02d}"

    def constraints(self, tolerance: float | None = None) -> tuple[Constraint, ...]:
        """What is to be kept; with a cup, upright within a tolerance in radians."""
        return self.held if self.axis is None or tolerance is None else (KeepUpright(self.axis, tolerance),)


@dataclass(frozen=True, eq=False)
class _World:
    """A scene, the constraints that hold in it, and what holds, beside, at the two ends of a query."""

    scene: Scene
    held: tuple[Constraint, ...]
    ends: tuple[tuple[Constraint, ...], ...] = ()


def draw(name: str, seed: int = SEED) -> Iterator[ConstrainedQuery]:
    """The queries of a set; the same in every call and process of the pinned environment.

    The public problems are the same for every seed; their ends are made upright in another way.
    """
    if name == "panda":
        yield from _public(seed)
    elif name in UPRIGHT:
        yield from _cups(name, seed)
    else:
        for number in range(WORLDS):
            world = _world(name, number, seed)
            chance = random.Random(f"{seed} {name} queries {number}")
            pairs = _trays(world, chance) if name == "hands" else _reached(load_robot(ROBOTS[name]), world, chance)
            for k in range(PER_WORLD):
                start, goals = next(pairs)
                yield ConstrainedQuery(name, number * PER_WORLD + k, world.scene, start, goals, held=world.held)


def _scene(name: str, number: int) -> Scene:
    if name == "panda":
        return public_problems().problems[number].scene
    if name == "carried":
        cup = Attached("cup", Box((0.04, 0.02, 0.06)), Pose((0.02, 0.0, 0.0)), ("finger_left", "finger_right"))
        return load_scene("bin").with_attached(cup)
    return load_scene(name) if name in UPRIGHT else _world(name, number // PER_WORLD).scene


# A cup.


def _public(seed: int) -> Iterator[ConstrainedQuery]:
    """The public problems whose ends can be made upright, along the tool axis for which that takes least."""
    robot = load_robot(ROBOTS["panda"])
    for number, problem in enumerate(public_problems().problems):
        ends = [problem.start, problem.goals[0]]

        def tilt(axis: Vector, ends: Sequence[FloatArray] = ends) -> float:
            given = ConstraintSet(robot, (KeepUpright(axis, TIGHT),))
            return max(given.quantities(q)[0].value for q in ends)

        axis = min(AXES, key=tilt)
        projector = projector_of(ConstraintSet(robot, (KeepUpright(axis, TIGHT),)))
        checker, chance = CollisionChecker(robot, problem.scene), random.Random(f"{seed} upright {problem.id}")
        start, goal = (_nearest(projector, checker, q, chance) for q in ends)
        if start is not None and goal is not None:
            yield ConstrainedQuery("panda", number, problem.scene, start, read_only([goal]), axis)


def _nearest(
    projector: Projector, checker: CollisionChecker, q: FloatArray, chance: random.Random
) -> FloatArray | None:
    """The nearest free configuration found that keeps constraints, from the least disturbed ends that give one."""
    for deviation in NEAR:
        tries = ([v + chance.gauss(0.0, deviation) for v in q.tolist()] for _ in range(NEAR_DRAWS))
        found = (_free(projector, checker, near) for near in tries)
        kept = [end for end in found if end is not None]
        if kept:
            return min(kept, key=lambda end: float(np.linalg.norm(end - q)))
    return None


def _free(projector: Projector, checker: CollisionChecker, q: Sequence[float]) -> FloatArray | None:
    kept = projector.project(tuple(q))
    return None if kept is None else _rounded(checker, kept)


def _rounded(checker: CollisionChecker, q: Sequence[float]) -> FloatArray | None:
    """The configuration as it is stored, if it is free and inside the joint limits."""
    end, limits = read_only([round(value, DECIMALS) for value in q]), checker.robot.limits
    inside = bool(np.all((limits.lower <= end) & (end <= limits.upper)))
    return end if inside and checker.state_is_free(end) else None


def _cups(name: str, seed: int) -> Iterator[ConstrainedQuery]:
    """Between the regions of the stored queries, the tool upright and turned a little about the vertical."""
    robot, scene, chance = load_robot(ROBOTS[name]), _scene(name, 0), random.Random(f"{seed} upright {name}")
    checker, axis = CollisionChecker(robot, scene), DOWN if name in ("bin", "carried") else (0.0, 0.0, 1.0)
    pairs = SCENES["bin" if name == "carried" else name]
    for number in range(CUPS):
        sides = list(pairs[chance.randrange(len(pairs))])
        chance.shuffle(sides)
        start, goals = (_solutions(robot, checker, side, axis, chance) for side in sides)
        yield ConstrainedQuery(name, number, scene, _one_of(start, chance), goals, axis)


def _cup(region: Region, axis: Vector, chance: random.Random) -> Pose:
    x, y, z = (chance.uniform(*side) for side in (region.x, region.y, region.z))
    yaw = math.atan2(y, x) + math.radians(chance.uniform(-40.0, 40.0))
    return Pose.from_rpy((x, y, max(z, LEAST_HEIGHT)), (0.0, math.pi / 2 if axis == DOWN else 0.0, yaw))


def _solutions(
    robot: Robot, checker: CollisionChecker, region: Region, axis: Vector, chance: random.Random
) -> FloatArray:
    """All free configurations of the first pose in a region that has one."""
    for _ in range(DRAWS):
        solutions = inverse_kinematics(robot, _cup(region, axis, chance)).tolist()
        kept = [q for q in (_rounded(checker, solution) for solution in solutions) if q is not None]
        if kept:
            return read_only(kept)
    raise BrokenInvariant(f"no free configuration of {robot.name} in {checker.scene.name}")


def _one_of(ends: FloatArray, chance: random.Random) -> FloatArray:
    return read_only(ends[chance.randrange(len(ends))])


# Regions of space.


@cache
def _world(name: str, number: int, seed: int = SEED) -> _World:
    chance = random.Random(f"{seed} {name} world {number}")
    return _WORLDS[name](chance)


def _board(chance: random.Random) -> _World:
    """A tilted board before the arm with two blocks on it; a pen of 5 cm keeps its point 5 mm above it, to 1 mm."""
    position = (chance.uniform(0.45, 0.55), chance.uniform(-0.1, 0.1), chance.uniform(0.25, 0.45))
    board = Pose.from_rpy(position, (chance.uniform(-0.3, 0.3), chance.uniform(-1.0, -0.2), 0.0))
    obstacles = [Obstacle("board", Box((0.5, 0.6, 0.02)), board)]
    for k, y in enumerate((chance.uniform(-0.15, -0.05), chance.uniform(0.05, 0.15))):
        at = board @ Pose((chance.uniform(-0.1, 0.1), y, 0.04))
        obstacles.append(Obstacle(f"block_{k}", Box((0.05, 0.05, 0.06)), at))
    plane, pen = board @ Pose((0.0, 0.0, 0.015)), (0.0, 0.0, 0.05)
    sides = [((-0.2, -0.25, -0.0005), (0.2, -0.18, 0.0005)), ((-0.2, 0.18, -0.0005), (0.2, 0.25, 0.0005))]
    ends = tuple((ToolRegion(plane, low, high, tilt=0.8, tool=Pose(pen, FLIPPED)),) for low, high in sides)
    return _World(Scene(tuple(obstacles), name="board"), (OnPlane(plane, 0.001, point=pen),), ends)


def _line(chance: random.Random) -> _World:
    """A line before the arm, 1 or 2 mm wide either way, and objects at least 5 cm from it."""
    start, end = (
        (chance.uniform(0.22, 0.36), y, chance.uniform(0.12, 0.32)) for y in (chance.uniform(-0.3, -0.2), 0.25)
    )
    held = OnLine(start, end, chance.choice((0.001, 0.002)))
    stations = np.asarray(np.linspace(start, end, 30), dtype=np.float64)
    length = math.dist(start, end)
    t = held.upper[0]
    parts = [(0.0, 0.2 * length), (0.8 * length, length)]
    ends = tuple(_ahead(held.frame, (-t / 2, -t / 2, low), (t / 2, t / 2, high)) for low, high in parts)
    return _World(_cluttered(chance, stations, 0.05), (held,), ends)


def _box(chance: random.Random) -> _World:
    """A box of space before the arm, and objects in it and about it."""
    size = (chance.uniform(0.12, 0.25), 0.5, chance.uniform(0.12, 0.25))
    centre = Pose((chance.uniform(0.28, 0.36), 0.0, chance.uniform(0.18, 0.3)))
    x, y, z = (length / 2 for length in size)
    sides = [((-x, -y, -z), (x, -0.15, z)), ((-x, 0.15, -z), (x, y, z))]
    ends = tuple(_ahead(centre, low, high) for low, high in sides)
    return _World(_cluttered(chance, np.array([centre.position]), 0.02), (InBox(centre, size),), ends)


def _tray(chance: random.Random) -> _World:
    """Both hands on a tray, over a table with a post between them and objects about it."""
    held = RelativePose("right_ee_gripper_link", "left_ee_gripper_link", Pose((0.0, -2.0 * GRIP, 0.0)), 0.002, 0.01)
    places = np.array([(0.3, 0.0, 0.2), (0.0, 0.25, 0.1), (0.0, -0.25, 0.1)])  # the middle, and the bases of the arms
    scene, height = _cluttered(chance, places, 0.15, (2, 4)), chance.uniform(0.05, 0.2)
    at = Pose((chance.uniform(0.22, 0.4), chance.uniform(-0.12, 0.12), height / 2))
    return _World(scene.with_obstacle(Obstacle("post", Box((0.06, 0.06, height)), at)), (held,))


_WORLDS: Mapping[str, Callable[[random.Random], _World]] = {
    "plane": _board,
    "line": _line,
    "box": _box,
    "hands": _tray,
}


def _ahead(frame: Pose, lower: Vector, upper: Vector) -> tuple[Constraint, ...]:
    """A part of space, with the tool pointing forward and down within a radian."""
    return ToolRegion(frame, lower, upper), KeepUpright((1.0, 0.0, 0.0), 1.0, up=(0.8, 0.0, -0.6))


def _cluttered(chance: random.Random, places: FloatArray, apart: float, count: tuple[int, int] = (5, 9)) -> Scene:
    """A table with objects that keep some distance from places."""
    scene = load_scene("table")
    for obstacle in draw_objects(chance, chance.randint(*count)):
        back = obstacle.pose.inverse()
        local = places @ back.rotation.T + np.array(back.position)
        if float(obstacle.shape.distance(local).min()) > apart:
            scene = scene.with_obstacle(obstacle)
    return scene


def _reached(robot: Robot, world: _World, chance: random.Random) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Starts and goals: random configurations projected onto the constraints, at one side and at the other."""
    checker, held = CollisionChecker(robot, world.scene), ConstraintSet(robot, world.held)
    anywhere = projector_of(held)
    sides = [projector_of(ConstraintSet(robot, (*world.held, *end))) for end in world.ends]
    while True:
        order = sides if chance.random() < 0.5 else sides[::-1]
        start, goal = (_drawn(robot, projector, checker, chance) for projector in order)
        others = inverse_kinematics(robot, Pose.from_matrix(robot.tool_pose(goal))).tolist()
        rounded = [q for q in (_rounded(checker, other) for other in others) if q is not None]
        goals = [goal, *(q for q in rounded if held.violation(q) is None and float(np.abs(q - goal).max()) > APART)]
        if not _straight(anywhere, checker, start, goals):
            yield start, read_only(goals)


def _straight(projector: Projector, checker: CollisionChecker, start: FloatArray, goals: Iterable[FloatArray]) -> bool:
    """Whether a straight joint line to one of the goals is free and keeps the constraints: nothing to plan."""
    first = tuple(start.tolist())
    return any(projector.keeps(first, tuple(goal.tolist())) and checker.edge_is_free(start, goal) for goal in goals)


def _drawn(robot: Robot, projector: Projector, checker: CollisionChecker, chance: random.Random) -> FloatArray:
    limits = robot.limits
    ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), strict=True))
    for _ in range(DRAWS):
        q = _free(projector, checker, [chance.uniform(low, high) for low, high in ranges])
        if q is not None:
            return q
    raise BrokenInvariant(f"no free configuration of {robot.name} in {checker.scene.name}")


def _trays(world: _World, chance: random.Random) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Starts and goals: a tray before the arms, in all ways in which both can hold it."""
    robot, one = load_robot(ROBOTS["hands"]), load_robot("wxai")
    checker, held = CollisionChecker(robot, world.scene), ConstraintSet(robot, world.held)
    anyhow = projector_of(held)
    bases = [Pose.from_matrix(robot.link_frame(f"{side}_base_link")[1]).inverse() for side in ("left", "right")]

    def holds(tray: Pose) -> FloatArray:
        tools = [tray @ Pose((0.0, y, 0.0)) for y in (GRIP, -GRIP)]
        left, right = (inverse_kinematics(one, base @ tool).tolist() for base, tool in zip(bases, tools, strict=True))
        both = (_rounded(checker, [*a, *b]) for a in left for b in right)
        return np.array([q for q in both if q is not None and held.violation(q) is None])

    def anywhere() -> tuple[Pose, FloatArray]:
        for _ in range(DRAWS):
            position = (chance.uniform(0.2, 0.42), chance.uniform(-0.12, 0.12), chance.uniform(0.1, 0.4))
            turn = (chance.uniform(-0.2, 0.2), chance.uniform(0.2, 0.9), chance.uniform(-0.3, 0.3))
            tray = Pose.from_rpy(position, turn)
            found = holds(tray)
            if len(found):
                return tray, read_only(found)
        raise BrokenInvariant("no tray that both hands can hold")

    while True:
        (first, start), (second, goals) = anywhere(), anywhere()
        begin = _one_of(start, chance)
        if math.dist(first.position, second.position) > CARRIED and not _straight(anyhow, checker, begin, goals):
            yield begin, goals


def text_of(queries: Sequence[ConstrainedQuery]) -> str:
    """The content of a stored file: one query a line."""
    rows = [
        json.dumps({"number": q.number, "axis": q.axis, "start": q.start.tolist(), "goals": q.goals.tolist()})
        for q in queries
    ]
    first, body = queries[0], ",\n    ".join(rows)
    head = f'  "set": "{first.set}",\n  "robot": "{ROBOTS[first.set]}",\n  "seed": {SEED},\n'
    return f'{{\n{head}  "queries": [\n    {body}\n  ]\n}}\n'


def stored_text(name: str) -> str:
    """The stored file of a set as it is."""
    return (FOLDER / f"{name}.json").read_text("utf-8")


def load(name: str) -> tuple[ConstrainedQuery, ...]:
    """The stored queries of a set."""
    return tuple(_stored(name, **row) for row in json.loads(stored_text(name))["queries"])


def _stored(
    name: str, number: int, axis: Vector | None, start: list[float], goals: list[list[float]]
) -> ConstrainedQuery:
    up = None if axis is None else vector(axis)
    held = () if name in UPRIGHT else _world(name, number // PER_WORLD).held
    return ConstrainedQuery(name, number, _scene(name, number), read_only(start), read_only(goals), up, held)
