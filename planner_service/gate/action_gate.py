"""Targets for an arm, proven before they are sent, each with a proven stop behind it.

What is proven of every target that passes: wherever the arm can be on its way to it, by ``Tracking``, nothing touches,
and the same of the targets that brake it afterwards within its limits. So if a target is refused, if no more come, or
if whoever sends them ends, the arm comes to rest in free space; if even those that brake are not sent, it stops at the
last target that was, as abruptly as its driver does. ``docs/design/the-gate.md`` has the argument.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify.certifier import Certifier, TubeProof
from planner_service.errors import InvalidRequest
from planner_service.gate.tracking import Course, Setpoint, Tracking
from planner_service.gate.verdict import Counts, Kind, Refused, Verdict
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.validation import finite_numbers, flag, instance, number, numbers, whole
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService

__all__ = ["ActionGate"]

MAX_CHUNK = 1000
"""Targets; at 30 Hz half a minute."""

MAX_RATE = 2000.0
MAX_SCALE = 10.0

MAX_BRAKES = 400
"""Targets that brake the arm; at 200 Hz two seconds."""

TRIES = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675)
"""How many targets are taken back, one after the other, until what brakes the arm after the rest is free."""

SLOWER = 6
"""Halvings of the interval in which the largest speed is looked for that keeps the limits."""

ROUNDING = 1e-9
"""Of an acceleration that is as large as it may be, relative."""

TINY_SPEED = 1e-6
"""Radians (or metres) a second: less is rest."""


class ActionGate:
    """Decides which targets may be sent to an arm.

    The arm stands still at the first check. Call ``check`` before each target or chunk of targets is sent, and send the
    rows of its verdict, one each period, until there is another; from one thread.

    Args:
        service: Of the robot and the scene. Continuous joints stay in the window that the robot was given.
        rate: Targets a second.
        tracking: What is assumed of the driver.
        padding: Metres that everything keeps beyond the room that the arm may need.
        acceleration_scale: Part of the robot's acceleration limits that setpoints and the stop may use, in (0, 10].
        slow: Whether a chunk that is too fast is followed along the same line at less than its own speed.

    Attributes:
        counts: What was decided.
        certifier: What proves it.

    Raises:
        InvalidRequest: a value out of range.
    """

    def __init__(
        self,
        service: PlannerService,
        *,
        rate: float,
        tracking: Tracking,
        padding: float = 0.0,
        acceleration_scale: float = 1.0,
        slow: bool = False,
    ) -> None:
        self.service = instance("service", service, PlannerService, "a PlannerService")
        self.robot: Robot = service.robot
        self.rate = number("rate", rate, f"targets a second, in [1, {MAX_RATE:g}]", 1.0, MAX_RATE)
        self.tracking = instance("tracking", tracking, Tracking, "a Tracking")
        self.padding = number("padding", padding, "metres in [0, 0.1]", 0.0, 0.1)
        scale = number("acceleration_scale", acceleration_scale, "a number in (0, 10]", math.ulp(0.0), MAX_SCALE)
        self.slow = flag("slow", slow)
        self.counts = Counts()
        self._error = tracking.of(self.robot.n)
        self._acceleration = scale * self.robot.limits.acceleration
        self._lower, self._upper = self.robot.bounds
        self._shares = tracking.shares(1.0 / self.rate)
        self.certifier = self._new_certifier(service.scene)
        self._nothing: FloatArray = read_only(np.empty((0, self.robot.n)))
        self.reset()

    # -- what a user calls ------------------------------------------------------------------------

    def check(
        self, q: ArrayLike, chunk: ArrayLike, *, sent: int | None = None, elapsed: float | None = None
    ) -> Verdict:
        """What may be sent of targets that a policy wants.

        A target that is no number is refused, and a measurement that is none counts as a lost arm.

        Args:
            q: Measured, (n,), when the next target is about to be sent.
            chunk: Targets, (k, n) or (n,), one each period.
            sent: How many of the last verdict's ``rows`` were sent since; if None, all of its targets, or one row of
                its stop if it had none.
            elapsed: Seconds since the last of them was sent; a period if None.

        Raises:
            InvalidRequest: other shapes, no numbers, or more rows sent than there were. Nothing is decided then, and
                what the last verdict said still holds.
        """
        measured = numbers("q", q, f"{self.robot.n} joint values")
        if measured.shape != (self.robot.n,):
            raise InvalidRequest("q", measured.shape, f"{self.robot.n} joint values")
        wanted = self._chunk(chunk)
        now = self._advanced(measured, sent, elapsed)
        self.counts.chunks += 1
        if self._lost:
            return self._passed(self._held(now, Refused(Kind.TRACKING, 0, self._lost)))
        return self._passed(self._decided(now, wanted))

    def update(self, scene: Scene, *, sent: int | None = None, elapsed: float | None = None) -> Verdict:
        """Take a changed scene: what is left to send of the last verdict is proven anew, or as much of it as is free.

        Where not even a stop is free any more, the arm is told to stay where it is.

        Args:
            sent: As in ``check``.
            elapsed: Likewise.

        Raises:
            InvalidRequest: no Scene.
        """
        certifier = self._new_certifier(instance("scene", scene, Scene, "a Scene"))
        service = self.service.with_scene(scene)
        now = self._advanced(None, sent, elapsed) if self._came is not None else None
        self.certifier, self.service = certifier, service
        if now is None:
            return Verdict(self._nothing, self._nothing, None)
        if self._lost:
            return self._passed(self._held(now, Refused(Kind.TRACKING, 0, self._lost)))
        return self._passed(self._decided(now, self._pending[: self._left]))

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
        if target is not None:
            self._target = finite_numbers("target", target, self.robot.n)
            self._came = Setpoint.at_rest(self._target, np.zeros(self.robot.n))
        self._pending, self._left = self._nothing, 0  # rows that may be sent, and how many of them are no brakes
        self._lost = ""

    # -- where the setpoint is --------------------------------------------------------------------

    def _advanced(self, measured: FloatArray | None, sent: int | None, elapsed: float | None) -> Setpoint:
        """Follow what was sent, and see whether the arm is where it can be by now."""
        rows = self._left or min(1, len(self._pending))
        rows = rows if sent is None else whole("sent", sent, 0, len(self._pending))
        waited = 1.0 / self.rate if elapsed is None else number("elapsed", elapsed, "seconds >= 0", 0.0, math.inf)
        if self._came is None:
            if measured is None or not np.isfinite(measured).all():
                raise InvalidRequest("q", measured, f"{self.robot.n} finite numbers at the first check")
            place = np.clip(measured, self._lower, self._upper)
            beyond = np.minimum(np.abs(measured - place), self._error)  # more is noticed below
            self._came = Setpoint.at_rest(place, self._error + beyond)
        for target in self._pending[:rows]:
            self._came, self._target = self._moved(self._came, self._shares), target
        self._pending, self._left = self._pending[rows:], max(0, self._left - rows)
        now = self._moved(self._came, self.tracking.shares(waited))
        if measured is not None and not self._lost:
            self._lost = self._astray(now, measured)
        return now

    def _moved(self, came: Setpoint, shares: tuple[float, float]) -> Setpoint:
        return came if self._target is None else came.after(self._target, shares, self.tracking.goal_time)

    def _astray(self, now: Setpoint, measured: FloatArray) -> str:
        """Why the arm is not where it can be; empty if it is."""
        off = np.abs(measured - now.place)
        room = now.radius + self._error
        if np.all(off <= room):
            return ""
        joint = int(np.argmax(np.where(np.isfinite(off), off - room, np.inf)))
        return (
            f"{self.robot.joint_names[joint]} is {off[joint]:.4g} from where its driver should have it, and at most"
            f" {room[joint]:.4g} is assumed: the arm does not follow as Tracking says"
        )

    def _held(self, now: Setpoint, refused: Refused, bounds: int = 0) -> Verdict:
        """Nothing passes, and the arm is to stay where its setpoint is by now: no proof stands for that."""
        return Verdict(self._nothing, read_only(now.place[None]), refused, proven=False, bounds=bounds)

    def _passed(self, verdict: Verdict) -> Verdict:
        """Remember and count what is decided."""
        self._pending, self._left = verdict.rows, len(verdict.targets)
        counts = self.counts
        counts.accepted += verdict.accepted
        counts.bounds += verdict.bounds
        counts.slowed += verdict.speed < 1.0
        if verdict.refused is not None:
            kind = verdict.refused.kind.value
            counts.refused[kind] = counts.refused.get(kind, 0) + 1
        return verdict

    # -- decisions --------------------------------------------------------------------------------

    def _decided(self, now: Setpoint, wanted: FloatArray) -> Verdict:
        beyond, speed = self._beyond(wanted), 1.0
        targets = wanted = wanted if beyond is None else wanted[: beyond.index]
        course = self._course(now, targets)
        refused = self._objection(course, targets)
        if refused is not None and self.slow:
            speed, targets = self._slowed(now, wanted)
            course = self._course(now, targets)
            refused = self._objection(course, targets)
        refused = beyond if refused is None else refused
        passing = len(targets) if refused is None else refused.index
        proof = self._proof(course, targets[:passing])
        bounds = proof.distances
        if proof.pair is not None:
            passing, refused = proof.free, self._contact(proof)
        for back in (*(each for each in TRIES if each < passing), passing):
            rows = np.array(list(self._braking(course.at(passing - back))))
            found = self._stop_proof(course.at(passing - back), rows)
            bounds += 0 if found is None else found.distances
            if found is not None and found.pair is None:
                refused = self._no_stop(passing - back, refused) if back else refused
                return Verdict(read_only(targets[: passing - back]), read_only(rows), refused, speed, bounds=bounds)
        refused = self._no_stop(0, refused)
        last = now.place if self._target is None else self._target
        for rows in (self._pending, last[None].copy()):
            found = self._stop_proof(now, rows) if len(rows) else None
            bounds += 0 if found is None else found.distances
            if found is not None and found.pair is None:
                return Verdict(self._nothing, read_only(rows.copy()), refused, bounds=bounds)
        return self._held(now, refused, bounds)

    def _course(self, now: Setpoint, targets: FloatArray) -> Course:
        return now.course(targets, self._shares, self.tracking.goal_time)

    def _stop_proof(self, now: Setpoint, rows: FloatArray) -> TubeProof | None:
        """The proof of rows that brake, from where the setpoint is; none if they are outside the joint limits."""
        if float(np.maximum(rows - self._upper, self._lower - rows).max()) > 0.0:
            return None
        return self._proof(self._course(now, rows), rows)

    def _proof(self, course: Course, targets: FloatArray) -> TubeProof:
        """How many of the ways to targets (k, n) are free, from the first on, with what may be beside them."""
        k = len(targets)
        return self.certifier.certify_tubes(
            course.places[:k], targets, course.radii[:k] + self._error, padding=self.padding
        )

    def _beyond(self, targets: FloatArray) -> Refused | None:
        """The first target outside the joint limits, or that is no number."""
        inside = (targets >= self._lower) & (targets <= self._upper)
        if inside.all():
            return None
        index, joint = (int(each[0]) for each in np.nonzero(~inside))
        value = targets[index, joint]
        if not math.isfinite(value):
            return self._of_joint(Kind.NUMBER, index, joint, f"{value} is no finite number")
        span = f"[{self._lower[joint]:.6g}, {self._upper[joint]:.6g}]"
        return self._of_joint(Kind.LIMIT, index, joint, f"{value:.6g} is outside its limits {span}")

    def _objection(self, course: Course, targets: FloatArray) -> Refused | None:
        """The first target that breaks a limit of speed or acceleration, and which."""
        limits, k = self.robot.limits, len(targets)
        speeds = (np.abs(targets - course.places[:k]) + course.radii[:k]) / self.tracking.goal_time
        changes = np.abs(np.diff(course.speeds, axis=0)) * self.rate
        over = np.stack([speeds - limits.velocity, changes - self._acceleration * (1.0 + ROUNDING)], axis=1) > 0.0
        if not over.any():
            return None
        index, what, joint = (int(each[0]) for each in np.nonzero(over))
        if what == 0:
            words = f"{speeds[index, joint]:.4g} a second to be there in time, of {limits.velocity[joint]:.4g}"
            return self._of_joint(Kind.SPEED, index, joint, words)
        words = f"{changes[index, joint]:.4g} a second squared, of {self._acceleration[joint]:.4g}"
        return self._of_joint(Kind.ACCELERATION, index, joint, words)

    def _of_joint(self, kind: Kind, index: int, joint: int, what: str) -> Refused:
        name = self.robot.joint_names[joint]
        return Refused(kind, index, f"{name}: {what}", index / self.rate, name)

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

    def _no_stop(self, index: int, refused: Refused | None) -> Refused:
        """The word on a target after which the arm could not stop."""
        if refused is not None and refused.index <= index:
            return refused
        detail = "after it the arm could not stop within its limits in free space"
        if refused is None:
            return Refused(Kind.STOP, index, detail, index / self.rate)
        return Refused(
            *(Kind.STOP, index, f"{detail}; ahead, {refused}", index / self.rate),
            joint=refused.joint, pair=refused.pair, at=refused.at, depth=refused.depth,
        )  # fmt: skip

    def _slowed(self, now: Setpoint, wanted: FloatArray) -> tuple[float, FloatArray]:
        """The largest share of its speed at which a chunk keeps the limits, about, and its targets then."""
        begun = now.place if self._target is None else self._target
        line = np.concatenate([begun[None], wanted])
        best, low, high = (0.0, line[:1].repeat(len(wanted), axis=0)), 0.0, 1.0
        for _ in range(SLOWER):
            share = 0.5 * (low + high)
            targets = _along(line, share)
            if self._objection(self._course(now, targets), targets) is None:
                best, low = (share, targets), share
            else:
                high = share
        return best

    def _braking(self, now: Setpoint) -> Iterator[FloatArray]:
        """Targets that each take as much speed as the limits allow, of all joints alike, until the driver may stop."""
        goal_time = self.tracking.goal_time
        place, speed = now.place, now.speed
        share = 0.5 * sum(self._shares)
        for _ in range(MAX_BRAKES):
            left = float((np.abs(speed) * self.rate / self._acceleration).max())
            if left <= 1.0 or float(np.abs(speed).max()) < TINY_SPEED:
                break
            speed = speed * (1.0 - 1.0 / left)
            target = place + speed * goal_time
            yield target
            place = place + share * (target - place)
        yield place

    def _chunk(self, chunk: ArrayLike) -> FloatArray:
        expected = f"targets of shape (k, {self.robot.n}) or ({self.robot.n},), 1 to {MAX_CHUNK} of them"
        rows = numbers("chunk", chunk, expected)
        rows = rows[None] if rows.ndim == 1 else rows
        if rows.ndim != 2 or rows.shape[1] != self.robot.n or not 1 <= len(rows) <= MAX_CHUNK:
            raise InvalidRequest("chunk", rows.shape, expected)
        return rows

    def _new_certifier(self, scene: Scene) -> Certifier:
        return Certifier(self.robot, scene, allowed=self.service.allowed)


def _along(line: FloatArray, share: float) -> FloatArray:
    """Points (k, n) of a polyline (k + 1, n) at share, 2 share, ... times its pieces."""
    at = share * np.arange(1, len(line))
    k = np.minimum(at.astype(np.intp), len(line) - 2)
    return np.asarray(line[k] + (line[k + 1] - line[k]) * (at - k)[:, None])
