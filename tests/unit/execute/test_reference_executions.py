"""What an arm is told and what is reported of it, tick by tick, when all goes well and when it does not.

The numbers are those of release 0.1.0; the arm and the clock are not real.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from planner_service import PlannerService, PlanRequest, PlanResult
from planner_service.collision import CheckCounts
from planner_service.execute import ExecutionReport, ExecutionStopped, Streaming, execute
from planner_service.execute import stream as execution
from planner_service.geometry.arrays import FloatArray
from planner_service.records.plan_file import SavedTask
from planner_service.tasks import Segment
from tests.support.arms import FakeArm, FakeTime
from tests.support.pinned import pinned

STEP = np.array([0.3, -0.2, 0.25, 0.2, 0.1, -0.4])
SHORT = Streaming(settle=0.05, gripper_time=0.1)


PINNED = pinned("executions")


@lru_cache
def service() -> PlannerService:
    return PlannerService("wxai", "empty")


@lru_cache
def plan(way: int) -> PlanResult:
    """From home, or back to it if the way is -1."""
    start, goal = (service().robot.home, service().robot.home + STEP)[::way]
    return service().plan(PlanRequest(start, goal, time_limit=None))


def task() -> SavedTask:
    there, back = plan(1), plan(-1)
    segments = (Segment("there", there, 0.07), Segment("back", back, 0.045), Segment("again", there, 0.045))
    return SavedTask(service().world, "there and back", segments, CheckCounts(), 0.0)


def real(arm: FakeArm, clock: FakeTime) -> None:
    arm.simulated = False


def quick(arm: FakeArm, clock: FakeTime) -> None:
    """As it comes."""


def lagging(arm: FakeArm, clock: FakeTime) -> None:
    arm.lag = np.array([0.02, 0.02, 0.02, 0.02, 0.04, 0.04])


def lagging_far(arm: FakeArm, clock: FakeTime) -> None:
    arm.lag = np.full(6, 0.1)


def standing_beside(arm: FakeArm, clock: FakeTime) -> None:
    arm.off = np.array([0.004, 0.0, -0.002, 0.0, 0.0, 0.001])


def slow_now_and_then(arm: FakeArm, clock: FakeTime) -> None:
    def slow(tick: int) -> None:
        clock.now += 0.011 * (tick % 10 == 3) + 0.0005

    arm.trouble = slow


def failing(arm: FakeArm, clock: FakeTime) -> None:
    def fail(tick: int) -> None:
        if tick == 40:
            raise OSError("no answer")

    arm.trouble = fail


def held_up(arm: FakeArm, clock: FakeTime) -> None:
    where = np.array(arm.q)

    def seen() -> FloatArray:
        return np.asarray(where + 0.3 * (arm.q - where))

    arm.seen = seen


def too_late(arm: FakeArm, clock: FakeTime) -> None:
    def late(tick: int) -> None:
        clock.now += 0.2 * (tick == 30)

    arm.trouble = late


CASES: dict[str, tuple[Callable[[FakeArm, FakeTime], None], Streaming]] = {
    "real": (real, SHORT),
    "real at half the speed": (real, replace(SHORT, speed=0.5, rate=100.0)),
    "quick": (quick, SHORT),
    "lagging": (lagging, SHORT),
    "lagging far": (lagging_far, SHORT),
    "standing beside": (standing_beside, replace(SHORT, settle=0.3)),
    "slow now and then": (slow_now_and_then, SHORT),
    "failing": (failing, SHORT),
    "held up": (held_up, SHORT),
    "too late": (too_late, SHORT),
    "task": (quick, SHORT),
}


def micro(value: float) -> int:
    """In millionths, without rounding of the last places."""
    return round(value * 1e6)


def summary(report: ExecutionReport, arm: FakeArm) -> str:
    """What is pinned: the report, then what the arm was told."""
    motions = [
        f"{motion.duration:.6g} s {motion.ticks} ticks {motion.late} late {len(motion.recording.t)} rows"
        f" {micro(motion.error_max.max())} {micro(motion.error_rms.sum())} {micro(motion.final_error.sum())}"
        f" {micro(motion.tool_lag)} {micro(motion.tool_off_path)}"
        for motion in report.motions
    ]
    told = [math.fsum(abs(float(row[part].sum())) for row in arm.told) for part in range(3)]
    commands = f"{len(arm.told)} commands {told[0]:.7g} {told[1]:.7g} {told[2]:.5g}, {len(arm.held)} holds {arm.widths}"
    return f"{report.ok} {report.seconds:.4g} s; {'; '.join(motions)}; {commands}"


def run(name: str) -> str:
    prepare, how = CASES[name]
    arm, clock = FakeArm(np.array(service().robot.home)), FakeTime()
    prepare(arm, clock)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(execution, "time", clock)
        try:
            report = execute(task() if name == "task" else plan(1), arm, service().robot, how, allow_unproven=True)
        except ExecutionStopped as stopped:
            report = stopped.report
    return summary(report, arm)


def lines() -> dict[str, str]:
    """What is to be pinned."""
    return {name: run(name) for name in CASES}


def test_the_pinned_executions_are_these() -> None:
    assert list(PINNED) == list(CASES)


@pytest.mark.parametrize("name", CASES)
def test_an_execution_is_told_and_reported_as_pinned(name: str) -> None:
    assert run(name) == PINNED[name]
