"""Where the gripper closes or opens: grasps and placements, and the straight lines to and from each of them.

Contact is meant there and nowhere else. On the last approach and the first retreat, where they go along the gripper's
own axis, the fingers may touch the object that they take or leave; so they may while they close or open. What is
carried may touch its support within ``support_gap`` of where it stood, or will stand.

The cheapest to refuse comes first: whether the arm reaches the pose, what touches there, whether the arm can go the
lines, and only then whether these, and the gripper's own motion, are proven free.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from planner_service.certify import GripperMotion
from planner_service.collision import CollisionChecker
from planner_service.constraints import Constraint, KeepUpright
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.grasping.grasps import top_grasps, width_across
from planner_service.grasping.guards import grasp_objection, unwanted
from planner_service.kinematics.cartesian_waypoints import thinned
from planner_service.kinematics.tool_line import straight_tool_line
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Attached, Obstacle
from planner_service.service import PlannerService
from planner_service.tasks.inspector import Rank, Visit
from planner_service.tasks.motions import Motions, NoMotion, Touch
from planner_service.tasks.steps import USUAL_LENGTHS, Approach, ContactStage, Grasp, Numbered, Release, Retreat

__all__ = ["FINGER_ROOM", "Contact", "Lines", "Way", "Ways", "gripper_of", "kept_upright", "opening"]

Vector = tuple[float, float, float]

FINGER_ROOM = 0.012
"""Metres between each finger and the object when the gripper opens for it."""


@dataclass(frozen=True, eq=False)
class Contact:
    """One place where the gripper closes or opens.

    Attributes:
        tool: The tool's pose there.
        width: Metres between the fingers on the way in.
        then: The same on the way out.
        services: Make the services that plan the way in, and the way out.
        objection: Why a configuration there would not do, as the checker of the way in sees it; empty if it would.
        fingers: What the fingers may touch.
        standing: What the object may touch: before it is released, or once it is taken.
        gap: Metres within which it may.
    """

    tool: Pose
    width: float
    then: float
    services: tuple[Callable[[], PlannerService], Callable[[], PlannerService]]
    objection: Callable[[CollisionChecker, FloatArray], str]
    fingers: Touch
    standing: tuple[Touch, ...]
    gap: float
    takes: bool

    @cached_property
    def before(self) -> PlannerService:
        """What plans the way in; made when first needed, as most grasps turn out to be out of reach before that."""
        return self.services[0]()

    @cached_property
    def after(self) -> PlannerService:
        """What plans the way out."""
        return self.services[1]()

    def touches(self, *, inward: bool, along_axis: bool) -> tuple[Touch, ...]:
        """What may touch on the line to the contact, or from it."""
        fingers = (self.fingers,) if inward == self.takes and along_axis else ()
        standing = self.standing if inward != self.takes and along_axis else ()
        return (*fingers, *standing)


@dataclass(frozen=True, eq=False)
class Way:
    """One way to a contact and on, not yet proven.

    Attributes:
        number: Of its grasp or placement, from 1.
        of: How many grasps or placements there are.
        solution: Of its inverse kinematics solutions, which.
        q: At the contact, (n,).
        inward: Each approach as a line outwards, the last approach first: waypoints (N, n).
        outward: Each retreat: waypoints (N, n).
    """

    number: int
    of: int
    solution: int
    contact: Contact
    q: FloatArray
    inward: tuple[FloatArray, ...]
    outward: tuple[FloatArray, ...]

    @property
    def begin(self) -> FloatArray:
        """Where the first approach begins, (n,)."""
        return self.inward[-1][-1] if self.inward else self.q

    @property
    def end(self) -> FloatArray:
        """Where the last retreat ends, (n,)."""
        return self.outward[-1][-1] if self.outward else self.q

    def length(self, robot: Robot) -> float:
        """Metres of the approach next to the contact."""
        return _travel(robot, self.inward[0])[-1]

    def turned(self, robot: Robot, q: FloatArray) -> Way:
        """The same with continuous joints moved by whole turns, its beginning as near to q as that goes; itself if it
        is."""
        turns = robot.nearest_turns(np.concatenate([*self.outward, self.q[None], *self.inward]), q)
        if not turns.any():
            return self
        moved = (tuple(line + turns for line in lines) for lines in (self.inward, self.outward))
        return Way(self.number, self.of, self.solution, self.contact, self.q + turns, *moved)


@dataclass(frozen=True, eq=False)
class Lines:
    """The proven motions of a way: the lines to its contact, what the gripper does there, and the lines on."""

    inward: tuple[PlanResult, ...]
    grip: GripperMotion | None
    outward: tuple[PlanResult, ...]


@dataclass(eq=False)
class Ways:
    """All ways of one contact in one world, and which of them are proven.

    Attributes:
        stage: The contact.
        service: What plans in the world before it.
    """

    motions: Motions
    stage: ContactStage
    service: PlannerService
    _fitting: dict[tuple[int, bytes], tuple[list[FloatArray], list[str]]] = field(default_factory=dict)
    _walked: dict[tuple[Contact, bytes, Vector | None, float], FloatArray | str] = field(default_factory=dict)
    _lines: dict[tuple[Contact, bytes], Lines | NoMotion] = field(default_factory=dict)

    @cached_property
    def contacts(self) -> list[Contact]:
        """The grasps or placements, best first.

        Raises:
            NoMotion: There are none.
        """
        step, service = self.stage.act.step, self.service
        if isinstance(step, Grasp):
            return _graspings(self.motions, service, step)
        return _placings(self.motions, service, step)

    def __call__(self, q: FloatArray, visit: Visit) -> Iterator[Way]:
        """The ways in the order of preference, for a robot that stands at q (n,); ``visit`` is told what is refused."""
        try:
            contacts = self.contacts
        except NoMotion as none:
            visit.refuse(self.stage.act, str(none))
            return
        visit.ways = len(contacts)
        still = self.service.robot.unwound(q)
        for short in (False, True):
            for number, contact in enumerate(contacts, start=1):
                for solution, at in enumerate(self._solutions(number, contact, still, visit, again=short)):
                    yield from self._lined(number, solution, contact, at, visit, short=short)

    def here(self, q: FloatArray, visit: Visit) -> Iterator[Way]:
        """The ways where the gripper closes or opens at q (n,), where the robot stands."""
        step, service = self.stage.act.step, self.service
        tool = Pose.from_matrix(service.robot.tool_pose(q))
        try:
            if isinstance(step, Grasp):
                contact = _grasping(self.motions, service, service.scene.obstacle(step.object), tool, step, here=True)
            else:
                held = _held(service, step.object)
                contact = _placing(self.motions, service, held, tool @ held.pose, step)
        except NoMotion as none:
            visit.refuse(self.stage.act, str(none))
            return
        visit.ways = 1
        if objection := self._objection(contact, q):
            visit.refuse(self.stage.act, objection)
            return
        for outward in self._outward(contact, q, (), visit, 1):
            yield Way(1, 1, 0, contact, q, (), outward)

    def _solutions(
        self, number: int, contact: Contact, still: FloatArray, visit: Visit, *, again: bool
    ) -> list[FloatArray]:
        """Configurations that would do at a contact; why there are none is told unless it was before."""
        key = (number, still.tobytes())
        known = key in self._fitting
        if not known:
            fitting, refused = [], []
            solutions = self.motions.solutions(self.service.robot, contact.tool, still)
            for q in solutions:
                objection = self._objection(contact, q)
                if objection:
                    refused.append(objection)
                else:
                    fitting.append(q)
            self._fitting[key] = fitting, refused if len(solutions) else [OUT_OF_REACH]
        fitting, refused = self._fitting[key]
        if not again:
            for reason in refused:
                visit.refuse(self.stage.act, reason, f"way {number}: {reason}", known=known)
            if refused == [OUT_OF_REACH]:
                visit.unreached[number] = contact.tool
        return fitting

    def _objection(self, contact: Contact, q: FloatArray) -> str:
        checker = contact.before.checker
        tally = checker.ledger.own
        before = tally.counts
        objection = contact.objection(checker, q)
        self.motions.spent += tally.counts - before
        return objection

    def _lined(
        self, number: int, solution: int, contact: Contact, q: FloatArray, visit: Visit, *, short: bool
    ) -> Iterator[Way]:
        """The ways through one configuration at a contact."""
        for inward in self._inward(contact, q, visit, number, short=short):
            for outward in self._outward(contact, q, inward, visit, number):
                yield Way(number, len(self.contacts), solution, contact, q, inward, outward)

    def _inward(
        self, contact: Contact, q: FloatArray, visit: Visit, number: int, *, short: bool
    ) -> Iterator[tuple[FloatArray, ...]]:
        """The lines of the approaches outwards, last approach first, with usual lengths or with short ones."""
        steps = [numbered.step for numbered in reversed(self.stage.approaches)]
        if short and not any(step.shorter for step in steps):
            return
        choices = [step.shorter if short and step.shorter else step.lengths for step in steps]

        def extended(lines: tuple[FloatArray, ...]) -> Iterator[tuple[FloatArray, ...]]:
            k = len(lines)
            if k == len(steps):
                yield lines
                return
            begin = lines[-1][-1] if lines else q
            for length in choices[k]:
                line, known = self._line(contact, begin, steps[k].direction, -length, first=k == 0)
                if isinstance(line, str):
                    told = f"way {number} with {length * 100:.0f} cm: {line}"
                    visit.refuse(self.stage.approaches[-1 - k], line, told, Rank.LINE, known=known)
                else:
                    yield from extended((*lines, line))

        yield from extended(())

    def _outward(
        self, contact: Contact, q: FloatArray, inward: tuple[FloatArray, ...], visit: Visit, number: int
    ) -> Iterator[tuple[FloatArray, ...]]:
        """The lines of the retreats, if the arm can go them."""
        lines: list[FloatArray] = []
        back = True
        for k, numbered in enumerate(self.stage.retreats):
            step: Retreat = numbered.step
            back = back and step.lengths is None and step.direction is None and k < len(inward)
            if back:
                lines.append(inward[k])
                continue
            begin, why, known = lines[-1][-1] if lines else q, "", False
            for length in step.lengths or USUAL_LENGTHS:
                outwards = length if step.direction else -length
                line, known = self._line(contact, begin, step.direction, outwards, first=k == 0)
                if not isinstance(line, str):
                    lines.append(line)
                    break
                why = why or line
            else:
                visit.refuse(numbered, why, f"way {number}: {why}", Rank.LINE, known=known)
                return
        yield tuple(lines)

    def _line(
        self, contact: Contact, q: FloatArray, direction: Vector | None, length: float, *, first: bool
    ) -> tuple[FloatArray | str, bool]:
        """The straight line (N, n) of the tool from q, thinned, or why the arm cannot go it; and if that was known.

        Args:
            direction: In the base frame; None for the gripper's axis of approach.
            length: Metres along it, negative for against it.
            first: Whether it begins at the contact: the last waypoint where object and support may touch is kept.
        """
        key = (contact, q.tobytes(), direction, length)
        if known := key in self._walked:
            return self._walked[key], known
        self._walked[key] = self._walk(contact, q, direction, length, first=first)
        return self._walked[key], known

    def _walk(
        self, contact: Contact, q: FloatArray, direction: Vector | None, length: float, *, first: bool
    ) -> FloatArray | str:
        """See ``_line``."""
        robot = self.service.robot
        begin = contact.tool if first else Pose.from_matrix(robot.tool_pose(q))
        if direction is None:
            x, y, z = gripper_of(robot).approach
            end = begin @ Pose((length * x, length * y, length * z))
        else:
            (x, y, z), (u, v, w) = begin.position, direction
            end = Pose((x + length * u, y + length * v, z + length * w), begin.quaternion)
        line = straight_tool_line(robot, q, end)
        if line.stopped is not None:
            return str(line.stopped)
        away = _travel(robot, line.waypoints) if first else []
        keep = [max(k for k, metres in enumerate(away) if metres <= contact.gap)] if first else []
        return thinned(robot, line.waypoints, keep=keep)

    def lines(self, way: Way, visit: Visit) -> Lines:
        """The proven lines of a way; proven once and remembered.

        Raises:
            NoMotion: One of them is not free; ``visit`` was told.
        """
        key = way.contact, b"".join(line.tobytes() for line in (*way.inward, way.q, *way.outward))
        if key not in self._lines:
            try:
                self._lines[key] = self._proven(way, visit)
            except NoMotion as none:
                self._lines[key] = none
        known = self._lines[key]
        if isinstance(known, NoMotion):
            raise known
        return known

    def _proven(self, way: Way, visit: Visit) -> Lines:
        contact = way.contact
        with visit.trying(self.stage.act, "", Rank.GRIPPER):
            grip = self.motions.gripper(contact.before, way.q, contact.then, contact.fingers)
        inward: list[PlanResult] = []
        for k, line in enumerate(way.inward):
            step = self.stage.approaches[-1 - k]
            inward.insert(0, self._followed(step, way, contact.before, line, visit, first=k == 0, inward=True))
        outward = [
            self._followed(step, way, contact.after, line, visit, first=k == 0, inward=False)
            for k, (step, line) in enumerate(zip(self.stage.retreats, way.outward, strict=True))
        ]
        return Lines(tuple(inward), grip, tuple(outward))

    def _followed(
        self,
        numbered: Numbered,
        way: Way,
        service: PlannerService,
        line: FloatArray,
        visit: Visit,
        *,
        first: bool,
        inward: bool,
    ) -> PlanResult:
        """The proven motion along a line that begins at a contact, or farther out."""
        step: Approach | Retreat = numbered.step
        touches = way.contact.touches(inward=inward, along_axis=step.direction is None) if first else ()
        away = _travel(service.robot, line) if touches else []
        waypoints = line[::-1] if inward else line
        with visit.trying(numbered, f"{step.name}: ", Rank.PROOF):
            return self.motions.followed(service, waypoints, _stretches(touches, away, inward=inward))

    def segments(self, way: Way, lines: Lines) -> tuple[tuple[Segment, ...], tuple[Segment, ...]]:
        """The motions to a contact, and those from it, the first of which has the gripper's."""
        contact, law = way.contact, self.motions.law
        inward = [
            Segment(numbered.step.name, line, contact.width, contact.before.scene, timing=law)
            for numbered, line in zip(self.stage.approaches, lines.inward, strict=True)
        ]
        outward = [
            Segment(numbered.step.name, line, contact.then, contact.after.scene, lines.grip if k == 0 else None, law)
            for k, (numbered, line) in enumerate(zip(self.stage.retreats, lines.outward, strict=True))
        ]
        return tuple(inward), tuple(outward)

    def tells_of_fingers(self, reasons: Sequence[str]) -> bool:
        """Whether open fingers, and not closed ones, were in the way of something."""
        service = self.service
        names = Names(service.robot, service.scene)
        fingers = [f"{names.link(finger)} x " for finger in _fingers(service)]
        step = self.stage.act.step
        lines = self.stage.retreats if isinstance(step, Grasp) else (self.stage.connect, *self.stage.approaches)
        closed = tuple(f"{each.step.name}:" for each in lines if each is not None)
        if isinstance(step, Release):
            closed = ("way ", *closed)
        opened = (reason for reason in reasons if not reason.startswith(closed))
        return any(finger in reason for reason in opened for finger in fingers)


