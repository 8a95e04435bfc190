"""What clients send about several arms of a server: each is its robot at a place, or some joints of its robot."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationInfo, ValidatorFunctionWrapHandler, WrapValidator

from planner_service.cell import Anywhere, Arm, AtTool, Cell
from planner_service.cell.layout import Layout
from planner_service.errors import InvalidRequest
from planner_service.files.schema import Record, Text, at_most
from planner_service.geometry.shapes import Pose
from planner_service.planning.request import PlanRequest
from planner_service.records.cells.cell_file import MAX_ARMS, MAX_CARRIED, MAX_JOINTS, AtToolRecord
from planner_service.records.cells.cell_request import CellRequest
from planner_service.records.http.bodies import BodyReading, Configuration, InWorld, RequestBody
from planner_service.records.scene import AttachedRecord
from planner_service.records.values import PoseRecord
from planner_service.roadmap import RoadmapReference
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["CellArmBody", "PlanCellBody"]

MOST_DELAY = 10.0
"""Seconds, as of ``Cell.plan``."""


def _with_own_joints(value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    """Read an arm with the number of its joints; the names of poses are those of the whole robot, and of none else."""
    reading = info.context
    joints = value.get("joints") if isinstance(value, dict) else None
    if not isinstance(reading, BodyReading) or not isinstance(joints, list):
        return handler(value)
    known = reading.joints, reading.robot
    reading.joints, reading.robot = len(joints), None
    try:
        return handler(value)
    finally:
        reading.joints, reading.robot = known


class CellArmBody(Record):
    """An arm of a cell, and what it is to do.

    Attributes:
        name: What it is called.
        base: The pose of its base frame in the cell's frame, of an arm that is the server's robot at a place.
        joints: The joints that are this arm's, where the server's robot has several arms; all arms have them, or none.
        tool: The link that is the tool of such an arm; the robot's tool if not given.
        carried: What it holds, at poses in its tool frame.
        request: Its motion; none if it stands. Poses are in the cell's frame.
        at_tool: Where its tool is to be at the end in the tool frame of another arm, in place of the request's goals.
        anywhere: Whether it only gets out of the way if it has to, whatever the request's goals are.
        stands: Where it stands without a request; at home if not given.
    """

    name: Text
    base: PoseRecord | None = None
    joints: Annotated[list[Text], Field(min_length=1), at_most(MAX_JOINTS)] | None = None
    tool: Text | None = None
    carried: Annotated[list[AttachedRecord], at_most(MAX_CARRIED)] = Field(default_factory=list)
    request: RequestBody | None = None
    at_tool: AtToolRecord | None = None
    anywhere: bool = False
    stands: Configuration | None = None

    @cached_property
    def value(self) -> CellArmBody:
        if self.request is not None and self.stands is not None:
            raise InvalidRequest("stands", self.stands, "an arm without a request")
        if self.request is None and (self.at_tool is not None or self.anywhere):
            raise InvalidRequest("request", None, "the start and the settings of an arm that moves")
        if self.at_tool is not None and self.anywhere:
            raise InvalidRequest("anywhere", self.anywhere, "an arm that is to be at no other's tool")
        if self.request is not None and isinstance(self.request.value.planner, RoadmapReference):
            raise InvalidRequest("request.planner", "a roadmap", "another planner: a roadmap is of one arm alone")
        if self.joints is None and self.tool is not None:
            raise InvalidRequest("tool", self.tool, "an arm with joints of the robot")
        if self.joints is not None and self.base is not None:
            raise InvalidRequest("base", "a pose", "an arm without joints of its own: the robot stands where it does")
        return self

    def goal(self) -> AtTool | Anywhere | None:
        """What depends on other arms."""
        if self.at_tool is not None:
            found: AtTool = self.at_tool.value
            return found
        return Anywhere() if self.anywhere else None


class PlanCellBody(InWorld):
    """Motions of several arms, each on its own clock, that do not touch.

    Attributes:
        arms: The arms, in the order of their joints.
        delay: Seconds by which any arm may be late at any time, each for itself, without touching another.
    """

    arms: Annotated[
        list[Annotated[CellArmBody, WrapValidator(_with_own_joints)]], Field(min_length=1), at_most(MAX_ARMS)
    ]
    delay: Annotated[float, Field(ge=0.0, le=MOST_DELAY)] = 0.0

    @cached_property
    def value(self) -> PlanCellBody:
        names = [arm.name for arm in self.arms]
        if len({*names}) < len(names):
            raise InvalidRequest("arms", names, "each name once")
        if len({arm.joints is None for arm in self.arms}) > 1:
            raise InvalidRequest("arms", names, "robots at places, or joints of one robot")
        if all(arm.request is None for arm in self.arms):
            raise InvalidRequest("arms", names, "one at least with a request")
        return self

    def asked(self, robot: Robot, scene: Scene) -> CellRequest:
        """What is asked of a cell of this robot in this scene.

        Raises:
            InvalidRequest: It is none: names clash, or joints do not make arms of it.
            UnknownName: No such joint or link.
        """
        carried = {arm.name: tuple(each.value for each in arm.carried) for arm in self.arms if arm.carried}
        if self.arms[0].joints is None:
            bases = {arm.name: Pose() if arm.base is None else arm.base.value for arm in self.arms}
            layout = Layout(scene, {name: Arm(robot, base) for name, base in bases.items()}, carried=carried)
        else:
            groups = {arm.name: tuple(arm.joints or ()) for arm in self.arms}
            tools = {arm.name: arm.tool for arm in self.arms if arm.tool is not None}
            layout = Layout(scene, whole=robot, groups=groups, tools=tools, carried=carried)
        requests: Mapping[str, PlanRequest] = {
            arm.name: arm.request.value for arm in self.arms if arm.request is not None
        }
        standing = {arm.name: np.array(arm.stands, dtype=np.float64) for arm in self.arms if arm.stands is not None}
        goals = {arm.name: goal for arm in self.arms if (goal := arm.goal()) is not None}
        return CellRequest(Cell.laid_out(layout), requests, standing, self.delay, goals)
