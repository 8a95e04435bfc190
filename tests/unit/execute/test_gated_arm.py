"""An arm between plans and targets, in time that only passes when the arm is waited for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.execute import DriverGroup, GatedArm, Streaming
from planner_service.gate import ActionGate, Kind, TargetFilter, Tracking, Verdict
from planner_service.geometry.arrays import FloatArray
from tests.support.arms import STEP, FakeArm, FakeTime, robot, service

PERIOD, GOAL_TIME = 1.0 / 30.0, 0.1
QUICK = Streaming(settle=0.02)


@dataclass
class GoingArm(FakeArm):
    """Goes straight to targets, as the clock passes; what it is sent is written down, with the time."""

    clock: FakeTime = field(default_factory=FakeTime)
    sent: list[tuple[float, FloatArray]] = field(default_factory=list)

    def go(self, q: ArrayLike, seconds: float) -> None:
        assert seconds == GOAL_TIME
        self.q = self.positions()
        self.sent.append((self.clock.now, np.array(q)))

    def positions(self) -> FloatArray:
        if not self.sent:
            return self.q + self.off
        began, target = self.sent[-1]
        share = min((self.clock.now - began) / GOAL_TIME, 1.0)
        return self.q + share * (target - self.q) + self.off

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        self.sent = []
        super().command(q, qd, qdd)


@pytest.fixture
def going(clock: FakeTime) -> GoingArm:
    return GoingArm(np.array(robot().home), clock=clock)


@pytest.fixture
def gated(going: GoingArm, clock: FakeTime) -> GatedArm:
    tracking = Tracking(goal_time=GOAL_TIME, error=0.01)
    targets = TargetFilter(ActionGate(service(), rate=1.0 / PERIOD, tracking=tracking, slow=True))
    return GatedArm(going, targets, QUICK, clock=clock.perf_counter, wait=clock.sleep)


def swing(gated: GatedArm, clock: FakeTime) -> FloatArray:
    """Send targets that get faster, and none after them; the stop behind the last one."""
    start: FloatArray = gated.driver.positions()
    stop: FloatArray = start[None]
    for k in range(1, 21):
        stop = gated.send(start + np.array([0.0005 * k * k, 0.0, 0.0, 0.0, 0.0, 0.0])).stop
        clock.sleep(PERIOD)
    return stop


def test_a_target_that_passes_is_sent_by_the_arms_own_driver(gated: GatedArm, going: GoingArm) -> None:
    wanted = robot().home + 0.003
    sent = gated.send(wanted)
    assert np.array_equal(sent.q, wanted)
    assert np.array_equal(going.sent[-1][1], wanted)
    assert going.told == []


def test_a_move_is_planned_from_where_the_arm_stands_and_arrives(gated: GatedArm, going: GoingArm) -> None:
    going.q = robot().home + STEP
    report = gated.move_to(robot().home)
    assert report.ok
    assert np.allclose(going.q, robot().home, atol=1e-9)
    assert np.allclose(report.motions[0].recording.measured[0], robot().home + STEP, atol=1e-3)


def test_a_moving_arm_is_halted_before_it_is_moved_and_targets_pass_from_there(
    gated: GatedArm, going: GoingArm, clock: FakeTime
) -> None:
    stop = swing(gated, clock)
    report = gated.move_to(robot().home + STEP)
    assert np.allclose(report.motions[0].recording.measured[0], stop[-1], atol=1e-3)
    assert gated.send(robot().home + STEP + 0.003).verdict.ok


def test_a_moving_arm_halts_along_its_proven_stop(gated: GatedArm, going: GoingArm, clock: FakeTime) -> None:
    stop, many = swing(gated, clock), len(going.sent)
    assert len(stop) > 1
    gated.halt()
    rows = [q for _, q in going.sent[many:]]
    assert np.array_equal(rows, stop)
    assert np.allclose(going.positions(), stop[-1])


def test_the_rows_of_a_stop_are_a_period_apart(gated: GatedArm, going: GoingArm, clock: FakeTime) -> None:
    swing(gated, clock)
    gated.halt()
    assert np.allclose(np.diff([when for when, _ in going.sent]), PERIOD)


def test_an_arm_whose_last_target_is_a_while_ago_stands_there_and_is_not_sent_on(
    gated: GatedArm, going: GoingArm, clock: FakeTime
) -> None:
    swing(gated, clock)
    clock.sleep(1.0)
    many = len(going.sent)
    gated.halt()
    assert len(going.sent) == many


def test_an_arm_that_does_not_follow_is_told_to_stay_and_not_moved_any_more(
    gated: GatedArm, going: GoingArm, clock: FakeTime
) -> None:
    swing(gated, clock)
    going.off = np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0])
    refused = gated.send(going.positions()).verdict.refused
    assert refused is not None
    assert refused.kind is Kind.TRACKING
    assert "joint_1" in gated.lost
    with pytest.raises(InvalidRequest, match="an arm that follows"):
        gated.move_to(robot().home)


def test_what_was_decided_too_late_is_not_sent_and_the_arm_goes_on_to_its_last_target(
    gated: GatedArm, going: GoingArm, clock: FakeTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    swing(gated, clock)
    check, many, last = gated.targets.gate.check, len(going.sent), going.sent[-1][1]

    def slow(*given: Any, **options: Any) -> Verdict:
        verdict = check(*given, **options)
        clock.sleep(2.0 * verdict.due)
        return verdict

    monkeypatch.setattr(gated.targets.gate, "check", slow)
    sent = gated.send(going.positions())
    assert sent.verdict.refused is not None
    assert sent.verdict.refused.kind is Kind.LATE
    assert np.array_equal(sent.q, last)
    assert len(going.sent) == many
    monkeypatch.setattr(gated.targets.gate, "check", check)
    clock.sleep(3.0 * PERIOD)
    assert gated.send(last).verdict.ok  # the arm is where the gate has it
    assert len(going.sent) == many + 1


def test_where_there_is_no_plan_nothing_moves(gated: GatedArm, going: GoingArm) -> None:
    beyond = robot().home + 10.0
    with pytest.raises(InvalidRequest, match="one with a plan"):
        gated.move_to(beyond)
    assert going.told == []
    assert going.sent == []


def test_an_arm_that_lags_is_sent_its_targets_in_a_stream(going: GoingArm, clock: FakeTime) -> None:
    going.lag = np.full(6, 0.05)
    targets = TargetFilter(ActionGate(service(), rate=30.0, tracking=Tracking(goal_time=GOAL_TIME, error=0.01)))
    gated = GatedArm(going, targets, QUICK, clock=clock.perf_counter, wait=clock.sleep)
    gated.send(robot().home + 0.003)
    gated.close()
    assert going.sent == []


def test_arms_in_a_group_move_as_one() -> None:
    left, right = FakeArm(np.zeros(6)), FakeArm(np.ones(6), velocity=3.0)
    group = DriverGroup([left, right])
    assert np.array_equal(group.positions(), [*np.zeros(6), *np.ones(6)])
    assert np.array_equal(group.limits().velocity, [10.0] * 6 + [3.0] * 6)
    q = np.arange(12.0)
    group.command(q, 2.0 * q, 3.0 * q)
    assert np.array_equal(np.stack(left.told[0]), [q[:6], 2.0 * q[:6], 3.0 * q[:6]])
    assert np.array_equal(np.stack(right.told[0]), [q[6:], 2.0 * q[6:], 3.0 * q[6:]])
    assert group.go is None


def test_every_arm_of_a_group_is_told_to_hold_and_closed_whatever_another_does() -> None:
    left, right = FakeArm(np.zeros(6), refusals=1), FakeArm(np.zeros(6), refusals=1)
    for deaf, hears in ((left, right), (right, left)):
        deaf.refusals, hears.refusals, hears.held = 1, 0, []
        with pytest.raises(OSError, match="no route"):
            DriverGroup([left, right]).hold(np.arange(12.0))
        assert len(hears.held) == 1
    DriverGroup([left, right]).close()
    assert left.closed
    assert right.closed


def test_a_group_goes_where_each_of_its_arms_can(clock: FakeTime) -> None:
    left, right = (GoingArm(np.zeros(6), clock=clock) for _ in range(2))
    group = DriverGroup([left, right])
    assert group.go is not None
    group.go(np.arange(12.0), GOAL_TIME)
    assert np.array_equal(left.sent[0][1], np.arange(6.0))
    assert np.array_equal(right.sent[0][1], np.arange(6.0, 12.0))


@pytest.mark.parametrize("arms", [[], [FakeArm(np.zeros(6)), FakeArm(np.zeros(6), simulated=False)]])
def test_a_group_of_none_or_of_real_and_simulated_arms_is_refused(arms: list[FakeArm]) -> None:
    with pytest.raises(InvalidRequest, match="drivers"):
        DriverGroup(arms)
