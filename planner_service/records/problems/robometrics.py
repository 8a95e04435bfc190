"""Problems in YAML as robometrics publishes them (github.com/fishbotics/robometrics).

::

    bookshelf_small_panda:                     # a name, with a list of problems
    - start: [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
      goal_ik: [[-0.36, 0.28, -1.07, -2.2, 2.74, 2.24, 1.3]]     # any of these; if there is none, the pose
      goal_pose: {frame: panda_hand, position_xyz: [0.1, -0.57, 0.35], quaternion_wxyz: [0.61, 0.37, 0.6, -0.37]}
      world_frame: panda_link0
      collision_buffer_ik: 0
      obstacles:
        cuboid: {base: {dims: [1.2, 1.0, 0.04], pose: [0.6, -1.0, 0.2, 1.0, 0.0, 0.0, 0.0]}}   # x y z, then w x y z
        cylinder: {can: {radius: 0.01, height: 0.14, pose: [0.2, -1.1, 0.3, 1.0, 0.0, 0.0, 0.0]}}

The joints have no names: they are those of the robot, in its order. ``collision_buffer_ik`` is what the authors added
to their robot when they looked for goals; it is not used.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from planner_service.files.schema import (
    Numbers,
    Reading,
    Record,
    Text,
    Vector3,
    Vector4,
    at_most,
    of_length,
    read_record,
)
from planner_service.geometry.arrays import read_only
from planner_service.geometry.shapes import Box, Cylinder, Pose, Shape, Sphere
from planner_service.records.problem_set import MAX_GOALS, MAX_JOINTS, MAX_PROBLEMS, Problem, ProblemSet
from planner_service.scene.scene import Obstacle, Scene

__all__ = ["robometrics_problems"]

Configuration = Annotated[Numbers, at_most(MAX_JOINTS)]
PoseNumbers = Annotated[Numbers, of_length(7, "7 numbers: x, y, z, then the quaternion w, x, y, z")]


def robometrics_problems(path: Path, document: Any) -> ProblemSet:
    """The problems of a document of robometrics.

    Raises:
        InvalidFile: with all problems found.
    """
    problems: ProblemSet = read_record(RobometricsFile, {"sets": document}, path, Reading()).value
    return problems


class Body(Record):
    """A solid somewhere."""

    pose: PoseNumbers

    def obstacle(self, name: str, shape: Shape) -> Obstacle:
        """The solid as an obstacle."""
        x, y, z, *(qw, qx, qy, qz) = self.pose
        return Obstacle(name, shape, Pose((x, y, z), (qw, qx, qy, qz)))

    def named(self, name: str) -> Obstacle:
        """The obstacle of that name."""
        return self.obstacle(name, self.value)


class Cuboid(Body):
    """A box by its full lengths."""

    dims: Vector3

    @cached_property
    def value(self) -> Box:
        x, y, z = self.dims
        return Box((x, y, z))


class Tube(Body):
    """A cylinder along its z."""

    radius: float
    height: float

    @cached_property
    def value(self) -> Cylinder:
        return Cylinder(self.radius, self.height)


class Ball(Body):
    """A sphere."""

    radius: float

    @cached_property
    def value(self) -> Sphere:
        return Sphere(self.radius)


class Bodies(Record):
    """Obstacles by kind and name."""

    cuboid: dict[Text, Cuboid] | None = None
    cylinder: dict[Text, Tube] | None = None
    sphere: dict[Text, Ball] | None = None

    @cached_property
    def value(self) -> tuple[Obstacle, ...]:
        kinds = (self.cuboid, self.cylinder, self.sphere)
        return tuple(body.named(name) for bodies in kinds for name, body in (bodies or {}).items())


class GoalPose(Record):
    """Where a frame of the robot is to be."""

    frame: Text
    position_xyz: Vector3
    quaternion_wxyz: Vector4

    @cached_property
    def value(self) -> Pose:
        (x, y, z), (qw, qx, qy, qz) = self.position_xyz, self.quaternion_wxyz
        return Pose((x, y, z), (qw, qx, qy, qz))


class RobometricsProblem(Record):
    """One of the problems of a name."""

    start: Configuration
    goal_ik: Annotated[list[Configuration], at_most(MAX_GOALS)] = Field([])
    goal_pose: GoalPose | None = None
    obstacles: Bodies
    world_frame: Text = ""
    collision_buffer_ik: Any = None

    @cached_property
    def value(self) -> None:
        """Nothing; it refuses a problem without a goal, or of configurations of different lengths."""
        if any(len(goal) != len(self.start) for goal in self.goal_ik):
            raise ValueError(f"each goal as many numbers as the start, {len(self.start)}")
        if not self.goal_ik and self.goal_pose is None:
            raise ValueError("a goal_ik or a goal_pose")

    def problem(self, id: str) -> Problem:
        """The problem, by a name."""
        pose = None if self.goal_ik or self.goal_pose is None else (self.goal_pose.frame, self.goal_pose.value)
        ends = read_only(self.start), tuple(map(read_only, self.goal_ik))
        return Problem(id, (), Scene(self.obstacles.value, name=id), *ends, frame=self.world_frame, tool_pose=pose)


class RobometricsFile(Record):
    """A file."""

    sets: dict[Text, Annotated[list[RobometricsProblem], at_most(MAX_PROBLEMS)]]

    @cached_property
    def value(self) -> ProblemSet:
        found = [
            entry.problem(f"{name}/{k:04d}") for name, entries in self.sets.items() for k, entry in enumerate(entries)
        ]
        return ProblemSet((), tuple(found))
