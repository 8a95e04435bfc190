"""Streams a plan to an arm: checks it first, records the motion, and has the arm hold whatever happens.

Commands follow an absolute clock: tick k is due k / rate seconds after the beginning, however long earlier ticks took.
A tick whose time has passed is left out; a stream that is too late is stopped.

A stopped arm is commanded to hold its measured position. That position is free, because the arm is there; only its
momentum carries it further. The last command would lead it on, by its lag along the tangent of the path, where nothing
is proven. If the reading is missing or impossible, the arm is commanded to hold the last planned configuration instead,
which is proven free.

Commands are sent from a thread of their own. No signal interrupts it, so Ctrl-C cannot come between a failure and the
hold, and the caller's thread, which waits for it, notices a driver that does not return.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from planner_service.execute.arm import Arm, Call
from planner_service.execute.driver import Driver
from planner_service.execute.preconditions import (
    Executable,
    Motion,
    admitted,
    refusal,
    require_drivable,
    require_free_opening,
    require_near,
)
from planner_service.execute.report import ExecutedMotion, ExecutionReport, ExecutionStopped, Recording
from planner_service.execute.settings import HARDWARE_SPEED, Streaming
from planner_service.geometry.arrays import FloatArray
from planner_service.path.trajectory import MAX_SAMPLES, Trajectory
from planner_service.records.recertify import squeezed
from planner_service.robot.model import Robot
from planner_service.service import PlannerService

__all__ = ["Log", "Run", "execute"]

REST, STILL = 0.1, 2e-4
"""An arm that moves less than this many radians within these seconds has come to rest."""

MAX_RECENT = 101
"""The most ticks in that time."""

TRIES = 3
"""Attempts to tell an arm to hold."""

LOOK = 0.05
"""Seconds between two looks at the stream."""

SILENT = 40
"""Looks in a row that find the same call of the driver under way before it counts as one that never returns."""

WIDTH_KEPT = 1e-6
"""Metres; the gripper is not commanded to move less."""


def execute(
    plan: Executable,
    driver: Driver,
    robot: Robot | None = None,
    streaming: Streaming | None = None,
    *,
    service: PlannerService | None = None,
    allowed: Sequence[tuple[str, str]] = (),
    allow_unproven: bool = False,
) -> ExecutionReport:
    """Execute a plan, or all motions of a task with the gripper between them, and report how it went.

    Nothing is commanded before all of it has been checked: that it is proven again, whatever its certificates say
    (``recertify`` lists what that is; it takes some 2 ms, for a whole task 80 ms); that it was made for this very
    robot; that it stays inside the robot's position limits and the arm's, and below the arm's velocity limits at this
    speed; that motions follow each other; that the arm stands where the first begins; and that its gripper is free to
    go from the width it has to the first one.

    Args:
        plan: A ``PlanResult`` or a task, saved ones, or with ``allow_unproven`` a bare ``Trajectory``.
        robot: The robot it was made for; needed for a trajectory alone.
        service: The robot and the scene that the arm stands in, to which those of the plan must be equal. A plan from a
            file needs it to move a real arm, one that another process planned to move any.
        allowed: Pairs that may touch: those that the plan was made with as ``allowed``, and those of stretches that no
            rule of picking and placing gives. Name them again at each execution.
        allow_unproven: Execute what is not proven collision-free.

    Raises:
        InvalidRequest: a check failed (``NotProven``: the proof); the arm has not moved.
        ExecutionStopped: it began and did not end: the driver failed, the stream was too late, the arm did not follow
            or arrive, or the gripper did not. The arm was told to hold. Ctrl-C does the same, and stays a
            KeyboardInterrupt.
    """
    how = streaming or Streaming()
    simulated = driver.simulated is True
    robot, motions, proven = admitted(
        plan,
        robot,
        service,
        allowed=allowed,
        simulated=simulated,
        allow_unproven=allow_unproven,
        squeeze=how.squeeze,
    )
    arm = Arm(driver, robot)
    speed = how.speed if how.speed is not None else (1.0 if simulated else HARDWARE_SPEED)
    require_drivable(motions, robot, arm.limits, speed, how.start_tolerance)
    run = Run(arm, robot, how, speed)
    run.require_at("start", motions[0], 0.0)
    if proven is not None and robot.gripper is not None:
        require_free_opening(proven, arm.gripper_width(), how.gripper_tolerance)
    run.drive(motions)
    return run.report()


class Run:
    """One execution: what it has done so far, and where the arm was to be last."""

    def __init__(self, arm: Arm, robot: Robot, how: Streaming, speed: float) -> None:
        self.arm, self.robot, self.how, self.speed = arm, robot, how, speed
        self.began = time.perf_counter()
        self.done: list[tuple[str, Trajectory, Log]] = []
        self.planned: FloatArray = np.zeros(robot.n)
        self.commanded: FloatArray = self.planned
        self.width: float | None = None
        self.error: BaseException | None = None
        self.held: str | None = None
        self._launched = self._running = self._ended = False
        self._over = threading.Lock()

    def report(self, stopped: str | None = None) -> ExecutionReport:
        """What was done; takes a while, in which no arm may be kept waiting."""
        seconds, period = time.perf_counter() - self.began, 1.0 / self.how.rate
        done = [ExecutedMotion.of(name, way, log.recording(), self.robot, period) for name, way, log in self.done]
        return ExecutionReport(tuple(done), self.speed, seconds, self.arm.simulated, stopped)

    def drive(self, motions: Sequence[Motion]) -> None:
        """All motions; however that ends before its end, the arm is told to hold."""
        for motion in motions:
            ticks = motion.trajectory.duration / self.speed * self.how.rate
            if not ticks < MAX_SAMPLES:
                speed = f"{self.speed:g}, {ticks:.3g} commands in {motion.name}"
                raise refusal("speed", speed, f"one at which a motion has fewer than {MAX_SAMPLES}")
        self.drive_from(motions[0].trajectory(0.0), motions)

    def drive_from(self, planned: FloatArray, motions: Sequence[Motion]) -> None:
        """The same of an arm that stands at ``planned``, (n,)."""
        self.planned = self.commanded = planned
        try:
            self._supervise(motions)
            if self.error is not None and not isinstance(self.error, Exception):
                raise self.error
        except BaseException as interrupt:  # Ctrl-C
            if self.held is not None:
                interrupt.args = (self.held,)
            raise
        if self.error is not None:
            why = f"stopped by {type(self.error).__name__}: {self.error}; {self.held}"
            raise ExecutionStopped(self.report(why)) from self.error

    def _supervise(self, motions: Sequence[Motion]) -> None:
        """Stream in a thread of its own; whatever is raised here has it hold, and waits until it has."""
        stream = threading.Thread(target=self._stream, args=(motions,), name="planner-service stream", daemon=True)
        self._over.acquire()
        try:
            try:
                stream.start()
                self._launched = True
                self._wait()
            finally:
                self.arm.stopping = True
                self._wait()
        finally:  # a second Ctrl-C waits, too
            self.arm.stopping = True
            self._wait()

    def _wait(self) -> None:
        """Until the stream has ended, or a call of the driver does not."""
        before, looks = None, 0
        while (self._launched or self._running) and not self._ended and not self.arm.abandoned:
            self._over.acquire(timeout=LOOK)
            call = self.arm.call
            looks = looks + 1 if call is not None and call is before else 0
            before = call
            if call is not None and looks >= SILENT:
                self._abandon(call)

    def _abandon(self, call: Call) -> None:
        """Give up a stream that hangs in a call, and tell the arm to hold past it."""
        self.arm.abandoned = True
        self.error = TimeoutError(f"{call.name}() of the driver has not returned for {SILENT * LOOK:g} s")
        self.held = f"THE ARM COULD NOT BE TOLD TO HOLD ({self.error}): use its emergency stop"
        if call.name == "hold":
            return
        heard = threading.Lock()
        heard.acquire()

        def hold() -> None:
            with suppress(Exception):
                self.arm.driver.hold(self.planned.copy())
                heard.release()

        threading.Thread(target=hold, name="planner-service hold", daemon=True).start()
        if heard.acquire(timeout=SILENT * LOOK):
            self.held = "the arm was told to hold the last planned configuration, past the call that has not returned"

    def _stream(self, motions: Sequence[Motion]) -> None:
        """What the thread does: all motions, or until something is raised, and then the arm is told to hold."""
        self._running = True
        arrived = self.arm.stopping  # before anything was begun
        try:
            if not arrived:
                self._drive(motions)
                arrived = True
        except BaseException as error:
            if not self.arm.abandoned:
                self.error = error
        finally:
            if not arrived and not self.arm.abandoned:
                self._hold()
            self._ended = True
            self._over.release()

    def _drive(self, motions: Sequence[Motion]) -> None:
        grips = False
        for motion in motions:
            if motion.width is not None:
                self._set_gripper(motion.width, grips=grips)
            self._stand(motion.wait)
            self.require_at("start", motion, 0.0)
            self._follow(motion)
            self.require_at("end", motion, motion.trajectory.duration)
            grips = motion.grips

    def require_at(self, which: str, motion: Motion, t: float) -> None:
        """Raise unless the arm stands where the motion is after t seconds at full speed."""
        wanted, near = motion.trajectory(t), self.how.start_tolerance
        require_near(f"{which} of {motion.name}", self.arm.positions(wanted), wanted, self.robot, near)

    def _hold(self) -> None:
        """Tell the arm to hold, and keep what it was told, in words; what a driver raises as by Ctrl-C comes after."""
        self.arm.holding = True
        for _ in range(TRIES):
            try:
                self.held = self._told_to_hold()
                return
            except BaseException as interrupt:
                self.error = interrupt
        self.held = f"THE ARM COULD NOT BE TOLD TO HOLD ({type(self.error).__name__}): use its emergency stop"

    def _told_to_hold(self) -> str:
        wanted, where = self.planned, "the last planned configuration, as it gave no reading that can be believed"
        with suppress(Exception):  # whatever it is, the arm has to be told
            wanted, where = self.arm.positions(self.commanded), "where it was"
        for _ in range(TRIES):
            try:
                self.arm.hold(wanted)
            except Exception as error:
                failed = f"{type(error).__name__}: {error}"
            else:
                return f"the arm was told to hold {where}"
        return f"THE ARM COULD NOT BE TOLD TO HOLD ({failed}): use its emergency stop"

    def _set_gripper(self, width: float, *, grips: bool) -> None:
        """Open or close, if it is not so already; around what was just reached it is told to close farther."""
        near = WIDTH_KEPT
        if self.width is None:  # it may hold something, and then is let be
            self.width, near = self.arm.gripper_width(), self.how.gripper_tolerance
        if abs(width - self.width) <= near:
            self.width = width
            return
        closing = grips and not width > self.width
        commanded = squeezed(self.robot, width, self.how.squeeze) if closing else width
        self.arm.move_gripper(commanded, self.how.gripper_time)
        self.width = width
        self._stand(self.how.gripper_time)
        self._require_width(width)

    def _require_width(self, width: float) -> None:
        """Raise unless the gripper gets there before it should have settled; closed on nothing it is beyond."""
        late = time.perf_counter() + self.how.settle
        while not abs((actual := self.arm.gripper_width()) - width) <= self.how.gripper_tolerance:
            if time.perf_counter() >= late:
                expected = f"{width:.4f} within {self.how.gripper_tolerance:g} (gripper_tolerance)"
                raise refusal("gripper", f"{actual:.4f}", expected)
            self._stand(LOOK)

    def _stand(self, seconds: float) -> None:
        """Wait, and ask the arm all the while where it is, so that no reading jumps unseen."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0.0:
            self.arm.positions(self.commanded)
            time.sleep(min(1.0 / self.how.rate, left))

    def _follow(self, motion: Motion) -> None:
        """Command every tick until the end, then its end until the arm has settled there, or has had its time to."""
        trajectory, log = motion.trajectory.dilated(1.0 / self.speed), Log(self.robot.n)
        self.done.append((motion.name, trajectory, log))
        period, arm = 1.0 / self.how.rate, self.arm
        t, q, qd, qdd = trajectory.sample(period)
        last = len(t) - 1
        qd[last] = qdd[last] = 0.0  # what brakes the arm at the end would push it back afterwards
        rest = math.ceil(self.how.settle * self.how.rate)
        due = np.concatenate([t, t[-1] + period * np.arange(1, rest + 1)]).tolist()
        ahead = np.clip(q + arm.lag * qd, arm.limits.lower, arm.limits.upper)
        behind = math.ceil((self.how.latest + float(arm.lag.max(initial=0.0))) * self.how.rate)
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
            self.planned, self.commanded = q[k], np.stack([q[k], ahead[k]])
            arm.command(ahead[k], qd[k], qdd[k])
            measured = arm.positions(self.commanded)
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
            return
        k = int(np.argmax(off))
        at, wanted = f"{self.robot.joint_names[k]} at {measured[k]:.4f}", lately[-1, k]
        raise refusal("arm", at, f"{wanted:.4f} within {self.how.tracking_tolerance:g} (tracking_tolerance)")


class Log:
    """Commands and readings, tick by tick."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.rows: list[tuple[float, FloatArray, FloatArray, float]] = []
        self.skipped = 0

    def add(self, t: float, commanded: FloatArray, measured: FloatArray, late: float) -> None:
        self.rows.append((t, commanded, measured, late))

    def rests(self, after: float) -> bool:
        """Whether the arm has moved no more since some time before, which is after the end of its motion."""
        now = self.rows[-1][0]
        recent = [measured for t, _, measured, _ in self.rows[-MAX_RECENT:] if t >= now - REST]
        return now - REST > after and bool(np.ptp(recent, axis=0).max() < STILL)

    def recording(self) -> Recording:
        t, commanded, measured, late = zip(*self.rows, strict=True) if self.rows else ((), (), (), ())
        shape = (len(self.rows), self.n)
        commands, readings = np.array(commanded).reshape(shape), np.array(measured).reshape(shape)
        return Recording(np.array(t), commands, readings, np.array(late), self.skipped)