OUT_OF_REACH = "out of reach"


# Grasps.


def _graspings(motions: Motions, service: PlannerService, step: Grasp) -> list[Contact]:
    obstacle = service.scene.obstacle(step.object)
    if step.grasps is None:
        poses: Sequence[Pose] = _found(partial(top_grasps, service.robot, obstacle))
    elif isinstance(step.grasps, tuple):
        frame = frame_of(service, step.frame)
        poses = step.grasps if frame is None else [frame @ pose for pose in step.grasps]
    else:
        poses = _found(partial(step.grasps.poses, service.robot, obstacle))
    made, refused = [], ""
    for pose in poses:
        try:
            made.append(_grasping(motions, service, obstacle, pose, step))
        except NoMotion as none:
            refused = refused or str(none)
    if not made:
        raise NoMotion(refused or f"no grasp of {step.object} was found")
    return made


def _found(find: Callable[[], Sequence[Pose]]) -> Sequence[Pose]:
    try:
        return find()
    except InvalidRequest as error:
        raise NoMotion(str(error)) from error


def _grasping(
    motions: Motions, service: PlannerService, target: Obstacle, grasp: Pose, step: Grasp, *, here: bool = False
) -> Contact:
    gripper = gripper_of(service.robot)
    width = width_across(target, grasp, gripper)
    try:
        opened = opening(gripper, width, step.open_width)
    except InvalidRequest as error:
        raise NoMotion(str(error)) from error

    opened = service.robot.gripper_width if here else opened

    def before() -> PlannerService:
        return service if here else motions.changed(service, gripper=opened)

    def after() -> PlannerService:
        kept = () if step.upright is None else (kept_upright(grasp, step.upright),)
        pose = grasp.inverse() @ target.pose
        held = Attached(target.name, target.shape, pose, touch_links=_fingers(service), constraints=kept)
        scene = service.scene.without(target.name).with_attached(held)
        return motions.changed(service, gripper=width, scene=scene)

    touch = Touch(_touching(service, target.name), None, gripper.touching(target.name, "take"))

    def objection(checker: CollisionChecker, q: FloatArray) -> str:
        return grasp_objection(target, grasp, gripper) or unwanted(checker, q, touch.pairs)

    standing = _standing(service, step)
    return Contact(grasp, opened, width, (before, after), objection, touch, standing, step.support_gap, takes=True)


