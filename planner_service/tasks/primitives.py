"""Pick and place: straight lines first, each checked once, and the planner where one is blocked.

A pick is: open, go to the pregrasp, straight in along the approach, close, straight out. Contact is meant there and
nowhere else: from the pregrasp on the fingers may touch the object; once the object is carried, it may touch its
support while it is within ``support_gap`` of where it stood. The gripper's own opening and closing is proven as the
arm's motions are.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import GripperMotion
from planner_service.collision import CheckCounts, CollisionChecker
from planner_service.collision.budget import Cancelled
from planner_service.constraints import Constraint, KeepUpright
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, text
from planner_service.grasping.grasps import width_across
from planner_service.grasping.guards import LONGEST_APPROACH, grasp_objection, unwanted
from planner_service.kinematics.cartesian_waypoints import line_blends, thinned
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.reachability import why_unreachable
from planner_service.kinematics.tool_line import straight_tool_line
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.request import Pace, PlanRequest
from planner_service.planning.result import Failure, PlanResult, Reason, Stage
from planner_service.planning.task_result import Handling, Segment, TaskResult
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot, joint_vector
from planner_service.scene.names import Names
from planner_service.scene.scene import Attached, Obstacle
from planner_service.service import PlannerService

__all__ = ["LEAVE", "kept_upright", "pick", "picked", "place", "placed", "require_poses"]

USUAL_APPROACHES = (LONGEST_APPROACH, 0.09, 0.08)
SHORT_APPROACHES = (0.06, 0.04, 0.02)
"""Metres of straight motion before and after a contact, in the order tried; the notes say which it was."""

LEAVE = "leave"
"""The name of the first motion where the robot touches something at its start."""

FINGER_ROOM = 0.012
"""Metres between each finger and the object when the gripper opens for it."""

MAX_WHYS = 8
"""Poses out of reach that are looked at to tell what would bring the tool to the nearest of them."""

Pair = tuple[str, str]


def pick(
    service: PlannerService, q: ArrayLike, target: str, grasps: Sequence[Pose], handling: Handling | None = None
) -> TaskResult:
    """Take hold of an object: to the pregrasp, straight in, close, straight out.

    The first grasp is used all of whose motions have a plan, over all inverse kinematics solutions, with 8 to 10 cm of
    approach; with less only if no grasp has a plan with so much.

    Args:
        q: Where the robot stands, shape (n,).
        target: The obstacle to take.
        grasps: Tool poses, best first (``top_grasps`` suggests some).

    Raises:
        UnknownName: There is no such obstacle or support.
        InvalidRequest: No grasp is given, the robot has no gripper, or the object is too wide for it.
    """
    return picked(service, q, target, grasps, handling)[0]


def picked(
    service: PlannerService, q: ArrayLike, target: str, grasps: Sequence[Pose], handling: Handling | None
) -> tuple[TaskResult, PlannerService]:
    """The same, with the service that plans for what follows."""
    instance("service", service, PlannerService, "a PlannerService")
    handling = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    obstacle = service.scene.obstacle(target)
    require_poses("grasps", grasps)
    if handling.support == target:
        raise InvalidRequest("support", target, "what the object stands on, not the object itself")
    task = _Task(service, q, handling, f"pick {target}")
    touch = _Touch(_touching(service, _fingers(service), target), None, _gripper(service).touching(target, "take"))
    lifting = _standing(service, target, handling)
    return task.result([_grasping(service, obstacle, grasp, handling, touch, lifting) for grasp in grasps])


def place(
    service: PlannerService, q: ArrayLike, carried: str, poses: Sequence[Pose], handling: Handling | None = None
) -> TaskResult:
    """Set a carried object down: to above its place, straight in, open, straight out.

    Args:
        q: Where the robot stands, shape (n,).
        carried: The attached object.
        poses: Where the object may be set down, in the base frame, best first.

    Raises:
        UnknownName: There is no such carried object or support.
        InvalidRequest: No pose is given, the robot has no gripper, or ``handling.upright``, for picks, is given.
    """
    return placed(service, q, carried, poses, handling)[0]


def placed(
    service: PlannerService, q: ArrayLike, carried: str, poses: Sequence[Pose], handling: Handling | None
) -> tuple[TaskResult, PlannerService]:
    """The same, with the service that plans for what follows."""
    instance("service", service, PlannerService, "a PlannerService")
    handling = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    text("carried", carried)
    held = next((a for a in service.scene.attached if a.name == carried), None)
    if held is None:
        raise UnknownName("carried object", carried, [a.name for a in service.scene.attached])
    if handling.upright is not None:
        raise InvalidRequest("upright", handling.upright, "None for a place: it keeps the carried object's constraints")
    require_poses("poses", poses)
    task = _Task(service, q, handling, f"place {carried}")
    return task.result([_placing(service, held, pose, handling) for pose in poses])


def require_poses(name: str, poses: object) -> None:
    """Refuse what is no list of poses, or an empty one."""
    if not isinstance(poses, list | tuple) or not poses or not all(isinstance(pose, Pose) for pose in poses):
        raise InvalidRequest(name, poses, "a list of at least one Pose")


@dataclass(frozen=True)
class _Touch:
    """Pairs that may touch, within how many metres of the contact (None for all of the line), and why."""

    pairs: tuple[Pair, ...]
    within: float | None
    reason: str


@dataclass(frozen=True, eq=False)
class _Contact:
    """One place where the gripper closes or opens.

    Attributes:
        tool: The tool's pose there.
        services: Makes the services that plan the way in and the way out.
        touches_in: Where contact is meant on the straight line in.
        touches_out: Where contact is meant on the straight line out.
        grip: What may touch while the gripper closes or opens there.
        names: Of the three motions: to the line, in along it, and out along it.
        closed: What reasons begin with that are about the closed gripper.
        objection: Why a configuration there would not do, as the checker of the way in sees it; empty if it would.
    """

    tool: Pose
    services: Callable[[], tuple[PlannerService, PlannerService]]
    objection: Callable[[CollisionChecker, FloatArray], str]
    touches_in: tuple[_Touch, ...]
    touches_out: tuple[_Touch, ...]
    grip: _Touch
    names: tuple[str, str, str]
    closed: tuple[str, ...]

    @cached_property
    def made(self) -> tuple[PlannerService, PlannerService]:
        """The services, made when first needed: most grasps turn out to be out of reach before that."""
        return self.services()


def _grasping(
    service: PlannerService,
    target: Obstacle,
    grasp: Pose,
    handling: Handling,
    touch: _Touch,
    lifting: tuple[_Touch, ...],
) -> _Contact:
    gripper = _gripper(service)
    width = width_across(target, grasp, gripper)
    opening = _opening(service, width, handling)

    def services() -> tuple[PlannerService, PlannerService]:
        kept = () if handling.upright is None else (kept_upright(grasp, handling.upright),)
        pose = grasp.inverse() @ target.pose
        held = Attached(target.name, target.shape, pose, touch_links=_fingers(service), constraints=kept)
        scene = service.scene.without(target.name).with_attached(held)
        return service.changed(gripper=opening), service.changed(gripper=width, scene=scene)

    def objection(checker: CollisionChecker, q: FloatArray) -> str:
        return grasp_objection(target, grasp, gripper) or unwanted(checker, q, touch.pairs)

    return _Contact(
        grasp, services, objection, (touch,), lifting, touch, ("to pregrasp", "descend", "lift"), ("lift:",)
    )


def kept_upright(grasp: Pose, tolerance: float) -> Constraint:
    """What an object keeps that was taken at a grasp and may lean by so many radians from how it stood."""
    up = grasp.inverse().rotation[:, 2]  # in the tool frame
    return KeepUpright(up.tolist(), tolerance)


def _placing(service: PlannerService, held: Attached, pose: Pose, handling: Handling) -> _Contact:
    opening = _opening(service, service.robot.gripper_width, handling)
    names = Names(service.robot, service.scene)

    def services() -> tuple[PlannerService, PlannerService]:
        scene = service.scene.without_attached(held.name).with_obstacle(Obstacle(held.name, held.shape, pose))
        return service, service.changed(gripper=opening, scene=scene)

    def objection(checker: CollisionChecker, q: FloatArray) -> str:
        if handling.support is None:
            return ""
        pair = (names.object(held.name), names.object(handling.support))
        roomy = checker.variant(padding=handling.support_gap)
        if pair not in roomy.touching(q):
            return f"{held.name} would not come within {handling.support_gap * 1000:g} mm of {handling.support}"
        return unwanted(checker, q, (pair,))

    reason = "" if service.robot.gripper is None else service.robot.gripper.touching(held.name, "leave")
    touch = _Touch(_touching(service, _fingers(service), held.name), None, reason)
    lowering = _standing(service, held.name, handling)
    motions = ("transfer", "lower", "retreat")
    tool, closed = pose @ held.pose.inverse(), ("way ", "transfer:", "lower:")
    return _Contact(tool, services, objection, lowering, (touch,), touch, motions, closed)


def _fingers(service: PlannerService) -> tuple[str, ...]:
    """The finger links that can touch anything."""
    shaped = {shape.link for shape in service.robot.shapes}
    return tuple(link for link in _gripper(service).links if link in shaped)


def _touching(service: PlannerService, fingers: tuple[str, ...], name: str) -> tuple[Pair, ...]:
    """The labels of each finger and an object."""
    names = Names(service.robot, service.scene)
    return tuple((names.link(finger), names.object(name)) for finger in fingers)


def _gripper(service: PlannerService) -> Gripper:
    if service.robot.gripper is None:
        raise InvalidRequest("robot", service.robot.name, "a robot with a gripper")
    return service.robot.gripper


def _opening(service: PlannerService, width: float, handling: Handling) -> float:
    widest = _gripper(service).upper
    if _gripper(service).kind == "vacuum":
        return widest
    if width > widest:
        raise InvalidRequest("target", f"{width:.4f} m wide", f"an object at most {widest:.4f} m wide")
    if handling.open_width is None:
        return min(widest, width + 2 * FINGER_ROOM)
    if handling.open_width < width:
        raise InvalidRequest("open_width", handling.open_width, f"at least the object's width, {width:.4f} m")
    return handling.open_width


def _standing(service: PlannerService, name: str, handling: Handling) -> tuple[_Touch, ...]:
    if handling.support is None:
        return ()
    names = Names(service.robot, service.scene)
    standing, support = names.object(name), names.object(service.scene.obstacle(handling.support).name)
    return (_Touch(((standing, support),), handling.support_gap, f"{standing} stands on {support}"),)


class _Task:
    """One pick or place: what it has tried and spent so far."""

    def __init__(self, service: PlannerService, q: ArrayLike, handling: Handling, task: str) -> None:
        self._began = time.perf_counter()
        self._service = service
        self._task = task
        self._start = joint_vector("q", q, service.robot)
        limits = service.robot.around(self._start).limits
        self._standing = np.clip(self._start, limits.lower, limits.upper)
        self._still = service.robot.unwound(self._standing)
        self._handling = handling
        self._template = replace(
            handling.request or PlanRequest(self._start, self._start), start=self._start, goal=self._start
        )
        limit = self._template.time_limit
        self._deadline = None if limit is None else time.monotonic() + limit
        self._spent = CheckCounts()
        self._tried: list[str] = []
        self._grips: dict[tuple[bytes, float, float], GripperMotion] = {}
        self._ended: Failure | None = None
        self._unreached: dict[int, Pose] = {}
        self._leave: tuple[Segment, ...] = ()

    def result(self, contacts: Sequence[_Contact]) -> tuple[TaskResult, PlannerService]:
        """The first contact whose motions all have a plan, with the longest approach that has one, and its service."""
        start = self._start_trouble()
        if start is not None:
            return self._failed(start)
        for number, contact, outward in self._lines(contacts):
            try:
                segments = (*self._leave, *self._motions(contact, outward))
            except _NoMotion:
                segments = ()
            if segments:
                length = _travel(self._service.robot, outward)[-1]
                notes = (f"way {number} of {len(contacts)}, {length * 100:.0f} cm of straight line", *self._tried)
                choosing = self._spent - sum((segment.counts for segment in segments), CheckCounts())
                end = _end(segments[-1].result)
                return self._result(segments, contact.made[1], end, None, choosing, notes)
            if self._ended is not None:
                return self._failed(self._ended)
        detail = f"none of {len(contacts)} ways has a plan: {'; '.join(self._tried[:6])}{self._too_wide(contacts[0])}"
        return self._failed(self._explained(Failure(Stage.ENDPOINTS, Reason.PLANNING_FAILED, detail)))

    def _too_wide(self, contact: _Contact) -> str:
        """That a smaller opening may do, where open fingers were in the way and nobody said how wide they open."""
        if self._handling.open_width is not None or _gripper(self._service).kind == "vacuum":
            return ""
        names = Names(self._service.robot, self._service.scene)
        fingers = [f"{names.link(finger)} x " for finger in _fingers(self._service)]
        opened = (reason for reason in self._tried if not reason.startswith(contact.closed))
        if not any(finger in reason for reason in opened for finger in fingers):
            return ""
        return f"; fingers open {FINGER_ROOM * 1000:g} mm beyond the object on either side: a smaller open_width may do"

    def _explained(self, failure: Failure) -> Failure:
        """The failure with why the tool cannot be brought to the nearest of the poses that are out of reach."""
        robot, seed = self._service.robot, self._template.seed
        whys = [
            (why.gap, why.turn, number, why)
            for number, pose in list(self._unreached.items())[:MAX_WHYS]
            for why in [why_unreachable(robot, pose, seed=seed, still=self._still)]
        ]
        if not whys:
            return failure
        *_, number, why = min(whys, key=lambda each: each[:3])
        return replace(failure, detail=f"{failure.detail}; way {number} comes nearest: {why}", unreachable=why)

    def _failed(self, failure: Failure) -> tuple[TaskResult, PlannerService]:
        return self._result((), self._service, self._start, failure, self._spent, tuple(self._tried))

    def _result(
        self,
        segments: tuple[Segment, ...],
        service: PlannerService,
        q: FloatArray,
        failure: Failure | None,
        choosing: CheckCounts,
        notes: tuple[str, ...],
    ) -> tuple[TaskResult, PlannerService]:
        world, seconds = service.world, time.perf_counter() - self._began
        request = replace(self._template, start=self._start, goal=self._start) if self._leave else self._template
        return TaskResult(segments, world, q, failure, choosing, notes, request, self._task, seconds), service

    def _start_trouble(self) -> Failure | None:
        """Why no motion can begin where the robot stands: this is checked before any grasp.

        Where it touches something by so little that a plan begins with a way out, this is the first motion.
        """
        result = self._service.plan(self._template, cancel=self._handling.cancel)
        self._spent += result.counts
        if result.failure is None or result.failure.reason is not Reason.GOAL_IN_COLLISION:
            return result.failure
        way = self._service.way_out(self._standing, padding=self._template.padding)
        if way is None:
            return result.failure
        self._spent += CheckCounts(distances=way.distances)
        end = way.path.waypoints[-1]
        leave = self._service.plan(replace(self._template, goal=end), cancel=self._handling.cancel)
        self._spent += leave.counts
        if leave.failure is None:
            self._leave = (Segment(LEAVE, leave, self._service.robot.gripper_width, self._service.scene),)
            self._standing, self._still = end, self._service.robot.unwound(end)
            self._template = replace(self._template, start=end, goal=end)
        return leave.failure

    def _lines(self, contacts: Sequence[_Contact]) -> Iterator[tuple[int, _Contact, FloatArray]]:
        """The straight lines out of every contact, numbered from 1, in the order of preference."""
        x, y, z = _gripper(self._service).approach
        for lengths in (USUAL_APPROACHES, SHORT_APPROACHES):
            for number, contact in enumerate(contacts, start=1):
                for q in self._fitting(number, contact, first=lengths is USUAL_APPROACHES):
                    for length in lengths:
                        back = contact.tool @ Pose((-length * x, -length * y, -length * z))
                        line = straight_tool_line(self._service.robot, q, back)
                        if line.stopped is None:
                            yield number, contact, self._thinned(line.waypoints)
                        else:
                            self._tried.append(f"way {number} with {length * 100:.0f} cm: {line.stopped}")

    def _thinned(self, waypoints: FloatArray) -> FloatArray:
        """As few waypoints as the line needs, and the last one at which object and support may touch."""
        away = _travel(self._service.robot, waypoints)
        gap = max(k for k, metres in enumerate(away) if metres <= self._handling.support_gap)
        return thinned(self._service.robot, waypoints, keep=(gap,))

    def _fitting(self, number: int, contact: _Contact, *, first: bool) -> list[FloatArray]:
        """Configurations that would do at a contact; why there are none is noted the ``first`` time."""
        robot, seed = self._service.robot, self._template.seed
        solutions = inverse_kinematics(robot, contact.tool, seed=seed, still=self._still)
        refused = []
        if len(solutions) == 0:
            refused.append("out of reach")
            self._unreached[number] = contact.tool
        fitting = []
        for q in solutions:
            checker = contact.made[0].checker
            tally = checker.ledger.own
            before = tally.counts
            objection = contact.objection(checker, q)
            self._spent += tally.counts - before
            if objection:
                refused.append(objection)
            else:
                fitting.append(q)
        if first:
            self._tried += [f"way {number}: {reason}" for reason in refused]
        return fitting

    def _motions(self, contact: _Contact, outward: FloatArray) -> tuple[Segment, ...]:
        """The three motions and what the gripper does between them; the cheapest to refuse are planned first.

        Raises:
            _NoMotion: One of them has no plan.
        """
        before, after = contact.made
        going, into, out = contact.names
        opening = self._gripper_motion(self._service, self._standing, before.robot.gripper_width, None)
        outward = _turned(before.robot, outward, self._standing)
        line_in, grip, line_out = self._touching(contact, outward)
        request = replace(self._template, goal=outward[-1], time_limit=self._share_of_time())
        to = self._having_plan(going, before.plan(request, cancel=self._handling.cancel))
        there = _turned(before.robot, outward, _end(to))
        if there is not outward:  # a joint has gone the other way round
            line_in, grip, line_out = self._touching(contact, there)
        open_width, law = before.robot.gripper_width, self._handling.line_timing
        return (
            Segment(going, to, open_width, before.scene, opening),
            Segment(into, line_in, open_width, before.scene, timing=law),
            Segment(out, line_out, after.robot.gripper_width, after.scene, grip, law),
        )

    def _touching(self, contact: _Contact, outward: FloatArray) -> tuple[PlanResult, GripperMotion | None, PlanResult]:
        """The line to a contact, what the gripper does there, and the line out.

        Raises:
            _NoMotion: One of them is not free.
        """
        before, after = contact.made
        _, into, out = contact.names
        away = _travel(before.robot, outward)
        grip = self._gripper_motion(before, outward[0], after.robot.gripper_width, contact.grip)
        line_in = self._followed(into, before, outward[::-1], _stretches(contact.touches_in, away, inward=True))
        line_out = self._followed(out, after, outward, _stretches(contact.touches_out, away, inward=False))
        return line_in, grip, line_out

    def _gripper_motion(
        self, service: PlannerService, q: FloatArray, width: float, touch: _Touch | None
    ) -> GripperMotion | None:
        """The gripper going from its width to another one; None if it has it already. It is proven once and remembered.

        Raises:
            _NoMotion: It is not proven free.
        """
        now = service.robot.gripper_width
        if width == now:
            return None
        key = (q.tobytes(), now, width)
        if key not in self._grips:
            touching, reason = ((), "") if touch is None else (touch.pairs, touch.reason)
            cancel = self._handling.cancel
            try:
                motion = service.certify_gripper(q, now, width, touching=touching, reason=reason, cancel=cancel)
            except Cancelled as cancelled:
                self._ended = Failure(Stage.CERTIFY, Reason.PREEMPTED, str(cancelled))
                raise _NoMotion from cancelled
            self._grips[key] = motion
            self._spent += CheckCounts(distances=motion.certificate.distances)
            self._tried += [motion.refused] if motion.refused else []
        if self._grips[key].refused:
            raise _NoMotion
        return self._grips[key]

    def _followed(
        self, name: str, service: PlannerService, waypoints: FloatArray, contacts: tuple[AllowedStretch, ...]
    ) -> PlanResult:
        result = service.follow(
            waypoints,
            contacts=contacts,
            blends=np.minimum(line_blends(service.robot, waypoints), self._template.blend),
            pace=Pace.of(self._template, self._handling.line_timing),
            padding=self._template.padding,
            constraints=self._template.constraints,
            cancel=self._handling.cancel,
        )
        return self._having_plan(name, result)

    def _share_of_time(self) -> float | None:
        """Seconds for the next search: half of what is left, so that other grasps get their turn.

        Raises:
            _NoMotion: No time is left.
        """
        if self._deadline is None:
            return None
        left = self._deadline - time.monotonic()
        if left <= 0.0:
            detail = f"the time limit of {self._template.time_limit:g} s passed; {'; '.join(self._tried[:6])}"
            self._ended = Failure(Stage.SEARCH, Reason.TIMED_OUT, detail)
            raise _NoMotion
        return left / 2.0

    def _having_plan(self, name: str, result: PlanResult) -> PlanResult:
        """The result itself if it has a plan. Its cost is counted either way, and a cancelled one ends the task.

        Raises:
            _NoMotion: It has none.
        """
        self._spent += result.counts
        if result.failure is None:
            return result
        self._tried.append(f"{name}: {result.failure.detail}")
        self._ended = result.failure if result.failure.reason is Reason.PREEMPTED else None
        raise _NoMotion


class _NoMotion(Exception):
    """One of the motions of a grasp or placement has no plan; the reason was noted."""


def _turned(robot: Robot, outward: FloatArray, q: FloatArray) -> FloatArray:
    """A line with continuous joints moved by whole turns, its end as near to q as that goes; itself if it is."""
    turns = robot.nearest_turns(outward, q)
    return outward + turns if turns.any() else outward


def _end(result: PlanResult) -> FloatArray:
    end: FloatArray = result.unwrap()[0].waypoints[-1]
    return end


def _travel(robot: Robot, waypoints: FloatArray) -> list[float]:
    """Metres between the tool's origin at the first waypoint and at each."""
    places = [[row[3] for row in robot.tool_rows(q)] for q in waypoints]
    return [math.dist(places[0], place) for place in places]


def _stretches(touches: tuple[_Touch, ...], away: Sequence[float], *, inward: bool) -> tuple[AllowedStretch, ...]:
    """Where on the line pairs may touch, given how many metres ``away`` from the contact each waypoint is."""
    last = len(away) - 1
    stretches = []
    for touch in touches:
        reach = last if touch.within is None else max(k for k, metres in enumerate(away) if metres <= touch.within)
        first, end = (last - reach, last) if inward else (0, reach)
        stretches.append(AllowedStretch(first, end, touch.pairs, touch.reason))
    return tuple(stretches)
