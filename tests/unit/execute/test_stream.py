"""What is checked before an arm moves, what it is told, and that it holds however the stream ends."""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from planner_service import InvalidRequest, JointPath, NotProven, PlanRequest, PlanResult, Trajectory, Trapezoidal
from planner_service.certify import ExemptInterval, Refusal
from planner_service.collision import CheckCounts
from planner_service.execute import ExecutionStopped, Streaming, TrossenDriver, execute, meant_contacts, taken
from planner_service.geometry.arrays import FloatArray
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.tasks import Segment
from tests.support.arms import QUICK, STEP, FakeArm, FakeTime, back, raising, robot, service, stopped, there
from tests.support.command import refused
from tests.support.command import run as command
from tests.support.optional import present

WORLD = ["--robot", "wxai", "--scene", "empty"]
ARM = ("--arm", "192.168.1.2")


def motion_of(result: PlanResult) -> Trajectory:
    return result.unwrap()[1]


def task_of(*segments: Segment) -> SavedTask:
    return SavedTask(service().world, "there and back", segments, CheckCounts(), 0.0)


def test_an_arm_that_stands_elsewhere_is_not_moved(arm: FakeArm) -> None:
    arm.q = robot().home + np.array([0.0, 0.0, -0.015, 0.0, 0.0, 0.0])
    with pytest.raises(InvalidRequest, match=r"joint_2 at 1\.1350; expected 1\.1500 within 0\.01 \(start_tolerance\)"):
        execute(there(), arm, robot(), QUICK)
    assert arm.told == []
    execute(there(), arm, robot(), replace(QUICK, start_tolerance=0.02))
    assert arm.told


def test_a_trajectory_without_a_proof_is_executed_only_if_told(arm: FakeArm) -> None:
    with pytest.raises(InvalidRequest, match="a bare trajectory only with allow_unproven=True"):
        execute(motion_of(there()), arm, robot(), QUICK)
    assert arm.told == []
    assert execute(motion_of(there()), arm, robot(), QUICK, allow_unproven=True).ok


def test_what_counts_is_the_proof_made_now_and_not_the_one_a_plan_brings(arm: FakeArm) -> None:
    refusal = Refusal(0.0, 0.1, 0.0, "link_2", "link_5", "they touch")
    brought = replace(there(), certificate=replace(present(there().certificate), refusal=refusal))
    assert execute(brought, arm, robot(), QUICK).ok


def test_a_plan_made_for_another_robot_is_not_executed(arm: FakeArm) -> None:
    other = replace(robot(), settle_time=9.0)
    saved = SavedPlan(replace(service().world, robot=other), None, there())
    with pytest.raises(InvalidRequest, match=r"expected a plan made for this robot \(--robot\), wxai"):
        execute(saved, arm, robot(), QUICK)
    assert arm.told == []
    assert execute(replace(saved, begin=service().world), arm, robot(), QUICK).ok


def test_nothing_is_executed_that_is_no_plan(arm: FakeArm) -> None:
    failed = service().plan(PlanRequest(service().robot.home, np.full(6, 9.0)))
    task = replace(task_of(Segment("there", failed, 0.06)), failure=failed.failure)
    given: Any
    for given, message in [
        ("plan.json", "a plan, a saved plan, a task or a trajectory"),
        (failed, "GOAL_OUTSIDE_LIMITS"),
        (task, "expected a plan, not a failure"),
    ]:
        with pytest.raises(InvalidRequest, match=message):
            execute(given, arm, robot(), QUICK)
    assert arm.told == []


def test_a_motion_that_begins_at_speed_is_not_executed(arm: FakeArm) -> None:
    whole = motion_of(there())
    k = len(whole.durations) // 2
    begin = float(whole.coefficients[k, 0])
    cut = Trajectory(whole.path, whole.durations[k:], whole.coefficients[k:], part=(begin, whole.end))
    arm.q = cut(0.0)
    with pytest.raises(InvalidRequest, match="one that begins at rest"):
        execute(cut, arm, robot(), QUICK, allow_unproven=True)
    assert arm.told == []


