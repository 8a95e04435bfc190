"""Two arms as one robot: each is a WidowX AI, each sees the other, and one or both of them are planned."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service import PlannerService, PlanRequest, PlanResult, load_scene
from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from tests.support.optional import present
from tests.support.refusals import refused_pair

ROOT = Path(__file__).parents[2]

OVER = [-0.785, 1.559, 1.982, -1.023, 0.0, 0.0]
UNDER = [-0.785, 1.479, 0.726, 0.153, 0.0, 0.0]
"""The left tool across the middle, 0.38 m and 0.10 m high; mirrored in joint_0 they are the right arm's."""

BETWEEN = [0.751, 1.169, 0.704, 0.265, 0.0, 0.0]
"""The right arm across the middle at 0.24 m, between these ends of the left arm's motion."""
ABOVE, BELOW = [-0.695, 1.19, 1.453, -0.463, 0.0, 0.0], [-0.695, 1.692, 0.25, 1.243, 0.0, 0.0]


def arms(names: Iterable[str]) -> set[str]:
    """Which arms links belong to; an obstacle is called by its own name."""
    return {name.split("_")[0] for name in names}


def mirrored(q: list[float]) -> list[float]:
    return [-q[0], *q[1:]]


@pytest.fixture(scope="module")
def dual() -> Robot:
    return load_robot("wxai_dual")


@pytest.fixture(scope="module")
def service(dual: Robot) -> PlannerService:
    return PlannerService(dual, "table")


@pytest.fixture(scope="module")
def second() -> IndependentChecker:
    return IndependentChecker(ROOT / "robots" / "wxai_dual", ROOT / "scenes" / "table.toml")


def right_arm_at(dual: Robot, values: list[float]) -> Robot:
    """The left arm alone, the right one standing."""
    return dual.locked(dict(zip(dual.joint_names[6:], values, strict=True)))


def towards_each_other(dual: Robot, count: int) -> FloatArray:
    """Configurations in which the arms reach inwards, where they often meet."""
    low, high = dual.limits.lower.copy(), dual.limits.upper.copy()
    low[[0, 6]], high[[0, 6]] = (-1.6, -0.3), (0.3, 1.6)
    for joint, (a, b) in {1: (0.5, 2.0), 2: (0.3, 2.0), 3: (-1.0, 1.0), 4: (-1.0, 1.0)}.items():
        low[[joint, joint + 6]], high[[joint, joint + 6]] = a, b
    return np.random.default_rng(7).uniform(low, high, (count, 12))


def test_verdicts_and_names_are_the_independent_checkers(
    dual: Robot, service: PlannerService, second: IndependentChecker
) -> None:
    anywhere = np.random.default_rng(6).uniform(dual.limits.lower, dual.limits.upper, (300, 12))
    between_arms = 0
    for k, q in enumerate([*towards_each_other(dual, 700), *anywhere]):
        assert service.checker.state_is_free(q) == second.free(q)
        if k % 10 == 0:
            touching = {frozenset(pair) for pair in second.touching(q)}
            assert {frozenset((c.a, c.b)) for c in service.checker.contacts(q)} == touching
            between_arms += any(arms(pair) == {"left", "right"} for pair in touching)
    assert between_arms > 5


def free_for_the_independent_checker(result: PlanResult, second: IndependentChecker, right: FloatArray | None) -> bool:
    """Whether the curve is free, the right arm standing at ``right`` if it is not part of it."""
    path = result.unwrap()[0]

    def both(s: FloatArray) -> FloatArray:
        q = path(s)
        return q if right is None else np.concatenate([q, np.repeat(right[None], len(q), axis=0)], axis=1)

    return second.curve_touch(both, path.length) is None


def test_both_arms_change_places_and_the_plan_is_proven(service: PlannerService, second: IndependentChecker) -> None:
    start, goal = [*OVER, *mirrored(UNDER)], [*UNDER, *mirrored(OVER)]
    request = PlanRequest(start, goal, seed=1, time_limit=None)
    result = service.plan(request)
    assert result.ok, result.failure
    assert "right_link_6 x left_link_6" in result.stages[1].note, "a straight line would not do"
    assert present(result.certificate).certified
    assert free_for_the_independent_checker(result, second, None)
    again = PlannerService("wxai_dual", "table").plan(request)
    assert again.counts == result.counts
    assert again.unwrap()[0].waypoints.tobytes() == result.unwrap()[0].waypoints.tobytes()


def test_one_arm_goes_around_the_other_that_stands_still(dual: Robot, second: IndependentChecker) -> None:
    service = PlannerService(right_arm_at(dual, BETWEEN), "table")
    request = PlanRequest(ABOVE, BELOW, seed=1, time_limit=None)
    result = service.plan(request)
    assert result.ok, result.failure
    assert "right_finger" in result.stages[1].note, "a straight line would not do"
    path = result.unwrap()[0]
    assert path.waypoints.shape[1] == 6
    assert present(result.certificate).certified
    assert free_for_the_independent_checker(result, second, np.array(BETWEEN))
    assert service.plan(request).counts == result.counts


def test_the_arm_that_stands_still_is_judged_as_both_arms_would_be(dual: Robot) -> None:
    scene = load_scene("table")
    left, both = CollisionChecker(right_arm_at(dual, BETWEEN), scene), CollisionChecker(dual, scene)
    between_arms = 0
    for q in towards_each_other(dual, 150)[:, :6]:
        pairs = {frozenset((c.a, c.b)) for c in left.contacts(q)}
        assert pairs == {frozenset((c.a, c.b)) for c in both.contacts([*q, *BETWEEN])}
        between_arms += any(arms(pair) == {"left", "right"} for pair in pairs)
    assert between_arms > 15


def test_a_certificate_refuses_a_path_through_the_other_arm(dual: Robot) -> None:
    proof = PlannerService(right_arm_at(dual, BETWEEN), "table").certify([ABOVE, BELOW])
    refusal = refused_pair(proof)
    assert arms((refusal.a, refusal.b)) == {"left", "right"}
    proof = PlannerService(dual, "table").certify([[*OVER, *mirrored(UNDER)], [*UNDER, *mirrored(OVER)]])
    refusal = refused_pair(proof)
    assert arms((refusal.a, refusal.b)) == {"left", "right"}
