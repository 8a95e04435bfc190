"""Where the problems of a suite come from: each kind of table in its file, and what it makes."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.baselines.lesson import Toy
from benchmarks.worlds import queries
from benchmarks.worlds.growing import MOST_JOINTS, MOST_OBSTACLES, blocked_ends, crowd, planar_robot
from planner_service.errors import InvalidRequest
from planner_service.files.json_reader import Node
from planner_service.geometry.shapes import Box, FloatArray, Pose
from planner_service.records.problem_set import read_problems
from planner_service.robot.model import load_robot
from planner_service.scene.scene import Obstacle, Scene, load_scene

__all__ = [
    "SOURCES",
    "Maker",
    "Motion",
    "Problem",
    "Task",
    "ToyQuery",
    "allow_only",
    "at_most",
    "attempt",
    "listed",
    "whole",
]

PROBLEM_SETS = Path(__file__).parents[1] / "problems"

MAX_COUNT = 1000
"""Problems of one kind that a suite may draw, and entries of a list in it."""


@dataclass(frozen=True, eq=False)
class Motion:
    """From a configuration to one of several, in a scene.

    Attributes:
        id: Once in a suite, such as ``bin/3``.
        kind: What it is one of, such as ``bin``.
        robot: The name of a robot, or the path of its robot.toml.
        start: Shape (n,).
        goals: Shape (n,) each; any of them will do.
    """

    id: str
    kind: str
    robot: str
    scene: Scene
    start: FloatArray
    goals: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Task:
    """A pick and a place, from home and back to it."""

    id: str
    kind: str
    robot: str
    scene: Scene
    target: str
    onto: str


@dataclass(frozen=True)
class ToyQuery:
    """The lesson's query: a point in the square of two joints, and a disc in its way."""

    id: str = "toy"
    kind: str = "toy"
    robot: str = "a point"
    start = Toy.START
    goals = (Toy.GOAL,)


Problem = Motion | Task | ToyQuery


Maker = Callable[[], Iterator[Problem]]
"""Makes the problems of a table, once the whole file is right."""


def _queries(node: Node) -> Maker | None:
    allow_only(node, ("scenes", "numbers"))
    scenes, numbers = _query_scenes(node, "scenes"), _numbers(node)

    def make() -> Iterator[Problem]:
        for name in scenes:
            scene, stored = load_scene(name), queries.load(name)
            for query in (stored[k] for k in numbers):
                yield Motion(f"{name}/{query.number}", name, queries.ROBOT, scene, query.start, (query.goal,))

    return make


def _problems(node: Node) -> Maker | None:
    allow_only(node, ("file", "robot", "ids"))
    file, arm = node.at("file"), node.at("robot")
    name, robot = file.text(), _robot(arm)
    if not re.fullmatch(r"[\w-]+\.json", name):
        file.wrong("the name of a file in benchmarks/problems")
        return None
    found = attempt(file, read_problems, PROBLEM_SETS / name)
    ids = [item.text() for item in listed(node.at("ids"))] if node.has("ids") else None
    problems = () if found is None else found.problems
    if problems and arm.sound:
        attempt(arm, problems[0].request, load_robot(robot))
    unknown = set(ids or ()) - {problem.id for problem in problems}
    if unknown:
        node.at("ids").problem(f"no problem {sorted(unknown)[0]!r} in {name}")

    def make() -> Iterator[Problem]:
        for p in problems:
            if ids is None or p.id in ids:
                yield Motion(p.id, p.id.partition("/")[0], robot, p.scene, p.start, p.goals)

    return make


def _tasks(node: Node) -> Maker | None:
    allow_only(node, ("scene", "robot", "pick", "onto", "without", "block", "tray"))
    robot = _robot(node.at("robot")) if node.has("robot") else queries.ROBOT
    place, *wanted = (node.at(key) for key in ("scene", "pick", "onto"))
    name, target, onto = (item.text() for item in (place, *wanted))
    scene, said = attempt(place, load_scene, name), []
    without = listed(node.at("without")) if node.has("without") else []
    for key, put in (("block", _block), ("tray", _tray)):
        if node.has(key):
            where = node.at(key)
            x, y = where.numbers(2)
            said.append(f"{key} {x:g} {y:g}")
            scene = None if scene is None else attempt(where, scene.with_obstacle, put(x, y))
    for gone in without:
        scene = None if scene is None else attempt(gone, scene.without, gone.text())
    for item in wanted:
        if scene is not None:
            attempt(item, scene.obstacle, item.text())
    id = "/".join(["task", name, *(f"without {gone.value}" for gone in without), *said]).replace(" ", "_")

    def make() -> Iterator[Problem]:
        if scene is not None:
            yield Task(id, "task", robot, scene, target, onto)

    return make