def test_a_motion_faster_than_the_arm_may_be_is_refused_with_the_speed_that_would_do(arm: FakeArm) -> None:
    arm.velocity = 0.2
    with pytest.raises(InvalidRequest, match=r"speed: got 1, joint_. moving at .*; expected at most 0\.") as caught:
        execute(there(), arm, robot(), QUICK)
    assert arm.told == []
    allowed = float(caught.value.expected.split()[2].rstrip(":"))
    execute(there(), arm, robot(), replace(QUICK, speed=allowed * 0.999))
    fastest = max(float(np.abs(qd).max()) for _, qd, _ in arm.told)  # 250 times a second it may be missed by little
    assert 0.19 < fastest <= 0.2


@pytest.mark.parametrize("whose", ["the arm", "the robot"])
def test_a_motion_outside_position_limits_is_refused(whose: str, arm: FakeArm) -> None:
    narrow = replace(robot(), limits=replace(robot().limits, upper=np.array([3.0, 3.0, 1.16, 1.5, 1.5, 3.0])))
    arm.reach = 1.16 if whose == "the arm" else arm.reach
    with pytest.raises(InvalidRequest, match=f"joint_2 in motion: .*; expected {whose}'s .* to 1.1600"):
        execute(motion_of(there()), arm, robot() if whose == "the arm" else narrow, QUICK, allow_unproven=True)
    assert arm.told == []


def test_a_real_arm_moves_at_a_fifth_of_the_speed_by_default(arm: FakeArm) -> None:
    arm.simulated = False
    report = execute(there(), arm, robot(), QUICK)
    whole = motion_of(there())
    assert report.speed == 0.2
    assert report.motions[0].duration == pytest.approx(5.0 * whole.duration, rel=1e-12)
    wanted = whole.sample(0.004 / 5.0)
    rows = np.concatenate([wanted.q, wanted.qd / 5.0, wanted.qdd / 25.0], axis=1)[:-1]
    for told in arm.told[:20]:
        assert np.abs(rows - np.concatenate(told)).max(axis=1).min() < 1e-9


def test_commands_are_ahead_by_the_arms_lag(arm: FakeArm) -> None:
    arm.lag = np.array([0.05, 0.05, 0.05, 0.05, 0.1, 0.1])
    motion = execute(there(), arm, robot(), QUICK).motions[0]
    samples = motion.trajectory.sample(0.004)
    wanted = samples.q + arm.lag * samples.qd
    wanted[-1] = samples.q[-1]
    assert max(np.abs(wanted - row).max(axis=1).min() for row in motion.recording.commanded) < 1e-12
    assert (
        np.abs(motion.recording.commanded - motion.trajectory(0.0)).max() > np.abs(STEP).max()
    )  # ahead of its end, too
    assert np.array_equal(motion.recording.commanded[-1], samples.q[-1])


def test_every_tick_is_told_and_recorded_until_the_arm_has_settled(arm: FakeArm) -> None:
    report = execute(there(), arm, robot(), replace(QUICK, settle=0.1))
    (motion,) = report.motions
    m = len(motion.recording.t)
    assert m == len(arm.told)
    assert motion.recording.skipped == 0
    due = motion.trajectory.sample(0.004).t
    assert motion.recording.t[: len(due)] == pytest.approx(due, abs=1e-9)
    assert motion.recording.measured.shape == motion.recording.commanded.shape == (m, 6)
    assert (report.ok, report.stopped, motion.completed, arm.held) == (True, None, True, [])
    for q, qd, qdd in arm.told[-5:]:
        assert np.array_equal(q, motion.trajectory(motion.duration))
        assert not qd.any()
        assert not qdd.any()
    assert motion.recording.t[-1] > motion.duration + 0.09


