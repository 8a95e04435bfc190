"""Problems of MotionBenchMaker and robowflex: a MoveIt planning scene and a motion plan request each, both in YAML.

Of ``scene0001.yaml``, the solids in ``world.collision_objects`` are read: boxes, spheres, cylinders, and meshes by
their vertices, which become their hull. Of ``request0001.yaml``, the start and the joint constraints that are the goal;
each is met exactly, whatever its tolerance. The robot, and which of its links may touch, are not taken from there: a
pair that only the file lets touch is judged. What would change the problem and is not read is refused by name:
octomaps, attached objects, path constraints, goals other than joint constraints.
"""

from __future__ import annotations

import os
import re
import tarfile
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Discriminator, Field

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import read_bytes
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
from planner_service.files.yaml_reader import parse_yaml
from planner_service.geometry.arrays import read_only
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Pose, Shape, Sphere
from planner_service.records.problem_set import MAX_JOINTS, MAX_PROBLEMS, Problem, ProblemSet
from planner_service.scene.scene import MAX_OBJECTS, Obstacle, Scene

__all__ = ["archived_problems", "folder_problems"]

MAX_BYTES, MAX_ARCHIVE = 5_000_000, 500_000_000
"""Bytes of one YAML file, and of all files of an archive together."""

MAX_ENTRIES = 50_000
"""Files and folders in a folder: twice as many as the most problems have, and some beside them."""

NAME = re.compile(r"(scene|request)(\D*?)(\d+)\.ya?ml")

Read = Callable[[], bytes]


def folder_problems(folder: Path) -> ProblemSet:
    """The problems in a folder, at any depth.

    Raises:
        InvalidFile: of the first file that cannot be used, with all problems found in it; or there is none.
    """
    found: dict[Path, Read] = {}
    left, inside = MAX_ENTRIES, folder.resolve()
    for place, folders, names in os.walk(folder):
        folders.sort()
        left -= len(folders) + len(names)
        if left < 0:
            raise InvalidFile(folder, [f"more than {MAX_ENTRIES:,} files and folders; expected those of a problem set"])
        for name in sorted(filter(NAME.fullmatch, names)):
            path = Path(place, name)
            if not path.resolve().is_relative_to(inside):
                raise InvalidFile(path, ["a link that leads out of the folder of the problem set; copy the file"])
            found[path.relative_to(folder)] = lambda path=path: read_bytes(path, MAX_BYTES)  # type: ignore[misc]
    return _problems(folder, found)


def archived_problems(path: Path) -> ProblemSet:
    """The problems in a tar archive, compressed or not; nothing of it is unpacked to the disk.

    Raises:
        InvalidFile: as ``folder_problems``; or no such archive, or one of more than 500 MB.
    """
    read_bytes(path, MAX_ARCHIVE)  # a regular file, and no larger
    found: dict[Path, Read] = {}
    left = MAX_ARCHIVE
    try:
        with tarfile.open(path) as archive:
            for member in archive:
                left -= member.size + tarfile.BLOCKSIZE
                if left < 0:
                    raise InvalidFile(path, [f"too large: more than {MAX_ARCHIVE:,} bytes of files"])
                if member.isfile() and NAME.fullmatch(Path(member.name).name) and member.size <= MAX_BYTES:
                    file = archive.extractfile(member)
                    data = b"" if file is None else file.read()
                    found[Path(member.name)] = lambda data=data: data  # type: ignore[misc]
    except (tarfile.TarError, OSError, EOFError) as error:
        raise InvalidFile(path, [f"no archive: {error}"]) from None
    return _problems(path, found)


def _problems(root: Path, files: dict[Path, Read]) -> ProblemSet:
    """The problems of scenes and requests that stand beside each other with the same number."""
    scenes: dict[tuple[Path, str], list[Path]] = {}
    requests: dict[tuple[Path, str], Path] = {}
    for path in files:
        match = NAME.fullmatch(path.name)
        if match is None:
            continue
        key = path.parent, match[3]
        if match[1] == "scene":
            scenes.setdefault(key, []).append(path)
        else:
            requests[key] = path
    if not requests:
        raise InvalidFile(root, ["no requests: expected files such as request0001.yaml beside scene0001.yaml"])
    if len(requests) > MAX_PROBLEMS:
        raise InvalidFile(root, [f"{len(requests):,} problems; expected at most {MAX_PROBLEMS:,}"])
    found = []
    for key, path in sorted(requests.items()):
        beside = sorted(scenes.get(key, ()), key=lambda scene: len(scene.name))  # scene0001 before scene_sensed0001
        if not beside:
            raise InvalidFile(root / path, [f"scene{key[1]}.yaml is missing beside it"])
        scene: WorldFile = _read(WorldFile, root / beside[0], files[beside[0]])
        request: RequestFile = _read(RequestFile, root / path, files[path])
        found.append(_problem("/".join((*path.parent.parts[-1:], key[1])), root / path, scene, request))
    names = {problem.joint_names for problem in found}
    return ProblemSet(found[0].joint_names if len(names) == 1 else (), tuple(found), found[0].robot)


