"""Ways to a contact and on: straight lines to where the gripper closes or opens, and from there.

The cheapest to refuse comes first: whether the arm reaches the pose, what touches there, whether the arm can go the
lines, and only then whether these, and the gripper's own motion, are proven free.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import GripperMotion
from planner_service.collision import CancelToken, CollisionChecker
from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance
from planner_service.grasping.openings import FINGER_ROOMS, tells_of_fingers
from planner_service.kinematics.cartesian_waypoints import thinned
from planner_service.kinematics.tool_line import straight_tool_line
from planner_service.memory.memory import gripped_near, knows
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.request import PlanRequest, require_timing
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment
from planner_service.robot.model import Robot, joint_vector
from planner_service.scene.names import Names
from planner_service.service import PlannerService
from planner_service.tasks.contacts import Choices, Contact, choices_of, contact_here, fingers_of, gripper_of
from planner_service.tasks.inspector import Inspector, Rank, Visit
from planner_service.tasks.motions import Ended, Motions, NoMotion, Touch
from planner_service.tasks.names import require_names
from planner_service.tasks.steps import USUAL_LENGTHS, Approach, Retreat, Step
from planner_service.tasks.task import ContactStage, Numbered, Task
from planner_service.timing.laws import Timing

__all__ = ["OUT_OF_REACH", "Lines", "ProvenWay", "Way", "Ways", "proven_ways"]

Vector = tuple[float, float, float]

OUT_OF_REACH = "out of reach"


@dataclass(frozen=True, eq=False)
class Way:
    """One way to a contact and on, not yet proven.

    Attributes:
        number: Of its grasp or placement, from 1.
        of: How many grasps or placements there are, of the kinds that were looked for.
        solution: Of its inverse kinematics solutions, which.
        q: At the contact, (n,).
        inward: Each approach as a line outwards, the last approach first: waypoints (N, n).
        outward: Each retreat: waypoints (N, n).
        kind: Of its grasp, if that is not the usual one.
    """

    number: int
    of: int
    solution: int
    contact: Contact
    q: FloatArray
    inward: tuple[FloatArray, ...]
    outward: tuple[FloatArray, ...]
    kind: str = ""

    @property
    def begin(self) -> FloatArray:
        """Where the first approach begins, (n,)."""
        return self.inward[-1][-1] if self.inward else self.q

    @property
    def end(self) -> FloatArray:
        """Where the last retreat ends, (n,)."""
        return self.outward[-1][-1] if self.outward else self.q

    @property
    def key(self) -> tuple[Any, ...]:
        """What is equal for the same way, however it came about."""
        return self.number, self.contact.width, self.contact.then, self.q.tobytes(), self.begin.tobytes()

    def length(self, robot: Robot) -> float:
        """Metres of the approach next to the contact."""
        return _travel(robot, self.inward[0])[-1]

    def turned(self, robot: Robot, q: FloatArray) -> Way:
        """The same with continuous joints moved by whole turns, its beginning as near to q as that goes; itself if it
        is."""
        turns = robot.nearest_turns(np.concatenate([*self.outward, self.q[None], *self.inward]), q)
        if not turns.any():
            return self
        inward, outward = (tuple(line + turns for line in lines) for lines in (self.inward, self.outward))
        return replace(self, q=self.q + turns, inward=inward, outward=outward)


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
    _cramped: bool = False
    _choices: list[Choices] = field(default_factory=list)
    _more: Iterator[Choices] | None = None
    _refused: set[tuple[Choices, int]] = field(default_factory=set)
    _told: dict[Contact, list[str]] = field(default_factory=dict)
    _narrower: dict[tuple[Contact, int], Contact | None] = field(default_factory=dict)
    _fitting: dict[tuple[Contact, bytes], tuple[list[tuple[int, FloatArray]], list[str]]] = field(default_factory=dict)
    _walked: dict[tuple[Contact, bytes, Vector | None, float], FloatArray | str] = field(default_factory=dict)
    _lines: dict[tuple[Contact, bytes], Lines | NoMotion] = field(default_factory=dict)
    _opened: dict[Contact, list[Contact]] = field(default_factory=dict)
    _objections: dict[tuple[Contact, bytes], str] = field(default_factory=dict)

    def __call__(self, q: FloatArray, visit: Visit, enough: Callable[[], bool] = lambda: False) -> Iterator[Way]:
        """The ways in the order of preference, for a robot that stands at q (n,); ``visit`` is told what is refused.

        Grasps of another kind follow when all of the kind before were tried. Where open fingers meet something, the
        gripper is opened less, once all of a kind has been tried with the usual opening. Before all of them, those are
        tried that are like one that is remembered.

        Args:
            enough: Asked before another kind is looked for: whether the ones before will do.
        """
        still = self.service.robot.unwound(q)
        begin = 1
        try:
            for choices in self._kinds():
                visit.begins(choices.kind, choices.count)
                if choices.count:
                    yield from self._of_kind(choices, begin, still, visit)
                else:
                    visit.refuse(self.stage.act, choices.why)
                begin += choices.count
                if enough():
                    return
        except NoMotion as none:
            visit.refuse(self.stage.act, str(none))

    def _kinds(self) -> Iterator[Choices]:
        """The kinds of grasps, or the placements; found once.

        Raises:
            NoMotion: There can be none.
        """
        if self._more is None:
            self._more = choices_of(self.motions, self.service, self.stage.act.step)
        for k in count():
            if k == len(self._choices):
                following = next(self._more, None)
                if following is None:
                    return
                self._choices.append(following)
            yield self._choices[k]

    def _of_kind(self, choices: Choices, begin: int, still: FloatArray, visit: Visit) -> Iterator[Way]:
        """The ways of one kind, numbered from ``begin``."""
        before: set[tuple[Any, ...]] = set()
        for way in self._remembered(choices, begin, still, visit):
            before.add(way.key)
            yield way
        numbered: list[tuple[int, Contact]] = []
        for rank in range(1, len(FINGER_ROOMS) + 1):
            for short in (False, True):
                first = rank == 1 and not short
                for number, contact in self._usual(choices, begin, visit, numbered) if first else numbered:
                    for solution, at in self._solutions(number, contact, still, visit, again=short):
                        ways = self._lined(number, solution, contact, at, visit, short=short)
                        yield from (way for way in ways if way.key not in before)
            numbered = [(number, less) for number, each in numbered for less in self._less(each, rank)]

    def _usual(
        self, choices: Choices, begin: int, visit: Visit, numbered: list[tuple[int, Contact]]
    ) -> Iterator[tuple[int, Contact]]:
        """The contacts of one kind with the usual opening, each made when its turn comes and added to ``numbered``."""
        for k in range(choices.count):
            try:
                contact = choices.contact(k)
            except NoMotion as none:
                key = choices, k
                visit.refuse(self.stage.act, str(none), f"way {begin + k}: {none}", known=key in self._refused)
                self._refused.add(key)
                continue
            numbered.append((begin + k, contact))
            yield begin + k, contact

    def _remembered(self, choices: Choices, begin: int, still: FloatArray, visit: Visit) -> Iterator[Way]:
        """The ways at whose contact the gripper closed or opened like this before, along a line that was gone."""
        memory, robot = self.motions.memory, self.service.robot
        if memory is None or not memory.grips:
            return
        for k in range(choices.count):
            try:
                usual = choices.contact(k)
            except NoMotion:
                continue
            for solution, q in enumerate(self.motions.solutions(robot, usual.tool, still)):
                for contact in self._openings(usual):
                    if not gripped_near(memory, q, contact.width, contact.then) or self._objection(contact, q):
                        continue
                    for short in (False, True):
                        for way in self._lined(begin + k, solution, contact, q, visit, short=short):
                            if not way.inward or knows(memory, way.inward[0][-1], q):
                                yield way

    def _openings(self, usual: Contact) -> list[Contact]:
        """A contact with the gripper opened as usual, and less."""
        if usual not in self._opened:
            less = (usual.less(rank) for rank in range(1, len(FINGER_ROOMS)))
            self._opened[usual] = [usual, *(contact for contact in less if contact is not None)]
        return self._opened[usual]

    def _less(self, contact: Contact, rank: int) -> Iterator[Contact]:
        """A contact at which fingers met something, with a smaller opening, if there is one."""
        key = contact, rank
        if key not in self._narrower:
            made = None
            if any(map(self._of_fingers, self._told.get(contact, ()))):
                made = contact.less(rank)
            self._narrower[key] = made
        made = self._narrower[key]
        if made is not None:
            yield made

    def _of_fingers(self, reason: str) -> bool:
        """Whether a reason says that fingers meet something."""
        return tells_of_fingers(reason, *self._fingers)

    @cached_property
    def _fingers(self) -> tuple[tuple[str, ...], Names]:
        return fingers_of(self.service), Names(self.service.robot, self.service.scene)

    def told(self, contact: Contact, why: str) -> None:
        """Something is in the way of the open gripper at a contact, or of its motion."""
        self._told.setdefault(contact, []).append(why)

    def here(self, q: FloatArray, visit: Visit) -> Iterator[Way]:
        """The ways where the gripper closes or opens at q (n,), where the robot stands."""
        try:
            contact = contact_here(self.motions, self.service, self.stage.act.step, q)
        except NoMotion as none:
            visit.refuse(self.stage.act, str(none))
            return
        visit.begins("", 1)
        if objection := self._objection(contact, q):
            visit.refuse(self.stage.act, objection)
            return
        for outward in self._outward(contact, q, (), visit, 1):
            yield Way(1, 1, 0, contact, q, (), outward)

    def _solutions(
        self, number: int, contact: Contact, still: FloatArray, visit: Visit, *, again: bool
    ) -> list[tuple[int, FloatArray]]:
        """Configurations that would do at a contact, numbered; why there are none is told unless it was before."""
        key = (contact, still.tobytes())
        known = key in self._fitting
        if not known:
            fitting, refused = list[tuple[int, FloatArray]](), list[str]()
            solutions = self.motions.solutions(self.service.robot, contact.tool, still)
            for solution, q in enumerate(solutions):
                objection = self._objection(contact, q)
                if objection:
                    refused.append(contact.says(objection, fingers=self._of_fingers(objection)))
                    if contact.takes:
                        self.told(contact, objection)
                else:
                    fitting.append((solution, q))
            self._fitting[key] = fitting, refused if len(solutions) else [OUT_OF_REACH]
        fitting, refused = self._fitting[key]
        if not again:
            for reason in refused:
                visit.refuse(self.stage.act, reason, f"way {number}: {reason}", known=known)
            if refused == [OUT_OF_REACH]:
                visit.unreached[number] = contact.tool
        return fitting

    def _objection(self, contact: Contact, q: FloatArray) -> str:
        key = contact, q.tobytes()
        if key not in self._objections:
            self._objections[key] = self.motions.counted(
                contact.before.checker, lambda checker: contact.objection(checker, q)
            )
        return self._objections[key]

    def _lined(
        self, number: int, solution: int, contact: Contact, q: FloatArray, visit: Visit, *, short: bool
    ) -> Iterator[Way]:
        """The ways through one configuration at a contact."""
        for inward in self._inward(contact, q, visit, number, short=short):
            for outward in self._outward(contact, q, inward, visit, number):
                yield Way(number, visit.ways, solution, contact, q, inward, outward, visit.kind)

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
            axis = k < len(inward) and self.stage.approaches[-1 - k].step.direction is None
            back = back and axis and step.lengths is None and step.direction is None
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
            self.motions.look()
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
        with visit.trying(self.stage.act, contact.note, Rank.GRIPPER), self._telling(contact, wanted=True):
            if self._cramped:
                self._require_room(contact, way.q)
            try:
                grip = self.motions.gripper(contact.before, way.q, contact.then, contact.fingers)
            except NoMotion:
                self._cramped = True
                raise
        inward: list[PlanResult] = []
        for k, line in enumerate(way.inward):
            step = self.stage.approaches[-1 - k]
            inward.insert(0, self._followed(step, way, contact.before, line, visit, first=k == 0, inward=True))
        outward = [
            self._followed(step, way, contact.after, line, visit, first=k == 0, inward=False)
            for k, (step, line) in enumerate(zip(self.stage.retreats, way.outward, strict=True))
        ]
        return Lines(tuple(inward), grip, tuple(outward))

    def _require_room(self, contact: Contact, q: FloatArray) -> None:
        """Refuse a contact where something is in the way once the gripper has moved: a state costs less than a proof.

        Raises:
            NoMotion: Something is.
        """
        checker = contact.after.checker
        meant = [pair for touch in (contact.fingers, *contact.standing) for pair in touch.pairs]
        lenient = checker.variant(allowed=(*checker.allowed, *meant))
        if not self.motions.counted(lenient, lambda asked: asked.state_is_free(q)):
            a, b = self._touching(lenient, q)
            raise NoMotion(f"{a} x {b} touch where the gripper is {'closed' if contact.takes else 'open'}")

    def _require_apart(self, checker: CollisionChecker, q: FloatArray) -> None:
        """Refuse a retreat at whose end the fingers still touch what they have left.

        Raises:
            NoMotion: They do.
        """
        if not self.motions.counted(checker, lambda asked: asked.state_is_free(q)):
            a, b = self._touching(checker, q)
            raise NoMotion(f"it ends where {a} x {b} still touch")

    def _touching(self, checker: CollisionChecker, q: FloatArray) -> tuple[str, str]:
        """What touches deepest where something touches."""
        names = self.motions.counted(checker, lambda asked: asked.deepest_touching(q))
        assert names is not None
        return names

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
        opened = inward == way.contact.takes
        prefix = f"{step.name}: {way.contact.note if opened else ''}"
        with visit.trying(numbered, prefix, Rank.PROOF), self._telling(way.contact, wanted=opened):
            result = self.motions.followed(service, waypoints, _stretches(touches, away, inward=inward))
            if result.exempt and not inward and not way.contact.takes and len(way.outward) == 1:
                self._require_apart(service.checker, way.end)
        return result

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

    @contextmanager
    def _telling(self, contact: Contact, *, wanted: bool) -> Iterator[None]:
        """Keep in mind, if ``wanted``, what is in the way of the open gripper in the block."""
        try:
            yield
        except NoMotion as none:
            if wanted:
                self.told(contact, str(none))
            raise


def _travel(robot: Robot, waypoints: FloatArray) -> list[float]:
    """Metres between the tool's origin at the first waypoint and at each."""
    places = robot.tool_origins(waypoints).tolist()
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


