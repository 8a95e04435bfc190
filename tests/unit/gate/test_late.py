"""A verdict that comes too late counts for nothing: the one before still holds, and the gate goes on from there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.gate import ActionGate, Kind, TargetFilter
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound
from planner_service.geometry.shapes import Box
from planner_service.scene.scene import Scene
from tests.unit.certify.test_certifier import PLANAR, ball_beyond
from tests.unit.gate.test_action_gate import RATE, START, TRACKING, colliding, gate_of, ramp

SHARE = 1.0 / RATE / TRACKING.goal_time


def follow(q: FloatArray, rows: FloatArray) -> FloatArray:
    """Where a setpoint is that went to each row for a period."""
    for row in rows:
        q = q + SHARE * (row - q)
    return q


def test_a_verdict_says_within_how_long_it_is_to_be_sent() -> None:
    gate = gate_of(ball_beyond(0.1))
    assert gate.check(START, ramp(5)).due == TRACKING.jitter
    assert gate.update(ball_beyond(0.1)).due == TRACKING.jitter


def test_a_late_verdict_leaves_what_is_left_of_the_one_before() -> None:
    gate = gate_of(ball_beyond(0.1))
    first = gate.check(START, ramp(20))
    q = follow(START, first.rows[:5])
    gate.check(q, ramp(20)[4] + np.zeros((3, 2)), sent=5)
    left = gate.late()
    assert left.refused is not None
    assert left.refused.kind is Kind.LATE
    assert left.proven
    np.testing.assert_array_equal(left.targets, first.targets[5:])
    np.testing.assert_array_equal(left.stop, first.stop)


def test_rows_of_the_verdict_before_are_counted_after_a_late_one() -> None:
    """What goes on with them meanwhile is where the gate has it; what would be elsewhere is noticed."""
    for other in (False, True):
        gate = gate_of(ball_beyond(0.1))
        first = gate.check(START, ramp(20))
        q = follow(START, first.rows[:5])
        aside = np.array([0.0, 0.0004]) * np.arange(1, 9)[:, None] ** 2
        second = gate.check(q, first.rows[5:13] + aside, sent=5)
        assert second.ok
        gate.late()
        gone = follow(q, second.rows[:8] if other else first.rows[5:13])
        third = gate.check(gone, gone[None], sent=8)
        assert (third.refused is not None and third.refused.kind is Kind.TRACKING) == other


def test_after_silence_the_arm_rests_at_its_last_target_and_goes_on_from_there() -> None:
    gate = gate_of(ball_beyond(0.1))
    first = gate.check(START, ramp(20))
    q = follow(START, first.rows[:5])
    gate.check(q, ramp(20)[5:], sent=5)
    gate.late()
    rested = first.rows[4]
    verdict = gate.check(rested, ramp(10, rested), sent=0, elapsed=1.0)
    assert verdict.ok
    assert colliding(gate, rested, verdict.rows, draws=10, seed=2) == 0


def test_the_first_verdict_may_be_late_and_two_in_a_row() -> None:
    gate = gate_of(ball_beyond(0.1))
    for _ in range(2):
        gate.check(START, ramp(5), sent=0)
        left = gate.late()
        assert len(left.rows) == 0
    assert gate.check(START, ramp(5), sent=0).ok
    assert gate.counts.accepted == 5
    assert gate.counts.refused == {"late": 2}


def test_what_was_not_decided_cannot_be_late() -> None:
    gate = gate_of(ball_beyond(0.1))
    for _ in range(2):
        with pytest.raises(InvalidRequest, match="taken back"):
            gate.late()
        gate.check(START, ramp(5), sent=0)
        gate.late()


def test_what_is_left_of_a_verdict_of_another_scene_is_not_called_proven() -> None:
    gate = gate_of(Scene())
    gate.check(START, ramp(60))
    gate.update(ball_beyond(-0.05), sent=5)
    assert not gate.late().proven


def test_who_stands_beside_keeps_clear_of_both_until_one_of_them_is_sent() -> None:
    gate = gate_of(Scene())
    first = gate.check(START, ramp(40))
    assert gate.check(follow(START, first.rows[:2]), first.rows[2:3], sent=2).ok
    tip = PLANAR.tool_pose(first.rows[-1])[:3, 3]
    body = gate.occupied("arm").obstacle.shape
    assert isinstance(body, Compound)
    assert any(
        np.all(np.abs(tip - at.position) <= 0.5 * np.array(box.size)) for box, at in body.parts if isinstance(box, Box)
    )


def test_a_late_verdict_is_in_the_log(tmp_path: Path) -> None:
    gate = gate_of(ball_beyond(0.1), log=tmp_path / "gate.jsonl")
    gate.check(START, ramp(5))
    gate.late()
    (line,) = map(json.loads, (tmp_path / "gate.jsonl").read_text().splitlines())
    assert line["kind"] == "late"


def test_a_plan_that_took_too_long_begins_with_the_next_target() -> None:
    targets = TargetFilter(ActionGate(gate_of(ball_beyond(0.3)).service, rate=RATE, tracking=TRACKING, slow=True))
    wanted = START + np.array([0.6, 0.4])
    first = targets.next(START, wanted)
    assert first.planned
    held = targets.late()
    np.testing.assert_array_equal(held.q, START)
    again = targets.next(START, wanted, elapsed=0.5)
    assert again.planned
    np.testing.assert_array_equal(again.q, first.q)
    q = START
    for _ in range(150):
        q = follow(q, targets.next(q, wanted).q[None])
    np.testing.assert_allclose(q, wanted, atol=1e-3)
