"""A plan on an arm: checked against it, streamed to it, recorded; and whatever happens, the arm is told to hold.

Commands follow an absolute clock: tick k is due at k / rate after the begin, however long the ticks before took; one
whose time has passed is left out. A stream that is too late for that is stopped.

Where an arm is told to hold: where it is, as measured. It has been there, so it is free, and nothing but its own
momentum carries it on. What it was told last lies ahead of it, by its lag along the tangent of the path, where nothing
is proven. Only where the arm does not say where it is, or says what cannot be, it holds the last planned configuration,
which is proven free.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.execute.driver import ArmLimits, Driver
from planner_service.execute.report import ExecutedMotion, ExecutionReport, ExecutionStopped, Recording
from planner_service.geometry import FloatArray, number
from planner_service.outcome import PlanResult
from planner_service.peaks import TOLERANCE, peaks
from planner_service.plan_file import SavedPlan, SavedTask
from planner_service.robot import Robot
from planner_service.task import Segment, TaskResult
from planner_service.trajectory import Trajectory

__all__ = ["HARDWARE_SPEED", "Executable", "Streaming", "execute"]

Executable = PlanResult | SavedPlan | SavedTask | TaskResult | Trajectory

HARDWARE_SPEED = 0.2
"""Of what was planned: slow enough to be at the emergency stop in time."""

ROUNDED = 1e-4
"""Radians by which a controller's position limits may be rounded: the simulated one's are, to 3e-6."""

ABSURD = 0.5
"""Radians between where an arm was to be and where it says it is, beyond which it is not believed."""

REST, STILL = 0.1, 2e-4
"""Seconds for which an arm moves less than so many radians if it has come to rest."""

MOST_RECENT = 101
"""Ticks in that time, at most."""

TRIES = 3
"""Of telling an arm to hold."""

WIDTH_KEPT = 1e-6
"""Metres; a gripper that is to move less need not."""


@dataclass(frozen=True)
class Streaming:
    """How plans are driven.

    Attributes:
        speed: Part in (0, 1] of the planned speed: time is stretched, so velocities fall by it and accelerations by its
            square. If None 1 in simulation, else 0.2.
        rate: Commands per second.
        start_tolerance: Radians (or metres) by which the arm may stand elsewhere than where a motion begins; MoveIt's.
        settle: Seconds that the arm may take to come to rest after the end of each motion; it is recorded until then.
        latest: Seconds by which a command may be late before the stream is stopped.
        gripper_time: Seconds in which the gripper opens or closes.
        squeeze: Metres that the gripper is told to close beyond an object, so that it presses.

    Raises:
        InvalidRequest: a value is no number, or out of its range.
    """

    speed: float | None = None
    rate: float = 250.0
    start_tolerance: float = 0.01
    settle: float = 2.0
    latest: float = 0.1
    gripper_time: float = 1.0
    squeeze: float = 0.01

    def __post_init__(self) -> None:
        if self.speed is not None:
            number("speed", self.speed, "a part of the planned speed in (0, 1]", 1e-3, 1.0)
        ranges = {"rate": (10.0, 1000.0), "start_tolerance": (0.0, 0.1), "settle": (0.0, 10.0), "latest": (0.0, 1.0)}
        ranges |= {"gripper_time": (0.1, 10.0), "squeeze": (0.0, 0.02)}
        for item in fields(self)[1:]:
            lowest, highest = ranges[item.name]
            number(item.name, getattr(self, item.name), f"a number from {lowest:g} to {highest:g}", lowest, highest)


def execute(
    plan: Executable,
    driver: Driver,
    robot: Robot,
    streaming: Streaming | None = None,
    *,
    allow_unproven: bool = False,
) -> ExecutionReport:
    """Drive a plan, or all motions of a task with the gripper between them, and say how it went.

    Nothing is commanded before all of it has been checked: that every motion is proven, by a certificate that covers
    it; for saved plans and tasks, that it was made for this very robot; that it stays inside the robot's position
    limits and the arm's, and below the arm's velocity limits at this speed; that motions follow each other; and that
    the arm stands where the first begins.

    Args:
        plan: A ``PlanResult``, which says not for which robot it was made: the caller does; or a saved plan or task,
            or a task, or with ``allow_unproven`` a bare ``Trajectory``.
        robot: The robot it was made for.
        allow_unproven: Drive what no certificate says is free of collisions.

    Raises:
        InvalidRequest: a check failed; the arm has not moved.
        ExecutionStopped: it began and did not end: the driver failed, the stream was too late, or the arm was not
            where the next motion begins. The arm was told to hold. Ctrl-C does the same, and stays a KeyboardInterrupt.
    """
    how = streaming or Streaming()
    segments = _segments(plan, robot, allow_unproven=allow_unproven)
    speed = how.speed if how.speed is not None else (1.0 if driver.simulated else HARDWARE_SPEED)
    limits = driver.limits()
    for segment in segments:
        _require_within(segment, robot, limits, speed)
    _require_follow(segments, robot, how)
    _require_there(segments[0], driver, robot, how)
    run = _Run(driver, robot, how, speed, limits)
    run.drive(segments)
    return run.report()


@dataclass(frozen=True, eq=False)
class _Motion:
    """What is left of a segment once it is known to be proven; width None without a gripper, ``grips``: at its end."""

    name: str
    trajectory: Trajectory
    width: float | None
    grips: bool = False


def _segments(plan: Executable, robot: Robot, *, allow_unproven: bool) -> list[_Motion]:
    if isinstance(plan, Trajectory):
        if not allow_unproven:
            expected = "a plan with its certificate; a bare trajectory only with allow_unproven=True"
            raise InvalidRequest("plan", plan, expected)
        return [_rested("motion", plan, None)]
    if isinstance(plan, SavedPlan | SavedTask) and plan.made_for.robot_hash != robot.hash:
        expected = f"a plan made for this robot ({robot.name}, {robot.hash[:12]})"
        raise _refusal("plan", f"made for {plan.made_for.robot}, {plan.made_for.robot_hash[:12]}", expected)
    if isinstance(plan, SavedPlan):
        plan = plan.result
    if isinstance(plan, PlanResult):
        return [_proven(Segment("motion", plan, math.nan), robot, allow_unproven=allow_unproven)]
    if not isinstance(plan, SavedTask | TaskResult):
        raise InvalidRequest("plan", plan, "a plan, a saved plan, a task or a trajectory")
    if plan.failure is not None or not plan.segments:
        raise InvalidRequest("plan", str(plan.failure), "a task all of whose motions have a plan")
    return [_proven(segment, robot, allow_unproven=allow_unproven) for segment in plan.segments]


def _proven(segment: Segment, robot: Robot, *, allow_unproven: bool) -> _Motion:
    result = segment.result
    if result.trajectory is None:
        raise InvalidRequest(segment.name, str(result.failure), "a motion with a trajectory")
    proof, motion = result.certificate, result.trajectory
    begin, end = (-math.inf, math.inf) if proof is None or proof.part is None else proof.part
    if not allow_unproven and (proof is None or not proof.certified or begin > motion.begin or end < motion.end):
        why = "none" if proof is None else str(proof.refusal or f"a proof from s = {begin:g} to {end:g}")
        raise InvalidRequest(
            f"certificate of {segment.name}", why, "a proof of the whole motion, or allow_unproven=True"
        )
    fingers = set(() if robot.gripper is None else robot.gripper.links)
    touched = {name for interval in result.exempt for pair in interval.pairs for name in pair}
    width = None if math.isnan(segment.width) or robot.gripper is None else segment.width
    return replace(_rested(segment.name, motion, width), grips=bool(fingers & touched))


def _rested(name: str, trajectory: Trajectory, width: float | None) -> _Motion:
    if float(np.abs(trajectory(0.0, 1)).max(initial=0.0)) > TOLERANCE:
        raise InvalidRequest(f"trajectory of {name}", "moving at its begin", "one that begins at rest")
    return _Motion(name, trajectory, width)


def _require_within(motion: _Motion, robot: Robot, limits: ArmLimits, speed: float) -> None:
    path = motion.trajectory.path
    if path.n != robot.n or len(limits.lower) != robot.n:
        found = f"{path.n} joints, the arm {len(limits.lower)}"
        raise _refusal(f"trajectory of {motion.name}", found, f"the {robot.n} joints of {robot.name}")
    least, most = path.waypoints.min(axis=0), path.waypoints.max(axis=0)  # blends stay between their waypoints
    for whose, lower, upper, slack in (
        ("the robot", robot.limits.lower, robot.limits.upper, TOLERANCE),
        ("the arm", limits.lower, limits.upper, ROUNDED),
    ):
        for k, joint in enumerate(robot.joint_names):
            if least[k] < lower[k] - slack or most[k] > upper[k] + slack:
                found = f"from {least[k]:.4f} to {most[k]:.4f}"
                raise _refusal(f"{joint} in {motion.name}", found, f"{whose}'s {lower[k]:.4f} to {upper[k]:.4f}")
    peak = peaks(motion.trajectory, replace(robot.limits, velocity=limits.velocity)).velocity
    if peak.ratio * speed > 1.0 + TOLERANCE:
        allowed, joint = limits.velocity[peak.joint], robot.joint_names[peak.joint]
        found = f"{speed:g}, {joint} moving at {peak.ratio * speed * allowed:.3f} in {motion.name}"
        raise _refusal("speed", found, f"at most {1.0 / peak.ratio:.3f}: the arm's limit is {allowed:.3f}")


def _require_follow(motions: Sequence[_Motion], robot: Robot, how: Streaming) -> None:
    for before, after in pairwise(motions):
        end, begin = before.trajectory(before.trajectory.duration), after.trajectory(0.0)
        _require_near(f"begin of {after.name}", begin, end, robot, how)


def _require_there(motion: _Motion, driver: Driver, robot: Robot, how: Streaming) -> None:
    _require_near(f"start of {motion.name}", driver.positions(), motion.trajectory(0.0), robot, how)


def _require_near(field: str, found: FloatArray, wanted: FloatArray, robot: Robot, how: Streaming) -> None:
    """Raise for the joint that is farthest off, if any is too far."""
    if found.shape != wanted.shape:
        raise InvalidRequest(field, found, f"{robot.n} joint positions")
    off = np.abs(found - wanted)
    k = int(np.argmax(np.where(np.isfinite(off), off, math.inf)))
    if not off[k] <= how.start_tolerance:
        at = f"{robot.joint_names[k]} at {found[k]:.4f}"
        raise _refusal(field, at, f"{wanted[k]:.4f} within {how.start_tolerance:g} (start_tolerance)")


def _refusal(field: str, found: str, expected: str) -> InvalidRequest:
    return InvalidRequest(field, found, expected, message=f"{field}: got {found}; expected {expected}")


class _Run:
    """One execution: what it has done so far, and where the arm was to be last."""

    def __init__(self, driver: Driver, robot: Robot, how: Streaming, speed: float, limits: ArmLimits) -> None:
        self.driver, self.robot, self.how, self.speed, self.limits = driver, robot, how, speed, limits
        self.began = time.perf_counter()
        self.done: list[ExecutedMotion] = []
        self.planned: FloatArray | None = None
        self.width = math.nan

    def report(self, stopped: str | None = None) -> ExecutionReport:
        seconds = time.perf_counter() - self.began
        return ExecutionReport(tuple(self.done), self.speed, seconds, self.driver.simulated, stopped)

    def drive(self, motions: Sequence[_Motion]) -> None:
        """All motions; however that ends before its end, the arm is told to hold."""
        self.planned = motions[0].trajectory(0.0)
        grips, finished = False, False
        why = "interrupted"
        held = ""
        try:
            for motion in motions:
                if motion.width is not None:
                    self._set_gripper(motion.width, grips=grips)
                _require_there(motion, self.driver, self.robot, self.how)
                self._stream(motion)
                grips = motion.grips
            finished = True
        except Exception as error:
            held = self._hold()
            why, finished = f"{type(error).__name__}: {error}", True
            raise ExecutionStopped(self.report(f"stopped by {why}; {held}")) from error
        finally:
            if not finished:  # Ctrl-C
                self._hold()

    def _hold(self) -> str:
        """Tell the arm to hold; in words, what it was told."""
        wanted = self.planned
        if wanted is None:
            raise BrokenInvariant("an execution that has not begun cannot be stopped")
        where = "the last planned configuration, as it does not say where it is"
        try:
            found = self.driver.positions()
            if found.shape == wanted.shape and np.all(np.abs(found - wanted) <= ABSURD):
                wanted, where = found, "where it was"
        except Exception:  # whatever it is, the arm has to be told
            pass
        for _ in range(TRIES):
            try:
                self.driver.hold(wanted)
            except Exception as error:
                failed = f"{type(error).__name__}: {error}"
            else:
                return f"the arm was told to hold {where}"
        return f"THE ARM COULD NOT BE TOLD TO HOLD ({failed}): use its emergency stop"

    def _set_gripper(self, width: float, *, grips: bool) -> None:
        """Open or close, if it is not so already; around what was just reached it is told to close farther."""
        if abs(width - self.width) <= WIDTH_KEPT:
            return
        closing = grips and not width > self.width
        told = max(0.0, width - self.how.squeeze) if closing else width
        self.driver.move_gripper(told, self.how.gripper_time)
        self.width = width
        time.sleep(self.how.gripper_time)

    def _stream(self, motion: _Motion) -> None:
        trajectory = motion.trajectory.dilated(1.0 / self.speed)
        log = _Log(self.robot.n)
        try:
            self._follow(trajectory, log)
        finally:
            self.done.append(
                ExecutedMotion.of(motion.name, trajectory, log.recording(), self.robot, 1.0 / self.how.rate)
            )

    def _follow(self, trajectory: Trajectory, log: _Log) -> None:
        """Command every tick until the end, then its end until the arm has settled."""
        period, driver = 1.0 / self.how.rate, self.driver
        t, q, qd, qdd = trajectory.sample(period)
        last = len(t) - 1
        qd[last] = qdd[last] = 0.0  # what brakes the arm at the end would push it back afterwards
        rest = math.ceil(self.how.settle * self.how.rate)
        due = np.concatenate([t, t[-1] + period * np.arange(1, rest + 1)]).tolist()
        ahead = np.clip(q + driver.lag * qd, self.limits.lower, self.limits.upper)
        began = time.perf_counter()
        tick = 0
        while tick < len(due):
            late = time.perf_counter() - began - due[tick]
            if late < 0.0:
                time.sleep(-late)
                late = time.perf_counter() - began - due[tick]
            if late > self.how.latest:
                raise TimeoutError(f"a command was due {late:.3f} s ago, {self.how.latest:g} s are allowed (latest)")
            now = due[tick] + late
            while tick + 1 < len(due) and due[tick + 1] <= now:
                tick += 1
                log.skipped += tick <= last
            k = min(tick, last)
            self.planned = q[k]
            driver.command(ahead[k], qd[k], qdd[k])
            log.add(time.perf_counter() - began, ahead[k], driver.positions(), late)
            tick += 1
            if tick > last and log.rests(t[-1]):
                return


class _Log:
    """What was told and seen, tick by tick."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.rows: list[tuple[float, FloatArray, FloatArray, float]] = []
        self.skipped = 0

    def add(self, t: float, commanded: FloatArray, measured: FloatArray, late: float) -> None:
        self.rows.append((t, commanded, measured, late))

    def rests(self, after: float) -> bool:
        """Whether the arm has moved no more since some time before, which is after the end of its motion."""
        now = self.rows[-1][0]
        recent = [measured for t, _, measured, _ in self.rows[-MOST_RECENT:] if t >= now - REST]
        return now - REST > after and bool(np.ptp(recent, axis=0).max() < STILL)

    def recording(self) -> Recording:
        t, commanded, measured, late = zip(*self.rows, strict=True) if self.rows else ((), (), (), ())
        shape = (len(self.rows), self.n)
        told, seen = np.array(commanded).reshape(shape), np.array(measured).reshape(shape)
        return Recording(np.array(t), told, seen, np.array(late), self.skipped)
