"""Drivers that lie, fail, hang or are interrupted: no reading is trusted, and the arm holds whatever happens."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import InvalidRequest, PlanRequest
from planner_service.collision import CheckCounts
from planner_service.execute import ArmLimits, ExecutionStopped, execute
from planner_service.execute import arm as arm_module
from planner_service.execute import stream as execution
from planner_service.records.plan_file import SavedTask
from planner_service.tasks import Segment
from tests.support.arms import QUICK, STEP, FakeArm, FakeTime, raising, robot, service, stopped, there
from tests.support.optional import present

PLANNED = "the arm was told to hold the last planned configuration, as it gave no reading that can be believed"


def in_two() -> SavedTask:
    """A task whose gripper closes before its motion."""
    return SavedTask(service().world, "close and go", (Segment("go", there(), 0.03),), CheckCounts(), 0.0)


@pytest.mark.parametrize(("joint", "jump"), [*enumerate([0.15, -0.45, 1.0, 0.15, -0.45, 1.0])])
def test_an_encoder_that_jumps_is_not_believed(jump: float, joint: int, arm: FakeArm) -> None:
    off = np.zeros(6)
    off[joint] = jump
    arm.seen = lambda: arm.q + off * (len(arm.told) > 20)
    report = stopped(there(), arm)
    assert report.stopped is not None
    assert f"arm: got joint_{joint} at " in report.stopped
    assert "ms after the last reading" in report.stopped
    assert report.stopped.endswith(PLANNED)
    assert len(arm.told) == 21
    assert np.array_equal(arm.held, [arm.told[-1][0]])  # without lag it is told the planned configuration


def test_after_a_jump_no_reading_is_believed(arm: FakeArm, clock: FakeTime) -> None:
    jumped: list[int] = []

    def seen() -> Any:
        if len(arm.told) <= 20:
            return arm.q
        clock.sleep(1.0 * len(jumped))  # in which an arm can go far
        jumped.append(1)
        return arm.q + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])

    arm.seen = seen
    report = stopped(there(), arm)
    assert present(report.stopped).endswith(PLANNED)
    assert len(jumped) == 2
    assert np.array_equal(arm.held, [arm.told[-1][0]])


def test_an_encoder_that_jumps_while_the_gripper_moves_is_not_believed(arm: FakeArm) -> None:
    arm.seen = lambda: arm.q + np.array([0.0, 0.45, 0.0, 0.0, 0.0, 0.0]) * len(arm.widths)
    report = stopped(in_two(), arm, replace(QUICK, gripper_time=2.0))
    assert present(report.stopped).endswith(PLANNED)
    assert np.array_equal(arm.held, [robot().home])


@pytest.mark.parametrize("stall", [0.02, 0.09])
def test_readings_that_come_late_and_catch_up_are_believed(stall: float, arm: FakeArm, clock: FakeTime) -> None:
    plan = service().plan(PlanRequest(robot().home, robot().home + 12.0 * STEP))
    whole, began = plan.unwrap()[1], clock.now
    frozen: list[Any] = []

    def seen() -> Any:
        if 0.3 < clock.now - began < 0.3 + stall:
            frozen.append(arm.q)
            return frozen[0]
        return arm.q

    arm.seen = seen
    assert execute(plan, arm, robot(), QUICK).ok
    assert float(np.abs(whole(0.3, 1)).max()) * stall > 0.02 * stall
    assert frozen


READINGS: dict[str, Callable[[Any], Any]] = {
    "text": lambda q: np.array(["a"] * 6),
    "too few": lambda q: q[:5],
    "too many": lambda q: np.append(q, 0.0),
    "a column": lambda q: q[:, None],
    "a number": lambda q: 0.3,
    "nothing": lambda q: None,
    "ragged": lambda q: [[0.0], 1.0, 2.0, 3.0, 4.0, 5.0],
    "complex": lambda q: q + 1j,
    "nan": lambda q: np.full(6, np.nan),
    "infinite": lambda q: np.append(q[:5], np.inf),
}


@pytest.mark.parametrize("what", READINGS)
def test_a_malformed_reading_stops_the_stream(what: str, arm: FakeArm) -> None:
    arm.seen = lambda: READINGS[what](arm.q) if len(arm.told) > 20 else arm.q
    report = stopped(there(), arm)
    assert present(report.stopped).startswith("stopped by InvalidRequest: ")
    assert present(report.stopped).endswith(PLANNED)
    assert len(arm.held) == 1
    assert report.motions[0].recording.measured.shape == (20, 6)


@pytest.mark.parametrize("what", ["text", "too few", "nan"])
def test_an_arm_whose_first_reading_is_malformed_is_not_moved(what: str, arm: FakeArm) -> None:
    arm.seen = lambda: READINGS[what](arm.q)
    with pytest.raises(InvalidRequest, match=r"positions|arm: got joint_"):
        execute(there(), arm, robot(), QUICK)
    assert arm.told == []


def test_readings_may_be_a_list(arm: FakeArm) -> None:
    arm.seen = lambda: arm.q.tolist()
    assert execute(there(), arm, robot(), QUICK).ok


def test_readings_are_copied(arm: FakeArm) -> None:
    buffer = np.array(robot().home)

    def seen() -> Any:
        buffer[:] = arm.q
        return buffer

    arm.seen = seen
    recording = execute(there(), arm, robot(), QUICK).motions[0].recording
    assert np.array_equal(recording.measured, recording.commanded)
    assert np.ptp(recording.measured, axis=0).max() > 0.03


def test_a_driver_may_change_what_it_is_given() -> None:
    class Greedy(FakeArm):
        def command(self, q: Any, qd: Any, qdd: Any) -> None:
            super().command(q, qd, qdd)
            for given in (q, qd, qdd):
                given[:] = 9.0

        def hold(self, q: Any) -> None:
            super().hold(q)
            q[:] = 9.0

    recording = execute(there(), Greedy(np.array(robot().home)), robot(), QUICK).motions[0].recording
    assert np.abs(recording.commanded - robot().home).max() < 0.05


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lag", np.full(6, np.nan)),
        ("lag", np.full(6, np.inf)),
        ("lag", np.full(6, -1.0)),
        ("lag", np.full(6, 1.001)),
        ("lag", np.zeros(7)),
        ("lag", None),
        ("simulated", float("nan")),
        ("simulated", None),
        ("simulated", "yes"),
        ("limits", lambda: None),
    ],
)
def test_a_driver_that_talks_nonsense_is_not_used(name: str, value: Any, arm: FakeArm) -> None:
    setattr(arm, name, value)
    with pytest.raises(InvalidRequest, match=f"^{name}: "):
        execute(there(), arm, robot(), QUICK)
    assert (arm.told, arm.held) == ([], [])


@pytest.mark.parametrize("name", ["limits", "positions"])
def test_a_driver_that_does_not_answer_is_not_used(name: str, arm: FakeArm, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise OSError("no route to the arm")

    monkeypatch.setattr(arm, name, fail)
    with pytest.raises(InvalidRequest, match="OSError: no route to the arm; expected an arm that answers"):
        execute(there(), arm, robot(), QUICK)


def test_limits_that_make_no_sense_are_refused() -> None:
    for velocity, upper in [(0.0, 1.0), (-1.0, 1.0), (1.0, -1.0)]:
        with pytest.raises(InvalidRequest, match=r"velocity|upper"):
            ArmLimits(np.zeros(6), np.full(6, upper), np.full(6, velocity))


def test_a_joint_of_an_arm_may_be_held_in_one_place() -> None:
    assert ArmLimits(np.ones(6), np.ones(6), np.ones(6)).upper.tolist() == [1.0] * 6


def test_an_arm_that_says_it_may_be_faster_than_the_robot_is_not_driven_faster(arm: FakeArm) -> None:
    motion = there().unwrap()[1].dilated(0.05)
    arm.velocity = 1e6
    with pytest.raises(InvalidRequest, match="speed: got 1, joint_"):
        execute(motion, arm, robot(), QUICK, allow_unproven=True)
    assert arm.told == []


def test_with_a_gripper_that_does_not_know_its_width_nothing_moves(arm: FakeArm) -> None:
    arm.width = float("nan")
    with pytest.raises(InvalidRequest, match="gripper: got nan; expected metres between the finger pads"):
        execute(in_two(), arm, robot(), QUICK)
    assert (arm.widths, arm.told, arm.held) == ([], [], [])


def test_a_motion_too_long_to_command_is_refused_before_the_first(arm: FakeArm) -> None:
    slow = there().unwrap()[1].dilated(1e4)
    with pytest.raises(InvalidRequest, match=r"commands in motion; expected one at which a motion has fewer than"):
        execute(slow, arm, robot(), replace(QUICK, speed=0.5), allow_unproven=True)
    assert (arm.told, arm.held) == ([], [])


class Hanging(FakeArm):
    """One of its methods does not return, the first time after so many commands."""

    method, after, passed = "", 20, 0
    hung = False

    def __init__(self, q: Any) -> None:
        super().__init__(q)
        self.released = threading.Event()

    def _hang(self, name: str) -> None:
        if name == self.method and not self.hung and len(self.told) >= self.after:
            self.passed -= 1
            if self.passed >= 0:
                return
            self.hung = True
            self.released.wait(20.0)

    def positions(self) -> Any:
        self._hang("positions")
        return super().positions()

    def command(self, q: Any, qd: Any, qdd: Any) -> None:
        self._hang("command")
        super().command(q, qd, qdd)

    def hold(self, q: Any) -> None:
        self._hang("hold")
        super().hold(q)

    def gripper_width(self) -> float:
        self._hang("gripper_width")
        return super().gripper_width()


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[Hanging]:
    monkeypatch.setattr(execution, "SILENT", 4)
    arm = Hanging(np.array(robot().home))
    yield arm
    arm.released.set()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["positions", "command", "gripper_width"])
def test_past_a_call_that_does_not_return_the_arm_is_told_to_hold(method: str, hanging: Hanging) -> None:
    hanging.method = method
    if method == "gripper_width":  # it is asked once before anything is commanded
        hanging.after, hanging.passed = 0, 1
    before = set(threading.enumerate())
    report = stopped(in_two(), hanging)
    assert f"{method}() of the driver has not returned for 0.2 s; the arm was told to hold" in present(report.stopped)
    assert len(hanging.held) == 1
    told = len(hanging.told)
    hanging.released.set()
    for thread in set(threading.enumerate()) - before:
        thread.join(20.0)  # the call returns, and nothing comes after it
    assert (len(hanging.told) - told <= (method == "command"), len(hanging.held)) == (True, 1)


@pytest.mark.slow
def test_of_a_hold_that_does_not_return_the_caller_is_told(hanging: Hanging) -> None:
    hanging.trouble, hanging.method = raising(20, OSError("the cable was pulled")), "hold"
    report = stopped(there(), hanging)
    assert "THE ARM COULD NOT BE TOLD TO HOLD" in present(report.stopped)
    assert "use its emergency stop" in present(report.stopped)


def test_ctrl_c_says_what_the_arm_was_told(arm: FakeArm) -> None:
    arm.trouble = raising(9, KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt, match="the arm was told to hold where it was"):
        execute(there(), arm, robot(), QUICK)
    assert len(arm.told) == 9
    assert [q.tolist() for q in arm.held] == [arm.positions().tolist()]
    arm.q, arm.refusals, arm.told = np.array(robot().home), 99, []
    with pytest.raises(KeyboardInterrupt, match="use its emergency stop"):
        execute(there(), arm, robot(), QUICK)


FILES = {str(Path(module.__file__)) for module in (execution, arm_module) if module.__file__}


def interrupted(call: Callable[[], Any], *at: int) -> str:
    """What comes of a call when Ctrl-C falls on these lines of those files, counted as they run."""
    seen = 0

    def line(frame: Any, event: str, _: Any) -> Any:
        nonlocal seen
        if event == "line":
            seen += 1
            if seen - 1 in at:
                raise KeyboardInterrupt
        return line

    sys.settrace(lambda frame, event, _: line if frame.f_code.co_filename in FILES else None)
    try:
        call()
        outcome = "done"
    except KeyboardInterrupt:
        outcome = "interrupted"
    except ExecutionStopped:
        outcome = "stopped"
    finally:
        sys.settrace(None)
    return outcome


@pytest.mark.slow
@pytest.mark.parametrize("twice", [False, True])
@pytest.mark.parametrize("fails", [False, True])
def test_ctrl_c_on_any_line_has_a_commanded_arm_hold(fails: bool, twice: bool) -> None:
    def trouble(step: int) -> None:
        time.sleep(0.0005)  # really, so that lines of the waiting thread fall between commands
        if fails and step == 25:
            raise OSError("the cable was pulled")

    at, outcome = -1, "interrupted"
    while outcome == "interrupted":
        at += 1
        arm = FakeArm(np.array(robot().home), trouble=trouble)
        outcome = interrupted(partial(execute, there(), arm, robot(), QUICK), *range(at, at + 1 + twice))
        arrived = len(arm.told) > 0 and np.array_equal(arm.told[-1][0], robot().home + STEP)
        assert arm.held or arrived or not arm.told, f"line {at}: {len(arm.told)} commands, {outcome}"
    assert outcome == ("stopped" if fails else "done")
    assert at > 60
