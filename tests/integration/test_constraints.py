"""Plans under constraints: what is checked first, what is proven, and what failures say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner_service import (
    BalancedRRTConnect,
    InvalidRequest,
    Optimise,
    PlannerService,
    PlanRequest,
    RRTConnect,
    load_robot,
)
from planner_service.constraints import KeepUpright
from planner_service.kinematics.constraint_set import ConstraintSet, projector_of
from planner_service.planning.result import Reason, Stage
from planner_service.scene.loading import load_scene
from tests.support.constraints import CASES, kept_configurations
from tests.support.optional import present

UPRIGHT = KeepUpright((-1.0, 0.0, 0.0), 0.1)
SCENES = {"upright": "bin", "narrow": "shelf"}


def asked(name: str, seed: int) -> tuple[PlannerService, PlanRequest]:
    """A service, and a request between two configurations that keep the constraints of a case."""
    robot, constraints = load_robot(CASES[name][0]), CASES[name][1]
    service = PlannerService(robot, load_scene(SCENES.get(name, "empty")))
    resolved = ConstraintSet(robot, constraints)
    start, goal = kept_configurations(resolved, projector_of(resolved), service.checker, seed)
    return service, PlanRequest(start, goal, seed=seed, constraints=constraints)


@pytest.mark.parametrize("name", ["upright", "line"])
def test_a_plan_keeps_its_constraints_and_says_how_well(name: str) -> None:
    for seed in (0, 1):
        service, request = asked(name, seed)
        result = service.plan(request)
        if result.failure is not None:
            assert result.failure.reason in {Reason.TIMED_OUT, Reason.CHECK_BUDGET_EXHAUSTED, Reason.PLANNING_FAILED}
            continue
        resolved = ConstraintSet(service.robot, list(request.constraints))
        path, certificate = present(result.path), present(result.certificate)
        assert [kept.name for kept in certificate.kept] == [getattr(c, "name", "") for c in request.constraints]
        worst = max(
            quantity.share for s in np.linspace(0.0, path.length, 500) for quantity in resolved.quantities(path(s))
        )
        assert worst <= 1.0 + 1e-9
        for bound in (bound for kept in certificate.kept for bound in kept.bounds):
            assert bound.bound <= bound.tolerance + 1e-9
        assert "kept" in result.stage(Stage.CERTIFY).note


def test_ends_that_do_not_keep_a_constraint_are_named_with_the_amount() -> None:
    service, request = asked("upright", 0)
    tilted = np.add(request.start, [0.0, 0.0, 0.0, 0.4, 0.0, 0.0])
    failure = present(service.plan(replace(request, start=tilted)).failure)
    assert (failure.stage, failure.reason) == (Stage.ENDPOINTS, Reason.START_VIOLATES_CONSTRAINT)
    assert failure.detail.startswith("start does not keep upright: tilted by 0.")
    assert failure.detail.endswith(" rad, at most 0.1")
    failure = present(service.plan(replace(request, goal=[tilted, tilted])).failure)
    assert failure.reason is Reason.GOAL_VIOLATES_CONSTRAINT
    assert failure.detail.startswith("goal[0] does not keep upright")
    goal = np.array(request.goal)
    result = service.plan(replace(request, goal=[tilted, goal]))
    assert (result.failure, result.goal_index) == (None, 1)


def test_what_cannot_keep_constraints_is_refused() -> None:
    more: Any
    for field, more in [
        ("planner", {"planner": RRTConnect()}),
        ("planner", {"planner": Optimise()}),
        ("polish", {"planner": BalancedRRTConnect(), "polish": Optimise()}),
        ("constraints[0]", {"constraints": ["upright"]}),
        ("constraints", {"constraints": [UPRIGHT] * 17}),
        ("constraints", {"constraints": UPRIGHT}),
    ]:
        with pytest.raises(InvalidRequest) as refused:
            PlanRequest(np.zeros(6), np.ones(6), **{"constraints": [UPRIGHT], **more})
        assert refused.value.field == field
