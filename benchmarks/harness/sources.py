"""Where the problems of a suite come from: each kind of table in its file, and what it makes."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from benchmarks.worlds import queries
from benchmarks.worlds.drawn import blocked_ends
from benchmarks.worlds.planar import MOST_JOINTS, planar_robot
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.files.schema import Record, Text, at_most
from planner_service.geometry.arrays import FloatArray
from planner_service.records.problem_set import read_problems
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene

__all__ = ["Maker", "Motion", "Sources"]

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


Maker = Callable[[], Iterator[Motion]]
"""Makes the problems of a table, once the whole file is right."""


# Kinds of values.


def _robot(text: str) -> str:
    """A robot that ``load_robot`` finds, or ``planar:N``."""
    planar = re.fullmatch(r"planar:(\d{1,3})", text)
    if planar is None:
        load_robot(text)
    elif not 1 <= int(planar[1]) <= MOST_JOINTS:
        raise ValueError(f"planar:1 to planar:{MOST_JOINTS}")
    return text


def _path_of(robot: str) -> str:
    """What ``load_robot`` takes for a robot of a suite."""
    name, _, joints = robot.partition(":")
    return planar_robot(int(joints)) if name == "planar" else robot


def _scene(name: str) -> str:
    load_scene(name)
    return name


def _query_scene(name: str) -> str:
    if name not in queries.SCENES:
        raise ValueError(f"one of {', '.join(queries.SCENES)}")
    return name


def _problem_file(name: str) -> str:
    if not re.fullmatch(r"[\w-]+\.json", name):
        raise ValueError("the name of a file in benchmarks/problems")
    read_problems(PROBLEM_SETS / name)
    return name


def _each_once(values: list[int]) -> list[int]:
    """Refuse what would be the same problem again, before it is made."""
    if len(set(values)) < len(values):
        raise ValueError("each number once")
    return values


Robot = Annotated[Text, AfterValidator(_robot)]
SceneName = Annotated[Text, AfterValidator(_scene)]
QueryScene = Annotated[Text, AfterValidator(_query_scene)]
Some = Field(min_length=1, description="a list of at least one entry")
Numbers = Annotated[
    list[Annotated[int, Field(ge=0, lt=queries.PER_SCENE)]], AfterValidator(_each_once), Some, at_most(MAX_COUNT)
]
Texts = Annotated[list[Text], Some, at_most(MAX_COUNT)]


# Tables: the value of each makes its problems.


class QueriesTable(Record):
    """``[[queries]]``."""

    scenes: Annotated[list[QueryScene], Some, at_most(MAX_COUNT)]
    numbers: Numbers | None = None

    @cached_property
    def value(self) -> Maker:
        numbers = range(queries.PER_SCENE) if self.numbers is None else self.numbers

        def make() -> Iterator[Motion]:
            for name in self.scenes:
                scene, stored = load_scene(name), queries.load(name)
                for query in (stored[k] for k in numbers):
                    yield Motion(f"{name}/{query.number}", name, queries.ROBOT, scene, query.start, (query.goal,))

        return make


class ProblemsTable(Record):
    """``[[problems]]``."""

    file: Annotated[Text, AfterValidator(_problem_file)]
    robot: Robot
    ids: Texts | None = None

    @cached_property
    def value(self) -> Maker:
        problems = read_problems(PROBLEM_SETS / self.file).problems
        robot = _path_of(self.robot)
        if problems:
            problems[0].request(load_robot(robot))
        unknown = set(self.ids or ()) - {problem.id for problem in problems}
        if unknown:
            raise InvalidRequest("ids", sorted(unknown)[0], f"the ids of problems in {self.file}")

        def make() -> Iterator[Motion]:
            for p in problems:
                if self.ids is None or p.id in self.ids:
                    yield Motion(p.id, p.id.partition("/")[0], robot, p.scene, p.start, p.goals)

        return make


class DrawnTable(Record):
    """``[[drawn]]``."""

    robots: Annotated[list[Robot], Some, at_most(MAX_COUNT)]
    scene: SceneName
    count: Annotated[int, Field(ge=1, le=MAX_COUNT)]

    @cached_property
    def value(self) -> Maker:
        def make() -> Iterator[Motion]:
            scene = load_scene(self.scene)
            for text in self.robots:
                name = _path_of(text)
                robot = load_robot(name)
                chance = random.Random(f"{queries.SEED} ends {robot.name} {scene.name}")
                ends = blocked_ends(CollisionChecker(robot, scene), chance)
                for k, (start, goal) in enumerate(islice(ends, self.count)):
                    yield Motion(f"{text}/{k}", f"{robot.n} joints", name, scene, start, (goal,))

        return make


class Sources(Record):
    """All kinds of tables."""

    queries: Annotated[list[QueriesTable], at_most(MAX_COUNT)] = Field([])
    problems: Annotated[list[ProblemsTable], at_most(MAX_COUNT)] = Field([])
    drawn: Annotated[list[DrawnTable], at_most(MAX_COUNT)] = Field([])

    @property
    def makers(self) -> list[Maker]:
        """What makes the problems of each table, kind by kind."""
        return [table.value for kind in Sources.model_fields for table in getattr(self, kind)]
