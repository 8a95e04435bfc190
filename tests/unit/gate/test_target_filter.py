"""One target in, one out: near ones pass or are braked before, far ones are reached on a plan."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlannerService, PlanRequest, PlanResult
from planner_service.errors import InvalidRequest
from planner_service.gate import ActionGate, FilteredTarget, Kind, TargetFilter, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.scene.scene import Scene
from tests.unit.certify.test_certifier import PLANAR, ball_beyond

RATE, GOAL_TIME = 30.0, 0.1
START = np.array([-0.5, 0.0])
ROUNDING = 1e-9


class Run:
    """An arm that goes straight to what is sent, and a filter that decides what that is."""

    def __init__(self, scene: Scene) -> None:
        tracking = Tracking(goal_time=GOAL_TIME, error=0.002, jitter=0.004)
        gate = ActionGate(PlannerService(PLANAR, scene), rate=RATE, tracking=tracking, slow=True)
        self.targets, self.q, self.sent = TargetFilter(gate, jump=0.2), START, list[FilteredTarget]()

    def want(self, wanted: FloatArray, periods: int = 1) -> FloatArray:
        """Want the same for so many periods; where the arm is then."""
        for _ in range(periods):
            done = self.targets.next(self.q, wanted)
            self.sent.append(done)
            self.q = self.q + (done.q - self.q) / (RATE * GOAL_TIME)
        return self.q


def test_a_near_target_is_sent_as_it_is() -> None:
    run = Run(ball_beyond(0.3))
    wanted = START + 0.002
    run.want(wanted)
    assert not run.sent[0].planned
    assert np.array_equal(run.sent[0].q, wanted)


def test_a_far_target_of_an_arm_at_rest_is_reached_on_a_plan() -> None:
    run = Run(ball_beyond(0.3))
    wanted = START + np.array([0.6, 0.4])
    assert np.allclose(run.want(wanted, 120), wanted, atol=1e-3)
    assert run.sent[0].planned
    assert all(done.verdict.accepted for done in run.sent)


def test_a_plan_goes_round_what_the_straight_way_would_touch() -> None:
    """Past the ball there is no way for this arm but with the forearm folded."""
    run = Run(ball_beyond(-0.05))
    wanted = np.array([1.6, 0.0])
    assert np.allclose(run.want(wanted, 400), wanted, atol=1e-3)
    assert max(abs(done.q[1]) for done in run.sent) > 0.5
    assert all(done.verdict.accepted for done in run.sent)


def test_a_plan_is_gone_to_its_end_whatever_is_wanted_meanwhile() -> None:
    run = Run(ball_beyond(0.3))
    wanted = START + np.array([0.6, 0.0])
    run.want(wanted)
    run.want(START, 200)
    planned = [done.q for done in run.sent if done.planned]
    assert run.sent[0].planned
    assert any(np.allclose(q, wanted, atol=ROUNDING) for q in planned)


def test_a_far_target_of_a_moving_arm_is_followed_and_not_planned_for() -> None:
    run = Run(ball_beyond(0.3))
    for k in range(1, 20):
        run.want(START + 0.01 * k)
    run.want(START + 1.0)
    assert not any(done.planned for done in run.sent)


def test_where_there_is_no_plan_the_arm_stays_and_none_is_looked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    run, asked = Run(ball_beyond(-0.05)), list[PlanRequest]()
    service = run.targets.gate.service
    plan = service.plan

    def counted(request: PlanRequest) -> PlanResult:
        asked.append(request)
        return plan(request)

    monkeypatch.setattr(service, "plan", counted)
    through = np.array([0.123, 0.0])  # the ball is there
    assert service.checker.state_is_free(through) is False
    assert np.allclose(run.want(through, 10), START, atol=0.02)
    first = len(asked)
    assert first > 0
    run.want(through + 0.05, 10)
    assert len(asked) == first


def test_what_is_beyond_a_limit_is_wanted_at_the_limit() -> None:
    run = Run(ball_beyond(0.3))
    upper = PLANAR.bounds[1]
    run.q = np.array([-0.5, upper[1] - 0.001])
    run.want(np.array([-0.5, upper[1] + 0.5]), 10)
    assert run.sent[-1].q[1] == upper[1]
    assert run.sent[-1].verdict.refused is None


@pytest.mark.parametrize("moving", [0, 9])
def test_what_is_no_number_is_refused_and_braked(moving: int) -> None:
    run = Run(ball_beyond(0.3))
    for k in range(moving):
        run.want(START + 0.01 * k)
    run.want(np.array([np.nan, 0.0]))
    refused = run.sent[-1].verdict.refused
    assert refused is not None
    assert refused.kind is Kind.NUMBER
    assert np.isfinite(run.sent[-1].q).all()


def test_the_stop_of_a_target_brings_the_arm_to_rest() -> None:
    run = Run(ball_beyond(0.3))
    for k in range(1, 20):
        run.want(START + 0.01 * k)
    stop = run.sent[-1].stop
    assert np.array_equal(run.sent[-1].verdict.rows[1:], stop)
    assert len(stop) >= 1


def test_after_a_reset_the_arm_is_at_rest_where_it_was_said_to_be() -> None:
    run = Run(ball_beyond(0.3))
    for k in range(1, 10):
        run.want(START + 0.01 * k)
    assert not run.targets.at_rest
    run.targets.reset(START)
    assert run.targets.at_rest
    run.q = START
    run.want(START + 0.002)
    assert run.sent[-1].verdict.accepted


@pytest.mark.parametrize("options", [{"jump": 0.0}, {"jump": "far"}, {"speed": 0.0}, {"speed": 2.0}])
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InvalidRequest, match=next(iter(options))):
        TargetFilter(Run(ball_beyond(0.3)).targets.gate, **options)


@pytest.mark.parametrize(("q", "wanted", "match"), [(START, np.zeros(3), "wanted"), (np.zeros(1), START, "q: got")])
def test_other_shapes_are_refused(q: FloatArray, wanted: FloatArray, match: str) -> None:
    with pytest.raises(InvalidRequest, match=match):
        Run(ball_beyond(0.3)).targets.next(q, wanted)