def kept_upright(grasp: Pose, tolerance: float) -> Constraint:
    """What an object keeps that was taken at a grasp and may lean by so many radians from how it stood."""
    up = grasp.inverse().rotation[:, 2]  # in the tool frame
    return KeepUpright(up.tolist(), tolerance)


def opening(gripper: Gripper, width: float, wanted: float | None) -> float:
    """Metres between the fingers around something.

    Raises:
        InvalidRequest: It is too wide for the gripper, or for what is wanted.
    """
    widest = gripper.upper
    if gripper.kind == "vacuum":
        return widest
    if width > widest:
        raise InvalidRequest("target", f"{width:.4f} m wide", f"an object at most {widest:.4f} m wide")
    if wanted is None:
        return min(widest, width + 2 * FINGER_ROOM)
    if wanted < width:
        raise InvalidRequest("open_width", wanted, f"at least the object's width, {width:.4f} m")
    return wanted


# Placements.


def _placings(motions: Motions, service: PlannerService, step: Release) -> list[Contact]:
    held, frame = _held(service, step.object), frame_of(service, step.frame)
    assert step.poses is not None
    poses = step.poses if frame is None else [frame @ pose for pose in step.poses]
    return [_placing(motions, service, held, pose, step) for pose in poses]


def _placing(motions: Motions, service: PlannerService, held: Attached, pose: Pose, step: Release) -> Contact:
    gripper, names = gripper_of(service.robot), Names(service.robot, service.scene)
    try:
        opened = opening(gripper, service.robot.gripper_width, step.open_width)
    except InvalidRequest as error:
        raise NoMotion(str(error)) from error

    def after() -> PlannerService:
        scene = service.scene.without_attached(held.name).with_obstacle(Obstacle(held.name, held.shape, pose))
        return motions.changed(service, gripper=opened, scene=scene)

    def objection(checker: CollisionChecker, q: FloatArray) -> str:
        if step.support is None:
            return ""
        pair = (names.object(held.name), names.object(step.support))
        roomy = checker.variant(padding=step.support_gap)
        if pair not in roomy.touching(q):
            return f"{held.name} would not come within {step.support_gap * 1000:g} mm of {step.support}"
        return unwanted(checker, q, (pair,))

    touch = Touch(_touching(service, held.name), None, gripper.touching(held.name, "leave"))
    tool, width, standing = pose @ held.pose.inverse(), service.robot.gripper_width, _standing(service, step)
    services = (lambda: service), after
    return Contact(tool, width, opened, services, objection, touch, standing, step.support_gap, takes=False)