def test_errors_are_told_joint_by_joint_and_in_metres_of_the_tool(arm: FakeArm) -> None:
    arm.off = np.array([0.004, 0.0, 0.0, 0.0, 0.0, 0.0])
    (motion,) = execute(there(), arm, robot(), QUICK).motions
    assert motion.final_error == pytest.approx([0.004, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-12)
    recording, planned = motion.recording, motion.trajectory(np.minimum(motion.recording.t, motion.duration))
    error = np.abs(recording.measured - planned)[recording.t <= motion.duration + 1e-9]
    assert motion.error_max.tolist() == error.max(axis=0).tolist()
    assert motion.error_rms == pytest.approx(np.sqrt((error**2).mean(axis=0)), rel=1e-12)
    assert (motion.ticks, motion.late) == (len(error), 0)
    tools = [np.array([robot().tool_pose(q)[:3, 3] for q in Q]) for Q in (recording.measured, planned)]
    assert motion.tool_lag == pytest.approx(np.linalg.norm(tools[0] - tools[1], axis=1).max(), rel=1e-12)
    end = robot().tool_pose(motion.trajectory(motion.duration))[:3, 3]
    moved = robot().tool_pose(motion.trajectory(motion.duration) + arm.off)[:3, 3]
    assert motion.tool_lag >= float(np.linalg.norm(end - moved)) - 1e-12
    assert 0.0 < motion.tool_off_path <= motion.tool_lag


def test_when_the_driver_fails_the_arm_holds_where_it_is(arm: FakeArm) -> None:
    k = 17
    arm.trouble, arm.off = raising(k, OSError("the cable was pulled")), np.full(6, 0.002)
    with pytest.raises(ExecutionStopped, match="the cable was pulled") as caught:
        execute(there(), arm, robot(), QUICK)
    report = caught.value.report
    assert isinstance(caught.value.__cause__, OSError)
    assert len(arm.told) == k
    assert [q.tolist() for q in arm.held] == [arm.positions().tolist()]
    assert report.stopped == "stopped by OSError: the cable was pulled; the arm was told to hold where it was"
    (motion,) = report.motions
    assert (len(motion.recording.t), motion.completed, report.ok) == (k, False, False)


def test_a_stream_that_is_too_late_stops_and_holds_the_arm(arm: FakeArm, clock: FakeTime) -> None:
    def stall(step: int) -> None:
        if step == 5:
            clock.sleep(0.08)

    arm.trouble = stall
    report = stopped(there(), arm, replace(QUICK, latest=0.03))
    assert "0.03 s are allowed (latest)" in present(report.stopped)
    assert (len(arm.told), len(arm.held)) == (6, 1)


def test_ticks_that_have_passed_are_left_out_and_counted(arm: FakeArm, clock: FakeTime) -> None:
    arm.trouble = lambda k: clock.sleep(0.010)  # two and a half ticks
    (motion,) = execute(there(), arm, robot(), QUICK).motions
    ticks = len(motion.trajectory.sample(0.004).t)
    told = int((motion.recording.t <= motion.duration).sum())
    assert told == pytest.approx(ticks * 0.4, abs=2)
    assert motion.recording.skipped == pytest.approx(ticks * 0.6, abs=2)
    assert motion.late >= motion.recording.skipped
    assert np.array_equal(arm.told[-1][0], motion.trajectory(motion.duration))
    assert float(motion.recording.lateness.max()) < 0.012  # it does not fall behind


@pytest.mark.parametrize("answer", ["an error", "elsewhere"])
def test_an_arm_that_does_not_say_where_it_is_holds_what_was_planned_last(answer: str, arm: FakeArm) -> None:
    arm.lag = np.full(6, 0.05)

    def fail(step: int) -> None:
        if step == 12:
            arm.seen = seen
            raise OSError("no answer")

    def seen() -> FloatArray:
        if answer == "an error":
            raise OSError("no answer")
        return np.full(6, 3.0)

    arm.trouble = fail
    report = stopped(there(), arm)
    planned = report.motions[0].trajectory.sample(0.004).q
    assert present(report.stopped).endswith(
        "hold the last planned configuration, as it gave no reading that can be believed"
    )
    assert np.array_equal(arm.held, planned[12:13])  # not where it was told to be, which is ahead of its path


@pytest.mark.parametrize(("refusals", "holds"), [(2, 1), (99, 0)])
def test_an_arm_is_told_to_hold_until_it_hears_or_the_caller_is_told(refusals: int, holds: int, arm: FakeArm) -> None:
    arm.trouble, arm.refusals = raising(0, OSError("no answer")), refusals
    report = stopped(there(), arm)
    assert len(arm.held) == holds
    assert ("use its emergency stop" in present(report.stopped)) == (holds == 0)


def grip_of(result: PlanResult) -> PlanResult:
    """The plan, as if the fingers touched a block at its end."""
    return touching(result, ("finger_left", "block"), ("finger_right", "block"))


def touching(result: PlanResult, *pairs: tuple[str, str]) -> PlanResult:
    """The plan, as if these pairs were meant to touch."""
    touch = ExemptInterval(0.0, 0.01, pairs, "they are meant to")
    return replace(result, certificate=replace(present(result.certificate), exempt=(touch,)))


def test_the_gripper_moves_between_motions_and_presses_on_what_it_takes(arm: FakeArm) -> None:
    down, up = Segment("descend", grip_of(there()), 0.07), Segment("lift", touching(back(), ("block", "floor")), 0.045)
    lower, away = Segment("lower", there(), 0.045), Segment("retreat", grip_of(back()), 0.07)
    task = task_of(down, up, lower, away)
    arm.stone = 0.045
    report = execute(task, arm, robot(), replace(QUICK, squeeze=0.01), allow_unproven=True)
    assert arm.widths == pytest.approx([0.07, 0.035, 0.07])
    assert [motion.name for motion in report.motions] == ["descend", "lift", "lower", "retreat"]
    assert taken(task, robot()) == ("block",)
    pairs = [("finger_left", "block"), ("finger_right", "block"), ("block", "floor")]
    assert meant_contacts(task) == {frozenset(pair) for pair in pairs}


def test_the_arm_stands_still_before_a_motion_for_as_long_as_its_task_says(clock: FakeTime) -> None:
    def seconds_with(wait: float) -> float:
        began = clock.now
        task = task_of(Segment("there", there(), 0.045), replace(Segment("back", back(), 0.045), wait=wait))
        execute(task, FakeArm(np.array(robot().home)), robot(), QUICK, allow_unproven=True)
        return clock.now - began

    assert seconds_with(7.5) - seconds_with(0.0) == pytest.approx(7.5, abs=0.02)


def test_motions_that_do_not_follow_each_other_are_refused(arm: FakeArm) -> None:
    twice = task_of(Segment("there", there(), 0.06), Segment("again", there(), 0.06))
    with pytest.raises(InvalidRequest, match=r"begin of again: got joint_0 at 0\.0000; expected 0\.0400 within"):
        execute(twice, arm, robot(), QUICK, allow_unproven=True)
    with pytest.raises(NotProven, match=r"again: got a start with joint_0 at 0; expected 0\.04, where there ends"):
        execute(twice, arm, robot(), QUICK)
    assert (arm.told, arm.widths) == ([], [])


def test_an_arm_that_does_not_follow_is_stopped_and_holds_where_it_is(arm: FakeArm) -> None:
    stuck = robot().home + 0.1 * STEP
    arm.seen = lambda: stuck.copy() if np.abs(arm.q - robot().home).max() > 0.004 else arm.q
    report = stopped(there(12.0), arm, replace(QUICK, speed=0.2))
    assert "within 0.1 (tracking_tolerance); the arm was told to hold where it was" in present(report.stopped)
    assert np.array_equal(arm.held, [stuck])
    told = float(np.abs(arm.told[-1][0] - stuck).max())
    fastest = float(np.abs(arm.told[-1][1]).max())
    assert 0.1 < told < 0.1 + (QUICK.latest + 0.01) * fastest


def test_an_arm_that_follows_late_but_on_its_path_goes_on(arm: FakeArm, clock: FakeTime) -> None:
    whole, began = motion_of(there(12.0)), clock.now
    arm.seen = lambda: whole(min(max(clock.now - began - 0.17, 0.0), whole.duration))
    assert float(np.abs(whole(np.linspace(0.0, whole.duration, 50), 1)).max()) > 1.2  # 0.2 rad behind, then
    assert execute(there(12.0), arm, robot(), replace(QUICK, settle=0.3)).ok


def test_what_a_server_planned_is_proven_again_in_a_world_of_ones_own(arm: FakeArm) -> None:
    plan, arm.simulated = there(), False
    assert plan.origin is not None
    served = replace(plan, origin=replace(plan.origin, elsewhere=True))
    with pytest.raises(InvalidRequest, match="a plan from a file or a server moves a real arm only in your own robot"):
        execute(served, arm, streaming=QUICK)
    assert arm.told == []
    assert execute(served, arm, streaming=QUICK, service=service()).ok


@pytest.mark.parametrize(("stone", "stands"), [(0.0, "0.0350"), (0.06, "0.0600")])
def test_a_grip_on_nothing_or_on_something_else_stops(stone: float, stands: str, arm: FakeArm) -> None:
    arm.stone = stone
    task = task_of(Segment("down", grip_of(there()), 0.07), Segment("up", back(), 0.045))
    report = stopped(task, arm, allow_unproven=True)
    assert [motion.name for motion in report.motions] == ["down"]
    assert f"gripper: got {stands}; expected 0.0450 within 0.005 (gripper_tolerance)" in present(report.stopped)
    assert len(arm.held) == 1


def test_settings_out_of_range_are_refused() -> None:
    for name, value in [
        *(("speed", 0.0), ("speed", 1.1), ("rate", 5.0), ("start_tolerance", -0.5), ("settle", -1.0)),
        *(("latest", math.nan), ("latest", 0)),
    ]:
        with pytest.raises(InvalidRequest, match=name):
            Streaming(**{name: value})


def test_an_error_of_the_arm_is_not_cleared_by_connecting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever stopped the arm by its error decides when it may move again."""
    library = MagicMock(RuntimeError=RuntimeError, LogicError=ValueError)
    monkeypatch.setitem(sys.modules, "trossen_arm", library)
    assert not TrossenDriver("192.168.1.2", timeout=3.0).simulated
    *_, address, clear_error, timeout = library.TrossenArmDriver().configure.call_args.args
    assert (address, clear_error, timeout) == ("192.168.1.2", False, 3.0)


@pytest.fixture
def saved(tmp_path: Path) -> str:
    save_plan(SavedPlan(service().world, None, there()), tmp_path / "plan.json")
    return str(tmp_path / "plan.json")


@pytest.mark.usefixtures("unconnected")
def test_a_real_arm_is_not_even_connected_to_without_yes(saved: str) -> None:
    told = refused("run", saved, *ARM)
    assert "would move the arm at 192.168.1.2: motion;" in told
    assert "20% of the planned speed" in told
    assert "Nothing moved" in told


def test_with_yes_the_arm_moves_at_a_fifth_of_the_speed(saved: str, real: FakeArm) -> None:
    done = command("run", saved, *ARM, "--yes", *WORLD)
    assert (done.exit_code, done.stderr) == (0, "")
    assert "executed on the arm" in done.stdout
    assert "at 20% of the planned speed" in done.stdout
    assert real.q == pytest.approx(robot().home + STEP)
    assert real.closed


@pytest.mark.usefixtures("real")
def test_what_a_file_says_is_proven_is_proven_anew(tmp_path: Path) -> None:
    places = np.random.default_rng(1).uniform(robot().limits.lower, robot().limits.upper, (200, robot().n))
    into = next(q for q in places if not service().checker.state_is_free(q))
    path = JointPath(np.array([robot().home, into]))
    motion = Trapezoidal().time_path(path, robot().limits)
    forged = replace(back(), path=path, trajectory=motion)
    plan, task = SavedPlan(service().world, None, forged), task_of(Segment("fold", forged, 0.08))
    for saved in (plan, task):
        save_plan(saved, tmp_path / "plan.json")
        done = command("run", tmp_path / "plan.json", *ARM, "--yes")
        assert done.exit_code == 1
        assert "is not proven apart" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_whatever_ends_the_command_has_the_arm_hold(name: str, saved: str, real: FakeArm) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)

    def end(step: int) -> None:
        if step == 7:
            assert signal.getsignal(number) != signal.SIG_DFL, "it would end this process"
            os.kill(os.getpid(), number)
            time.sleep(0.1)  # really: the signal ends the wait of another thread

    real.trouble = end
    done = command("run", saved, *ARM, "--yes", *WORLD)
    assert done.exit_code == 130
    assert "interrupted; the arm was told to hold where it was" in done.stderr
    assert (len(real.told), len(real.held), real.closed) == (8, 1, True)
    assert signal.getsignal(number) == before


def test_what_cannot_be_run_is_bad_input() -> None:
    for words, message in [
        (["run"], "either --sim or --arm ADDRESS"),
        (["run", "--sim", "--arm", "192.168.1.2"], "either --sim or --arm ADDRESS"),
        (["run", "--arm", "192.168.1.2", "--yes"], "a saved plan or task"),
        (["run", "--sim", "--speed", "2"], "a part of the planned speed"),
    ]:
        assert message in refused(*words)
