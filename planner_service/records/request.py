"""Requests as JSON objects: start, goals, planner, timing law and what the answer may cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, JsonValue, Tag

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.schema import Count, Joints, Record, Text, Vector3, at_most
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.optimize import METHODS, Optimise
from planner_service.planners import PLANNERS
from planner_service.planning.request import PlanRequest
from planner_service.records.scene import PoseRecord
from planner_service.roadmap import Roadmap, RoadmapReference
from planner_service.timing.laws import SCurve, ToppRa, Trapezoidal

__all__ = ["TIMINGS", "RequestRecord"]

TIMINGS: Mapping[str, type[Any]] = MappingProxyType({law.name: law for law in (ToppRa, Trapezoidal, SCurve)})
"""Every timing law that can be made from its name alone, by that name."""

_PLANNERS: Mapping[str, type[Any]] = MappingProxyType({**PLANNERS, RoadmapReference.name: RoadmapReference})
"""Those that a name and settings make; of a roadmap the hash is kept."""

MAX_GOALS = 10_000


class JointGoal(Record):
    """A configuration."""

    joints: Joints

    @cached_property
    def value(self) -> tuple[float, ...]:
        return tuple(self.joints)


class RoomRecord(Record):
    """What a ``PoseGoal`` leaves open."""

    position_tolerance: float
    orientation_tolerance: float
    free_axis: Vector3 | None
    candidates: Count


class ToolGoal(Record):
    """A pose of the tool, with room or without."""

    pose: PoseRecord
    room: RoomRecord | None

    @cached_property
    def value(self) -> Pose | PoseGoal:
        if self.room is None:
            return self.pose.value
        axis = None if self.room.free_axis is None else _triple(self.room.free_axis)
        room = self.room
        return PoseGoal(self.pose.value, room.position_tolerance, room.orientation_tolerance, axis, room.candidates)


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return (x, y, z)


def _goal_kind(goal: Any) -> str:
    return "tool" if isinstance(goal, ToolGoal) or (isinstance(goal, dict) and "pose" in goal) else "joints"


GoalRecord = Annotated[
    Annotated[JointGoal, Tag("joints")] | Annotated[ToolGoal, Tag("tool")], Discriminator(_goal_kind)
]


class ChoiceRecord(Record):
    """A planner or a timing law: its name, and all of its settings."""

    name: Text
    settings: dict[str, JsonValue]

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
    """A planner; an optimisation has its method among its settings, a roadmap its hash."""

    @classmethod
    def of(cls, planner: Any) -> PlannerRecord | None:
        """Its record, None if it is not one that a name and settings make."""
        if isinstance(planner, Optimise):
            told, method = _settings(planner, {planner.name: Optimise}), _settings(planner.method, METHODS)
            if told is None or method is None:
                return None
            return cls(name=planner.name, settings={**told["settings"], "method": method})
        told = _settings(RoadmapReference(planner.hash) if isinstance(planner, Roadmap) else planner, _PLANNERS)
        return None if told is None else cls(**told)

    @cached_property
    def value(self) -> Any:
        if self.name != Optimise().name:
            return self.made("planner", _PLANNERS)
        method = ChoiceRecord.model_validate(self.settings.get("method")).made("method", METHODS)
        settings = {**self.settings, "method": method}
        return ChoiceRecord.model_construct(name=self.name, settings=settings).made("planner", {self.name: Optimise})


class TimingRecord(ChoiceRecord):
    """A timing law."""

    @classmethod
    def of(cls, timing: Any) -> TimingRecord | None:
        """Its record, None if it is not one that a name and settings make."""
        told = _settings(timing, TIMINGS)
        return None if told is None else cls(**told)

    @cached_property
    def value(self) -> Any:
        return self.made("timing law", TIMINGS)


def _settings(chosen: Any, known: Mapping[str, type[Any]]) -> dict[str, Any] | None:
    if type(chosen) is not known.get(getattr(chosen, "name", "")):
        return None
    return {"name": chosen.name, "settings": {item.name: getattr(chosen, item.name) for item in fields(chosen)}}


class RequestRecord(Record):
    """A ``PlanRequest``."""

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

    @classmethod
    def of(cls, request: PlanRequest) -> RequestRecord | None:
        """The record of a request, None if its planner or timing law has no name to be made from."""
        planner, timing = PlannerRecord.of(request.planner), TimingRecord.of(request.timing)
        polish = None if request.polish is None else PlannerRecord.of(request.polish)
        if planner is None or timing is None or (polish is None) != (request.polish is None):
            return None
        return cls(
            start=_list(request.start),
            goals=[_goal(goal) for goal in _goals(request.goal)],
            planner=planner,
            timing=timing,
            polish=polish,
            seed=int(request.seed),
            max_checks=int(request.max_checks),
            retries=None if request.retries is None else int(request.retries),
            padding=float(request.padding),
            velocity_scale=float(request.velocity_scale),
            acceleration_scale=float(request.acceleration_scale),
            blend=float(request.blend),
            start_tolerance=float(request.start_tolerance),
            time_limit=None if request.time_limit is None else float(request.time_limit),
            max_tool_speed=None if request.max_tool_speed is None else float(request.max_tool_speed),
        )

    @cached_property
    def value(self) -> PlanRequest:
        goals = tuple(goal.value for goal in self.goals)
        return PlanRequest(
            tuple(self.start),
            goals[0] if len(goals) == 1 else goals,
            self.planner.value,
            self.timing.value,
            seed=self.seed,
            max_checks=self.max_checks,
            time_limit=self.time_limit,
            retries=self.retries,
            padding=self.padding,
            velocity_scale=self.velocity_scale,
            acceleration_scale=self.acceleration_scale,
            max_tool_speed=self.max_tool_speed,
            blend=self.blend,
            start_tolerance=self.start_tolerance,
            polish=None if self.polish is None else self.polish.value,
        )


def _list(values: Any) -> list[float]:
    numbers: list[float] = np.asarray(values, dtype=np.float64).tolist()
    return numbers


def _goals(goal: Any) -> list[Any]:
    if isinstance(goal, Pose | PoseGoal):
        return [goal]
    several = any(isinstance(entry, Pose | PoseGoal) or np.ndim(entry) > 0 for entry in goal)
    return list(goal) if several else [goal]


def _goal(goal: Any) -> JointGoal | ToolGoal:
    if isinstance(goal, Pose):
        return ToolGoal(pose=PoseRecord.of(goal), room=None)
    if isinstance(goal, PoseGoal):
        room = RoomRecord(
            position_tolerance=goal.position_tolerance,
            orientation_tolerance=goal.orientation_tolerance,
            free_axis=None if goal.free_axis is None else list(goal.free_axis),
            candidates=goal.candidates,
        )
        return ToolGoal(pose=PoseRecord.of(goal.pose), room=room)
    return JointGoal(joints=_list(goal))
