"""Planning problems in JSON: a robot's joints, and for each problem a start, goals and obstacles.

::

    {
      "joints": ["joint_0", "joint_1"],                 # order of the values in start and goals
      "robot": "planar2",                               # optional, as are "source", "units" and "conventions"
      "problems": [{
        "id": "post/1",                                 # once in a file; "scene" and "index" are optional
        "start": [0.0, 0.0],
        "goals": [[1.0, 0.0]],
        "obstacles": [
          {"name": "post", "type": "cylinder", "radius": 0.03, "length": 0.4, "position": [0.3, 0.0, 0.2],
           "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]},    # optional; x y z w here, w x y z in our own files
          {"name": "shelf", "type": "box", "size": [0.4, 0.2, 0.02], "position": [0.3, 0.0, 0.5]},
          {"name": "ball", "type": "sphere", "radius": 0.05, "position": [0.0, 0.4, 0.2]}
        ]}]
    }

Metres and radians; a box by its full lengths, a cylinder along its local z, poses in the robot's base frame. This is
the format in which problems of MotionBenchMaker (Chamzas et al., RA-L 2022) are passed on.
"""

from __future__ import annotations

import os
import reprlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.json_reader import Node, read_json
from planner_service.files.reading import as_path
from planner_service.geometry.shapes import Box, Cylinder, FloatArray, Pose, Shape, Sphere, copied_in, read_only
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot
from planner_service.scene.obstacle_list import MAX_FOUND
from planner_service.scene.scene import MAX_OBJECTS, Obstacle, Scene

__all__ = ["Problem", "ProblemSet", "read_problems"]

MAX_JOINTS = 100
MAX_GOALS = 1000
MAX_PROBLEMS = 10_000
"""The largest set of MotionBenchMaker has 100 for each of its worlds."""

_PROBLEM_KEYS = ("id", "scene", "index", "start", "goals", "obstacles")
_SIZE_KEYS = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
_BODY_KEYS = ("name", "type", "position", "quaternion_xyzw")


@dataclass(frozen=True, eq=False)
class Problem:
    """A motion to be planned, in a world of its own.

    Attributes:
        id: Its name, once in its set; also the name of the scene.
        start: Joint vector, shape (n,), in the order of ``joint_names``.
        goals: Joint vectors, any of which will do.
    """

    id: str
    joint_names: tuple[str, ...]
    scene: Scene
    start: FloatArray
    goals: tuple[FloatArray, ...]

    def __post_init__(self) -> None:
        copied_in(self, "joint_names", "start")
        object.__setattr__(self, "goals", tuple(read_only(goal) for goal in self.goals))

    def request(self, robot: Robot, **settings: Any) -> PlanRequest:
        """What to ask of ``PlannerService(robot, problem.scene)``; settings are those of ``PlanRequest``.

        Raises:
            InvalidRequest: the joints of ``robot`` are others, or in another order.
        """
        if robot.joint_names != self.joint_names:
            ours, theirs = ", ".join(robot.joint_names), ", ".join(self.joint_names)
            message = f"robot: {robot.name} has the joints {ours}; problem {self.id!r} is for {theirs}"
            raise InvalidRequest("robot", robot.name, f"a robot with the joints {theirs}", message=message)
        return PlanRequest(self.start, self.goals[0] if len(self.goals) == 1 else self.goals, **settings)


@dataclass(frozen=True, eq=False)
class ProblemSet:
    """Problems for one robot, in the file's order.

    Attributes:
        robot: What the file calls the robot; empty if it does not say.
        source: Where the problems come from, in the file's words; may be empty.
    """

    joint_names: tuple[str, ...]
    problems: tuple[Problem, ...]
    robot: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        copied_in(self, "joint_names", "problems")

    def problem(self, id: str) -> Problem:
        """The problem of that name.

        Raises:
            UnknownName: there is none.
        """
        found = next((problem for problem in self.problems if problem.id == id), None)
        if found is None:
            raise UnknownName("problem", id, (problem.id for problem in self.problems))
        return found


