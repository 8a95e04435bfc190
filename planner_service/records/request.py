"""Requests as JSON objects: start, goals, planner, timing law, constraints, and what the answer may cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cached_property
from types import MappingProxyType, NoneType
from typing import Annotated, Any, ClassVar, TypeVar, get_type_hints

import numpy as np
from pydantic import Discriminator, Field, GetJsonSchemaHandler, JsonValue, Tag, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.docstrings import fields_documented, in_json, summary
from planner_service.files.schema import (
    Count,
    GrownRecord,
    Joints,
    Numbers,
    Record,
    Text,
    Vector3,
    at_most,
    of_length,
    plain,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.tool_line import rotation_distance
from planner_service.optimize import METHODS, Optimise
from planner_service.planners import PLANNERS
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.presentation.measures import numbers_text
from planner_service.records.values import Constraints, PoseRecord
from planner_service.roadmap import Roadmap, RoadmapReference
from planner_service.robot.inertia import Payload
from planner_service.robot.model import TURN, Robot, joint_vector
from planner_service.timing.laws import TIMINGS

__all__ = ["ONE_OF_BOTH", "RequestRecord", "astray", "goals_of", "reached"]

REACHED = 1e-6
"""Metres and radians by which a plan may miss its ends, for rounding."""

_PLANNERS: Mapping[str, type[Any]] = MappingProxyType({**PLANNERS, RoadmapReference.name: RoadmapReference})
"""Those that a name and settings make; of a roadmap the hash is kept."""

MAX_GOALS = 10_000

C = TypeVar("C", bound="ChoiceRecord")


class JointGoal(Record):
    """A configuration.

    Attributes:
        joints: Joint values in radians (metres for joints that slide).
    """

    joints: Joints

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        return {"joints": plain(value)}

    @cached_property
    def value(self) -> tuple[float, ...]:
        return tuple(self.joints)


class RoomRecord(Record):
    """What a ``PoseGoal`` leaves open.

    Attributes:
        free_axis: Axis x, y, z in the tool frame about which any rotation is allowed; null for none.
        candidates: How many poses are tried: the pose itself first, the others evenly spread.
    """

    about = PoseGoal

    position_tolerance: float
    orientation_tolerance: float
    free_axis: Vector3 | None
    candidates: Count


class ToolGoal(Record):
    """A pose of the tool, with room or without.

    Attributes:
        pose: Pose of the tool frame in the robot's base frame.
        room: What may differ from that pose; null for nothing.
    """

    pose: PoseRecord
    room: RoomRecord | None

    @classmethod
    def fields_of(cls, value: Pose | PoseGoal) -> dict[str, Any]:
        return {"pose": value, "room": None} if isinstance(value, Pose) else {"pose": value.pose, "room": value}

    @cached_property
    def value(self) -> Pose | PoseGoal:
        pose: Pose = self.pose.value
        return pose if self.room is None else PoseGoal(pose, **self.room.arguments)


def _goal_kind(goal: Any) -> str | None:
    """Which of both kinds a goal is, or the object of one: ``joints`` or ``tool``; None if neither or both."""
    if isinstance(goal, dict):
        kinds = [kind for key, kind in (("joints", "joints"), ("pose", "tool")) if key in goal]
        return kinds[0] if len(kinds) == 1 else None
    if isinstance(goal, str | int | float | NoneType):
        return None
    return "tool" if isinstance(goal, ToolGoal | Pose | PoseGoal) else "joints"


ONE_OF_BOTH = Discriminator(
    _goal_kind,
    custom_error_type="goal",
    custom_error_message="an object with joints, the values or the name of a pose, or with pose, one of the tool",
)
"""Tells goals apart."""

GoalRecord = Annotated[Annotated[JointGoal, Tag("joints")] | Annotated[ToolGoal, Tag("tool")], ONE_OF_BOTH]


class ChoiceRecord(Record):
    """A planner or a timing law: its name, and all of its settings.

    Attributes:
        what: What it is, for messages.
        known: Those that there are, by name.
    """

    what: ClassVar[str]
    known: ClassVar[Mapping[str, type[Any]]] = MappingProxyType({})

    name: Text
    settings: dict[str, JsonValue]

    @classmethod
    def find(cls: type[C], value: Any) -> C | None:
        """Its record, None if it is not one that a name and settings make."""
        choice = cls.choice(value)
        return None if choice is None else cls(**choice)

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        choice = cls.choice(value)
        if choice is None:
            raise InvalidRequest(cls.what, value, f"a {cls.what} of this package")
        return choice

    @classmethod
    def choice(cls, value: Any) -> dict[str, Any] | None:
        """Its name and settings, None if they do not make it."""
        raise NotImplementedError

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Each that there is with its own settings."""
        schema = super().__get_pydantic_json_schema__(core, handler)
        own = handler.resolve_ref_schema(schema)
        said = {name: each["description"] for name, each in own["properties"].items()}
        whole = cls.model_fields["settings"].is_required()
        description = own["description"]
        own.clear()
        own |= {"description": description, "oneOf": _choices(cls.known, said, whole)}
        return schema

    def made(self, kind: str, known: Mapping[str, type[Any]]) -> Any:
        """What the name and the settings make.

        Raises:
            UnknownName: there is none of that name.
            InvalidRequest: another setting, or a value that it cannot have.
        """
        if self.name not in known:
            raise UnknownName(kind, self.name, known)
        allowed = [item.name for item in fields(known[self.name])]
        if not set(self.settings) <= set(allowed):
            expected = f"no other keys than {', '.join(allowed)}" if allowed else "no settings"
            raise InvalidRequest("settings", self.settings, expected)
        return known[self.name](**self.settings)


