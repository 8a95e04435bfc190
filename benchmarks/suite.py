"""Suites: which problems, by which planners, with which seeds. TOML files in ``suites/``, or your own.

::

    about = "one sentence"
    planners = ["rrtconnect", "prm:milestones=200"]      # when a run names none: settings after a colon
    seeds = "0:5"                                        # when a run names none: 0, 1, 2, 3, 4
    max_checks = 50000                                   # optional: states a plan may judge
    ceilings = { rrtconnect = 8000 }                     # optional: p95 of a planner's states that the gate allows

    [[queries]]                                          # the stored queries of the WidowX AI
    scenes = ["bin", "shelf"]
    numbers = [0, 1]                                     # optional: all 20 if not given

    [[problems]]                                         # a JSON problem set beside this package
    file = "mbm_panda.json"
    robot = "panda_mbm"
    ids = ["cage/0057"]                                  # optional: all if not given

    [[tasks]]                                            # a pick and a place with its ways there and back
    scene = "bin"
    pick = "blue_block"
    onto = "tray"
    without = ["demo_post"]                              # optional: obstacles left out
    block = [0.3, -0.1]                                  # optional: a block "blue_block" standing at x, y,
    tray = [0.2, 0.28]                                   # and a "tray"

    [[drawn]]                                            # free ends that no straight line joins
    robots = ["planar:2", "planar:4", "wxai_dual"]       # planar:N is an arm of N joints in a plane
    scene = "discs"
    count = 3

    [[crowds]]                                           # stored queries among ever more obstacles
    scene = "post"
    numbers = [0]
    obstacles = [1, 10, 100, 1000]

    [[toy]]                                              # the lesson's two joints and a disc
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from benchmarks import queries
from benchmarks.growing import MOST_JOINTS, MOST_OBSTACLES, blocked_ends, crowd, planar_robot
from benchmarks.lesson import Toy
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.geometry import Box, FloatArray, Pose
from planner_service.interchange import read_problems
from planner_service.json_file import Node
from planner_service.planners import PLANNERS
from planner_service.robot import load_robot
from planner_service.scene import Obstacle, Scene, load_scene
from planner_service.scene_file import read_tables
from planner_service.search import Planner

__all__ = [
    "LESSON",
    "MAX_CHECKS",
    "SUITES",
    "Motion",
    "Problem",
    "Suite",
    "Task",
    "ToyQuery",
    "load_suite",
    "planner_of",
    "require_planner",
    "seeds_of",
    "suite_names",
]

SUITES = Path(__file__).parent / "suites"
PROBLEM_SETS = Path(__file__).parent / "problems"

MAX_COUNT = 1000
"""Problems of one kind that a suite may draw, and entries of a list in it."""

MAX_SEEDS = 10_000

MAX_CHECKS = 50_000
"""States a plan may judge where a suite says nothing: the budget of a default request."""

LESSON = "lesson"
"""The planner that is the textbook's program; it knows neither padding nor timing."""


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


@dataclass(frozen=True, eq=False)
class Suite:
    """Problems, and by which planners and with which seeds they are planned when nobody says otherwise.

    Attributes:
        max_checks: States a plan may judge.
        ceilings: By planner, the most that p95 of its states may be.
    """

    name: str
    about: str
    problems: tuple[Problem, ...]
    planners: tuple[str, ...]
    seeds: range
    max_checks: int
    ceilings: Mapping[str, int]


def suite_names() -> tuple[str, ...]:
    """The suites that come with the benchmarks."""
    return tuple(sorted(path.stem for path in SUITES.glob("*.toml")))


def load_suite(name_or_path: str) -> Suite:
    """A suite by name, or by the path of its TOML file, with its problems drawn.

    Raises:
        UnknownName: no such suite.
        InvalidFile: with all problems found.
    """
    path = Path(name_or_path)
    if not name_or_path.endswith(".toml"):
        if name_or_path not in suite_names():
            raise UnknownName("suite", name_or_path, suite_names())
        path = SUITES / f"{name_or_path}.toml"
    root = Node("", read_tables(path), [])
    _allow_only(root, ("about", "planners", "seeds", "max_checks", "ceilings", *_SOURCES))
    about, seeds = root.at("about").text(), root.at("seeds")
    span = _attempt(seeds, seeds_of, seeds.text())
    planners = tuple(item.text() for item in _listed(root.at("planners")))
    for text in planners:
        _attempt(root, require_planner, text)
    max_checks = _whole(root.at("max_checks"), 10**9) if root.has("max_checks") else MAX_CHECKS
    ceilings = _ceilings(root.at("ceilings"), planners) if root.has("ceilings") else {}
    makers = [_SOURCES[key](item) for key in _SOURCES if root.has(key) for item in _at_most(root.at(key))]
    if not root.problems and not makers:
        root.problem(f"no problems; expected at least one of {', '.join(f'[[{key}]]' for key in _SOURCES)}")
    if root.problems:
        raise InvalidFile(path, root.problems)
    found = tuple(problem for make in makers if make is not None for problem in make())
    ids = [problem.id for problem in found]
    twice = sorted({id for id in ids if ids.count(id) > 1})
    if twice:
        raise InvalidFile(path, [f"problem {id!r} is there twice" for id in twice])
    return Suite(path.stem, about, found, planners, span or range(0), max_checks, ceilings)