def _held(service: PlannerService, name: str) -> Attached:
    held = next((each for each in service.scene.attached if each.name == name), None)
    if held is None:
        raise NoMotion(f"{name} is not carried")
    return held


# What both have in common.


def gripper_of(robot: Robot) -> Gripper:
    """The gripper of a robot.

    Raises:
        InvalidRequest: It has none.
    """
    if robot.gripper is None:
        raise InvalidRequest("robot", robot.name, "a robot with a gripper")
    return robot.gripper


def frame_of(service: PlannerService, name: str) -> Pose | None:
    """Where an obstacle's frame is in the base frame; None for the base.

    Raises:
        NoMotion: It does not stand anywhere: it is carried.
    """
    if not name:
        return None
    found = next((obstacle for obstacle in service.scene.obstacles if obstacle.name == name), None)
    if found is None:
        raise NoMotion(f"{name} is carried, and has no frame")
    return found.pose


def _fingers(service: PlannerService) -> tuple[str, ...]:
    """The finger links that can touch anything."""
    shaped = {shape.link for shape in service.robot.shapes}
    return tuple(link for link in gripper_of(service.robot).links if link in shaped)


def _touching(service: PlannerService, name: str) -> tuple[tuple[str, str], ...]:
    """The labels of each finger and an object."""
    names = Names(service.robot, service.scene)
    return tuple((names.link(finger), names.object(name)) for finger in _fingers(service))


def _standing(service: PlannerService, step: Grasp | Release) -> tuple[Touch, ...]:
    if step.support is None:
        return ()
    names = Names(service.robot, service.scene)
    standing, support = names.object(step.object), names.object(service.scene.obstacle(step.support).name)
    return (Touch(((standing, support),), step.support_gap, f"{standing} stands on {support}"),)


def _travel(robot: Robot, waypoints: FloatArray) -> list[float]:
    """Metres between the tool's origin at the first waypoint and at each."""
    places = [[row[3] for row in robot.tool_rows(q)] for q in waypoints]
    return [math.dist(places[0], place) for place in places]


def _stretches(touches: tuple[Touch, ...], away: Sequence[float], *, inward: bool) -> tuple[AllowedStretch, ...]:
    """Where on the line pairs may touch, given how many metres ``away`` from the contact each waypoint is."""
    last = len(away) - 1
    stretches = []
    for touch in touches:
        reach = last if touch.within is None else max(k for k, metres in enumerate(away) if metres <= touch.within)
        first, end = (last - reach, last) if inward else (0, reach)
        stretches.append(AllowedStretch(first, end, touch.pairs, touch.reason))
    return tuple(stretches)
