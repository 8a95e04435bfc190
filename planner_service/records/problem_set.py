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

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.schema import Joints, Reading, Record, Text, Vector3, Vector4, at_most, read_record
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.shapes import Box, Cylinder, Pose, Shape, Sphere
from planner_service.geometry.validation import copied_in
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot
from planner_service.scene.scene import MAX_OBJECTS, Obstacle, Scene

__all__ = ["Problem", "ProblemSet", "own_problems"]

MAX_JOINTS = 100
MAX_GOALS = 1000
MAX_PROBLEMS = 10_000
"""The largest set of MotionBenchMaker has 100 for each of its worlds."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A motion to be planned, in a world of its own.

    Attributes:
        id: Its name, once in its set; also the name of the scene.
        start: Joint vector, shape (n,), in the order of ``joint_names``.
        goals: Joint vectors, any of which will do; none if ``tool_pose`` is the goal.
        joint_names: Empty where the file does not say: the joints of the robot in its order.
        frame: The link in whose frame the scene is; empty or "world" for the base.
        robot: What the file calls the robot; may be empty.
        tool_pose: A link and where it is to be.
    """

    id: str
    joint_names: tuple[str, ...]
    scene: Scene
    start: FloatArray
    goals: tuple[FloatArray, ...]
    frame: str = ""
    robot: str = ""
    tool_pose: tuple[str, Pose] | None = None

    def __post_init__(self) -> None:
        copied_in(self, "joint_names", "start")
        object.__setattr__(self, "goals", tuple(read_only(goal) for goal in self.goals))

    def request(self, robot: Robot, **settings: Any) -> PlanRequest:
        """What to ask of ``PlannerService(robot, problem.scene)``; settings are those of ``PlanRequest``.

        Raises:
            InvalidRequest: the joints of ``robot`` are others, the scene is in a frame that is not its base's, or the
                goal is a pose of a link that is not its tool.
        """
        order = self._order(robot)
        self._require_base(robot)
        goals: list[Any] = [goal[order] for goal in self.goals]
        if self.tool_pose is not None:
            link, pose = self.tool_pose
            if link != robot.tool_frame:
                expected = f"{link}, the link of which problem {self.id!r} says where it is to be"
                raise InvalidRequest("tool_frame", robot.tool_frame, expected)
            goals = [pose]
        return PlanRequest(self.start[order], goals[0] if len(goals) == 1 else goals, **settings)

    def _order(self, robot: Robot) -> list[int]:
        """Where the joints of a robot are among those of the problem."""
        if not self.joint_names and len(self.start) == robot.n:
            return list(range(robot.n))
        if sorted(robot.joint_names) != sorted(self.joint_names):
            ours, theirs = ", ".join(robot.joint_names), ", ".join(self.joint_names) or f"{len(self.start)} joints"
            message = f"robot: {robot.name} has the joints {ours}; problem {self.id!r} is for {theirs}"
            raise InvalidRequest("robot", robot.name, f"a robot with the joints {theirs}", message=message)
        return [self.joint_names.index(name) for name in robot.joint_names]

    def _require_base(self, robot: Robot) -> None:
        if self.frame in ("", "world"):
            return
        frames = {frame.link: frame for frame in robot.link_frames}
        found = frames.get(self.frame)
        if found is None or found.body != 0 or found.pose != Pose():
            fixed = [link for link, frame in frames.items() if frame.body == 0 and frame.pose == Pose()]
            raise InvalidRequest(
                f"frame of problem {self.id!r}", self.frame, f"the base of {robot.name}: {', '.join(fixed)}"
            )


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
        by_id = {problem.id: problem for problem in self.problems}
        if id not in by_id:
            raise UnknownName("problem", id, by_id)
        return by_id[id]


def own_problems(path: Path, document: Any) -> ProblemSet:
    """The problems in a document of our own format.

    Raises:
        InvalidFile: with all problems found, up to where there are too many of them.
    """
    joints = document.get("joints") if isinstance(document, dict) else None
    reading = Reading(joints=len(joints) if isinstance(joints, list) and len(joints) <= MAX_JOINTS else None)
    problems: ProblemSet = read_record(ProblemFile, document, path, reading).value
    return problems


# The file, declared.


def _each_once(names: list[str]) -> list[str]:
    if not names or not all(names) or len(set(names)) != len(names):
        raise ValueError(f"1 to {MAX_JOINTS} names, each once")
    return names


class BodyEntry(Record):
    """An obstacle; each type has the sizes of its shape."""

    name: Text
    type: str
    position: Vector3
    quaternion_xyzw: Vector4 = Field([0.0, 0.0, 0.0, 1.0])

    @cached_property
    def value(self) -> Obstacle:
        (x, y, z), (qx, qy, qz, qw) = self.position, self.quaternion_xyzw
        sizes = {key: size for key, size in self.arguments.items() if key not in BodyEntry.model_fields}
        return Obstacle(self.name, SHAPES[self.type](**sizes), Pose((x, y, z), (qw, qx, qy, qz)))


class BoxEntry(BodyEntry):
    """A box."""

    type: Literal["box"]
    size: Vector3


class CylinderEntry(BodyEntry):
    """A cylinder along its local z."""

    type: Literal["cylinder"]
    radius: float
    length: float


class SphereEntry(BodyEntry):
    """A sphere."""

    type: Literal["sphere"]
    radius: float


SHAPES: Mapping[str, Callable[..., Shape]] = {"box": Box, "cylinder": Cylinder, "sphere": Sphere}
Entry = Annotated[BoxEntry | CylinderEntry | SphereEntry, Discriminator("type")]


class ProblemEntry(Record):
    """One of the problems; ``scene`` and ``index`` are not used."""

    id: Annotated[Text, Field(min_length=1)]
    scene: Any = None
    index: Any = None
    start: Joints
    goals: Annotated[list[Joints], Field(min_length=1, description="a list of at least one goal"), at_most(MAX_GOALS)]
    obstacles: Annotated[list[Entry], at_most(MAX_OBJECTS)]

    @cached_property
    def value(self) -> Scene:
        """The scene of the problem."""
        return Scene(tuple(entry.value for entry in self.obstacles), name=self.id)


class ProblemFile(Record):
    """A problem set; ``units`` and ``conventions`` are for people."""

    joints: Annotated[list[Text], AfterValidator(_each_once), at_most(MAX_JOINTS)]
    robot: Text = ""
    source: Text = ""
    units: Any = None
    conventions: Any = None
    problems: Annotated[list[ProblemEntry], at_most(MAX_PROBLEMS)]

    @cached_property
    def value(self) -> ProblemSet:
        joints, ids = tuple(self.joints), set[str]()
        problems = []
        for k, entry in enumerate(self.problems):
            if entry.id in ids:
                raise InvalidRequest(f"problems[{k}].id", entry.id, "an id that no problem before it has")
            ids.add(entry.id)
            goals = tuple(map(read_only, entry.goals))
            problems.append(Problem(entry.id, joints, entry.value, read_only(entry.start), goals))
        return ProblemSet(joints, tuple(problems), self.robot, self.source)