class PlannerRecord(ChoiceRecord):
    """A planner; an optimisation has its method among its settings, a roadmap its hash.

    Attributes:
        name: One of the planners.
        settings: All of its settings.
    """

    what = "planner"
    known = MappingProxyType({**_PLANNERS, Optimise.name: Optimise})

    @classmethod
    def choice(cls, value: Any) -> dict[str, Any] | None:
        if isinstance(value, Optimise):
            choice, method = _choice(value, {value.name: Optimise}), _choice(value.method, METHODS)
            if choice is None or method is None:
                return None
            return {"name": value.name, "settings": {**choice["settings"], "method": method}}
        return _choice(RoadmapReference(value.hash) if isinstance(value, Roadmap) else value, _PLANNERS)

    @cached_property
    def value(self) -> Any:
        if self.name != Optimise.name:
            return self.made("planner", _PLANNERS)
        method = ChoiceRecord.model_validate(self.settings.get("method")).made("method", METHODS)
        settings = {**self.settings, "method": method}
        return ChoiceRecord.model_construct(name=self.name, settings=settings).made("planner", {self.name: Optimise})


class TimingRecord(ChoiceRecord):
    """A timing law.

    Attributes:
        name: One of the timing laws.
        settings: All of its settings.
    """

    what = "timing law"
    known = TIMINGS

    @classmethod
    def choice(cls, value: Any) -> dict[str, Any] | None:
        return _choice(value, TIMINGS)

    @cached_property
    def value(self) -> Any:
        return self.made("timing law", TIMINGS)


def _choice(chosen: Any, known: Mapping[str, type[Any]]) -> dict[str, Any] | None:
    if type(chosen) is not known.get(getattr(chosen, "name", "")):
        return None
    return {"name": chosen.name, "settings": {item.name: plain(getattr(chosen, item.name)) for item in fields(chosen)}}


def _choices(known: Mapping[str, type[Any]], said: Mapping[str, str], whole: bool) -> list[JsonSchemaValue]:
    """The JSON schemas of a name and its settings.

    Args:
        said: What the name and the settings are.
        whole: Whether all settings have to be there.
    """
    schemas: list[JsonSchemaValue] = []
    for name, kind in known.items():
        settings = _settings(kind, said, whole)
        schemas.append(
            {
                "title": name,
                "description": in_json(summary(kind)),
                "type": "object",
                "properties": {
                    "name": {"const": name, "type": "string", "description": said["name"]},
                    "settings": settings | {"description": said["settings"]},
                },
                "required": ["name", "settings"] if whole or settings.get("required") else ["name"],
                "additionalProperties": False,
            }
        )
    return schemas


def _settings(kind: type[Any], said: Mapping[str, str], whole: bool) -> JsonSchemaValue:
    hints, words = get_type_hints(kind), fields_documented(kind)
    properties, required = {}, []
    for each in fields(kind):
        usual = each.default_factory() if each.default_factory is not MISSING else each.default
        if each.name == "method":
            schema: JsonSchemaValue = {"oneOf": _choices(METHODS, said, whole)}
        else:
            schema = TypeAdapter(hints[each.name]).json_schema() | ({} if usual is MISSING else {"default": usual})
        properties[each.name] = schema | {"description": in_json(words[each.name])}
        if whole or usual is MISSING:
            required.append(each.name)
    schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return schema | ({"required": required} if required else {})


class PayloadRecord(Record, makes=Payload):
    """A ``Payload``."""

    inertia: Annotated[Numbers, of_length(6, "6 finite numbers")]


