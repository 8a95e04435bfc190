"""A chunk that ends behind an obstacle is led round it, by a plan that passes the gate."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlannerService, PlanRequest, PlanResult, load_robot
from planner_service.collision import CollisionChecker, JointStep
from planner_service.gate import ActionGate, Kind, TargetFilter, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene

WXAI = load_robot("wxai")
RATE = 30.0
TRACKING = Tracking(goal_time=0.1, error=0.003, jitter=0.004)
POST = Scene((Obstacle("post", Box((0.04, 0.04, 0.6)), Pose((0.32, 0.0, 0.3))),))
START, END = np.array([-0.9, 1.2, 0.9, 0.0, 0.0, 0.0]), np.array([0.9, 1.2, 0.9, 0.0, 0.0, 0.0])


def swing(robot: Robot = WXAI) -> FloatArray:
    """Targets from one side of the post to the other, from rest to rest."""
    x = np.linspace(0.0, 1.0, 120)[1:, None]
    return np.asarray(START + (3.0 * x**2 - 2.0 * x**3) * (END - START))


def test_a_chunk_that_ends_behind_an_obstacle_is_led_round_it_and_marked() -> None:
    service = PlannerService(WXAI, POST)
    plain = ActionGate(service, rate=RATE, tracking=TRACKING).check(START, swing())
    assert plain.refused is not None
    assert plain.refused.kind in (Kind.CONTACT, Kind.STOP)
    gate = ActionGate(service, rate=RATE, tracking=TRACKING, repair=True)
    verdict = gate.check(START, swing())
    assert verdict.repaired
    assert not verdict.ok
    assert verdict.refused is not None
    assert verdict.refused.pair == plain.refused.pair
    assert gate.counts.repaired == 1
    np.testing.assert_allclose(verdict.targets[-1], END, atol=1e-9)
    np.testing.assert_array_equal(verdict.targets[: plain.accepted], swing()[: plain.accepted])
    checker, setpoint = CollisionChecker(WXAI, POST, edge_step=JointStep(0.01)), START
    for row in verdict.rows:
        then = setpoint + (1.0 / RATE) / TRACKING.goal_time * (row - setpoint)
        assert checker.edge_is_free(setpoint, then)
        setpoint = then


@pytest.mark.parametrize("end", [START * 0.0 + 9.0, np.array([0.0, 1.7, 0.8, 0.0, 0.0, 0.0])])
def test_a_chunk_that_no_plan_can_end_is_refused_as_it_would_be(end: FloatArray) -> None:
    """Beyond the limits, or in the post."""
    chunk = np.concatenate([swing(), end[None]])
    verdicts = [
        ActionGate(PlannerService(WXAI, POST), rate=RATE, tracking=TRACKING, repair=repair).check(START, chunk)
        for repair in (False, True)
    ]
    assert not verdicts[1].repaired
    np.testing.assert_array_equal(verdicts[0].rows, verdicts[1].rows)


def round_trip() -> FloatArray:
    """A swing through the post, and then one up and down on its other side."""
    x = np.linspace(0.0, 1.0, 60)[1:, None]
    up = END + np.array([0.0, -0.5, 0.0, 0.0, 0.0, 0.0]) * np.sin(np.pi * (3.0 * x**2 - 2.0 * x**3))
    return np.concatenate([swing(), up])


def test_what_is_free_behind_an_obstacle_is_gone_as_it_was_wanted() -> None:
    """Not straight to the end: up and down again, which the end alone does not show."""
    gate = ActionGate(PlannerService(WXAI, POST), rate=RATE, tracking=TRACKING, repair=True)
    wanted = round_trip()
    verdict = gate.check(START, wanted)
    assert verdict.repaired
    np.testing.assert_allclose(verdict.targets[-1], wanted[-1], atol=1e-9)
    line = np.concatenate([wanted[119:][:-1], wanted[119:][1:]]).reshape(2, -1, 6)
    tail = verdict.targets[np.flatnonzero(np.abs(verdict.targets[:, 0] - END[0]) < 1e-6)]
    assert tail[:, 1].min() < 0.75  # from 1.2
    for q in tail:
        off = [np.abs(a + t * (b - a) - q).max() for a, b in zip(*line, strict=True) for t in np.linspace(0.0, 1.0, 21)]
        assert min(off) < 0.002


def test_a_way_round_is_the_same_however_busy_the_machine_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is limited by what it checks, not by the time."""
    asked = list[PlanRequest]()
    service = PlannerService(WXAI, POST)
    plan = service.plan

    def counted(request: PlanRequest) -> PlanResult:
        asked.append(request)
        return plan(request)

    monkeypatch.setattr(service, "plan", counted)
    ActionGate(service, rate=RATE, tracking=TRACKING, repair=True).check(START, swing())
    targets = TargetFilter(ActionGate(service, rate=RATE, tracking=TRACKING))
    targets.next(START, END)
    assert len(asked) >= 2
    assert {(each.time_limit, each.max_checks) for each in asked} == {(None, 20_000)}