def _block(x: float, y: float) -> Obstacle:
    return Obstacle("blue_block", Box((0.045, 0.045, 0.045)), Pose((x, y, 0.0225)))


def _tray(x: float, y: float) -> Obstacle:
    return Obstacle("tray", Box((0.16, 0.16, 0.01)), Pose((x, y, 0.005)))


def _drawn(node: Node) -> Maker | None:
    allow_only(node, ("robots", "scene", "count"))
    robots = [(item.text(), _robot(item)) for item in listed(node.at("robots"))]
    scene, count = attempt(node, load_scene, node.at("scene").text()), whole(node.at("count"), MAX_COUNT)

    def make() -> Iterator[Problem]:
        for text, name in robots:
            robot = load_robot(name)
            for k, (start, goal) in enumerate(blocked_ends(robot, scene, count)):
                kind = f"{robot.n} joints"
                yield Motion(f"{text}/{k}", kind, name, scene, start, (goal,))

    return make


def _crowds(node: Node) -> Maker | None:
    allow_only(node, ("scene", "numbers", "obstacles"))
    scenes, numbers = _query_scenes(node, "scene"), _numbers(node)
    told = node.at("obstacles")
    sizes = [item.whole() for item in listed(told)]
    if any(size > MOST_OBSTACLES for size in sizes):
        told.wrong(f"whole numbers of at most {MOST_OBSTACLES}")
    _each_once(told, sizes)

    def make() -> Iterator[Problem]:
        for query in (queries.load(scenes[0])[k] for k in numbers):
            for size in sizes:
                kind, scene = f"{size} obstacle{'s' * (size != 1)}", crowd(query, size)
                id = f"{kind}/{query.name}"
                yield Motion(id, kind, queries.ROBOT, scene, query.start, (query.goal,))

    return make


def _toy(node: Node) -> Maker | None:
    allow_only(node, ())
    return lambda: iter((ToyQuery(),))


SOURCES: Mapping[str, Callable[[Node], Maker | None]] = {
    "queries": _queries,
    "problems": _problems,
    "tasks": _tasks,
    "drawn": _drawn,
    "crowds": _crowds,
    "toy": _toy,
}


# --- values


def _robot(node: Node) -> str:
    """What ``load_robot`` takes for a robot's name, or for ``planar:N``."""
    text = node.text()
    planar = re.fullmatch(r"planar:(\d{1,3})", text)
    if planar is None:
        attempt(node, load_robot, text)
        return text
    if not 1 <= int(planar[1]) <= MOST_JOINTS:
        node.wrong(f"planar:1 to planar:{MOST_JOINTS}")
        return text
    return planar_robot(int(planar[1]))


def _query_scenes(node: Node, key: str) -> list[str]:
    items = [node.at(key)] if key == "scene" else list(listed(node.at(key)))
    for item in items:
        if item.text() not in queries.SCENES:
            item.wrong(f"one of {', '.join(queries.SCENES)}")
    return [item.value for item in items]


def _numbers(node: Node) -> Sequence[int]:
    if not node.has("numbers"):
        return range(queries.PER_SCENE)
    told = node.at("numbers")
    found = [item.whole() for item in listed(told)]
    if any(k >= queries.PER_SCENE for k in found):
        told.wrong(f"numbers below {queries.PER_SCENE}")
    _each_once(told, found)
    return found


def _each_once(node: Node, values: Sequence[int]) -> None:
    """Refuse what would be the same problem again, before it is made."""
    if node.sound and len(set(values)) < len(values):
        node.wrong("each number once")


def whole(node: Node, most: int) -> int:
    value = node.whole()
    if not 1 <= value <= most:
        node.wrong(f"a whole number from 1 to {most}")
    return value


def listed(node: Node) -> list[Node]:
    items = at_most(node)
    if not items:
        node.wrong("at least one entry")
    return items


def at_most(node: Node) -> list[Node]:
    if isinstance(node.value, list) and len(node.value) > MAX_COUNT:
        node.wrong(f"at most {MAX_COUNT} entries")
        return []
    return list(node.items())


def attempt(node: Node, make: Callable[[Any], Any], value: Any) -> Any:
    """What ``make`` returns; None if it refuses, which is one more problem, or if the value is a stand-in."""
    try:
        return make(value) if node.sound else None
    except InvalidRequest as error:
        node.problem(str(error).removeprefix(f"{node.where}: "))
        return None


def allow_only(node: Node, keys: Sequence[str]) -> None:
    unknown = [key for key in node.value if key not in keys] if isinstance(node.value, dict) else []
    for key in unknown[:MAX_COUNT]:
        node.problem(f"unknown key {reprlib.repr(key)}; allowed: {', '.join(keys) or 'none'}")