def require_planner(text: str) -> None:
    """Refuse what neither is ``LESSON`` nor says a planner; see ``planner_of``."""
    if text != LESSON:
        planner_of(text)


def planner_of(text: str) -> Planner:
    """The planner that ``name`` or ``name:setting=value,setting=value`` says.

    Raises:
        UnknownName: no such planner.
        InvalidRequest: it has no such setting, or the value is none.
    """
    name, _, rest = text.partition(":")
    if name not in PLANNERS:
        raise UnknownName("planner", name, PLANNERS)
    known = {item.name for item in fields(PLANNERS[name])}
    settings: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in known or not re.fullmatch(r"\d{1,12}(\.\d{1,12})?", value):
            raise InvalidRequest("planner", text, f"{name}:setting=number, settings being {', '.join(sorted(known))}")
        settings[key] = float(value) if "." in value else int(value)
    planner: Planner = PLANNERS[name](**settings)
    return planner


def seeds_of(text: str) -> range:
    """``A:B`` is A to B - 1, ``N`` is one seed.

    Raises:
        InvalidRequest: neither, or more than ``MAX_SEEDS``.
    """
    match = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?", text)
    if match:
        first, end = int(match[1]), int(match[2]) if match[2] else int(match[1]) + 1
        if first < end <= first + MAX_SEEDS:
            return range(first, end)
    raise InvalidRequest("seeds", text, f"N, or A:B for A to B - 1, at most {MAX_SEEDS:,} of them")


# --- sources: each reads its table, and returns what makes the problems once the whole file is right

Maker = Callable[[], Iterator[Problem]]


def _queries(node: Node) -> Maker | None:
    _allow_only(node, ("scenes", "numbers"))
    scenes, numbers = _query_scenes(node, "scenes"), _numbers(node)

    def make() -> Iterator[Problem]:
        for name in scenes:
            scene, stored = load_scene(name), queries.load(name)
            for query in (stored[k] for k in numbers):
                yield Motion(f"{name}/{query.number}", name, queries.ROBOT, scene, query.start, (query.goal,))

    return make


def _problems(node: Node) -> Maker | None:
    _allow_only(node, ("file", "robot", "ids"))
    file, robot = node.at("file"), _robot(node.at("robot"))
    name = file.text()
    if not re.fullmatch(r"[\w-]+\.json", name):
        file.wrong("the name of a file in benchmarks/problems")
        return None
    found = _attempt(file, read_problems, PROBLEM_SETS / name)
    ids = [item.text() for item in _listed(node.at("ids"))] if node.has("ids") else None
    problems = () if found is None else found.problems
    unknown = set(ids or ()) - {problem.id for problem in problems}
    if unknown:
        node.at("ids").problem(f"no problem {sorted(unknown)[0]!r} in {name}")

    def make() -> Iterator[Problem]:
        for p in problems:
            if ids is None or p.id in ids:
                yield Motion(p.id, p.id.partition("/")[0], robot, p.scene, p.start, p.goals)

    return make


def _tasks(node: Node) -> Maker | None:
    _allow_only(node, ("scene", "robot", "pick", "onto", "without", "block", "tray"))
    robot = _robot(node.at("robot")) if node.has("robot") else queries.ROBOT
    name, target, onto = (node.at(key).text() for key in ("scene", "pick", "onto"))
    scene = _attempt(node, load_scene, name)
    without = [item.text() for item in _listed(node.at("without"))] if node.has("without") else []
    for key, put in (("block", _block), ("tray", _tray)):
        if node.has(key):
            x, y = node.at(key).numbers(2)
            scene = None if scene is None else _attempt(node.at(key), scene.with_obstacle, put(x, y))
    for gone in without:
        scene = None if scene is None else _attempt(node, scene.without, gone)
    for wanted in (target, onto):
        if scene is not None:
            _attempt(node, scene.obstacle, wanted)
    said = [f"{key} {' '.join(f'{v:g}' for v in node.value[key])}" for key in ("block", "tray") if node.has(key)]
    id = "/".join(["task", name, *(f"without {gone}" for gone in without), *said]).replace(" ", "_")

    def make() -> Iterator[Problem]:
        if scene is not None:
            yield Task(id, "task", robot, scene, target, onto)

    return make


