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

import numpy as np

from planner_service.errors import BrokenInvariant
from planner_service.execute.admission import (
    Executable,
    Motion,
    motions_of,
    refusal,
    require_drivable,
    require_near,
    robot_of,
)
from planner_service.execute.driver import ArmLimits, Driver
from planner_service.execute.report import ExecutedMotion, ExecutionReport, ExecutionStopped, Recording
from planner_service.execute.streaming import HARDWARE_SPEED, Streaming
from planner_service.geometry import FloatArray
from planner_service.robot import Robot
from planner_service.trajectory import Trajectory

__all__ = ["execute"]

ABSURD = 0.5
"""Radians between where an arm was a moment ago and where it says it is, beyond which it is not believed."""

REST, STILL = 0.1, 2e-4
"""Seconds for which an arm moves less than so many radians if it has come to rest."""

MOST_RECENT = 101
"""Ticks in that time, at most."""

TRIES = 3
"""Of telling an arm to hold."""

LOOK = 0.05
"""Seconds between two looks at the gripper."""

WIDTH_KEPT = 1e-6
"""Metres; a gripper that is to move less need not."""


def execute(
    plan: Executable,
    driver: Driver,
    robot: Robot | None = None,
    streaming: Streaming | None = None,
    *,
    allow_unproven: bool = False,
) -> ExecutionReport:
    """Drive a plan, or all motions of a task with the gripper between them, and say how it went.

    Nothing is commanded before all of it has been checked: that every motion is proven, by a certificate that covers
    it; that it was made for this very robot; that it stays inside the robot's position
    limits and the arm's, and below the arm's velocity limits at this speed; that motions follow each other; and that
    the arm stands where the first begins.

    Args:
        plan: A ``PlanResult`` or a task, saved ones, or with ``allow_unproven`` a bare ``Trajectory``.
        robot: The robot it was made for. Not needed for what this process planned; of a result that another process
            planned, and of a trajectory, the caller alone knows it.
        allow_unproven: Drive what no certificate says is free of collisions.

    Raises:
        InvalidRequest: a check failed; the arm has not moved.
        ExecutionStopped: it began and did not end: the driver failed, the stream was too late, the arm did not follow
            or arrive, or the gripper did not. The arm was told to hold. Ctrl-C does the same, and stays a
            KeyboardInterrupt.
    """
    how = streaming or Streaming()
    robot = robot_of(plan, robot)
    motions = motions_of(plan, robot, allow_unproven=allow_unproven)
    speed = how.speed if how.speed is not None else (1.0 if driver.simulated else HARDWARE_SPEED)
    limits = driver.limits()
    require_drivable(motions, robot, limits, speed, how.start_tolerance)
    run = _Run(driver, robot, how, speed, limits)
    run.require_at("start", motions[0], 0.0)
    run.drive(motions)
    return run.report()