def _read(model: type[Any], path: Path, read: Read) -> Any:
    return read_record(model, parse_yaml(path, read()), path, Reading())


def _problem(id: str, path: Path, scene: WorldFile, request: RequestFile) -> Problem:
    (goal,) = request.goal_constraints
    names = tuple(joint.joint_name for joint in goal.joint_constraints)
    state = request.start_state.joint_state
    start = {} if state is None else dict(zip(state.name, state.position, strict=True))
    missing = [name for name in names if name not in start]
    if missing:
        raise InvalidFile(path, [f"start_state: no position of {', '.join(missing)}"])
    values = read_only([start[name] for name in names])
    goals = (read_only([joint.position for joint in goal.joint_constraints]),)
    frame, obstacles = scene.value
    return Problem(id, names, Scene(obstacles, name=id), values, goals, frame=frame, robot=scene.robot_model_name)


# The files, declared.


def _none(entries: list[Any]) -> list[Any]:
    if entries:
        raise ValueError("an empty list: what is in it is not read")
    return entries


Nothing = Annotated[list[Any], AfterValidator(_none)]


class Header(Record):
    """Of which only the frame matters."""

    frame_id: Text = ""
    seq: Any = None
    stamp: Any = None


class PoseEntry(Record):
    """A pose; the quaternion is x, y, z, w."""

    position: Vector3 = Field([0.0, 0.0, 0.0])
    orientation: Vector4 = Field([0.0, 0.0, 0.0, 1.0])

    @cached_property
    def value(self) -> Pose:
        (px, py, pz), (x, y, z, w) = self.position, self.orientation
        return Pose((px, py, pz), (w, x, y, z))


class BoxEntry(Record):
    """Full lengths."""

    type: Literal["box"]
    dimensions: Vector3

    @cached_property
    def value(self) -> Box:
        x, y, z = self.dimensions
        return Box((x, y, z))


class SphereEntry(Record):
    """A radius."""

    type: Literal["sphere"]
    dimensions: Annotated[Numbers, of_length(1, "[radius]")]

    @cached_property
    def value(self) -> Sphere:
        return Sphere(self.dimensions[0])


class CylinderEntry(Record):
    """A height and a radius."""

    type: Literal["cylinder"]
    dimensions: Annotated[Numbers, of_length(2, "[height, radius]")]

    @cached_property
    def value(self) -> Cylinder:
        return Cylinder(self.dimensions[1], self.dimensions[0])


class MeshEntry(Record):
    """A mesh by its corners, of which the hull is taken."""

    vertices: Annotated[list[Vector3], at_most(100_000)]
    triangles: Any = None

    @cached_property
    def value(self) -> Mesh:
        return Mesh(np.array(self.vertices))


class CollisionObject(Record):
    """Solids of one name; if there are several, they become ``name``, ``name#2``, ..."""

    id: Text
    header: Header | None = None
    pose: PoseEntry | None = None
    primitives: list[Annotated[BoxEntry | SphereEntry | CylinderEntry, Discriminator("type")]] = Field([])
    primitive_poses: list[PoseEntry] = Field([])
    meshes: list[MeshEntry] = Field([])
    mesh_poses: list[PoseEntry] = Field([])
    planes: Nothing = Field([])
    plane_poses: Any = None
    operation: Literal["add", 0] = "add"
    type: Any = None
    subframe_names: Any = None
    subframe_poses: Any = None

    @property
    def frame(self) -> str:
        """Of its pose."""
        return "" if self.header is None else self.header.frame_id.lstrip("/")

    @cached_property
    def value(self) -> tuple[Obstacle, ...]:
        for shapes, poses, field in (
            (self.primitives, self.primitive_poses, "primitive_poses"),
            (self.meshes, self.mesh_poses, "mesh_poses"),
        ):
            if len(shapes) != len(poses):
                raise InvalidRequest(field, len(poses), f"one pose for each of {len(shapes)} shapes")
        return tuple(self._bodies())

    def _bodies(self) -> Iterator[Obstacle]:
        shapes: list[Shape] = [entry.value for entry in (*self.primitives, *self.meshes)]
        here = Pose() if self.pose is None else self.pose.value
        for k, (shape, pose) in enumerate(zip(shapes, (*self.primitive_poses, *self.mesh_poses), strict=True)):
            yield Obstacle(self.id if k == 0 else f"{self.id}#{k + 1}", shape, here @ pose.value)


