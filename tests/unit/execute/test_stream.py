"""What is checked before an arm moves, what it is told, and that it holds however the stream ends."""

from __future__ import annotations

import math
import os
import re
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from planner_service import (
    InvalidRequest,
    JointPath,
    MissingDependency,
    NotProven,
    PlannerService,
    PlanRequest,
    PlanResult,
    Trajectory,
    Trapezoidal,
)
from planner_service.certify import ExemptInterval, Refusal
from planner_service.collision import CheckCounts
from planner_service.execute import (
    ExecutedMotion,
    ExecutionStopped,
    Streaming,
    TrossenDriver,
    execute,
    meant_contacts,
    taken,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.tasks import Segment, TaskResult
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


@pytest.mark.parametrize("proof", ["none", "refused", "of a part"])
def test_what_counts_is_the_proof_made_now_and_not_the_one_a_plan_brings(proof: str, arm: FakeArm) -> None:
    certificate = {
        "none": None,
        "refused": replace(
            present(there().certificate), refusal=Refusal(0.0, 0.1, 0.0, "link_2", "link_5", "they touch")
        ),
        "of a part": replace(present(there().certificate), part=(0.01, motion_of(there()).end)),
    }[proof]
    assert execute(replace(there(), certificate=certificate), arm, robot(), QUICK).ok


def test_a_plan_made_for_another_robot_is_not_executed(arm: FakeArm) -> None:
    other = replace(robot(), settle_time=9.0)
    saved = SavedPlan(replace(service().world, robot=other), None, there())
    with pytest.raises(InvalidRequest, match=r"expected a plan made for this robot \(--robot\), wxai"):
        execute(saved, arm, robot(), QUICK)
    assert arm.told == []
    assert execute(replace(saved, begin=service().world), arm, robot(), QUICK).ok


def test_no_plan_is_not_executed(arm: FakeArm) -> None:
    failed = service().plan(PlanRequest(service().robot.home, np.full(6, 9.0)))
    with pytest.raises(InvalidRequest, match="GOAL_OUTSIDE_LIMITS"):
        execute(failed, arm, robot(), QUICK)
    assert arm.told == []


def test_nothing_is_executed_that_is_no_plan(arm: FakeArm) -> None:
    with pytest.raises(InvalidRequest, match="a plan, a saved plan, a task or a trajectory"):
        execute("plan.json", arm, robot(), QUICK)  # type: ignore[arg-type]


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


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("beyond", [5e-5, 2e-4])
def test_what_a_controller_rounded_is_within_its_limits(beyond: float, side: str, arm: FakeArm) -> None:
    """Controllers keep their limits in single precision."""
    whole, wide = motion_of(there()), arm.limits()
    points = whole.path.waypoints
    end = points.min(axis=0) + beyond if side == "lower" else points.max(axis=0) - beyond
    arm.limits = lambda: replace(wide, **{side: end})  # type: ignore[method-assign]
    if beyond < 1e-4:
        execute(whole, arm, robot(), QUICK, allow_unproven=True)
        return
    with pytest.raises(InvalidRequest, match="expected the arm's"):
        execute(whole, arm, robot(), QUICK, allow_unproven=True)


def test_an_arm_of_other_joints_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="the 6 joints of wxai"):
        execute(there(), FakeArm(np.zeros(5)), robot(), QUICK)


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


def test_what_an_arm_is_told_ahead_stays_inside_its_limits(arm: FakeArm) -> None:
    arm.lag, arm.reach = np.full(6, 1.0), 1.2501  # joint_3 stands at -1.25 and moves by 0.02 rad
    how = replace(QUICK, tracking_tolerance=1.0)  # this arm follows a command at once, without its lag
    execute(there(), arm, robot(), how)
    assert max(float(np.abs(q).max()) for q, _, _ in arm.told) <= 1.2501


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


