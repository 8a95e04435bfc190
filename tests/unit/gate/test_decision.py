"""What a gate decided last says where the arm is and where what has passed takes it."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.gate import ActionGate, Decision
from planner_service.scene.scene import Scene
from tests.support.optional import present
from tests.unit.certify.test_certifier import ball_beyond
from tests.unit.gate.test_action_gate import RATE, START, TRACKING, gate_of, ramp


def decided(gate: ActionGate) -> Decision:
    return present(gate.decision)


def test_there_is_no_decision_before_the_first_check_nor_after_a_reset() -> None:
    gate = gate_of(Scene())
    before = gate.decision
    gate.check(START, ramp(3))
    number = decided(gate).number
    gate.reset()
    assert (before, number, gate.decision) == (None, 1, None)


def test_a_decision_has_what_was_measured_and_the_verdict_and_stays_as_it_was() -> None:
    gate = gate_of(ball_beyond(0.1))
    q = START.copy()
    verdict = gate.check(q, ramp(20))
    first = decided(gate)
    q += 1.0
    gate.check(START, ramp(20), sent=0)
    assert first.verdict is verdict
    np.testing.assert_array_equal(present(first.q), START)
    assert decided(gate).number == 2


def test_the_ways_ahead_are_to_the_last_target_and_to_each_row_with_room_for_the_arm() -> None:
    gate = gate_of(ball_beyond(0.1))
    gate.check(START, ramp(20))
    verdict = gate.check(START, ramp(20), sent=1)
    ahead = decided(gate).ahead
    assert len(ahead.starts) == 1 + len(verdict.rows)
    np.testing.assert_array_equal(ahead.ends, [ramp(20)[0], *verdict.rows])
    assert np.all(ahead.rooms >= TRACKING.of(2))
    np.testing.assert_allclose(ahead.starts[1], ahead.starts[0], atol=0.0)


def test_an_arm_that_follows_as_assumed_is_on_the_ways_ahead_until_it_rests() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        gate = gate_of(Scene())
        verdict = gate.check(START, ramp(10))
        ahead = decided(gate).ahead
        setpoint = START + TRACKING.of(2) * rng.uniform(-1.0, 1.0, 2)
        for target in verdict.rows:
            wait = 1.0 / RATE + TRACKING.jitter * rng.uniform(-1.0, 1.0)
            for share in (0.3, 1.0):
                now = setpoint + min(share * wait / TRACKING.goal_time, 1.0) * (target - setpoint)
                assert ahead.holds(now + TRACKING.of(2) * rng.choice([-1.0, 1.0], 2))
            setpoint = now


def test_a_scene_that_changes_is_a_decision_without_a_measurement() -> None:
    gate = gate_of(Scene())
    gate.check(START, ramp(20))
    gate.update(ball_beyond(-0.05), sent=5)
    assert decided(gate).q is None
    assert decided(gate).certifier is gate.certifier


@pytest.mark.parametrize("padding", [0.0, 0.01])
def test_the_ways_ahead_are_proven_by_the_certifier_of_the_decision(padding: float) -> None:
    gate = gate_of(ball_beyond(-0.05), padding=padding)
    gate.check(START, ramp(90))
    done = decided(gate)
    proof = done.certifier.certify_tubes(*done.ahead, padding=done.padding)
    assert (proof.pair, proof.free) == (None, len(done.ahead.starts))
