"""The stored queries under constraints, and the judge of what keeps them."""

from __future__ import annotations

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from auditor.constraints import deviations
from benchmarks.harness.audit import audited, independent
from benchmarks.worlds import constrained
from planner_service import CollisionChecker, Pose, load_robot
from planner_service.constraints import Constraint, InBox, JointRange, KeepOrientation, KeepUpright, RelativePose
from planner_service.kinematics.constraint_set import ConstraintSet
from planner_service.scene.loading import load_scene

TIGHT = 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", [*constrained.UPRIGHT, *constrained.REGIONS])
def test_the_ends_of_the_stored_queries_are_free_and_keep_their_constraints(name: str) -> None:
    robot, asked = load_robot(constrained.ROBOTS[name]), constrained.load(name)
    counts = {"panda": 70, **dict.fromkeys(constrained.REGIONS, 50)}
    assert len(asked) == counts.get(name, 20)
    for query in asked[::5]:
        checker, held = CollisionChecker(robot, query.scene), ConstraintSet(robot, query.constraints(TIGHT))
        for q in (query.start, *query.goals):
            assert checker.state_is_free(q)
            assert held.violation(q) is None


def judge(robot: str) -> IndependentChecker:
    return independent(robot, load_scene("empty"))


@pytest.mark.parametrize(
    ("robot", "given"),
    [
        ("wxai", [KeepUpright((-1.0, 0.2, 0.0), 0.1), JointRange("joint_1", 0.5, 1.5)]),
        (
            "panda_mbm",
            [KeepOrientation(Pose.from_rpy((0, 0, 0), (3.0, 0.2, 0.4)), 0.3), InBox(Pose(), (0.4, 0.4, 2.0))],
        ),
        (
            "wxai_dual",
            [RelativePose("right_ee_gripper_link", "left_ee_gripper_link", Pose((0.0, -0.3, 0.0)), 0.1, 0.3)],
        ),
    ],
)
def test_the_judge_of_constraints_agrees_with_the_planner_about_which_are_kept(
    robot: str, given: list[Constraint]
) -> None:
    known, rng = load_robot(robot), np.random.default_rng(1)
    Q = rng.uniform(known.limits.lower, known.limits.upper, (50, known.n))
    second, resolved = judge(robot), ConstraintSet(known, given)
    for q in Q:
        found = {item.quantity: item.amount for item in deviations(second, q[None], [audited(known, c) for c in given])}
        for item in resolved.quantities(q):
            middle = 0.0 if item.what in ("tilt", "turn") else (item.lower + item.upper) / 2.0
            assert abs(item.value - middle) == pytest.approx(found[item.what], abs=1e-9)