@pytest.mark.parametrize("swings", [True, False])
def test_an_arm_is_recorded_until_it_rests_or_its_time_is_over(swings: bool, arm: FakeArm) -> None:
    def swing(step: int) -> None:
        arm.off = np.full(6, 0.001 * (step // 3 % 2))

    arm.trouble = swing if swings else arm.trouble
    (motion,) = execute(there(), arm, robot(), replace(QUICK, settle=1.0)).motions
    settling = float(motion.recording.t[-1]) - motion.duration
    assert (settling > 0.95) == swings
    assert settling > 0.1


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


def test_an_arm_that_runs_on_past_its_end_is_off_its_path(arm: FakeArm, clock: FakeTime) -> None:
    whole, began = motion_of(there()), clock.now
    end = np.array(whole(whole.duration))

    def further() -> FloatArray:
        after = clock.now - began
        return whole(after) if after < whole.duration else end + 0.005 * STEP / np.abs(STEP).max()

    arm.seen = further
    (motion,) = execute(there(), arm, robot(), QUICK).motions
    beyond = robot().tool_pose(motion.recording.measured[-1])[:3, 3] - robot().tool_pose(end)[:3, 3]
    assert motion.tool_off_path == pytest.approx(float(np.linalg.norm(beyond)), rel=1e-9)


def test_an_arm_that_is_only_late_is_on_its_path(arm: FakeArm, clock: FakeTime) -> None:
    whole, began = motion_of(there()), clock.now

    def late() -> FloatArray:
        return whole(min(max(clock.now - began - 0.05, 0.0), whole.duration))

    arm.seen = late
    (motion,) = execute(there(), arm, robot(), replace(QUICK, settle=0.1)).motions
    assert motion.tool_lag > 0.002
    assert motion.tool_off_path < 2e-5


@pytest.mark.parametrize("k", [0, 1, 17])
def test_when_the_driver_fails_the_arm_holds_where_it_is(k: int, arm: FakeArm) -> None:
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


def test_ctrl_c_while_the_gripper_moves_holds_the_arm(arm: FakeArm, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(width: float, seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(arm, "move_gripper", interrupt)
    with pytest.raises(KeyboardInterrupt):
        execute(task_of(Segment("there", there(), 0.06)), arm, robot(), QUICK)
    assert [q.tolist() for q in arm.held] == [robot().home.tolist()]


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


@pytest.mark.parametrize("answer", ["an error", "nan", "elsewhere"])
def test_an_arm_that_does_not_say_where_it_is_holds_what_was_planned_last(answer: str, arm: FakeArm) -> None:
    arm.lag = np.full(6, 0.05)

    def fail(step: int) -> None:
        if step == 12:
            arm.seen = seen
            raise OSError("no answer")

    def seen() -> FloatArray:
        if answer == "an error":
            raise OSError("no answer")
        return np.full(6, np.nan if answer == "nan" else 3.0)

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


def test_motions_that_do_not_follow_each_other_are_refused(arm: FakeArm) -> None:
    twice = task_of(Segment("there", there(), 0.06), Segment("again", there(), 0.06))
    with pytest.raises(InvalidRequest, match=r"begin of again: got joint_0 at 0\.0000; expected 0\.0400 within"):
        execute(twice, arm, robot(), QUICK, allow_unproven=True)
    with pytest.raises(NotProven, match=r"again: got a start with joint_0 at 0; expected 0\.04, where there ends"):
        execute(twice, arm, robot(), QUICK)
    assert (arm.told, arm.widths) == ([], [])


def test_an_arm_that_did_not_arrive_begins_no_other_motion(arm: FakeArm) -> None:
    def drift(step: int) -> None:
        arm.off = np.full(6, 0.001 * step)

    arm.trouble = drift
    report = stopped(task_of(Segment("there", there(), 0.06), Segment("back", back(), 0.06)), arm)
    assert [motion.name for motion in report.motions] == ["there"]
    assert "end of there" in present(report.stopped)
    assert len(arm.held) == 1


def test_an_arm_that_has_moved_while_the_gripper_did_begins_no_other_motion(arm: FakeArm) -> None:
    def closed() -> float:
        arm.off = np.full(6, 0.02)
        return 0.03

    task = task_of(Segment("there", there(), 0.06), Segment("back", back(), 0.03))
    arm.trouble = lambda k: setattr(arm, "gripper_width", closed)
    report = stopped(task, arm)
    assert [motion.name for motion in report.motions] == ["there"]
    assert "start of back" in present(report.stopped)


def test_an_arm_that_pauses_on_its_way_to_rest_gets_its_time(arm: FakeArm) -> None:
    arm.trouble = lambda k: setattr(arm, "off", np.full(6, 0.03 if k < 130 else 0.0))
    assert execute(there(), arm, robot(), replace(QUICK, settle=0.5, start_tolerance=0.02)).ok
    assert len(arm.told) > 130


def test_an_arm_that_did_not_arrive_has_not_executed_its_last_motion(arm: FakeArm) -> None:
    arm.seen = lambda: arm.q + (0.02 * (arm.q - robot().home > 0.039) if arm.told else 0.0)
    report = stopped(there(), arm)
    assert "end of motion: got joint_0 at 0.0600; expected 0.0400 within 0.01 (start_tolerance)" in present(
        report.stopped
    )
    assert (report.motions[0].completed, len(arm.held)) == (True, 1)


@pytest.mark.parametrize("speed", [0.2, 1.0])
def test_an_arm_that_does_not_follow_is_stopped_and_holds_where_it_is(speed: float, arm: FakeArm) -> None:
    stuck = robot().home + 0.1 * STEP
    arm.seen = lambda: stuck.copy() if np.abs(arm.q - robot().home).max() > 0.004 else arm.q
    report = stopped(there(12.0), arm, replace(QUICK, speed=speed))
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


def test_the_arm_holds_before_anything_is_worked_out(arm: FakeArm, monkeypatch: pytest.MonkeyPatch) -> None:
    made = ExecutedMotion.of

    def of(*given: Any) -> Any:
        assert len(arm.held) == 1
        return made(*given)

    arm.trouble = raising(9, OSError("the cable was pulled"))
    monkeypatch.setattr(ExecutedMotion, "of", of)
    assert len(stopped(there(), arm).motions) == 1


@pytest.mark.parametrize("first", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("where", ["positions", "hold"])
def test_a_second_ctrl_c_waits_until_the_arm_was_told_to_hold(
    first: type[BaseException], where: str, arm: FakeArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, interrupts = getattr(arm, where), iter([KeyboardInterrupt])

    def interrupted(*given: Any) -> Any:
        for error in interrupts:
            raise error
        return asked(*given)

    def fail(step: int) -> None:
        monkeypatch.setattr(arm, where, interrupted)
        raise first

    arm.trouble = fail
    with pytest.raises(KeyboardInterrupt):
        execute(there(), arm, robot(), QUICK)
    assert [q.tolist() for q in arm.held] == [robot().home.tolist()]


def test_the_robot_comes_with_what_this_process_planned(arm: FakeArm) -> None:
    assert execute(there(), arm, streaming=QUICK).ok
    assert execute(task_of(Segment("back", back(), 0.08)), arm, streaming=QUICK).ok
    elsewhere, arm.q = replace(there(), origin=None), np.array(service().robot.home)
    with pytest.raises(InvalidRequest, match="service: got None; expected the robot and the scene it was planned for"):
        execute(elsewhere, arm, streaming=QUICK)
    with pytest.raises(InvalidRequest, match="robot: got None; expected the robot the plan was made for"):
        execute(elsewhere, arm, streaming=QUICK, allow_unproven=True)
    assert execute(elsewhere, arm, streaming=QUICK, service=service()).ok


def test_what_a_server_planned_is_proven_again_in_a_world_of_ones_own(arm: FakeArm) -> None:
    plan, arm.simulated = there(), False
    assert plan.origin is not None
    served = replace(plan, origin=replace(plan.origin, elsewhere=True))
    with pytest.raises(InvalidRequest, match="a plan from a file or a server moves a real arm only in your own robot"):
        execute(served, arm, streaming=QUICK)
    assert arm.told == []
    assert execute(served, arm, streaming=QUICK, service=service()).ok


def test_a_task_of_another_process_begins_in_the_world_that_it_says(arm: FakeArm) -> None:
    motion, arm.simulated = Segment("there", replace(there(), origin=None), 0.08, service().scene), False
    received = TaskResult((motion,), service().world, robot().home + STEP)
    with pytest.raises(InvalidRequest, match="a plan from a file or a server"):
        execute(received, arm, streaming=QUICK)
    assert execute(received, arm, streaming=QUICK, service=service()).ok
    arm.q = np.array(robot().home)
    slower = replace(robot(), limits=replace(robot().limits, velocity=robot().limits.velocity * 0.5))
    elsewhere = replace(received, world=replace(received.world, robot=slower))
    with pytest.raises(InvalidRequest, match="expected a plan made for this robot"):
        execute(elsewhere, arm, streaming=QUICK, service=service())


def test_what_was_planned_for_another_robot_is_not_executed(arm: FakeArm) -> None:
    slower = replace(robot(), limits=replace(robot().limits, velocity=robot().limits.velocity * 0.5))
    narrow = replace(robot(), gripper=replace(present(robot().gripper), upper=0.02), gripper_width=0.01)
    for other in (slower, narrow):
        with pytest.raises(InvalidRequest, match=r"expected a plan made for this robot \(--robot\), wxai"):
            execute(there(), arm, other, QUICK)
    assert arm.told == []


def test_the_gripper_is_as_far_open_as_the_plan_was_proven_with(arm: FakeArm) -> None:
    narrow = service().changed(gripper=0.03)
    plan = narrow.plan(PlanRequest(robot().home, robot().home + STEP))
    assert execute(plan, arm, robot(), QUICK).ok
    assert arm.widths == [0.03]
    arm.q, arm.width = np.array(robot().home), 0.027  # around something that gives way
    assert execute(replace(plan, origin=None), arm, streaming=QUICK, service=narrow).ok
    assert arm.widths == [0.03]


@pytest.mark.parametrize(("stone", "stands"), [(0.0, "0.0350"), (0.06, "0.0600")])
def test_a_grip_on_nothing_or_on_something_else_stops(stone: float, stands: str, arm: FakeArm) -> None:
    arm.stone = stone
    task = task_of(Segment("down", grip_of(there()), 0.07), Segment("up", back(), 0.045))
    report = stopped(task, arm, allow_unproven=True)
    assert [motion.name for motion in report.motions] == ["down"]
    assert f"gripper: got {stands}; expected 0.0450 within 0.005 (gripper_tolerance)" in present(report.stopped)
    assert len(arm.held) == 1


def test_a_task_that_has_no_plan_is_not_executed(arm: FakeArm) -> None:
    failed = service().plan(PlanRequest(service().robot.home, np.full(6, 9.0)))
    task = replace(task_of(Segment("there", failed, 0.06)), failure=failed.failure)
    with pytest.raises(InvalidRequest, match="expected a plan, not a failure"):
        execute(task, arm, robot(), QUICK)


def test_settings_out_of_range_are_refused() -> None:
    for name, value in [
        *(("speed", 0.0), ("speed", 1.1), ("rate", 5.0), ("start_tolerance", -0.5), ("settle", -1.0)),
        *(("latest", math.nan), ("latest", 0)),
    ]:
        with pytest.raises(InvalidRequest, match=name):
            Streaming(**{name: value})


def test_the_report_is_plain_json(arm: FakeArm) -> None:
    document = execute(there(), arm, robot(), QUICK).document()
    assert document["motions"][0]["ticks"] > 50
    assert document["simulated"] is True
    assert len(document["motions"][0]["final_error"]) == 6


def test_an_error_of_the_arm_is_not_cleared_by_connecting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever stopped the arm by its error decides when it may move again."""
    library = MagicMock(RuntimeError=RuntimeError, LogicError=ValueError)
    monkeypatch.setitem(sys.modules, "trossen_arm", library)
    assert not TrossenDriver("192.168.1.2", timeout=3.0).simulated
    *_, address, clear_error, timeout = library.TrossenArmDriver().configure.call_args.args
    assert (address, clear_error, timeout) == ("192.168.1.2", False, 3.0)


def test_without_the_driver_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trossen_arm", None)
    with pytest.raises(MissingDependency, match=r"planner-service\[sim\]"):
        TrossenDriver("127.0.0.1")


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


def test_what_would_be_done_is_told_motion_by_motion(tmp_path: Path) -> None:
    segments = (Segment("wave", there(), 0.06), Segment("back", back(), 0.06), Segment("wave", there(), 0.06))
    save_plan(task_of(*segments), tmp_path / "task.json")
    seconds = 2.0 * (2.0 * motion_of(there()).duration + motion_of(back()).duration)
    told = refused("run", tmp_path / "task.json", *ARM, "--speed", "0.5")
    assert f"wave, back, wave; {seconds:.1f} s of motion, at 50%" in told


@pytest.mark.usefixtures("unconnected")
def test_for_a_failure_no_arm_is_connected_to(tmp_path: Path) -> None:
    failed = service().plan(PlanRequest(service().robot.home, np.full(6, 9.0)))
    save_plan(SavedPlan(service().world, None, failed), tmp_path / "plan.json")
    assert "expected a file that holds a plan" in refused("run", tmp_path / "plan.json", *ARM, "--yes")


@pytest.mark.usefixtures("unconnected")
@pytest.mark.parametrize("robot_name", ["planar2", "ur5"])
def test_for_a_plan_of_another_arm_no_arm_is_connected_to(robot_name: str, tmp_path: Path) -> None:
    service = PlannerService(robot_name, "empty")
    still = service.plan(PlanRequest(service.robot.home, service.robot.home))
    save_plan(SavedPlan(service.world, None, still), tmp_path / "plan.json")
    for words in ([], ["--yes"]):
        told = refused("run", tmp_path / "plan.json", *ARM, *words)
        assert f"FILE: made for {robot_name}; expected a plan for the WidowX AI, of joint_0 to joint_5" in told


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
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_whatever_ends_the_command_has_the_arm_hold(name: str, saved: str, real: FakeArm) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)

    def end(step: int) -> None:
        if step == 7:
            assert signal.getsignal(number) != signal.SIG_DFL, "it would end this process"
            os.kill(os.getpid(), number)
            time.sleep(0.5)  # really: the signal ends the wait of another thread

    real.trouble = end
    done = command("run", saved, *ARM, "--yes", *WORLD)
    assert done.exit_code == 130
    assert "interrupted; the arm was told to hold where it was" in done.stderr
    assert (len(real.told), len(real.held), real.closed) == (8, 1, True)
    assert signal.getsignal(number) == before


def test_an_arm_that_stopped_leaves_code_1_and_says_why(saved: str, real: FakeArm) -> None:
    real.trouble = raising(0, OSError("the cable was pulled"))
    done = command("run", saved, *ARM, "--yes", *WORLD)
    assert done.exit_code == 1
    assert "the cable was pulled; the arm was told to hold where it was" in done.stderr
    assert (len(real.held), real.closed) == (1, True)


@pytest.mark.parametrize("option", ["--object=red", "--onto=table", "--seed=0"])
def test_what_a_file_has_cannot_be_chosen(option: str, saved: str) -> None:
    for where in ("--sim", "--arm=192.168.1.2"):
        name, _, value = option.partition("=")
        told = refused("run", saved, where, option)
        assert re.search(f"{name}: got '?{value}'?; expected no such option with FILE", told)


def test_what_cannot_be_run_is_bad_input() -> None:
    for words, message in [
        (["run"], "either --sim or --arm ADDRESS"),
        (["run", "--sim", "--arm", "192.168.1.2"], "either --sim or --arm ADDRESS"),
        (["run", "--arm", "192.168.1.2", "--yes"], "a saved plan or task"),
        (["run", "--sim", "--speed", "2"], "a part of the planned speed"),
    ]:
        assert message in refused(*words)