class RequestRecord(GrownRecord):
    """A ``PlanRequest``.

    Attributes:
        start: Where from: joint values in radians (metres for joints that slide).
        goals: Where to; one of them is reached.
    """

    about = PlanRequest

    start: Joints
    goals: Annotated[list[GoalRecord], Field(min_length=1), at_most(MAX_GOALS)]
    planner: PlannerRecord
    timing: TimingRecord
    polish: PlannerRecord | None
    seed: Count
    max_checks: Count
    retries: Count | None
    padding: float
    velocity_scale: float
    acceleration_scale: float
    blend: float
    start_tolerance: float
    time_limit: float | None
    max_tool_speed: float | None
    constraints: Constraints = Field(default_factory=list)
    payload: PayloadRecord | None = None
    torque_scale: float = 1.0
    evidence: bool = False
    start_overlap: float = 0.003
    improve: Count = 0

    @classmethod
    def find(cls, request: PlanRequest) -> RequestRecord | None:
        """The record of a request, None if its planner or timing law has no name to be made from.

        Raises:
            InvalidRequest: The same, but it has constraints: they would be lost.
        """
        planner, timing = PlannerRecord.choice(request.planner), TimingRecord.choice(request.timing)
        if not (planner and timing and (request.polish is None or PlannerRecord.choice(request.polish))):
            if request.constraints:
                field, given = ("timing", request.timing) if timing is None else ("planner", request.planner)
                raise InvalidRequest(f"request.{field}", given, "one of this package, as there are constraints to save")
            return None
        return cls.of(request)

    @classmethod
    def fields_of(cls, value: PlanRequest) -> dict[str, Any]:
        return super().fields_of(value) | {"goals": plain(goals_of(value.goal))}

    @cached_property
    def value(self) -> PlanRequest:
        arguments = self.arguments
        goals = arguments.pop("goals")
        return PlanRequest(goal=goals[0] if len(goals) == 1 else goals, **arguments)


def goals_of(goal: Any) -> list[Any]:
    """The goals of a request, each by itself."""
    if isinstance(goal, Pose | PoseGoal):
        return [goal]
    several = any(isinstance(entry, Pose | PoseGoal) or np.ndim(entry) > 0 for entry in goal)
    return list(goal) if several else [goal]


def astray(request: PlanRequest, result: PlanResult, robot: Robot, *, task: bool = False) -> str:
    """How a motion begins or ends elsewhere than where its request asks, in words; empty if it does not.

    What begins on the way, as a replanned motion does, may begin anywhere, and what claims no goal may stop before one.
    A motion ends where its part of the path does.

    Args:
        task: Whether it is the first motion of a task: the goal of its request has no meaning.
    """
    path, trajectory, index = result.path, result.trajectory, result.goal_index
    if path is None or trajectory is None or path.n != robot.n:
        return ""
    try:
        start = request.clamped(joint_vector("start", request.start, robot), robot)
        goals = request.goals(robot)
    except InvalidRequest as error:
        return f"its request: {error}"
    begin, part = path.waypoints[0], trajectory.part
    end = path.waypoints[-1] if part is None or part[1] >= path.length else path(part[1])
    if part is None and np.abs(begin - start).max() > REACHED:
        return f"it begins at {numbers_text(begin.tolist())}; its request at {numbers_text(start.tolist())}"
    if task or (index is None and part is not None):
        return ""
    if index is None or index >= len(goals):
        return f"it ends at goal {index}; its request has {len(goals)}"
    goal = goals[index]
    return "" if reached(goal, end, robot) else f"it ends at {numbers_text(end.tolist())}, which is not goal {index}"


def reached(goal: Any, end: FloatArray, robot: Robot) -> bool:
    """Whether a configuration (n,) is a goal: joint values, a pose of the tool, or one with room."""
    if not isinstance(goal, Pose | PoseGoal):
        off = end - goal
        off = np.where(robot.continuous or False, off - TURN * np.round(off / TURN), off)
        return bool(np.abs(off).max() <= REACHED)
    room = goal if isinstance(goal, PoseGoal) else PoseGoal(goal)
    tool, T = robot.tool_pose(end), room.pose.matrix
    if np.linalg.norm(tool[:3, 3] - T[:3, 3]) > room.position_tolerance + REACHED:
        return False
    leant = rotation_distance(Pose.from_matrix(tool), room.pose)
    if room.free_axis is not None:
        a, b = tool[:3, :3] @ room.free_axis, T[:3, :3] @ room.free_axis
        leant = float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    return leant <= room.orientation_tolerance + REACHED
