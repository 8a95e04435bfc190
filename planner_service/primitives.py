"""Pick, place and straight tool moves: straight lines first, one honest check each, the planner where a check fails.

A pick is: open, go before the object, straight in along the approach, close, straight out. Contact is
meant there, and only there: the fingers may touch the object from the pregrasp on; once it is
carried, it may touch its support while it is within ``support_gap`` of where it stood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from numpy.typing import ArrayLike

from planner_service.collision import CheckCounts
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.follow import AllowedStretch
from planner_service.geometry import FloatArray, Pose
from planner_service.grasps import width_across
from planner_service.kinematics import ToolLine, inverse_kinematics, straight_tool_line
from planner_service.outcome import Failure, PlanResult, Reason, Stage
from planner_service.request import PlanRequest, joint_vector
from planner_service.robot import Gripper, Robot
from planner_service.scene import Attached, Obstacle
from planner_service.service import PlannerService
from planner_service.timing import Timing, Trapezoidal

__all__ = ["Handling", "Segment", "TaskResult", "move_linear", "pick", "place"]

USUAL_APPROACHES = (0.10, 0.09, 0.08)
SHORT_APPROACHES = (0.06, 0.04, 0.02)
"""Metres of straight motion before and after a contact, in the order tried; a short one is said in the notes."""

FINGER_ROOM = 0.012
"""Metres that each finger stands off the object when the gripper opens for it."""

LINE_POINTS = 60

Pair = tuple[str, str]


@dataclass(frozen=True)
class Handling:
    """How an object is taken or set down.

    Attributes:
        support: What the object stands on before a pick, or on after a place: an obstacle's name.
        support_gap: Metres of the lift, or of the lowering, within which object and support may touch.
        open_width: The gripper's opening around the object; 12 mm of room for each finger if None.
        request: Planner, timing, seed and limits are taken from here; its start and goal are not.
        line_timing: The law along the straight tool lines. Between two stops on a straight piece the
            trapezoid is the optimum that TOPP-RA approaches, in closed form.
    """

    support: str | None = None
    support_gap: float = 0.005
    open_width: float | None = None
    request: PlanRequest | None = None
    line_timing: Timing = field(default_factory=Trapezoidal)

    def __post_init__(self) -> None:
        if not 0.0 <= self.support_gap <= 0.05:
            raise InvalidRequest("support_gap", self.support_gap, "metres in [0, 0.05]")


@dataclass(frozen=True, eq=False)
class Segment:
    """One motion of a task, by name; ``width`` is the gripper's opening in metres during it."""

    name: str
    result: PlanResult
    width: float


@dataclass(frozen=True, eq=False)
class TaskResult:
    """What a pick or a place came to.

    Attributes:
        segments: The motions, in order.
        service: Plans what follows: the robot with its gripper as it now stands, the scene as it now is.
        q: Where the robot ends, shape (n,).
        failure: None if every segment has a plan.
        choosing: What looking for a workable grasp or placement cost, beyond the segments.
        notes: What was chosen, and what was tried and left.
    """

    segments: tuple[Segment, ...]
    service: PlannerService
    q: FloatArray
    failure: Failure | None = None
    choosing: CheckCounts = field(default_factory=CheckCounts)
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether every segment has a plan."""
        return self.failure is None

    @property
    def counts(self) -> CheckCounts:
        """What the whole task asked of the collision checker."""
        return sum((segment.result.counts for segment in self.segments), self.choosing)

    @property
    def duration(self) -> float:
        """Seconds of motion, the gripper's own not included."""
        return sum(s.result.trajectory.duration for s in self.segments if s.result.trajectory is not None)


def move_linear(
    service: PlannerService,
    start: ArrayLike,
    goal: Pose | Sequence[float],
    *,
    points: int = LINE_POINTS,
    timing: Timing | None = None,
) -> PlanResult:
    """A straight motion of the tool, checked once and timed.

    Args:
        start: Joint vector, shape (n,).
        goal: The tool's pose at the end, or its displacement (x, y, z) in metres in the base frame
            (the orientation is kept).
        points: Configurations along the line, 50 to 100.

    Raises:
        InvalidRequest: as ``PlannerService.follow`` and ``straight_tool_line`` say.
    """
    q = joint_vector("start", start, service.robot)
    line = straight_tool_line(service.robot, q, goal, points=points)
    if line.stopped is not None:
        return PlanResult(None, None, _line_failure(line), ())
    return service.follow(line.waypoints, timing=timing)


def _line_failure(line: ToolLine) -> Failure:
    return Failure(Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED, str(line.stopped))


