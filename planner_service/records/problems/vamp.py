"""VAMP's problems in JSON, as ``resources/problem_tar_to_pkl_json.py`` of KavrakiLab/vamp writes them.

::

    {"robot": "panda", "joints": ["panda_joint1", ...],
     "problems": {"box": [{"index": 1, "problem": "box", "start": [...], "goals": [[...]], "valid": true,
       "box": [{"name": "base", "half_extents": [0.3, 0.3, 0.02], "position": [0.7, 0.2, 0.5],
                "orientation_euler_xyz": [0.0, 0.0, 0.1], "orientation_quat_xyzw": [0.0, 0.0, 0.05, 0.99875]}],
       "cylinder": [{"name": "can", "radius": 0.03, "length": 0.14, ...}],
       "sphere": [{"name": "ball", "radius": 0.1, ...}]}]}}

``valid`` says what VAMP's spheres make of both ends; it is not used. Of two orientations the quaternion is taken.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from planner_service.files.schema import Joints, Reading, Record, Text, Vector3, Vector4, at_most, read_record
from planner_service.geometry.arrays import read_only
from planner_service.geometry.shapes import Box, Cylinder, Pose, Shape, Sphere
from planner_service.records.problem_set import MAX_GOALS, MAX_JOINTS, MAX_PROBLEMS, Problem, ProblemSet
from planner_service.scene.scene import MAX_OBJECTS, Obstacle, Scene

__all__ = ["vamp_problems"]


def vamp_problems(path: Path, document: Any) -> ProblemSet:
    """The problems of a document of VAMP's.

    Raises:
        InvalidFile: with all problems found.
    """
    joints = document.get("joints")
    reading = Reading(joints=len(joints) if isinstance(joints, list) and len(joints) <= MAX_JOINTS else None)
    problems: ProblemSet = read_record(VampFile, document, path, reading).value
    return problems


class VampBody(Record):
    """A solid somewhere."""

    name: Text
    position: Vector3
    orientation_euler_xyz: Vector3 | None = None
    orientation_quat_xyzw: Vector4

    def obstacle(self, shape: Shape) -> Obstacle:
        """The solid as an obstacle."""
        (px, py, pz), (x, y, z, w) = self.position, self.orientation_quat_xyzw
        return Obstacle(self.name, shape, Pose((px, py, pz), (w, x, y, z)))


class VampBox(VampBody):
    """A box by its half lengths."""

    half_extents: Vector3

    @cached_property
    def value(self) -> Obstacle:
        x, y, z = self.half_extents
        return self.obstacle(Box((2.0 * x, 2.0 * y, 2.0 * z)))


class VampCylinder(VampBody):
    """A cylinder along its z."""

    radius: float
    length: float

    @cached_property
    def value(self) -> Obstacle:
        return self.obstacle(Cylinder(self.radius, self.length))


class VampSphere(VampBody):
    """A ball."""

    radius: float

    @cached_property
    def value(self) -> Obstacle:
        return self.obstacle(Sphere(self.radius))


class VampProblem(Record):
    """One of the problems of a name."""

    index: int
    problem: Text = ""
    start: Joints
    goals: Annotated[list[Joints], Field(min_length=1, description="a list of at least one goal"), at_most(MAX_GOALS)]
    valid: bool | None = None
    box: Annotated[list[VampBox], at_most(MAX_OBJECTS)] = Field([])
    cylinder: Annotated[list[VampCylinder], at_most(MAX_OBJECTS)] = Field([])
    sphere: Annotated[list[VampSphere], at_most(MAX_OBJECTS)] = Field([])

    @cached_property
    def value(self) -> tuple[Obstacle, ...]:
        """The obstacles."""
        return tuple(body.value for bodies in (self.box, self.cylinder, self.sphere) for body in bodies)


class VampFile(Record):
    """A file."""

    robot: Text = ""
    joints: Annotated[list[Text], Field(min_length=1), at_most(MAX_JOINTS)]
    problems: dict[Text, Annotated[list[VampProblem], at_most(MAX_PROBLEMS)]]

    @cached_property
    def value(self) -> ProblemSet:
        joints, found = tuple(self.joints), []
        for name, entries in self.problems.items():
            for entry in entries:
                ends = read_only(entry.start), tuple(map(read_only, entry.goals))
                id = f"{name}/{entry.index:04d}"
                found.append(Problem(id, joints, Scene(entry.value, name=id), *ends))
        return ProblemSet(joints, tuple(found), self.robot)
