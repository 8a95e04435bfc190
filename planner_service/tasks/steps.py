"""The steps of a task as values.

::

    Task((
        Connect("to pregrasp"), Approach("descend"), Grasp("block", support="table"), Retreat("lift"),
        Connect("transfer"), Approach("lower"), Release("block", [there], support="tray"), Retreat("retreat"),
        MoveTo(),
    ))

A step names what is to be done, not how: grasps, inverse kinematics branches and placements are chosen by ``solve``,
each so that what follows has a plan. What is carried and what stands where follows from the steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from planner_service.constraints import Constraint
from planner_service.constraints.values import MIN_ANGLE, checked_constraints
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import (
    checked_name,
    finite_tuple,
    items,
    number,
    numbers,
    text,
    whole,
)
from planner_service.grasping.guards import LONGEST_APPROACH
from planner_service.kinematics.pose_goal import PoseGoal, unit_axis
from planner_service.planning.task_result import MAX_SUPPORT_GAP
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle
from planner_service.tasks.tool_motions import MAX_ZONE

__all__ = [
    "Alternatives",
    "Approach",
    "Connect",
    "Follow",
    "Grasp",
    "GraspSource",
    "MoveCircular",
    "MoveLinear",
    "MoveTo",
    "Release",
    "Repeat",
    "Retreat",
    "Step",
    "Wait",
    "flat_steps",
]

USUAL_LENGTHS = (LONGEST_APPROACH, 0.09, 0.08)
SHORT_LENGTHS = (0.06, 0.04, 0.02)
"""Metres of straight motion before and after a contact, in the order tried."""

LEAST_LENGTH = 1e-3

MAX_POSES = 10_000
MAX_GOALS = 10_000
MAX_BRANCHES = 100
MAX_STEPS = 1_000
"""Of a task, with all repetitions and all alternatives."""

MAX_DEPTH = 8
"""Of alternatives and repetitions within each other."""

MAX_WAIT = 3_600.0
"""Seconds. More is a mistake in the unit."""

Vector = tuple[float, float, float]


@runtime_checkable
class GraspSource(Protocol):
    """What finds grasps of an object where it stands."""

    def poses(self, robot: Robot, obstacle: Obstacle) -> tuple[Pose, ...]:
        """Tool poses in the base frame, best first."""
        ...


class Step:
    """One step of a task.

    Attributes:
        kind: What files and reports call it.
    """

    kind: ClassVar[str]

    @property
    def what(self) -> str:
        """What it is about, in a word or two."""
        return str(getattr(self, "name", getattr(self, "object", "")))

    def __str__(self) -> str:
        return f"{self.kind} {self.what}".strip()


def _checked(step: Any) -> None:
    """Check the fields that several steps have."""
    named = {each.name for each in fields(step)}
    for name in named & {"name", "object"}:
        checked_name(name, getattr(step, name))
    if "frame" in named and text("frame", step.frame):
        checked_name("frame", step.frame)
    if "free_axis" in named and step.free_axis is not None:
        set_fields(step, free_axis=unit_axis(step.free_axis))
    if "constraints" in named:
        set_fields(step, constraints=checked_constraints(step.constraints))


@dataclass(frozen=True)
class MoveTo(Step):
    """A motion to a goal, around whatever is in the way.

    Attributes:
        goal: Joint values (n,), the name of a pose of the robot, a ``Pose`` or ``PoseGoal`` of the tool, or a sequence
            of these, any of which will do. None: where the task began.
        frame: The obstacle in whose frame poses are given; empty for the base.
        constraints: What holds during this motion, beside the constraints of the request and of what is carried.
        name: What the motion is called.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range.
    """

    kind = "MoveTo"

    goal: Any = None
    frame: str = ""
    constraints: Sequence[Constraint] = ()
    name: str = "move"

    def __post_init__(self) -> None:
        _checked(self)
        set_fields(self, goal=None if self.goal is None else _goals(self.goal))


def _goals(goal: Any) -> tuple[Any, ...]:
    """The goals one by one, joint values as tuples."""
    expected = "joint values, the name of a pose, a Pose, a PoseGoal, or a sequence of these"
    if isinstance(goal, str | Pose | PoseGoal):
        return (_goal("goal", goal, expected),)
    if _several(goal, (str, Pose, PoseGoal)):
        several = items("goal", goal, object, expected, MAX_GOALS)
        return tuple(_goal(f"goal[{k}]", each, expected) for k, each in enumerate(several))
    array = numbers("goal", goal, expected)
    return tuple(_goal("goal", row, expected) for row in (array if array.ndim == 2 and len(array) else [array]))


def _several(given: Any, kinds: tuple[type, ...]) -> bool:
    """Whether something is a sequence of goals, and not one goal of numbers."""
    nested = (*kinds, list, tuple, np.ndarray)
    return isinstance(given, list | tuple) and any(isinstance(each, nested) for each in given)


def _goal(field: str, goal: Any, expected: str) -> Any:
    if isinstance(goal, str):
        return checked_name(field, goal)
    if isinstance(goal, Pose | PoseGoal):
        return goal
    array = numbers(field, goal, expected)
    if array.ndim != 1 or not 0 < array.size <= MAX_STEPS or not np.isfinite(array).all():
        raise InvalidRequest(field, goal, expected)
    return tuple(array.tolist())


@dataclass(frozen=True)
class MoveLinear(Step):
    """A straight motion of the tool, or several with rounded corners; see ``move_linear``.

    Attributes:
        goal: The tool's pose at the end, or its displacement (x, y, z) in metres along the base's axes; or a sequence
            of these, to pass one after the other.
        frame: As of ``MoveTo``; a displacement is along the axes of that frame.
        zone: Metres before and after a corner within which it is rounded.
        constraints: As of ``MoveTo``.
        name: What the motion is called.
        free_axis: Axis (x, y, z) in the tool frame about which the tool may turn as it likes; None for none.
    """

    kind = "MoveLinear"

    goal: Any
    frame: str = ""
    zone: float = 0.0
    constraints: Sequence[Constraint] = ()
    name: str = "line"
    free_axis: Vector | None = None

    def __post_init__(self) -> None:
        _checked(self)
        goals = items("goal", self.goal, object, "targets", MAX_STEPS) if _several(self.goal, (Pose,)) else (self.goal,)
        set_fields(self, goal=tuple(_target("goal", each) for each in goals))
        set_fields(self, zone=number("zone", self.zone, f"metres in [0, {MAX_ZONE:g}]", 0.0, MAX_ZONE))


def _target(field: str, target: Any) -> Pose | Vector:
    """A pose, or a displacement of three numbers."""
    if isinstance(target, Pose):
        return target
    try:
        x, y, z = finite_tuple(field, target, 3)
    except InvalidRequest:
        raise InvalidRequest(field, target, "a Pose of the tool, or its displacement (x, y, z) in metres") from None
    return (x, y, z)


@dataclass(frozen=True)
class MoveCircular(Step):
    """A motion of the tool along the arc through a point; see ``move_circular``.

    Attributes:
        via: A point on the arc: a pose, whose orientation is ignored, or a displacement (x, y, z) from the start.
        goal: The tool's pose at the end, or its displacement from the start.
        frame: As of ``MoveLinear``; so is ``free_axis``.
        constraints: As of ``MoveTo``.
        name: What the motion is called.
    """

    kind = "MoveCircular"

    via: Pose | Vector
    goal: Pose | Vector
    frame: str = ""
    constraints: Sequence[Constraint] = ()
    name: str = "arc"
    free_axis: Vector | None = None

    def __post_init__(self) -> None:
        _checked(self)
        set_fields(self, via=_target("via", self.via), goal=_target("goal", self.goal))


@dataclass(frozen=True)
class Follow(Step):
    """A given polyline of joint values, as it is; see ``PlannerService.follow``.

    Attributes:
        waypoints: Shape (N, n). It begins where the robot stands, or after a ``Connect``, which goes there.
        blend: Radians of path that the blend of a corner may replace before and after it; 0 stops at every corner.
        constraints: As of ``MoveTo``.
        name: What the motion is called.
    """

    kind = "Follow"

    waypoints: Any
    blend: float = 0.0
    constraints: Sequence[Constraint] = ()
    name: str = "follow"

    def __post_init__(self) -> None:
        _checked(self)
        rows = numbers("waypoints", self.waypoints, "rows of joint values")
        if rows.ndim != 2 or not rows.size or not np.isfinite(rows).all():
            raise InvalidRequest("waypoints", rows.shape, "finite rows of joint values, shape (N, n)")
        set_fields(self, waypoints=tuple(map(tuple, rows.tolist())))
        set_fields(self, blend=number("blend", self.blend, "radians in [0, 3]", 0.0, 3.0))


@dataclass(frozen=True)
class Connect(Step):
    """A motion to where the next step, ``Approach`` or ``Follow``, begins, around whatever is in the way.

    It is searched for last, when all that it leads to has a plan.

    Attributes:
        name: What the motion is called.
        constraints: As of ``MoveTo``.
    """

    kind = "Connect"

    name: str = "transfer"
    constraints: Sequence[Constraint] = ()

    def __post_init__(self) -> None:
        _checked(self)


@dataclass(frozen=True)
class Approach(Step):
    """A straight motion of the tool to where the gripper closes or opens, or to where the next approach begins.

    Attributes:
        name: What the motion is called.
        lengths: Metres, at most 0.1, best first.
        shorter: Metres that are tried only if no grasp or placement has a plan with those.
        direction: Along which it goes, in the base frame; None for the gripper's own axis of approach.
    """

    kind = "Approach"

    name: str = "approach"
    lengths: Sequence[float] = USUAL_LENGTHS
    shorter: Sequence[float] = SHORT_LENGTHS
    direction: Vector | None = None

    def __post_init__(self) -> None:
        _checked(self)
        lengths = _lengths("lengths", self.lengths)
        if not lengths:
            raise InvalidRequest("lengths", self.lengths, "at least one length in metres")
        if self.lengths != USUAL_LENGTHS and self.shorter is SHORT_LENGTHS:
            set_fields(self, shorter=())
        set_fields(self, lengths=lengths, shorter=_lengths("shorter", self.shorter))
        set_fields(self, direction=_direction(self.direction))


def _lengths(field: str, values: Any) -> tuple[float, ...]:
    expected = f"metres in [{LEAST_LENGTH:g}, {LONGEST_APPROACH:g}]"
    given = items(field, values, object, f"a list of {expected}", MAX_BRANCHES)
    return tuple(
        number(f"{field}[{k}]", each, expected, LEAST_LENGTH, LONGEST_APPROACH) for k, each in enumerate(given)
    )


def _direction(given: Any) -> Vector | None:
    """A unit vector, or None."""
    if given is None:
        return None
    x, y, z = finite_tuple("direction", given, 3)
    size = float(np.hypot(np.hypot(x, y), z))
    if not 1e-6 <= size <= 1e6:
        raise InvalidRequest("direction", given, "a vector (x, y, z) with a length, or None")
    return (x / size, y / size, z / size)


@dataclass(frozen=True)
class Retreat(Step):
    """A straight motion of the tool away from where the gripper has closed or opened, or on from the retreat before.

    Attributes:
        name: What the motion is called.
        lengths: Metres, at most 0.1, best first; the first is taken that the arm can go. None: back along the approach,
            or, where there was none, as the usual ones.
        direction: Along which it goes, in the base frame; None for straight back along the gripper's axis of approach.
    """

    kind = "Retreat"

    name: str = "retreat"
    lengths: Sequence[float] | None = None
    direction: Vector | None = None

    def __post_init__(self) -> None:
        _checked(self)
        if self.lengths is not None:
            set_fields(self, lengths=_lengths("lengths", self.lengths))
            if not self.lengths:
                raise InvalidRequest("lengths", self.lengths, "at least one length in metres, or None")
        set_fields(self, direction=_direction(self.direction))


@dataclass(frozen=True)
class Grasp(Step):
    """The gripper closes on an object, which is carried from then on.

    Attributes:
        object: The obstacle to take.
        grasps: Tool poses, best first, or what finds them. None: ``GraspKinds()``, which is from above first, and of
            the other kinds where none of these has a plan; or, without an approach, where the tool is.
        frame: The obstacle in whose frame the poses are given, such as the object itself; empty for the base.
        open_width: Metres between the fingers before; None to have it chosen.
        support: The obstacle that the object stands on. The two may touch until the object is ``support_gap`` away.
        support_gap: Metres.
        upright: Radians by which the object may lean while it is carried, from how it stood; None for any.
    """

    kind = "Grasp"

    object: str
    grasps: Sequence[Pose] | GraspSource | None = None
    frame: str = ""
    open_width: float | None = None
    support: str | None = None
    support_gap: float = 0.005
    upright: float | None = None

    def __post_init__(self) -> None:
        _checked(self)
        _checked_handling(self)
        if self.grasps is not None and not isinstance(self.grasps, GraspSource):
            set_fields(self, grasps=_poses("grasps", self.grasps))
        if self.upright is not None:
            number("upright", self.upright, f"radians in [{MIN_ANGLE:g}, pi], or None", MIN_ANGLE, float(np.pi))


@dataclass(frozen=True)
class Release(Step):
    """The gripper opens, and what it carried stands from then on where it is.

    Attributes:
        object: What is carried.
        poses: Where it may be set down, best first. None, where there is no approach: where it is.
        frame: The obstacle in whose frame they are given; empty for the base.
        open_width: Metres between the fingers afterwards; None to have it chosen.
        support: The obstacle that it is set down on. The two may touch once the object is within ``support_gap``.
        support_gap: Metres.
    """

    kind = "Release"

    object: str
    poses: Sequence[Pose] | None = None
    frame: str = ""
    open_width: float | None = None
    support: str | None = None
    support_gap: float = 0.005

    def __post_init__(self) -> None:
        _checked(self)
        _checked_handling(self)
        if self.poses is not None:
            set_fields(self, poses=_poses("poses", self.poses))


def _checked_handling(step: Grasp | Release) -> None:
    """Check what a grasp and a release have in common."""
    if step.open_width is not None:
        number("open_width", step.open_width, "metres in [0, 1], or None", 0.0, 1.0)
    if step.support is not None:
        checked_name("support", step.support)
        if step.support == step.object:
            raise InvalidRequest("support", step.support, "what the object stands on, not the object itself")
    number("support_gap", step.support_gap, f"metres in [0, {MAX_SUPPORT_GAP:g}]", 0.0, MAX_SUPPORT_GAP)


def _poses(field: str, given: Any) -> tuple[Pose, ...]:
    if isinstance(given, list | tuple) and given and all(isinstance(pose, Pose) for pose in given):
        return items(field, given, Pose, "poses", MAX_POSES)
    raise InvalidRequest(field, given, "a list of at least one Pose")


@dataclass(frozen=True)
class Wait(Step):
    """The arm stands still: files, programs and execution have the next motion wait for so long.

    Attributes:
        seconds: For so long.
    """

    kind = "Wait"

    seconds: float

    def __post_init__(self) -> None:
        set_fields(self, seconds=number("seconds", self.seconds, f"seconds in [0, {MAX_WAIT:g}]", 0.0, MAX_WAIT))

    @property
    def what(self) -> str:
        """How long."""
        return f"{self.seconds:g} s"


@dataclass(frozen=True)
class Alternatives(Step):
    """Several ways to go on: the first is taken with which the rest of the task has a plan.

    Attributes:
        branches: Each a step or a sequence of steps; an empty one goes on without.
    """

    kind = "Alternatives"

    branches: Sequence[Any]

    def __post_init__(self) -> None:
        expected = "steps, or sequences of steps"
        given = items("branches", self.branches, object, expected, MAX_BRANCHES)
        if not given:
            raise InvalidRequest("branches", self.branches, "at least one step, or sequence of steps")
        set_fields(self, branches=tuple(flat_steps(f"branches[{k}]", each) for k, each in enumerate(given)))


@dataclass(frozen=True)
class Repeat(Step):
    """Steps that are done several times.

    Attributes:
        steps: What is repeated.
        times: How often.
    """

    kind = "Repeat"

    steps: Sequence[Any]
    times: int

    def __post_init__(self) -> None:
        set_fields(self, steps=flat_steps("steps", self.steps), times=whole("times", self.times, 1, MAX_STEPS))


def flat_steps(field: str, given: Any, depth: int = MAX_DEPTH) -> tuple[Step, ...]:
    """Steps, and sequences of steps, as one sequence.

    Raises:
        InvalidRequest: Something else is among them, they are too many, or nested too deeply.
    """
    if isinstance(given, Step):
        return (given,)
    expected = f"steps such as MoveTo(...), at most {MAX_STEPS:,}, and sequences of them"
    if depth == 0 or not isinstance(given, list | tuple):
        raise InvalidRequest(field, given, expected)
    steps: list[Step] = []
    for k, each in enumerate(items(field, given, object, expected, MAX_STEPS)):
        steps += flat_steps(f"{field}[{k}]", each, depth - 1)
        if len(steps) > MAX_STEPS:
            raise InvalidRequest(field, f"{len(steps):,} steps", expected)
    return tuple(steps)
