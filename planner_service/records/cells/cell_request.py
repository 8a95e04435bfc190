"""What a cell is asked to do, in a TOML file: the arms, where they stand, the scene, and the motion of each.

::

    scene = "table"
    delay = 0.1

    [[arm]]
    name = "left"
    robot = "wxai"
    position = [0.0, 0.2, 0.0]
    start = "ready"
    goal = [0.5, 1.4, 1.2, -0.8, 0.0, 0.0]
    velocity_scale = 0.5

    [[arm]]
    name = "right"
    robot = "wxai"
    position = [0.0, -0.2, 0.0]
    stands = "home"
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from planner_service.cell import Anywhere, Arm, AtTool, Cell, CellPlan
from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.files.schema import (
    Count,
    GrownRecord,
    Numbers,
    Reading,
    Record,
    Text,
    Vector3,
    Vector4,
    at_most,
    read_record,
)
from planner_service.files.toml_reader import read_tables
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in, in_file
from planner_service.planning.request import PlanRequest
from planner_service.records.cells.cell_file import MAX_ARMS
from planner_service.robot.model import Robot, joint_vector
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene

__all__ = ["CellRequest", "read_cell_request"]

MAX_BYTES = 1_000_000

ANY = "any"
"""The goal of an arm that only gets out of the way."""


@dataclass(frozen=True, eq=False)
class CellRequest:
    """What a cell is asked to do; ``plan`` plans it.

    Attributes:
        cell: The cell.
        requests: What each arm is to do, by its name.
        standing: Where the other arms stand.
        delay: Seconds by which any arm may be late.
        goals: Goals that depend on other arms, in place of those of the requests.
    """

    cell: Cell
    requests: Mapping[str, PlanRequest]
    standing: Mapping[str, FloatArray]
    delay: float
    goals: Mapping[str, AtTool | Anywhere] = field(default_factory=dict)

    def __post_init__(self) -> None:
        copied_in(self, "requests", "standing", "goals")

    def plan(self, cancel: CancelToken | None = None) -> CellPlan:
        """As ``Cell.plan``."""
        return self.cell.plan(self.requests, goals=self.goals, standing=self.standing, delay=self.delay, cancel=cancel)


class PoseTable(Record):
    """A pose of the tool in the cell's frame.

    Attributes:
        position: x, y, z in metres.
        quaternion: Orientation as a unit quaternion w, x, y, z.
    """

    position: Vector3
    quaternion: Vector4 = Field(alias="quaternion_wxyz")


class AtToolTable(PoseTable):
    """A pose of the tool in the tool frame of another arm.

    Attributes:
        at_tool_of: The name of the other arm.
    """

    at_tool_of: Text


def _kind(value: Any) -> str:
    return (
        "at_tool" if isinstance(value, AtToolTable) or (isinstance(value, dict) and "at_tool_of" in value) else "pose"
    )


Goal = Annotated[Annotated[PoseTable, Tag("pose")] | Annotated[AtToolTable, Tag("at_tool")], Discriminator(_kind)]


class ArmTable(GrownRecord):
    """An arm.

    Attributes:
        name: What it is called.
        robot: The name of a robot, or the path of its file.
        position: Where its base stands in the cell's frame, x, y, z in metres.
        quaternion: How, as a unit quaternion w, x, y, z.
        start: Joint values at its start, or the name of a pose.
        goal: Joint values at its end, the name of a pose, a pose of the tool, in the cell's frame or at the tool of
            another arm, or "any".
        stands: In place of start and goal: where it stands all the time.
        velocity_scale: Part in (0, 1] of its velocity limits.
        acceleration_scale: Part in (0, 1] of its acceleration limits.
        padding: Metres that everything keeps.
        seed: Of the search.
    """

    name: Text
    robot: Text
    position: Vector3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    quaternion: Vector4 = Field(alias="quaternion_wxyz", default_factory=lambda: [1.0, 0.0, 0.0, 0.0])
    start: Text | Numbers | None = None
    goal: Text | Numbers | Goal | None = None
    stands: Text | Numbers | None = None
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    padding: float = 0.0
    seed: Count = 0


class CellTable(GrownRecord):
    """The file.

    Attributes:
        scene: The name of a scene, or the path of its file.
        delay: Seconds by which any arm may be late at any time.
        arm: The arms.
    """

    scene: Text
    delay: float = 0.0
    arm: Annotated[list[ArmTable], Field(min_length=1), at_most(MAX_ARMS)]


def read_cell_request(path: str | os.PathLike[str]) -> CellRequest:
    """What a TOML file asks of a cell; a scene or a robot that is a file is looked for beside it.

    Raises:
        InvalidFile: The file cannot be used, and why.
        UnknownName: There is no such robot or scene.
    """
    file = as_path("path", path)
    table = read_record(CellTable, read_tables(file, MAX_BYTES), file, Reading())
    return in_file(file, lambda: _asked(table, file.parent))


def _asked(table: CellTable, folder: Path) -> CellRequest:
    names = [arm.name for arm in table.arm]
    if len(set(names)) < len(names):
        raise InvalidRequest("arm.name", names, "each name once")
    robots = {arm.robot: load_robot(_beside(arm.robot, folder)) for arm in table.arm}
    bases = [_pose(arm.position, arm.quaternion) for arm in table.arm]
    placed = {arm.name: Arm(robots[arm.robot], base) for arm, base in zip(table.arm, bases, strict=True)}
    cell = Cell(placed, load_scene(_beside(table.scene, folder)))
    requests, standing = dict[str, PlanRequest](), dict[str, FloatArray]()
    goals = dict[str, AtTool | Anywhere]()
    for arm in table.arm:
        robot = cell.arm(arm.name).robot
        if arm.goal is None:
            if arm.start is not None:
                raise InvalidRequest(f"{arm.name}.goal", None, "a goal, where there is a start")
            if arm.stands is not None:
                standing[arm.name] = _joints(f"{arm.name}.stands", arm.stands, robot)
            continue
        if arm.start is None or arm.stands is not None:
            raise InvalidRequest(f"{arm.name}.start", arm.start, "a start with a goal, and nothing that it stands at")
        start = _joints(f"{arm.name}.start", arm.start, robot)
        goal: Pose | FloatArray = start
        if isinstance(arm.goal, AtToolTable):
            goals[arm.name] = AtTool(arm.goal.at_tool_of, _pose(arm.goal.position, arm.goal.quaternion))
        elif isinstance(arm.goal, PoseTable):
            goal = _pose(arm.goal.position, arm.goal.quaternion)
        elif arm.goal == ANY:
            goals[arm.name] = Anywhere()
        else:
            goal = _joints(f"{arm.name}.goal", arm.goal, robot)
        requests[arm.name] = PlanRequest(
            start,
            goal,
            velocity_scale=arm.velocity_scale,
            acceleration_scale=arm.acceleration_scale,
            padding=arm.padding,
            seed=arm.seed,
        )
    return CellRequest(cell, requests, standing, table.delay, goals)


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Pose:
    (x, y, z), (w, a, b, c) = position, quaternion
    return Pose((x, y, z), (w, a, b, c))


def _beside(name: str, folder: Path) -> str:
    """The path of a file that is beside another one, or the name as it is."""
    there = folder / name
    return str(there) if there.suffix and there.is_file() else name


def _joints(field: str, value: object, robot: Robot) -> FloatArray:
    return np.asarray(robot.pose(value) if isinstance(value, str) else joint_vector(field, value, robot))