def pick(
    service: PlannerService, q: ArrayLike, target: str, grasps: Sequence[Pose], handling: Handling | None = None
) -> TaskResult:
    """Take hold of an object: to the pregrasp, straight in, close, straight out.

    The first grasp whose four motions all have a plan is used, over all inverse kinematics
    solutions, with 8 to 10 cm of approach; only when no grasp has one, with less.

    Args:
        q: Where the robot stands, shape (n,).
        target: The obstacle to take.
        grasps: Tool poses, best first (``top_grasps`` suggests some).

    Raises:
        UnknownName: no such obstacle or support.
        InvalidRequest: no grasp given, the robot has no gripper, or the object is too wide for it.
    """
    handling = handling or Handling()
    obstacle = service.scene.obstacle(target)
    if not grasps:
        raise InvalidRequest("grasps", grasps, "at least one tool pose")
    return _perform(service, q, [_grasping(service, obstacle, grasp, handling) for grasp in grasps], handling)


def place(
    service: PlannerService, q: ArrayLike, carried: str, poses: Sequence[Pose], handling: Handling | None = None
) -> TaskResult:
    """Set a carried object down: to above its place, straight in, open, straight out.

    Args:
        q: Where the robot stands, shape (n,).
        carried: The attached object.
        poses: Where the object may come to stand, in the base frame, best first.

    Raises:
        UnknownName: no such carried object or support.
        InvalidRequest: no pose given, or the robot has no gripper.
    """
    handling = handling or Handling()
    held = next((a for a in service.scene.attached if a.name == carried), None)
    if held is None:
        raise UnknownName("carried object", carried, [a.name for a in service.scene.attached])
    if not poses:
        raise InvalidRequest("poses", poses, "at least one pose of the object")
    return _perform(service, q, [_placing(service, held, pose, handling) for pose in poses], handling)


@dataclass(frozen=True)
class _Touch:
    """Pairs that may touch within so many metres of the contact (None: on all of the line), and why."""

    pairs: tuple[Pair, ...]
    within: float | None
    reason: str


@dataclass(frozen=True, eq=False)
class _Contact:
    """One place where the gripper closes or opens.

    Attributes:
        tool: The tool's pose there.
        services: Makes what plans the way in and what plans the way out.
        touches_in, touches_out: Where contact is meant on the straight lines in and out.
        names: Of the three motions: to the line, along it in, along it out.
    """

    tool: Pose
    services: Callable[[], tuple[PlannerService, PlannerService]]
    touches_in: tuple[_Touch, ...]
    touches_out: tuple[_Touch, ...]
    names: tuple[str, str, str]

    @cached_property
    def made(self) -> tuple[PlannerService, PlannerService]:
        """The services, made when first needed: most grasps are out of reach before that."""
        return self.services()


def _grasping(service: PlannerService, target: Obstacle, grasp: Pose, handling: Handling) -> _Contact:
    fingers = _gripper(service).links
    width = width_across(target, grasp)
    opening = _opening(service, width, handling)

    def services() -> tuple[PlannerService, PlannerService]:
        held = Attached(target.name, target.shape, grasp.inverse() @ target.pose, touch_links=fingers)
        scene = service.scene.without(target.name).with_attached(held)
        return service.changed(gripper=opening), service.changed(gripper=width, scene=scene)

    touch = _Touch(tuple((finger, target.name) for finger in fingers), None, "the fingers may touch what they take")
    return _Contact(
        grasp, services, (touch,), _standing(service, target.name, handling), ("to pregrasp", "descend", "lift")
    )


def _placing(service: PlannerService, held: Attached, pose: Pose, handling: Handling) -> _Contact:
    fingers = _gripper(service).links
    opening = _opening(service, service.robot.gripper_width, handling)

    def services() -> tuple[PlannerService, PlannerService]:
        scene = service.scene.without_attached(held.name).with_obstacle(Obstacle(held.name, held.shape, pose))
        return service, service.changed(gripper=opening, scene=scene)

    touch = _Touch(tuple((finger, held.name) for finger in fingers), None, "the fingers may touch what they leave")
    return _Contact(
        pose @ held.pose.inverse(),
        services,
        _standing(service, held.name, handling),
        (touch,),
        ("transfer", "lower", "retreat"),
    )


def _gripper(service: PlannerService) -> Gripper:
    if service.robot.gripper is None:
        raise InvalidRequest("robot", service.robot.name, "a robot with a gripper")
    return service.robot.gripper


def _opening(service: PlannerService, width: float, handling: Handling) -> float:
    widest = _gripper(service).upper
    if width > widest:
        raise InvalidRequest("target", f"{width:.4f} m wide", f"an object at most {widest:.4f} m wide")
    return min(widest, width + 2 * FINGER_ROOM) if handling.open_width is None else handling.open_width


def _standing(service: PlannerService, name: str, handling: Handling) -> tuple[_Touch, ...]:
    if handling.support is None:
        return ()
    support = service.scene.obstacle(handling.support).name
    return (_Touch(((name, support),), handling.support_gap, f"{name} stands on {support}"),)


