"""A goal all of whose configurations collide is proven impossible; one that is free is not overlooked."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import (
    Box,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    PoseGoal,
    Reason,
    Scene,
    inverse_kinematics,
)
from planner_service.planning import endpoints
from tests.support.optional import present

GOAL = Pose((0.5, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0))
START = (0.0, -1.5, -1.0, 0.0, 1.5, 0.0)


def blocked(size: float = 0.3) -> PlannerService:
    return PlannerService("ur5", Scene((Obstacle("block", Box((size,) * 3), Pose((0.5, 0.0, 0.3))),)))


@pytest.mark.parametrize("goal", [GOAL, PoseGoal(GOAL, 1e-5, 1e-5, candidates=2)], ids=["a pose", "with tolerances"])
def test_a_goal_of_which_every_solution_collides_is_proven_impossible(goal: Pose | PoseGoal) -> None:
    service = blocked()
    result = service.plan(PlanRequest(START, goal, time_limit=None))
    failure = present(result.failure)
    assert failure.reason is Reason.GOAL_IN_COLLISION
    assert failure.proven
    known = inverse_kinematics(service.robot, goal, complete=True)
    assert len(failure.colliding) == len(known) == 8
    for one, q in zip(failure.colliding, known.q, strict=True):
        assert np.array_equal(one.q, q)
        assert np.all((one.lower <= q) & (q <= one.upper))
        assert (one.a, one.b) in service.checker.touching(q)
    assert "no configurations but 8 reach it" in failure.detail


def test_an_explanation_names_the_pair_of_each_solution() -> None:
    told = blocked().explain(PlanRequest(START, GOAL, time_limit=None), plans=1)
    assert told.proven
    assert str(told).count("it would end at [") == 8
    assert "wrist_3_link x block" in str(told)


def test_a_goal_that_the_starts_have_missed_is_planned_to(monkeypatch: pytest.MonkeyPatch) -> None:
    service = PlannerService("ur5", Scene((Obstacle("ball", Box((0.05,) * 3), Pose((0.2, -0.35, 0.3))),)))
    known = inverse_kinematics(service.robot, GOAL, complete=True)
    free = [service.checker.state_is_free(q) for q in known.q]
    assert any(free)
    assert not all(free)
    refused = known.q[np.logical_not(free)]
    for found in (refused[:1], refused[:0]):
        monkeypatch.setattr(endpoints, "configurations_at", lambda *_, found=found, **__: found)
        result = service.plan(PlanRequest(known.q[free.index(True)], GOAL, time_limit=None))
        assert result.ok


def test_without_a_proof_of_all_nothing_is_claimed() -> None:
    service = PlannerService("panda", Scene((Obstacle("block", Box((0.3,) * 3), Pose((0.5, 0.0, 0.3))),)))
    failure = present(service.plan(PlanRequest(service.robot.home, GOAL, time_limit=None)).failure)
    assert not failure.proven
    assert failure.colliding == ()
