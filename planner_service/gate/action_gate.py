"""Targets for an arm, proven before they are sent, each with a proven stop behind it.

What is proven of every target that passes: wherever the arm can be on its way to it, by ``Tracking``, nothing touches,
and the same of the targets that brake it afterwards within its limits. So if a target is refused, if no more come, or
if the policy ends, the arm comes to rest in free space; if even the targets that brake it are not sent, it stops at the
last one that was, as abruptly as its driver does. ``docs/design/the-gate.md`` has the argument.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify.certifier import Certifier, TubeProof
from planner_service.errors import InvalidRequest
from planner_service.gate.decision import Decision
from planner_service.gate.limits import CommandLimits
from planner_service.gate.log import GateLog
from planner_service.gate.neighbour import Occupied
from planner_service.gate.pace import Pace
from planner_service.gate.tracking import Course, Setpoint, Tracking, Whereabouts
from planner_service.gate.verdict import Counts, Kind, Refused, Verdict
from planner_service.gate.way_round import ways_round
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.composite import Compound
from planner_service.geometry.shapes import Box, Pose
from planner_service.geometry.validation import finite_numbers, flag, instance, items, number, numbers, whole
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService

__all__ = ["ActionGate"]

MAX_CHUNK = 1000
"""Targets; at 30 Hz half a minute."""

MAX_RATE = 2000.0

UNKNOWN = "where the arm is is not known before its first check"

TRIES = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675)
"""How many targets are taken back, one after the other, until what brakes the arm after the rest is free."""

PARTS, PARTS_EACH = 192, 8
"""Of rooms that are too much as a whole: so many are looked at of a chunk, and of what brakes the arm after it; and so
many for one pair on the way to one target."""

SAME_WAY = 0.5
"""Of the room that the arm may need: a stop that comes so near to where another one could touch is not looked at."""

SPEED = 0.8
"""Part of the limits of velocity that plans use: the room that a late target costs needs some."""


class ActionGate:
    """Decides which targets may be sent to an arm.

    The arm stands still at the first check. Call ``check`` before each target or chunk of targets is sent, and send the
    rows of its verdict, one each period, until there is another; from one thread.

    Args:
        service: Of the robot and the scene. Continuous joints stay in the window that the robot was given, and a
            gripper as far open; ``robot.with_finger_room()`` is one whose fingers may move meanwhile.
        rate: Targets a second.
        tracking: What is assumed of the driver.
        padding: Metres that everything keeps beyond the room that the arm may need.
        acceleration_scale: Part of the robot's acceleration limits that setpoints and the stop may use, in (0, 10].
        jerk_scale: The same of its limits of jerk; None if targets may change the acceleration at once.
        torque_scale: Share in (0, 1] of the efforts of its URDF that targets may take; None if torques are not judged.
        slow: Whether a chunk that is too fast is followed along the same line at less than its own speed.
        repair: Whether a chunk of which something could touch is replaced by what passes of it, a plan round what is in
            the way and the rest of it, or a plan to its end. That takes as long as the plan, some milliseconds.
        log: A file to which what is refused or changed is appended, a line of JSON each, up to 64 MiB.

    Attributes:
        counts: What was decided.
        limits: Those of the robot that are kept.
        certifier: What proves it.
        decision: The last one, with what was known of the arm; None before the first after a reset. Other threads may
            read it.

    Raises:
        InvalidRequest: a value out of range, or a scene in which something is carried that has constraints.
    """

    def __init__(
        self,
        service: PlannerService,
        *,
        rate: float,
        tracking: Tracking,
        padding: float = 0.0,
        acceleration_scale: float = 1.0,
        jerk_scale: float | None = None,
        torque_scale: float | None = None,
        slow: bool = False,
        repair: bool = False,
        log: str | Path | None = None,
    ) -> None:
        self._service = instance("service", service, PlannerService, "a PlannerService")
        self.robot: Robot = service.robot
        self.rate = number("rate", rate, f"targets a second, in [1, {MAX_RATE:g}]", 1.0, MAX_RATE)
        self.tracking = instance("tracking", tracking, Tracking, "a Tracking")
        self.padding = number("padding", padding, "metres in [0, 0.1]", 0.0, 0.1)
        self.limits = CommandLimits(
            *(self.robot, service.scene, self.rate, self.tracking),
            acceleration_scale=acceleration_scale, jerk_scale=jerk_scale, torque_scale=torque_scale,
        )  # fmt: skip
        self._pace = Pace(self.limits, self.rate, self.tracking)
        self.slow, self.repair = flag("slow", slow), flag("repair", repair)
        self.counts = Counts()
        self._log = None if log is None else GateLog(log)
        self._error = tracking.of(self.robot.n)
        self._shares = tracking.shares(1.0 / self.rate)
        self._scene = service.scene
        self._acceleration_scale = min(1.0, acceleration_scale)
        self.certifier = self._new_certifier(service.scene)
        self._nothing: FloatArray = read_only(np.empty((0, self.robot.n)))
        self._decisions = 0  # verdicts, and what takes them back
        self._former: (
            tuple[FloatArray, int, bool] | None
        )  # what was left before the last verdict: rows, targets, proven
        self.reset()

    # -- what a user calls ------------------------------------------------------------------------

    def check(
        self,
        q: ArrayLike,
        chunk: ArrayLike,
        *,
        sent: int | None = None,
        elapsed: float | None = None,
        around: Sequence[Obstacle | Occupied] = (),
    ) -> Verdict:
        """What may be sent of targets that a policy wants.

        A target that is no number is refused, and a measurement that is none counts as a lost arm.

        Args:
            q: Measured, (n,), when the next target is about to be sent.
            chunk: Targets, (k, n) or (n,), one each period.
            sent: How many of the last verdict's ``rows`` were sent since; if None, all of its targets, or one row of
                its stop if it had none.
            elapsed: Seconds from when the last of them was sent until the next will be, give or take the jitter; a
                period if None.
            around: What moves beside this arm, and keeps clear of where this arm can be by what has passed so far: what
                ``occupied`` says of other gates that were given what it says of this one. It is no part of the scene.
                Gates decide one after the other, each beside what the last verdict of every other leaves.

        Raises:
            InvalidRequest: other shapes, no numbers, more rows sent than there were, or an arm around of which the gate
                has decided since; at the first check also an error so large that the arm may be too fast on its way to
                where it is measured. Nothing is decided then, and what the last verdict said still holds.
        """
        with _no_collection():
            return self._checked(q, chunk, sent, elapsed, around)

    def _checked(
        self,
        q: ArrayLike,
        chunk: ArrayLike,
        sent: int | None,
        elapsed: float | None,
        around: Sequence[Obstacle | Occupied],
    ) -> Verdict:
        measured = numbers("q", q, f"{self.robot.n} joint values")
        if measured.shape != (self.robot.n,):
            raise InvalidRequest("q", measured.shape, f"{self.robot.n} joint values")
        wanted = self._chunk(chunk)
        beside = self._beside(around)
        now = self._advanced(measured, sent, elapsed)
        self.counts.chunks += 1
        if self._lost:
            return self._passed(self._held(now, Refused(Kind.TRACKING, 0, self._lost)))
        verdict = self._decided(now, wanted, beside)
        if self.repair and verdict.refused is not None and verdict.refused.kind in (Kind.CONTACT, Kind.STOP):
            verdict = self._repaired(now, wanted, verdict, beside)
        return self._passed(verdict)

    def update(self, scene: Scene, *, sent: int | None = None, elapsed: float | None = None) -> Verdict:
        """Take a changed scene: what is left to send of the last verdict is proven anew, or as much of it as is free.

        What it has in the gripper counts for torques, too. Where not even a stop is free any more, the arm holds
        where it is.

        Args:
            sent: As in ``check``.
            elapsed: Likewise.

        Raises:
            InvalidRequest: no Scene, one in which something is carried that has constraints, or a wrong ``sent`` or
                ``elapsed``; the scene is as it was then.
        """
        certifier = self._new_certifier(instance("scene", scene, Scene, "a Scene"))
        torques = self.limits.torques_in(scene)
        if self._came is None:
            self.certifier, self._scene, self.limits.torques = certifier, scene, torques
            return Verdict(self._nothing, self._nothing, None)
        now = self._advanced(None, sent, elapsed)
        self.certifier, self._scene, self.limits.torques = certifier, scene, torques
        self._proven = self._pending_proven = False
        if self._lost:
            return self._passed(self._held(now, Refused(Kind.TRACKING, 0, self._lost)))
        here = certifier.certify_tubes(*self._whereabouts, padding=self.padding)  # where the arm may still be
        if here.pair is not None:
            refused = replace(self._contact(here), kind=Kind.SCENE, index=0, time=0.0)
            return self._passed(self._held(now, refused, here.distances))
        return self._passed(self._decided(now, self._pending[: self._left], certifier))

    def late(self) -> Verdict:
        """Take the last verdict back, which came too late: its first row was not sent within ``verdict.due`` seconds.

        The verdict before it still holds. Rows of that one that were sent meanwhile are what ``sent`` of the next
        ``check`` counts; 0 if none were, in which case the arm comes to rest at the last target that was sent.

        Returns:
            What is left of that verdict, refused as ``Kind.LATE``.

        Raises:
            InvalidRequest: nothing was decided since ``reset``, or the last verdict has been taken back already.
        """
        if self._former is None:
            raise InvalidRequest("late", "no verdict", "one that was not taken back before")
        withdrawn = 0 if self.decision is None else self.decision.verdict.accepted
        rows, left, proven = self._former
        refused = Refused(Kind.LATE, 0, "the verdict came too late to be sent; the one before still holds")
        verdict = self._passed(Verdict(rows[:left], rows[left:], refused, proven=proven or not len(rows)))
        self._former = None
        self.counts.accepted -= withdrawn + left
        return verdict

    def occupied(self, name: str, base: Pose | None = None) -> Occupied:
        """Where the arm can be, from now until it comes to rest, by what has passed: for gates of arms beside it.

        Boxes around each of its pieces, which hold until the next ``check``, ``update`` or ``late``, whatever is sent
        till then of the rows of the last verdict, or, in case it is late, of the one before. A ``check`` beside it is
        refused after that. For two arms, each with a service of its own::

            left_verdict = left.check(q_left, chunk_left, around=[right.occupied("right arm", right_base)])
            right_verdict = right.check(q_right, chunk_right, around=[left.occupied("left arm", left_base)])

        Args:
            name: Of the obstacle.
            base: The pose of this arm's base in the base frame of the arm for which that is an obstacle; the same if
                None.

        Raises:
            InvalidRequest: no pose, an unusable name, or nothing is known yet of where the arm is: before the first
                check after a reset without a target.
        """
        pose = instance("base", Pose() if base is None else base, Pose, "a Pose, or None")
        if self._came is None:
            raise InvalidRequest("name", name, "a gate that has checked, or was reset with a target", message=UNKNOWN)
        ways = [self._pending] if self._former is None else [self._pending, self._former[0]]
        ahead = (self._now.ahead(self._target, rows, self.tracking, 1.0 / self.rate) for rows in ways)
        tube = (np.concatenate(each) for each in zip(self._whereabouts, *ahead, strict=True))
        boxes = self.certifier.tube_boxes(*tube)
        sizes, centres = boxes[:, 1] - boxes[:, 0], boxes.mean(axis=1)
        parts = [(Box(tuple(size)), Pose(tuple(at))) for size, at in zip(sizes.tolist(), centres.tolist(), strict=True)]
        return Occupied(Obstacle(name, Compound(tuple(parts)), pose), self._decisions, lambda: self._decisions)

    def reset(self, target: ArrayLike | None = None) -> None:
        """Begin anew with an arm that stands still, after tracking was lost, or when others have moved it.

        Args:
            target: Where its driver holds it, (n,), if that is known; else it is wherever it is measured at the next
                check, give or take the error of its tracking.

        Raises:
            InvalidRequest: ``target`` is no n finite numbers.
        """
        self._came: Setpoint | None = None  # where the setpoint was when the last target came
        self._target: FloatArray | None = None  # that target
        self._trail: list[
            tuple[float, FloatArray, FloatArray, FloatArray]
        ] = []  # edges before that, and when they ended
        self._clock = 0.0  # seconds for which targets have been sent, at least
        self._waited = 0.0  # seconds from the last target to the last check
        if target is not None:
            self._target = finite_numbers("target", target, self.robot.n)
            self._came = Setpoint.at_rest(self._target, np.zeros(self.robot.n))
        if self._came is not None:
            self._now, self._whereabouts = self._came, self._around(self._came, 0.0)
        self._proven = self._pending_proven = False  # whether the way to that target is, in this scene, and to the rows
        self._pending, self._left = self._nothing, 0  # rows that may be sent, and how many of them are no brakes
        self._former = None
        self._decisions += 1
        self._lost = ""
        self._measured: FloatArray | None = None
        self.decision: Decision | None = None

    @property
    def service(self) -> PlannerService:
        """Plans in the scene as it is known by now."""
        if self._service.scene is not self._scene:
            self._service = self._service.with_scene(self._scene)
        return self._service

    # -- where the setpoint is --------------------------------------------------------------------

    def _advanced(self, measured: FloatArray | None, sent: int | None, elapsed: float | None) -> Setpoint:
        """Follow what was sent, and see whether the arm is where it can be by now."""
        rows = self._left or min(1, len(self._pending))
        rows = rows if sent is None else whole("sent", sent, 0, len(self._pending))
        self._measured = measured
        waited = 1.0 / self.rate
        if elapsed is not None:
            waited = number("elapsed", elapsed, "seconds >= 0", 0.0, math.inf)
        if self._came is None:
            if measured is None or not np.isfinite(measured).all():
                raise InvalidRequest("q", measured, f"{self.robot.n} finite numbers at the first check")
            place = np.clip(measured, self.limits.lower, self.limits.upper)
            beyond = np.minimum(np.abs(measured - place), self._error)  # more is noticed below
            self._came = self._at_rest(place, self._error + beyond)
        if rows > 0:
            self._send(self._came, self._pending[:rows])
            self._pending, self._left = self._pending[rows:], max(0, self._left - rows)
        self._waited = waited
        self._whereabouts = self._around(self._came, waited)
        if measured is not None and not self._lost and not self._whereabouts.holds(measured):
            self._lost = self._astray(measured)
        self._now = self._came
        if self._target is not None:
            self._now = self._came.after(self._target, self.tracking.shares(waited), self.tracking.goal_time)
        return self._now

    def _at_rest(self, place: FloatArray, room: FloatArray) -> Setpoint:
        """Of an arm that stands at ``place``, its setpoint within ``room`` of that, which it may go at once."""
        speeds = room / self.tracking.goal_time
        if np.any(over := speeds > self.limits.velocity):
            joint = int(over.argmax())
            raise InvalidRequest(
                "error",
                float(room[joint]),
                f"less than {self.limits.velocity[joint] * self.tracking.goal_time:.4g} for"
                f" {self.robot.joint_names[joint]}, which else may go from where its driver holds it to where it is"
                " measured faster than it may; or reset(target) with where its driver holds it",
            )
        return Setpoint.at_rest(place, room)

    def _send(self, came: Setpoint, targets: FloatArray) -> None:
        """Follow targets (k, n): the first was sent at the last check, the others in time after it.

        Of the ways before that what matters for an arm that lags is kept.
        """
        if self._target is not None:
            self._pass(self._target, came, self._waited)
        course = self._course(self._now, targets[:-1])
        for k, target in enumerate(targets[:-1]):
            self._pass(target, course.at(k), 1.0 / self.rate)
        self._trail = [edge for edge in self._trail if edge[0] > self._clock - self.tracking.lag]
        self._came, self._target = course.at(len(targets) - 1), targets[-1]
        self._proven = self._pending_proven

    def _pass(self, target: FloatArray, came: Setpoint, waited: float) -> None:
        """Remember the way towards a target as far as it went until the next one came."""
        if self.tracking.lag > 0.0:
            self._clock += max(waited - self.tracking.jitter, 0.0)
            end = came.place + self.tracking.shares(waited)[2] * (target - came.place)
            self._trail.append((self._clock, came.place, end, came.radius))

    def _around(self, came: Setpoint, waited: float) -> Whereabouts:
        """Where the arm can be so long after the last target came."""
        tracking = self.tracking
        target = came.place if self._target is None else self._target
        first, last = tracking.shares(waited - tracking.lag)[0], tracking.shares(waited)[2]
        since = self._clock + max(waited - tracking.jitter, 0.0) - tracking.lag
        before = [edge[1:] for edge in self._trail if edge[0] > since]
        radius = came.radius if self._target is None else (1.0 - first) * came.radius
        edges = [*before, (*(came.place + share * (target - came.place) for share in (first, last)), radius)]
        starts, ends, radii = (np.array(rows) for rows in zip(*edges, strict=True))
        return Whereabouts(starts, ends, radii + self._error)

    def _astray(self, measured: FloatArray) -> str:
        """In which joint the arm is farthest from where it can be."""
        starts, ends, rooms = self._whereabouts
        off = np.maximum(np.minimum(starts, ends) - measured, measured - np.maximum(starts, ends))
        beyond = np.where(np.isfinite(off), off - rooms, np.inf)
        edge = int(beyond.max(axis=1).argmin())
        joint = int(beyond[edge].argmax())
        return (
            f"{self.robot.joint_names[joint]} is {off[edge, joint]:.4g} from where its driver should have it, and at"
            f" most {rooms[edge, joint]:.4g} is assumed: the arm does not follow as Tracking says"
        )

    def _held(self, now: Setpoint, refused: Refused, bounds: int = 0) -> Verdict:
        """Nothing passes, and the arm is to stay where its setpoint is by now: no proof stands for that."""
        return Verdict(self._nothing, read_only(now.place[None]), refused, proven=False, bounds=bounds)

    def _passed(self, verdict: Verdict) -> Verdict:
        """Remember and count what is decided."""
        verdict = replace(verdict, due=self.tracking.jitter)
        self._former = self._pending, self._left, self._pending_proven
        self._decisions += 1
        self.decision = Decision(
            self.counts.chunks, self._measured, verdict, self._whereabouts, self._now, self._target, self.tracking,
            self.rate, self.padding, self.certifier,
        )  # fmt: skip
        self._pending, self._left, self._pending_proven = verdict.rows, len(verdict.targets), verdict.proven
        counts = self.counts
        counts.accepted += verdict.accepted
        counts.bounds += verdict.bounds
        counts.slowed += verdict.speed < 1.0
        counts.repaired += verdict.repaired
        if verdict.refused is not None:
            kind = verdict.refused.kind.value
            counts.refused[kind] = counts.refused.get(kind, 0) + 1
        if self._log is not None and not verdict.ok:
            self._log.write(counts.chunks, verdict, self._measured)
            counts.unlogged = self._log.lost
        return verdict

    # -- decisions --------------------------------------------------------------------------------

    def _decided(self, now: Setpoint, wanted: FloatArray, by: Certifier) -> Verdict:
        beyond, speed = self.limits.beyond(wanted), 1.0
        targets = wanted = wanted if beyond is None else wanted[: beyond.index]
        course = self._course(now, targets)
        refused = self.limits.objection(course, targets)
        slowed = None
        if refused is not None and self.slow:
            slowed = self._pace.slowed(now, now.place if self._target is None else self._target, wanted)
        if slowed is not None:
            speed, targets = slowed
            course, refused = self._course(now, targets), None
        refused = beyond if refused is None else refused
        passing = len(targets) if refused is None else refused.index
        proof = self._proof(course, targets[:passing], by)
        bounds = proof.distances
        if proof.pair is not None:
            passing, refused = proof.free, self._contact(proof)
        blocked: TubeProof | None = None
        for back in (*(each for each in TRIES if each < passing), passing):
            start = course.at(passing - back)
            rows = self.limits.braking(start)
            if rows is not None and back < passing and blocked is not None and self._comes_by(start, rows, blocked):
                continue
            if rows is not None and not self.limits.strong_enough(self._course(start, rows), rows):
                rows = None
            found = None if rows is None else self._stop_proof(start, rows, by, 0 if back else PARTS)
            bounds += 0 if found is None else found.distances
            if rows is not None and found is not None and found.pair is None:
                refused = self._no_stop(passing - back, refused, blocked) if back else refused
                return Verdict(read_only(targets[: passing - back]), read_only(rows), refused, speed, bounds=bounds)
            blocked = found or blocked
        refused = self._no_stop(0, refused, blocked)
        last = now.place if self._target is None else self._target
        for rows in (self._pending, last[None].copy()):
            if rows is not self._pending and self._proven:  # the rest of a way that is proven to its end
                return Verdict(self._nothing, read_only(rows), refused, bounds=bounds)
            found = self._stop_proof(now, rows, self.certifier) if len(rows) else None  # what is around keeps clear
            bounds += 0 if found is None else found.distances
            if found is not None and found.pair is None:
                return Verdict(self._nothing, read_only(rows.copy()), refused, bounds=bounds)
        return self._held(now, refused, bounds)

    def _repaired(self, now: Setpoint, wanted: FloatArray, verdict: Verdict, by: Certifier) -> Verdict:
        """What passes of a chunk, its stop, a plan to where the chunk is free again, and the rest of it.

        If that does not pass, a plan to its end; the verdict if none does.
        """
        bounds, place = verdict.bounds, verdict.rows[-1]
        for first in self._rejoined(now, wanted, verdict, by):
            rest = self._pace.from_rest(wanted[first], wanted[first + 1 :])
            ways = () if rest is None else ways_round(
                self.service, place, wanted[first], self.rate, speed=SPEED, acceleration=self._acceleration_scale
            )  # fmt: skip
            for way in ways:
                assert rest is not None
                found = self._decided(now, np.concatenate([verdict.rows, way, rest]), by)
                bounds += found.bounds
                if found.refused is None:
                    return replace(found, refused=verdict.refused, repaired=True, bounds=bounds)
        return replace(verdict, bounds=bounds)

    def _rejoined(self, now: Setpoint, wanted: FloatArray, verdict: Verdict, by: Certifier) -> list[int]:
        """Targets of a chunk, by their number, to which a plan may lead round what is in the way of those before."""
        k = len(wanted)
        if self.limits.beyond(wanted[-1:]) is not None:
            return []
        if self.limits.beyond(wanted) is not None:
            return [k - 1]
        course = self._course(now, wanted)
        backwards = course.places[:k][::-1], wanted[::-1], course.radii[:k][::-1] + self._error
        free = by.certify_tubes(*backwards, padding=self.padding).free
        return sorted({max(k - free, verdict.accepted), k - 1}) if free else []

    def _course(self, now: Setpoint, targets: FloatArray) -> Course:
        return now.course(targets, self._shares, self.tracking.goal_time)

    def _stop_proof(self, now: Setpoint, rows: FloatArray, by: Certifier, parts: int = PARTS) -> TubeProof | None:
        """The proof of rows that brake, from where the setpoint is; none if they break limits of joints or velocity."""
        course = self._course(now, rows)
        if not (self.limits.inside(rows) and self.limits.slow_enough(course, rows)):
            return None
        return self._proof(course, rows, by, parts)

    def _proof(self, course: Course, targets: FloatArray, by: Certifier, parts: int = PARTS) -> TubeProof:
        """How many of the ways to targets (k, n) are free, from the first on, with what may be beside them."""
        k = len(targets)
        starts, rooms = course.places[:k], course.radii[:k] + self._error
        return by.certify_tubes(starts, targets, rooms, padding=self.padding, parts=parts, parts_each=PARTS_EACH)

    def _comes_by(self, now: Setpoint, rows: FloatArray, blocked: TubeProof) -> bool:
        """Whether the way to rows (k, n) comes close to where another one could touch: so will it, most likely."""
        course = self._course(now, rows)
        starts, rooms = course.places[:-1], SAME_WAY * (course.radii[:-1] + self._error)
        return Whereabouts(starts, rows, rooms).holds(np.array(blocked.at))

    def _contact(self, proof: TubeProof) -> Refused:
        assert proof.pair is not None
        pair, depth = " x ".join(proof.pair), max(0.0, -proof.gap) if proof.collides else 0.0
        if proof.collides:
            detail = f"{pair} would overlap by {1000.0 * depth:.2f} mm"
        else:
            detail = (
                f"{pair} could touch: {1000.0 * proof.gap:.2f} mm apart is less than the room that the arm may need"
            )
        return Refused(
            Kind.CONTACT, proof.free, detail, proof.free / self.rate, pair=proof.pair, at=proof.at, depth=depth
        )

    def _no_stop(self, index: int, refused: Refused | None, blocked: TubeProof | None) -> Refused:
        """The word on a target after which the arm could not stop, and what it would touch then."""
        if refused is not None and refused.index <= index:
            return refused
        stop = Refused(Kind.STOP, index, "", index / self.rate)
        if blocked is None or blocked.pair is None:
            return replace(stop, detail="after it the arm could not stop within the limits of its joints")
        touched = self._contact(blocked)
        detail = f"after it the arm could not stop: {touched.detail}"
        return replace(stop, detail=detail, pair=touched.pair, at=touched.at, depth=touched.depth)

    def _chunk(self, chunk: ArrayLike) -> FloatArray:
        expected = f"targets of shape (k, {self.robot.n}) or ({self.robot.n},), 1 to {MAX_CHUNK} of them"
        rows = numbers("chunk", chunk, expected)
        rows = rows[None] if rows.ndim == 1 else rows
        if rows.ndim != 2 or rows.shape[1] != self.robot.n or not 1 <= len(rows) <= MAX_CHUNK:
            raise InvalidRequest("chunk", rows.shape, expected)
        return rows

    def _beside(self, around: Sequence[Obstacle | Occupied]) -> Certifier:
        """What proves motions beside others."""
        expected = "a list of Obstacles, or of what occupied() says"
        given: tuple[Obstacle | Occupied, ...] = items("around", around, (Obstacle, Occupied), expected)
        bodies = list[Obstacle]()
        for k, each in enumerate(given):
            if isinstance(each, Occupied) and each.stale:
                told = "what occupied() says now: its gate has decided since"
                raise InvalidRequest(f"around[{k}]", each.obstacle.name, told)
            bodies.append(each.obstacle if isinstance(each, Occupied) else each)
        if not bodies:
            return self.certifier
        return self._new_certifier(replace(self._scene, obstacles=(*self._scene.obstacles, *bodies)))

    def _new_certifier(self, scene: Scene) -> Certifier:
        if scene.constraints:
            held = ", ".join(each.name for each in scene.attached if each.constraints)
            raise InvalidRequest("scene", held, "nothing carried that has constraints: a gate cannot keep them")
        return Certifier(self.robot, scene, allowed=self._service.allowed)


@contextmanager
def _no_collection() -> Iterator[None]:
    """No garbage is collected meanwhile: in a process with much in it that takes longer than all else here."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
