"""Two arms driven together: both arrive, or both come to rest where their proof has them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from planner_service import PlanRequest, Pose, load_robot
from planner_service.cell import Arm, Cell, CellPlan
from planner_service.errors import InvalidRequest, NotProven, PlanningFailed
from planner_service.execute import Streaming
from planner_service.execute.cells import CellReport, CellStopped, execute_cell
from planner_service.geometry.arrays import FloatArray
from tests.support.arms import FakeArm, raising

HOW = Streaming(speed=0.5, rate=100.0, settle=0.2, latest=1.0)
"""Whatever else the machine does, a tick is not a second late."""

ASIDE = [-0.5, 1.4, 1.2, -0.8, 0.0, 0.0]
SHORT = Streaming(speed=0.5, rate=100.0, settle=0.2, latest=0.1)


@cache
def cell() -> Cell:
    robot = load_robot("wxai")
    return Cell({"left": Arm(robot, Pose((0.0, 0.2, 0.0))), "right": Arm(robot, Pose((0.0, -0.2, 0.0)))}, "table")


@cache
def plan() -> CellPlan:
    """Both arms go to the left, the right one after the left one."""
    requests = {
        "left": PlanRequest([-0.6, 1.4, 1.2, -0.8, 0.0, 0.0], [0.5, 1.4, 1.2, -0.8, 0.0, 0.0]),
        "right": PlanRequest(ASIDE, [0.6, 1.4, 1.2, -0.8, 0.0, 0.0]),
    }
    return cell().plan(requests, delay=0.4)


def arms() -> dict[str, FakeArm]:
    begin = plan()(0.0)
    width = cell().arm("left").robot.gripper_width
    return {name: FakeArm(cell().of_arm(name, begin), width=width) for name in cell().arms}


def stopped(drivers: dict[str, FakeArm], how: Streaming = HOW) -> CellReport:
    with pytest.raises(CellStopped) as caught:
        execute_cell(cell(), plan(), drivers, how)
    return caught.value.report


def refused(error: type[Exception], what: CellPlan, drivers: dict[str, FakeArm], how: Streaming = HOW) -> str:
    """Nothing has been commanded then."""
    with pytest.raises(error) as caught:
        execute_cell(cell(), what, drivers, how)
    assert not any(arm.told for arm in drivers.values())
    return str(caught.value)


def test_both_arms_arrive_and_the_report_says_how_late_one_was() -> None:
    drivers = arms()
    report = execute_cell(cell(), plan(), drivers, HOW)
    end = plan()(plan().duration)
    for name, arm in drivers.items():
        assert np.abs(arm.q - cell().of_arm(name, end)).max() < 1e-6
        assert np.all(np.diff(report.arms[name].clock) >= 0.0)
        assert np.all(report.arms[name].seen <= report.arms[name].clock)
    assert report.ok
    assert 0.0 < report.behind < report.tolerated == plan().tolerates
    assert report.document()["arms"]["left"]["off"] < 1e-6


def test_if_one_driver_hangs_the_other_arm_rests_on_its_path_within_the_delay() -> None:
    drivers = arms()
    drivers["left"].trouble = lambda k: time.sleep(1.6) if k == 50 else None
    report = stopped(drivers, SHORT)
    left, right = report.arms["left"], report.arms["right"]
    assert right.clock[-1] - left.clock[-1] <= report.tolerated
    at = plan()(min(right.clock[-1], plan().duration))
    assert np.abs(drivers["right"].q - cell().of_arm("right", at)).max() < 1e-6
    assert not drivers["right"].held
    assert len(drivers["left"].held) == 1
    assert "right rests on its path" in str(report.stopped)
    assert "left was last seen" in str(report.stopped)


def test_if_one_driver_fails_the_other_arm_brakes_along_its_path() -> None:
    drivers = arms()
    drivers["right"].trouble = raising(60, OSError("unplugged"))
    report = stopped(drivers)
    speeds = np.diff(report.arms["left"].recording.commanded, axis=0)
    assert np.abs(speeds[-1]).max() == 0.0
    assert str(report.stopped).startswith("right failed; ")
    assert "right was stopped by OSError: unplugged" in str(report.stopped)
    assert "left rests on its path" in str(report.stopped)
    assert len(drivers["right"].held) == 1
    assert not report.ok


def test_an_arm_that_does_not_move_stops_both() -> None:
    drivers = arms()
    begin = drivers["left"].q
    drivers["left"].seen = lambda: begin
    report = stopped(drivers)
    assert report.arms["right"].clock[-1] < plan().duration
    assert "left" in str(report.stopped)


def test_an_interrupt_stops_both_along_their_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    drivers, main = arms(), threading.main_thread()
    wait: Callable[..., None] = threading.Thread.join
    begun = time.perf_counter()

    def interrupted(thread: threading.Thread, timeout: float | None = None) -> None:
        if threading.current_thread() is main and time.perf_counter() - begun > 0.8 and not raised:
            raised.append(True)
            raise KeyboardInterrupt
        wait(thread, timeout)

    raised: list[bool] = []
    monkeypatch.setattr(threading.Thread, "join", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        execute_cell(cell(), plan(), drivers, HOW)
    assert str(caught.value).count("rests on its path") == 2
    ends = [arm.told[-1][1] for arm in drivers.values()]
    assert not np.any(ends)


def test_nothing_moves_unless_all_of_it_is_proven_again() -> None:
    forged = replace(plan(), tolerates=3.0)
    assert "not proven apart" in refused(NotProven, forged, arms())
    sooner = replace(plan(), clocks=tuple(replace(clock, start=0.0) for clock in plan().clocks))
    assert any(clock.start > 0.0 for clock in plan().clocks)
    assert "not proven apart" in refused(NotProven, sooner, arms())
    elsewhere = replace(plan(), still=plan().still[:6])
    assert "expected 12 joint values" in refused(NotProven, elsewhere, arms())
    twice = replace(plan(), clocks=(plan().clocks[0],) * 2)
    assert "more than one motion" in refused(NotProven, twice, arms())
    failed = cell().plan({"left": PlanRequest(np.full(6, 0.1), [0.0, 3.1, 0.0, 0.0, 0.0, 0.0])})
    refused(PlanningFailed, failed, arms())


def test_arms_that_are_not_as_the_plan_has_them_are_not_moved() -> None:
    moved, open_, alone, more = arms(), arms(), arms(), arms()
    moved["right"].q = moved["right"].q + 0.02
    assert "start of right" in refused(InvalidRequest, plan(), moved)
    open_["left"].width = 0.02
    assert "gripper of left" in refused(InvalidRequest, plan(), open_)
    del alone["right"]
    assert "a driver of each of ['left', 'right']" in refused(InvalidRequest, plan(), alone)
    more["third"] = more["left"]
    assert "a driver of each" in refused(InvalidRequest, plan(), more)
    real = arms()
    real["left"].simulated = False
    assert "all simulated, or none" in refused(InvalidRequest, plan(), real)
    slow = arms()
    slow["left"].velocity = 0.1
    assert "speed" in refused(InvalidRequest, plan(), slow)


def test_a_delay_in_which_no_arm_can_stop_is_refused_with_the_one_that_would_do() -> None:
    assert "plan with more, or drive at a lower speed" in refused(
        InvalidRequest, plan(), arms(), replace(HOW, speed=1.0)
    )


def test_an_arm_that_stands_needs_no_driver_and_is_looked_at_if_it_has_one() -> None:
    goal: FloatArray = np.array([0.0, 1.4, 1.2, -0.8, 0.0, 0.0])
    request = PlanRequest([-0.6, 1.4, 1.2, -0.8, 0.0, 0.0], goal)
    alone = cell().plan({"left": request}, standing={"right": ASIDE})
    drivers = arms()
    execute_cell(cell(), alone, {"left": drivers["left"]}, HOW)
    assert np.abs(drivers["left"].q - goal).max() < 1e-6
    again = arms()
    again["right"].q = again["right"].q + 0.1
    assert "start of right" in refused(InvalidRequest, alone, again)
    near: FloatArray = np.array([0.6, 1.4, 1.2, -0.8, 0.0, 0.0])
    forged = replace(alone, still=cell().joined({"left": np.asarray(request.start), "right": near}))
    refused(NotProven, forged, arms())


def test_arms_that_share_a_clock_are_driven_each_by_its_own() -> None:
    requests = {clock.arms[0]: clock.plan for clock in plan().clocks}
    start, goal = plan()(0.0), plan()(plan().duration)
    whole = cell().service.plan(PlanRequest(start, goal, velocity_scale=0.2, acceleration_scale=0.04))
    columns = tuple(clock.columns[0] for clock in plan().clocks)
    shared = replace(plan().clocks[0], arms=tuple(requests), plan=whole, start=0.0, columns=columns)
    drivers = arms()
    report = execute_cell(cell(), replace(plan(), clocks=(shared,), tolerates=0.4), drivers, replace(HOW, speed=1.0))
    assert report.ok
    for name, arm in drivers.items():
        assert np.abs(arm.q - cell().of_arm(name, goal)).max() < 1e-6
