"""What is sent: requests, tasks and curves as the JSON bodies that a server takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from planner_service.certify import ExemptInterval
from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints
from planner_service.errors import InvalidRequest
from planner_service.files.schema import Record, plain, recorded
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import numbers
from planner_service.path.joint_path import JointPath
from planner_service.planning.request import Goal, Pace, PlanRequest
from planner_service.planning.task_result import Handling
from planner_service.records.request import PayloadRecord, PlannerRecord, RequestRecord, TimingRecord
from planner_service.records.result import ExemptRecord
from planner_service.records.values import Constraints, PoseRecord
from planner_service.timing.laws import Timing

__all__ = [
    "constraints_body",
    "curve_body",
    "goals_body",
    "handling_body",
    "pace_body",
    "planner_body",
    "pose_body",
    "request_body",
    "settings_body",
    "target_body",
]

ENDS = ("start", "goals")


def request_body(request: PlanRequest) -> dict[str, Any]:
    """A request.

    Raises:
        InvalidRequest: It has a planner or a timing law of the caller's own, which cannot be sent.
    """
    record = recorded("request", lambda: RequestRecord.find(request))
    if record is None:
        raise InvalidRequest("request", request.planner, "a planner and a timing law of this package")
    return record.document()


def settings_body(request: PlanRequest | None) -> dict[str, Any] | None:
    """A request without its ends.

    Raises:
        InvalidRequest: As ``request_body``.
    """
    if request is None:
        return None
    return {name: value for name, value in request_body(request).items() if name not in ENDS}


def goals_body(goal: Goal | None) -> list[Any] | None:
    """The goals of a request."""
    goals: list[Any] | None = None if goal is None else request_body(PlanRequest((), goal))["goals"]
    return goals


def planner_body(planner: Any) -> dict[str, Any]:
    """What grows a roadmap.

    Raises:
        InvalidRequest: It is none of this package.
    """
    record = recorded("planner", lambda: PlannerRecord.find(planner))
    if record is None:
        raise InvalidRequest("planner", planner, "a planner of this package")
    return record.document()


def handling_body(handling: Handling | None) -> dict[str, Any] | None:
    """How an object is taken or set down; a token stays with the client.

    Raises:
        InvalidRequest: As ``request_body``.
    """
    if handling is None:
        return None
    return {
        "support": handling.support,
        "support_gap": handling.support_gap,
        "open_width": handling.open_width,
        "upright": handling.upright,
        "request": settings_body(handling.request),
        "line_timing": None if handling.line_timing is None else _timing(handling.line_timing),
    }


def pace_body(pace: Pace | None) -> dict[str, Any] | None:
    """How fast a line is followed.

    Raises:
        InvalidRequest: Its timing law is none of this package.
    """
    if pace is None:
        return None
    return {
        "timing": _timing(pace.timing),
        "velocity_scale": pace.velocity_scale,
        "acceleration_scale": pace.acceleration_scale,
        "max_tool_speed": pace.max_tool_speed,
        "payload": None if pace.payload is None else PayloadRecord.of(pace.payload).document(),
        "torque_scale": pace.torque_scale,
    }


def _timing(timing: Timing) -> dict[str, Any]:
    record = recorded("timing", lambda: TimingRecord.find(timing))
    if record is None:
        raise InvalidRequest("timing", timing, "a timing law of this package")
    return record.document()


def curve_body(
    path: JointPath | ArrayLike, padding: float, exempt: Sequence[ExemptInterval], constraints: Sequence[Constraint]
) -> dict[str, Any]:
    """A path that is to be proven."""
    curve = path if isinstance(path, JointPath) else JointPath(numbers("path", path, "waypoints of shape (N, n)"))
    return {
        "waypoints": plain(curve.waypoints),
        "blends": plain(curve.blends),
        "padding": padding,
        "exempt": recorded("exempt", lambda: [ExemptRecord.of(stretch).document() for stretch in exempt]),
        "constraints": constraints_body(constraints),
    }


class _ConstraintsRecord(Record):
    constraints: Constraints


def constraints_body(constraints: Sequence[Constraint]) -> list[Any]:
    """What a motion is to keep."""
    checked = {"constraints": list(checked_constraints(constraints))}
    body: list[Any] = _ConstraintsRecord.model_validate(checked).document()["constraints"]
    return body


def pose_body(pose: Pose) -> dict[str, Any]:
    """A pose."""
    return PoseRecord.of(pose).document()


def target_body(target: Any) -> Any:
    """A pose of the tool, a displacement, or several of these."""
    if isinstance(target, Pose):
        return pose_body(target)
    if isinstance(target, list | tuple):
        return [target_body(each) for each in target]
    return plain(target)