class _Run:
    """One execution: what it has done so far, where the arm was to be last, and where it was."""

    def __init__(self, driver: Driver, robot: Robot, how: Streaming, speed: float, limits: ArmLimits) -> None:
        self.driver, self.robot, self.how, self.speed, self.limits = driver, robot, how, speed, limits
        self.began = time.perf_counter()
        self.done: list[tuple[str, Trajectory, _Log]] = []
        self.planned: FloatArray | None = None
        self.seen: FloatArray | None = None
        self.width: float | None = None

    def report(self, stopped: str | None = None) -> ExecutionReport:
        """What was done; takes a while, in which no arm may be kept waiting."""
        seconds, period = time.perf_counter() - self.began, 1.0 / self.how.rate
        done = [ExecutedMotion.of(name, way, log.recording(), self.robot, period) for name, way, log in self.done]
        return ExecutionReport(tuple(done), self.speed, seconds, self.driver.simulated, stopped)

    def drive(self, motions: Sequence[Motion]) -> None:
        """All motions; however that ends before its end, the arm is told to hold."""
        self.planned = motions[0].trajectory(0.0)
        grips = False
        try:
            for motion in motions:
                if motion.width is not None:
                    self._set_gripper(motion.width, grips=grips)
                self.require_at("start", motion, 0.0)
                self._follow(motion)
                self.require_at("end", motion, motion.trajectory.duration)
                grips = motion.grips
        except Exception as error:
            held = self._hold()
            why = f"{type(error).__name__}: {error}"
            raise ExecutionStopped(self.report(f"stopped by {why}; {held}")) from error
        except BaseException:  # Ctrl-C
            self._hold()
            raise

    def require_at(self, which: str, motion: Motion, t: float) -> None:
        """Raise unless the arm stands where the motion is after t seconds at full speed."""
        wanted, near = motion.trajectory(t), self.how.start_tolerance
        require_near(f"{which} of {motion.name}", self.driver.positions(), wanted, self.robot, near)

    def _hold(self) -> str:
        """As ``_told_to_hold``; Ctrl-C in the meantime waits until the arm was told, but not for ever."""
        interrupt: BaseException | None = None
        for _ in range(TRIES):
            try:
                told = self._told_to_hold()
            except BaseException as error:
                interrupt = error
            else:
                break
        if interrupt is not None:
            raise interrupt
        return told

    def _told_to_hold(self) -> str:
        """Tell the arm to hold; in words, what it was told."""
        wanted, seen = self.planned, self.planned if self.seen is None else self.seen
        if wanted is None or seen is None:
            raise BrokenInvariant("an execution that has not begun cannot be stopped")
        where = "the last planned configuration, as it does not say where it is"
        try:
            found = self.driver.positions()
            if found.shape == seen.shape and np.all(np.abs(found - seen) <= ABSURD):
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
        near = WIDTH_KEPT
        if self.width is None:  # it may hold something, and then is let be
            self.width, near = self.driver.gripper_width(), self.how.gripper_tolerance
        if abs(width - self.width) <= near:
            self.width = width
            return
        closing = grips and not width > self.width
        told = max(0.0, width - self.how.squeeze) if closing else width
        self.driver.move_gripper(told, self.how.gripper_time)
        self.width = width
        time.sleep(self.how.gripper_time)
        self._require_width(width)

    def _require_width(self, width: float) -> None:
        """Raise unless the gripper gets there before it should have settled; closed on nothing it is beyond."""
        waited = 0.0
        while not abs((found := self.driver.gripper_width()) - width) <= self.how.gripper_tolerance:
            if waited >= self.how.settle:
                expected = f"{width:.4f} within {self.how.gripper_tolerance:g} (gripper_tolerance)"
                raise refusal("gripper", f"{found:.4f}", expected)
            time.sleep(LOOK)
            waited += LOOK

    def _follow(self, motion: Motion) -> None:
        """Command every tick until the end, then its end until the arm has settled there, or has had its time to."""
        trajectory, log = motion.trajectory.dilated(1.0 / self.speed), _Log(self.robot.n)
        self.done.append((motion.name, trajectory, log))
        period, driver = 1.0 / self.how.rate, self.driver
        t, q, qd, qdd = trajectory.sample(period)
        last = len(t) - 1
        qd[last] = qdd[last] = 0.0  # what brakes the arm at the end would push it back afterwards
        rest = math.ceil(self.how.settle * self.how.rate)
        due = np.concatenate([t, t[-1] + period * np.arange(1, rest + 1)]).tolist()
        ahead = np.clip(q + driver.lag * qd, self.limits.lower, self.limits.upper)
        behind = math.ceil((self.how.latest + float(driver.lag.max(initial=0.0))) * self.how.rate)
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
            measured = driver.positions()
            log.add(time.perf_counter() - began, ahead[k], measured, late)
            self._require_followed(measured, q[min(max(tick - behind, 0), last) : k + 1])
            tick += 1
            if tick > last and log.rests(t[-1]) and np.all(np.abs(measured - q[last]) <= self.how.start_tolerance):
                return

    def _require_followed(self, measured: FloatArray, lately: FloatArray) -> None:
        """Raise for the joint that is farthest from everywhere (m, n) it was to be lately, if that is too far."""
        near = np.clip(measured, lately.min(axis=0), lately.max(axis=0))
        off = np.abs(measured - near)
        if np.all(off <= self.how.tracking_tolerance):
            self.seen = measured
            return
        k = int(np.argmax(np.where(np.isfinite(off), off, math.inf)))
        at, wanted = f"{self.robot.joint_names[k]} at {measured[k]:.4f}", lately[-1, k]
        raise refusal("arm", at, f"{wanted:.4f} within {self.how.tracking_tolerance:g} (tracking_tolerance)")


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