def read_problems(path: str | os.PathLike[str]) -> ProblemSet:
    """The problems in a JSON file.

    Raises:
        InvalidFile: with the problems found, up to where there are too many of them; a key of a problem or an
            obstacle that is not known is one, as it would change what is meant.
    """
    path = as_path("path", path)
    root = Node("", read_json(path), [])
    joints = _joints(root.at("joints"))
    texts = [root.at(key).text() if root.has(key) else "" for key in ("robot", "source")]
    _refuse(path, root)
    problems, ids = [], set[str]()
    for node in _at_most(root.at("problems"), MAX_PROBLEMS).items():
        problem = _problem(node, joints)
        if problem is not None and problem.id in ids:
            node.problem(f"the id {problem.id!r} is taken")
        elif problem is not None:
            ids.add(problem.id)
            problems.append(problem)
        if _hopeless(root):
            break
    _refuse(path, root)
    return ProblemSet(joints, tuple(problems), *texts)


def _refuse(path: Path, root: Node) -> None:
    if root.problems:
        raise InvalidFile(path, root.problems)


def _hopeless(node: Node) -> bool:
    return len(node.problems) > MAX_FOUND


def _joints(node: Node) -> tuple[str, ...]:
    names = tuple(item.text() for item in _at_most(node, MAX_JOINTS).items())
    if node.sound and not (names and len(set(names)) == len(names) and all(names)):
        node.wrong(f"1 to {MAX_JOINTS} names, each once")
    return names


def _problem(node: Node, joints: tuple[str, ...]) -> Problem | None:
    n = len(joints)
    _allow_only(node, _PROBLEM_KEYS)
    name = node.at("id").text()
    start = node.at("start").numbers(n)
    goals = _at_most(node.at("goals"), MAX_GOALS).rows(n)
    obstacles = []
    for item in _at_most(node.at("obstacles"), MAX_OBJECTS).items():
        obstacles.append(_obstacle(item))
        if _hopeless(node):
            return None
    scene = node.attempt(lambda: Scene(tuple(o for o in obstacles if o is not None), name=name))
    if not node.sound or scene is None:
        return None
    if not goals or not name:
        node.problem("expected an id and at least one goal")
        return None
    return Problem(name, joints, scene, read_only(start), tuple(map(read_only, goals)))


def _obstacle(node: Node) -> Obstacle | None:
    kind = node.at("type").text()
    if not node.sound:
        return None
    if kind not in _SIZE_KEYS:
        node.at("type").wrong(f"one of {', '.join(_SIZE_KEYS)}")
        return None
    _allow_only(node, (*_BODY_KEYS, *_SIZE_KEYS[kind]))
    shape = _shape(node, kind)
    name, (x, y, z) = node.at("name").text(), node.at("position").numbers(3)
    qx, qy, qz, qw = node.at("quaternion_xyzw").numbers(4) if node.has("quaternion_xyzw") else (0.0, 0.0, 0.0, 1.0)
    pose = node.attempt(lambda: Pose((x, y, z), (qw, qx, qy, qz)))
    if shape is None or pose is None:
        return None
    return node.attempt(lambda: Obstacle(name, shape, pose))


def _shape(node: Node, kind: str) -> Shape | None:
    if kind == "box":
        x, y, z = node.at("size").numbers(3)
        return node.attempt(lambda: Box((x, y, z)))
    radius = node.at("radius").number()
    if kind == "sphere":
        return node.attempt(lambda: Sphere(radius))
    length = node.at("length").number()
    return node.attempt(lambda: Cylinder(radius, length))


def _at_most(node: Node, most: int) -> Node:
    """The node, noted as wrong if it is a longer list: a file of megabytes would keep its reader busy for minutes."""
    if isinstance(node.value, list) and len(node.value) > most:
        node.wrong(f"at most {most:,} entries; there are {len(node.value):,}")
    return node


def _allow_only(node: Node, keys: tuple[str, ...]) -> None:
    """Note the first key that is not among them: a quaternion in another order must not be overlooked."""
    unknown = next((key for key in node.value if key not in keys), None) if isinstance(node.value, dict) else None
    if unknown is not None:
        node.problem(f"unknown key {reprlib.repr(unknown)}; allowed: {', '.join(keys)}")