@dataclass(frozen=True, eq=False)
class ProvenWay:
    """One way to a contact and on, proven, without the motion that leads there.

    Attributes:
        number: Of its grasp or placement, from 1.
        before: What plans the motion there, with the gripper open for it.
        after: What plans on.
        q_in: Where the first approach begins, (n,).
        q_out: Where the last retreat ends, (n,).
        segments: The approaches and the retreats; the first retreat has the gripper's motion.
    """

    number: int
    before: PlannerService
    after: PlannerService
    q_in: FloatArray
    q_out: FloatArray
    segments: tuple[Segment, ...]


def proven_ways(
    service: PlannerService,
    steps: Sequence[Step],
    q: ArrayLike,
    *,
    request: PlanRequest | None = None,
    line_timing: Timing | None = None,
    cancel: CancelToken | None = None,
) -> Iterator[ProvenWay]:
    """The proven ways of ``Connect``, approaches, ``Grasp`` or ``Release``, and retreats, the preferred first.

    There is one for each grasp or placement and each inverse kinematics solution at most; nothing is searched. Grasps
    of another kind follow only where none of the kind before has a way.

    Args:
        q: Near where the robot will come from, shape (n,): continuous joints are turned towards it.
        request: As for ``PlannerService.solve``; so are the others.

    Raises:
        InvalidRequest: The steps are others than these, or a value is of the wrong kind or out of its range.
        Cancelled: by ``cancel``.
    """
    instance("service", service, PlannerService, "a PlannerService")
    instance("request", request, (PlanRequest, NoneType), "a PlanRequest, or None")
    instance("cancel", cancel, (CancelToken, NoneType), "a CancelToken, or None")
    if line_timing is not None:
        require_timing(line_timing)
    task = Task(steps)
    (stage, *more) = task.stages
    if more or not isinstance(stage, ContactStage) or stage.connect is None:
        raise InvalidRequest(
            "steps", [str(step) for step in task.steps], "Connect, Approach, Grasp or Release, Retreat"
        )
    require_names(service, task.stages)
    start = joint_vector("q", q, service.robot)
    template = replace(request or PlanRequest(start, start), start=start, goal=start, time_limit=None)
    motions = Motions(template, line_timing, cancel, turns=1, searches=1_000)
    ways, visit = Ways(motions, stage, motions.begin(service)), Visit(Inspector([stage]), stage, service, start)
    done = set[tuple[int, int]]()
    every = ways(start, visit, enough=lambda: bool(done))
    while True:
        try:
            found = next(every, None)
            if found is None:
                return
            if (found.number, found.solution) in done:
                continue
            way = found.turned(service.robot, start)
            lines = ways.lines(way, visit)
        except NoMotion:
            continue
        except Ended as ended:
            raise Cancelled(ended.failure.detail) from ended
        done.add((way.number, way.solution))
        inward, outward = ways.segments(way, lines)
        contact = way.contact
        yield ProvenWay(way.number, contact.before, contact.after, way.begin, way.end, (*inward, *outward))
