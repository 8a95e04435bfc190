"""Drives the arms of a cell together, each from a thread of its own, so that a driver that hangs holds up no other.

If one fails, is late or does not follow, or its driver does not answer, all stop: those that can be commanded along
their proven paths (``joint_clock`` has the lemma), one whose driver failed where it is.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import NoneType

import numpy as np

from planner_service.cell import Cell, CellPlan, OwnClock
from planner_service.errors import InvalidRequest, PlanningFailed
from planner_service.execute.arm import Arm
from planner_service.execute.cells.joint_clock import Course, JointClock
from planner_service.execute.cells.report import ArmCourse, CellReport, CellStopped
from planner_service.execute.driver import Driver
from planner_service.execute.preconditions import Motion, refusal, require_drivable, require_near
from planner_service.execute.report import ExecutionStopped
from planner_service.execute.settings import HARDWARE_SPEED, Streaming
from planner_service.execute.stream import Log, Run
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance
from planner_service.path.trajectory import MAX_SAMPLES
from planner_service.records.cells import SavedCellPlan, prove_cell

__all__ = ["execute_cell"]

LEAD = 0.1
"""Seconds from the last check to the common start."""

LOOK = 0.05
"""Seconds between two looks at the arms."""

MOST_DELAY = 10.0
"""Seconds; an arm that is later than that stops the others, whatever is proven."""


def execute_cell(
    cell: Cell, plan: CellPlan | SavedCellPlan, drivers: Mapping[str, Driver], streaming: Streaming | None = None
) -> CellReport:
    """Execute motions of several arms, each with its own driver, and report how it went.

    Nothing is commanded before all of it has been checked: that each motion is proven again in this cell, that no two
    arms touch if either is late by ``plan.tolerates``, that the motions are within the arms' limits at this speed, that
    all arms stand where their motions begin or, without a motion, where the plan has them, and that grippers are open
    as the cell has them. Grippers do not move.

    An arm goes on only as long as it can stop in time for where every other was last seen. So the delay of the plan has
    to be more than the longest stop, lags and what the streams are late; ``plan(..., delay=0.5)`` asks for that.

    Args:
        cell: The arms and the scene that they really stand in.
        drivers: By the names of arms: of all that move; one of an arm that stands says whether it stands there.
        streaming: As for ``execute``. Its ``latest`` is what a tick of one arm's stream may be late.

    Raises:
        InvalidRequest: A check failed (``NotProven``: a proof), or the delay is too short to stop in; nothing moved.
        PlanningFailed: The plan has no motions.
        CellStopped: It began and did not end. All arms were told to stop or to hold; ``report.stopped`` says how.
            Ctrl-C does the same, and stays a KeyboardInterrupt.
    """
    instance("cell", cell, Cell, "a Cell")
    instance("plan", plan, (CellPlan, SavedCellPlan), "a CellPlan or a SavedCellPlan")
    instance("drivers", drivers, Mapping, "drivers by the names of the arms")
    how = instance("streaming", streaming, (Streaming, NoneType), "a Streaming, or None") or Streaming()
    claimed = plan.plan if isinstance(plan, SavedCellPlan) else plan
    if claimed.failure is not None:
        raise PlanningFailed(claimed.failure)
    proven = prove_cell(replace(claimed, layout=cell.layout)).required().plan
    moving = {name: clock for clock in proven.clocks for name in clock.arms}
    for name in [*moving, *drivers]:
        if name not in drivers or name not in cell.arms:
            raise InvalidRequest("drivers", sorted(map(str, drivers)), f"a driver of each of {sorted(moving)}")
    arms = {name: Arm(driver, cell.arm(name).robot) for name, driver in drivers.items()}
    simulated = {arm.simulated for arm in arms.values()}
    if len(simulated) > 1:
        raise InvalidRequest("drivers", sorted(arms), "all simulated, or none")
    speed = how.speed if how.speed is not None else (1.0 if simulated == {True} else HARDWARE_SPEED)
    delay = min(proven.tolerates, MOST_DELAY)
    lanes = _lanes(cell, proven, moving, arms, how, speed, delay)
    return _Together(lanes, speed, delay, simulated == {True}).report()


def _lanes(
    cell: Cell,
    plan: CellPlan,
    moving: Mapping[str, OwnClock],
    arms: Mapping[str, Arm],
    how: Streaming,
    speed: float,
    delay: float,
) -> list[_Lane]:
    """What drives each arm, all of them checked and standing where they begin."""
    begin, courses = plan(0.0), dict[str, Course]()
    for name, arm in arms.items():
        robot = cell.arm(name).robot
        at = cell.of_arm(name, begin)
        require_near(f"start of {name}", arm.positions(at), at, robot, how.start_tolerance)
        if robot.gripper is not None:
            _require_open(name, arm, robot.gripper_width, how.gripper_tolerance)
        if name not in moving:
            continue
        clock = moving[name]
        trajectory = clock.plan.unwrap()[1]
        if not trajectory.duration / speed * how.rate < MAX_SAMPLES:
            raise refusal(
                "speed", f"{speed:g}, {trajectory.duration:.3g} s of motion", f"fewer than {MAX_SAMPLES} commands"
            )
        own = None if len(clock.arms) == 1 else clock.columns[clock.arms.index(name)]
        if own is None:
            require_drivable([Motion(name, trajectory, None)], robot, arm.limits, speed, how.start_tolerance)
        else:
            _require_within(name, trajectory(np.linspace(0.0, trajectory.duration, 1000), 1)[:, own], arm, speed)
        courses[name] = Course(trajectory, own, clock.start, robot.limits.acceleration, speed, 1.0 / how.rate)
    lags = {name: float(arms[name].lag.max(initial=0.0)) for name in courses}
    for name, course in courses.items():
        needed = course.longest_way + speed * (lags[name] + 2.0 / how.rate)
        if len(courses) > 1 and not needed < delay:
            expected = f"more than {needed:.3f} s, in which {name} stops; plan with more, or drive at a lower speed"
            raise refusal("delay", f"{delay:.3f} s tolerated", expected)
    clock_of_all = JointClock(courses, delay, speed, lags)
    return [_Lane(arms[name], cell, name, how, speed, clock_of_all) for name in courses]


def _require_open(name: str, arm: Arm, wanted: float, near: float) -> None:
    """Raise for a gripper that is not as far open as the proof has it."""
    if abs((width := arm.gripper_width()) - wanted) > near:
        raise refusal(f"gripper of {name}", f"{width:.4f}", f"{wanted:.4f} within {near:g} (gripper_tolerance)")


def _require_within(name: str, velocity: FloatArray, arm: Arm, speed: float) -> None:
    """Raise for an arm that shares a clock and is faster than its controller allows."""
    ratio = (np.abs(velocity) * speed / arm.limits.velocity).max(axis=0)
    k = int(np.argmax(ratio))
    if ratio[k] > 1.0 + 1e-6:
        raise refusal("speed", f"{speed:g}", f"at most {speed / ratio[k]:.3f}: {arm.joints[k]} of {name} is too fast")


class _Together:
    """One execution of all lanes."""

    def __init__(self, lanes: Sequence[_Lane], speed: float, delay: float, simulated: bool) -> None:
        self._lanes, self._speed, self._delay, self._simulated = lanes, speed, delay, simulated

    def report(self) -> CellReport:
        """Drive all arms to the end, or to a stop, and say how it went.

        Raises:
            CellStopped: It did not end.
        """
        began = time.perf_counter()
        clock = self._lanes[0].clock
        threads = [threading.Thread(target=lane.supervised, daemon=True) for lane in self._lanes]
        for lane in self._lanes:
            lane.start = began + LEAD
        interrupt: BaseException | None = None
        try:
            for thread in threads:
                thread.start()
            self._wait(threads)
        except BaseException as error:  # Ctrl-C
            interrupt = error
            clock.stop(f"{type(error).__name__}")
            try:
                self._wait(threads)
            finally:  # a second one: where they are
                for lane in self._lanes:
                    lane.arm.stopping = True
                self._wait(threads)
        why = None
        if clock.stopped:
            why = "; ".join([clock.stopped, *(f"{lane.name} {lane.ended}" for lane in self._lanes)])
        if interrupt is not None:
            interrupt.args = (why,)
            raise interrupt
        courses = {lane.name: lane.course() for lane in self._lanes}
        seconds = time.perf_counter() - began
        report = CellReport(courses, self._speed, seconds, self._simulated, self._delay, clock.behind, why)
        if why is not None:
            raise CellStopped(report)
        return report

    @staticmethod
    def _wait(threads: Sequence[threading.Thread]) -> None:
        while any(thread.is_alive() for thread in threads):
            for thread in threads:
                if thread.ident is not None:
                    thread.join(LOOK)


class _Lane(Run):
    """One arm of several: its commands follow its clock of the joint ones."""

    def __init__(self, arm: Arm, cell: Cell, name: str, how: Streaming, speed: float, clock: JointClock) -> None:
        super().__init__(arm, cell.arm(name).robot, how, speed)
        self.name, self.clock = name, clock
        self.ended = "has not moved"
        self.start = 0.0
        self._log = Log(self.robot.n)
        self._clock: list[float] = []
        self._seen: list[float] = []
        self._off = 0.0

    def supervised(self) -> None:
        """Drive the arm; what is raised is kept, and stops all."""
        course = self.clock.courses[self.name]
        try:
            self.drive_from(course.at(0.0)[0], ())
        except ExecutionStopped as stopped:
            self.ended = f"was {stopped}"
        except BaseException as error:
            self.ended = f"ended: {type(error).__name__}: {error}"
        if self.error is not None or self.held is not None:
            self.clock.stop(f"{self.name} failed")

    def course(self) -> ArmCourse:
        """What was done."""
        return ArmCourse(self._log.recording(), np.array(self._clock), np.array(self._seen), self._off)

    def _drive(self, motions: Sequence[Motion]) -> None:
        try:
            self._follow_clock()
        except BaseException:
            self.clock.stop(f"{self.name} failed")
            raise

    def _follow_clock(self) -> None:
        """Command every tick until the end of the motion or of a stop, and then until the arm has settled."""
        course, arm, log, period = self.clock.courses[self.name], self.arm, self._log, 1.0 / self.how.rate
        lately = deque[FloatArray](maxlen=2 + int((self.how.latest + float(arm.lag.max(initial=0.0))) * self.how.rate))
        tick, rests_since = 0, -1.0
        while True:
            late = time.perf_counter() - self.start - tick * period
            if late < 0.0:
                time.sleep(-late)
                late = time.perf_counter() - self.start - tick * period
            if late > self.how.latest:
                raise TimeoutError(f"a command was due {late:.3f} s ago, {self.how.latest:g} s are allowed (latest)")
            skipped = int(late / period)
            log.skipped += skipped
            tick += skipped
            now = tick * period + late - skipped * period
            step = self.clock.advance(self.name, now)
            q, way, bend = course.at(step.u)
            qd, qdd = way * step.rate, bend * step.rate**2 + way * step.slowing
            ahead = np.clip(q + arm.lag * qd, arm.limits.lower, arm.limits.upper)
            self.planned, self.commanded = q, np.stack([q, ahead])
            lately.append(q)
            arm.command(ahead, qd, qdd)
            measured = arm.positions(self.commanded)
            log.add(time.perf_counter() - self.start, ahead, measured, late)
            self._clock.append(step.u)
            self._seen.append(self.clock.seen(self.name, measured))
            self._off = max(self._off, float(np.abs(measured - q).max()))
            self._require_followed(measured, np.array(lately))
            tick += 1
            done = step.u >= course.end or (step.stopping and step.rate == 0.0)
            rests_since = now if done and rests_since < 0.0 else rests_since
            if not done:
                continue
            near = bool(np.all(np.abs(measured - q) <= self.how.start_tolerance))
            if now - rests_since >= self.how.settle or (log.rests(rests_since) and near):
                break
        require_near(f"end of {self.name}", measured, q, self.robot, self.how.start_tolerance)
        self.ended = f"rests on its path, after {step.u:.2f} s of the plan"
        if not step.stopping:
            self.clock.through(self.name)