class World(Record):
    """What stands around the robot."""

    collision_objects: Annotated[list[CollisionObject], at_most(MAX_OBJECTS)] = Field([])
    octomap: Any = None

    @cached_property
    def value(self) -> None:
        """Nothing; it refuses an octomap with data."""
        inner = self.octomap.get("octomap", self.octomap) if isinstance(self.octomap, dict) else None
        if isinstance(inner, dict) and inner.get("data"):
            raise InvalidRequest("octomap", "...", "none: give its points as a PointCloud")


class JointState(Record):
    """Positions by name."""

    header: Any = None
    name: Annotated[list[Text], at_most(MAX_JOINTS)] = Field([])
    position: Annotated[Numbers, at_most(MAX_JOINTS)] = Field([])
    velocity: Any = None
    effort: Any = None

    @cached_property
    def value(self) -> None:
        """Nothing; it refuses names without positions."""
        if len(self.name) != len(self.position):
            raise InvalidRequest("position", len(self.position), f"one number for each of {len(self.name)} names")


class RobotState(Record):
    """A state of the robot."""

    joint_state: JointState | None = None
    multi_dof_joint_state: Any = None
    attached_collision_objects: Nothing = Field([])
    is_diff: Any = None


class WorldFile(Record):
    """``scene0001.yaml``: a ``moveit_msgs/PlanningScene``."""

    name: Any = None
    is_diff: Any = None
    robot_model_name: Text = ""
    robot_state: RobotState | None = None
    fixed_frame_transforms: Any = None
    allowed_collision_matrix: Any = None
    link_padding: Any = None
    link_scale: Any = None
    object_colors: Any = None
    world: World | None = None

    @cached_property
    def value(self) -> tuple[str, tuple[Obstacle, ...]]:
        """The frame of all objects, and these."""
        entries = [] if self.world is None else self.world.collision_objects
        frames = dict.fromkeys(entry.frame for entry in entries)
        if len(frames) > 1:
            raise InvalidRequest("world", ", ".join(frames), "objects in one frame")
        return next(iter(frames), ""), tuple(body for entry in entries for body in entry.value)


class JointConstraint(Record):
    """Where a joint is to be."""

    joint_name: Text
    position: float
    tolerance_above: float = 0.0
    tolerance_below: float = 0.0
    weight: Any = None


class GoalConstraints(Record):
    """One goal: all of its joint constraints."""

    name: Any = None
    joint_constraints: Annotated[
        list[JointConstraint], Field(min_length=1, description="at least one joint"), at_most(100)
    ]
    position_constraints: Nothing = Field([])
    orientation_constraints: Nothing = Field([])
    visibility_constraints: Nothing = Field([])


class RequestFile(Record):
    """``request0001.yaml``: a ``moveit_msgs/MotionPlanRequest``."""

    start_state: RobotState
    goal_constraints: Annotated[list[GoalConstraints], of_length(1, "one goal")]
    path_constraints: Any = None
    trajectory_constraints: Any = None
    workspace_parameters: Any = None
    group_name: Any = None
    planner_id: Any = None
    pipeline_id: Any = None
    reference_trajectories: Any = None
    num_planning_attempts: Any = None
    allowed_planning_time: Any = None
    max_velocity_scaling_factor: Any = None
    max_acceleration_scaling_factor: Any = None
    cartesian_speed_limited_link: Any = None
    cartesian_speed_end_effector_link: Any = None
    max_cartesian_speed: Any = None

    @cached_property
    def value(self) -> None:
        """Nothing; it refuses constraints of the path."""
        kinds = self.path_constraints.values() if isinstance(self.path_constraints, dict) else ()
        if any(isinstance(kind, list) and kind for kind in kinds):
            raise InvalidRequest("path_constraints", "...", "none: give them as constraints of a PlanRequest")
