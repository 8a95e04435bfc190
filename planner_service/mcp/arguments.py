"""What tools take: arguments that are read strictly, each with what it is."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field

from planner_service.errors import InvalidRequest
from planner_service.files.schema import Joints, Reading, Record, Vector2, Vector3, Vector4, at_most, read_record
from planner_service.robot.model import Robot

__all__ = [
    "CertifyArguments",
    "CheckArguments",
    "DescribeArguments",
    "ExecuteArguments",
    "ExplainArguments",
    "LookArguments",
    "MoveLinearArguments",
    "PickArguments",
    "PlaceArguments",
    "PlanArguments",
    "Where",
    "read_arguments",
]

MAX_NAME = 64
"""Characters of a name that is looked for; no object has a longer one."""

MAX_WAYPOINTS = 1_000
"""Of a polyline to certify."""

A = TypeVar("A", bound=Record)

Name = Annotated[str, Field(max_length=MAX_NAME, min_length=1)]
Metres = Annotated[float, Field(ge=0.0, le=0.1)]


def described(text: str, default: Any = None) -> Any:
    """An argument that may be left out, and what it is."""
    return Field(default=default, description=text)


class Where(Record):
    """A place for the arm: exactly one of joints, named and position."""

    joints: Joints | None = described("one value for each joint, in rad (m for a prismatic joint)")
    named: Name | None = described('the name of a pose of the robot, such as "home"')
    position: Vector3 | None = described("where the tool is to be, [x, y, z] in m in the robot's base frame")
    quaternion_wxyz: Vector4 | None = described(
        "with position: how the tool is to be turned, a unit quaternion; as it is where the arm stands if not given"
    )

    @cached_property
    def value(self) -> Where:
        """Itself, if it says one thing."""
        given = [name for name in ("joints", "named", "position") if getattr(self, name) is not None]
        if len(given) != 1:
            raise InvalidRequest("place", " and ".join(given) or "none", "one of joints, named and position")
        if self.quaternion_wxyz is not None and self.position is None:
            raise InvalidRequest("quaternion_wxyz", self.quaternion_wxyz, "none without position")
        return self


class _AfterArguments(Record):
    after: Name | None = described(
        "the id of a plan at whose end this one begins, before anything has moved; where the arm stands if not given"
    )


class DescribeArguments(Record):
    """Arguments of describe_scene."""

    after: Name | None = described("the id of a plan: the scene as it is at its end; as it is now if not given")
    first: Annotated[int, Field(ge=0, le=100_000)] = described("of how many objects to leave out, for the next page", 0)


class CheckArguments(_AfterArguments):
    """Arguments of check."""

    at: Where | None = described("the place to look at; where the arm stands if not given")


class PlanArguments(_AfterArguments):
    """Arguments of plan."""

    goal: Where = Field(description="where to go")


class PickArguments(_AfterArguments):
    """Arguments of pick."""

    object: Name = Field(description="the name of the object to take, as describe_scene has it")
    upright: Annotated[float, Field(gt=0.0, le=3.1416)] | None = described(
        "rad by which the object may lean while it is carried; any if not given"
    )


class PlaceArguments(_AfterArguments):
    """Arguments of place."""

    onto: Name = Field(description="the name of the object to set it down on, as describe_scene has it")
    at: Vector2 | None = described(
        "[x, y] in m in the base frame, where its middle is to be; the middle of onto if not"
    )


class MoveLinearArguments(_AfterArguments):
    """Arguments of move_linear."""

    by: Vector3 | None = described("metres along x, y and z of the base frame; the tool keeps its orientation")
    to: Where | None = described("where to go: a position")
    free_axis: Vector3 | None = described(
        "axis x, y, z in the tool frame about which the tool may turn on its way, as a pen may"
    )

    @cached_property
    def value(self) -> MoveLinearArguments:
        """Itself, if it says one thing."""
        if (self.by is None) == (self.to is None):
            raise InvalidRequest("goal", "both" if self.by else "neither", "one of by and to")
        if self.to is not None and self.to.position is None:
            raise InvalidRequest("to", "no position", "a position: the tool's, at the end of a straight line")
        return self


class ExplainArguments(PlanArguments):
    """Arguments of explain."""


class CertifyArguments(Record):
    """Arguments of certify."""

    plan: Name | None = described("the id of a plan, to prove it again")
    waypoints: Annotated[list[Joints], at_most(MAX_WAYPOINTS)] | None = described(
        "a polyline of joint values, in rad, to be proven where the arm stands"
    )
    padding: Metres = described("m that everything is to keep from everything", 0.0)

    @cached_property
    def value(self) -> CertifyArguments:
        """Itself, if it says one thing."""
        if (self.plan is None) == (self.waypoints is None):
            raise InvalidRequest("path", "both" if self.plan else "neither", "one of plan and waypoints")
        return self


class LookArguments(Record):
    """Arguments of look."""

    plan: Name | None = described("the id of a plan to draw; where the arm stands if not given")


class ExecuteArguments(Record):
    """Arguments of execute."""

    plan: Name = Field(description="the id of the plan; those it was planned after are executed before it")


def read_arguments(model: type[A], given: Any, robot: Robot) -> A:
    """The arguments that a client sent.

    Raises:
        InvalidFile: They do not fit; it lists the problems.
    """
    return read_record(model, {} if given is None else given, Path("arguments"), Reading(joints=robot.n))