def _perform(service: PlannerService, q: ArrayLike, contacts: Sequence[_Contact], handling: Handling) -> TaskResult:
    """The first contact whose motions all have a plan, with the longest approach that has one."""
    start = joint_vector("q", q, service.robot)
    began = service.checker.counts
    tried: list[str] = []
    for number, contact, line in _lines(service.robot, contacts, tried):
        segments = _motions(start, contact, line, handling, tried)
        if segments:
            length = _travel(service.robot, line.waypoints)[-1]
            return TaskResult(
                segments,
                contact.made[1],
                line.waypoints[-1],
                choosing=_spent(service, began, contacts) - sum((s.result.counts for s in segments), CheckCounts()),
                notes=(f"way {number + 1} of {len(contacts)}, {length * 100:.0f} cm of straight line", *tried),
            )
    failure = Failure(
        Stage.ENDPOINTS, Reason.PLANNING_FAILED, f"none of {len(contacts)} ways has a plan: {'; '.join(tried[:6])}"
    )
    return TaskResult((), service, start, failure, _spent(service, began, contacts), tuple(tried))


def _spent(service: PlannerService, began: CheckCounts, contacts: Sequence[_Contact]) -> CheckCounts:
    """What the task has counted so far, in its own services and in the given one."""
    made = {id(s): s for contact in contacts if "made" in vars(contact) for s in contact.made if s is not service}
    return sum((s.checker.counts for s in made.values()), service.checker.counts - began)


def _lines(robot: Robot, contacts: Sequence[_Contact], tried: list[str]) -> Iterator[tuple[int, _Contact, ToolLine]]:
    """The straight lines out of every contact, in the order of preference; one that has none is noted in ``tried``."""
    for lengths in (USUAL_APPROACHES, SHORT_APPROACHES):
        for number, contact in enumerate(contacts):
            solutions = inverse_kinematics(robot, contact.tool)
            if len(solutions) == 0 and lengths is USUAL_APPROACHES:
                tried.append(f"way {number + 1} is out of reach")
            for solution in solutions:
                for length in lengths:
                    back = contact.tool @ Pose((-length, 0.0, 0.0))
                    line = straight_tool_line(robot, solution, back, points=LINE_POINTS)
                    if line.stopped is None:
                        yield number, contact, line
                    else:
                        tried.append(f"way {number + 1} with {length * 100:.0f} cm: {line.stopped}")


def _motions(
    start: FloatArray, contact: _Contact, line: ToolLine, handling: Handling, tried: list[str]
) -> tuple[Segment, ...]:
    """The three motions, the cheapest to refuse first; none, and a note in ``tried``, if one of them has no plan."""
    before, after = contact.made
    template = handling.request or PlanRequest(start, start)
    inward, outward = line.waypoints[::-1], line.waypoints
    away = _travel(before.robot, outward)
    questions: tuple[tuple[int, Callable[[], PlanResult]], ...] = (
        (
            1,
            lambda: before.follow(
                inward, contacts=_stretches(contact.touches_in, away, inward=True), timing=handling.line_timing
            ),
        ),
        (
            2,
            lambda: after.follow(
                outward, contacts=_stretches(contact.touches_out, away, inward=False), timing=handling.line_timing
            ),
        ),
        (0, lambda: before.plan(replace(template, start=start, goal=inward[0]))),
    )
    results: dict[int, PlanResult] = {}
    for place_in_order, ask in questions:
        results[place_in_order] = result = ask()
        if result.failure is not None:
            tried.append(f"{contact.names[place_in_order]}: {result.failure.detail}")
            return ()
    widths = (before.robot.gripper_width, before.robot.gripper_width, after.robot.gripper_width)
    return tuple(Segment(contact.names[k], results[k], widths[k]) for k in range(3))


def _travel(robot: Robot, waypoints: FloatArray) -> list[float]:
    """Metres that the tool's origin has come from the first waypoint at each."""
    origin = robot.tool_pose(waypoints[0])[:3, 3]
    return [math.dist(origin, robot.tool_pose(q)[:3, 3]) for q in waypoints]


def _stretches(touches: tuple[_Touch, ...], away: Sequence[float], *, inward: bool) -> tuple[AllowedStretch, ...]:
    """Where on the line pairs may touch, given each waypoint's metres ``away`` from the contact."""
    last = len(away) - 1
    found = []
    for touch in touches:
        reach = last if touch.within is None else max(k for k, metres in enumerate(away) if metres <= touch.within)
        first, end = (last - reach, last) if inward else (0, reach)
        found.append(AllowedStretch(first, end, touch.pairs, touch.reason))
    return tuple(found)
