"""Drivers that lie, fail, hang or are interrupted: no reading is trusted, and the arm holds whatever happens."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import InvalidRequest
from planner_service.collision import CheckCounts
from planner_service.execute import ArmLimits, ExecutionStopped, execute
from planner_service.execute import arm as arm_module
from planner_service.execute import stream as execution
from planner_service.records.plan_file import SavedTask
from planner_service.tasks import Segment
from tests.support.arms import QUICK, STEP, FakeArm, raising, robot, service, stopped, there
from tests.support.optional import present

PLANNED = "the arm was told to hold the last planned configuration, as it gave no reading that can be believed"


def in_two() -> SavedTask:
    """A task whose gripper closes before its motion."""
    return SavedTask(service().world, "close and go", (Segment("go", there(), 0.03),), CheckCounts(), 0.0)


@pytest.mark.parametrize(("joint", "jump"), [(0, 0.15), (4, -0.45)])
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


READINGS: dict[str, Callable[[Any], Any]] = {
    "text": lambda q: np.array(["a"] * 6),
    "too few": lambda q: q[:5],
    "a number": lambda q: 0.3,
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


def test_an_arm_whose_first_reading_is_malformed_is_not_moved(arm: FakeArm) -> None:
    arm.seen = lambda: np.full(6, np.nan)
    with pytest.raises(InvalidRequest, match="arm: got joint_"):
        execute(there(), arm, robot(), QUICK)
    assert arm.told == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lag", np.full(6, np.nan)),
        ("lag", np.full(6, -1.0)),
        ("lag", np.zeros(7)),
        ("lag", None),
        ("simulated", None),
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
@pytest.mark.parametrize(("fails", "twice"), [(False, True), (True, False)])
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
