"""Constraints on the robots that come with the package, and configurations that keep them."""

from __future__ import annotations

import numpy as np

from planner_service import CollisionChecker, Pose, Robot, load_robot
from planner_service.constraints import (
    Constraint,
    InBox,
    KeepOrientation,
    KeepUpright,
    OnLine,
    OnPlane,
    RelativePose,
    ToolRegion,
)
from planner_service.kinematics.constraint_set import ConstraintSet, projector_of
from planner_service.native._core import Projector

__all__ = ["CASES", "case", "kept_configurations"]

BOTH_HANDS = RelativePose("right_ee_gripper_link", "left_ee_gripper_link", Pose((0.0, -0.3, 0.0)), 0.002, 0.01)

CASES: dict[str, tuple[str, list[Constraint]]] = {
    "upright": ("wxai", [KeepUpright((-1.0, 0.0, 0.0), 0.1)]),
    "narrow": ("panda", [KeepUpright((0.0, 0.0, -1.0), 0.02, link="panda_link7")]),
    "plane": ("ur5", [OnPlane(Pose.from_rpy((0.2, 0.1, 0.4), (0.3, 0.2, 0.0)), 0.001, point=(0.0, 0.05, 0.02))]),
    "line": ("wxai", [OnLine((0.25, -0.2, 0.2), (0.25, 0.2, 0.2), 0.003)]),
    "orientation in a box": (
        "panda",
        [
            KeepOrientation(Pose.from_rpy((0, 0, 0), (3.0, 0.2, 0.4)), 0.1),
            InBox(Pose((0.4, 0.0, 0.5)), (0.6, 0.8, 0.6)),
        ],
    ),
    "above a bound": ("wxai", [ToolRegion(lower=(-np.inf, -np.inf, 0.1), tilt=1.2, turn=0.8)]),
    "both hands": ("wxai_dual", [BOTH_HANDS]),
}


def case(name: str) -> tuple[Robot, ConstraintSet, Projector]:
    """A robot with constraints and what keeps them."""
    robot, constraints = load_robot(CASES[name][0]), CASES[name][1]
    resolved = ConstraintSet(robot, constraints)
    return robot, resolved, projector_of(resolved)


def kept_configurations(
    constraints: ConstraintSet, projector: Projector, checker: CollisionChecker, seed: int, count: int = 2
) -> list[tuple[float, ...]]:
    """Free configurations that keep the constraints."""
    rng, out = np.random.default_rng(seed), list[tuple[float, ...]]()
    for _ in range(20_000):
        q = projector.project(tuple(rng.uniform(constraints.lower, constraints.upper).tolist()))
        if q is not None and checker.state_is_free(np.array(q)):
            out.append(q)
        if len(out) == count:
            break
    projector.take()
    return out