def _block(x: float, y: float) -> Obstacle:
    return Obstacle("blue_block", Box((0.045, 0.045, 0.045)), Pose((x, y, 0.0225)))


def _tray(x: float, y: float) -> Obstacle:
    return Obstacle("tray", Box((0.16, 0.16, 0.01)), Pose((x, y, 0.005)))


def _drawn(node: Node) -> Maker | None:
    _allow_only(node, ("robots", "scene", "count"))
    robots = [(item.text(), _robot(item)) for item in _listed(node.at("robots"))]
    scene, count = _attempt(node, load_scene, node.at("scene").text()), _whole(node.at("count"), MAX_COUNT)

    def make() -> Iterator[Problem]:
        for text, name in robots:
            robot = load_robot(name)
            for k, (start, goal) in enumerate(blocked_ends(robot, scene, count)):
                kind = f"{robot.n} joints"
                yield Motion(f"{text}/{k}", kind, name, scene, start, (goal,))

    return make


def _crowds(node: Node) -> Maker | None:
    _allow_only(node, ("scene", "numbers", "obstacles"))
    scenes, numbers = _query_scenes(node, "scene"), _numbers(node)
    sizes = [item.whole() for item in _listed(node.at("obstacles"))]
    if any(size > MOST_OBSTACLES for size in sizes):
        node.at("obstacles").wrong(f"whole numbers of at most {MOST_OBSTACLES}")

    def make() -> Iterator[Problem]:
        for query in (queries.load(scenes[0])[k] for k in numbers):
            for size in sizes:
                kind, scene = f"{size} obstacle{'s' * (size != 1)}", crowd(query, size)
                id = f"{kind}/{query.name}"
                yield Motion(id, kind, queries.ROBOT, scene, query.start, (query.goal,))

    return make


def _toy(node: Node) -> Maker | None:
    _allow_only(node, ())
    return lambda: iter((ToyQuery(),))


_SOURCES: Mapping[str, Callable[[Node], Maker | None]] = {
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
        _attempt(node, load_robot, text)
        return text
    if not 1 <= int(planar[1]) <= MOST_JOINTS:
        node.wrong(f"planar:1 to planar:{MOST_JOINTS}")
        return text
    return planar_robot(int(planar[1]))


def _query_scenes(node: Node, key: str) -> list[str]:
    items = [node.at(key)] if key == "scene" else list(_listed(node.at(key)))
    for item in items:
        if item.text() not in queries.SCENES:
            item.wrong(f"one of {', '.join(queries.SCENES)}")
    return [item.value for item in items]


def _numbers(node: Node) -> Sequence[int]:
    if not node.has("numbers"):
        return range(queries.PER_SCENE)
    found = [item.whole() for item in _listed(node.at("numbers"))]
    if any(k >= queries.PER_SCENE for k in found):
        node.at("numbers").wrong(f"numbers below {queries.PER_SCENE}")
    return found


def _ceilings(node: Node, planners: Sequence[str]) -> dict[str, int]:
    if not isinstance(node.value, dict) or not set(node.value) <= set(planners):
        node.wrong(f"a table of planners of this suite: {', '.join(planners)}")
        return {}
    return {name: _whole(node.at(name), 10**9) for name in node.value}


def _whole(node: Node, most: int) -> int:
    value = node.whole()
    if not 1 <= value <= most:
        node.wrong(f"a whole number from 1 to {most}")
    return value


def _listed(node: Node) -> list[Node]:
    items = _at_most(node)
    if not items:
        node.wrong("at least one entry")
    return items


def _at_most(node: Node) -> list[Node]:
    if isinstance(node.value, list) and len(node.value) > MAX_COUNT:
        node.wrong(f"at most {MAX_COUNT} entries")
        return []
    return list(node.items())


def _attempt(node: Node, make: Callable[[Any], Any], value: Any) -> Any:
    """What ``make`` returns; None if it refuses, which is one more problem."""
    try:
        return make(value)
    except InvalidRequest as error:
        node.problem(str(error))
        return None


def _allow_only(node: Node, keys: Sequence[str]) -> None:
    unknown = [key for key in node.value if key not in keys] if isinstance(node.value, dict) else []
    for key in unknown[:MAX_COUNT]:
        node.problem(f"unknown key {reprlib.repr(key)}; allowed: {', '.join(keys) or 'none'}")
