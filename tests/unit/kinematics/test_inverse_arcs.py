"""The configurations of an arm with one joint too many are on arcs, exactly one for each value of a joint."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planner_service import InvalidRequest, Pose, PoseGoal, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.complete_inverse import InverseArcs
from planner_service.kinematics.inverse import ToolChain, inverse_arcs
from planner_service.kinematics.tool_arm import descended
from planner_service.robot.model import Robot

ARMS = ("panda", "xarm7")


def arm(name: str) -> Robot:
    whole = load_robot(name)
    return ToolChain.of(whole, whole.home).robot


def drawn(robot: Robot, rng: np.random.Generator) -> tuple[FloatArray, Pose]:
    q = rng.uniform(robot.limits.lower, robot.limits.upper)
    return q, Pose.from_matrix(robot.tool_pose(q))


@pytest.mark.parametrize("name", ARMS)
def test_every_configuration_that_random_starts_find_is_on_an_arc(name: str) -> None:
    robot, rng = arm(name), np.random.default_rng(5)
    found = 0
    for _ in range(2):
        q, pose = drawn(robot, rng)
        arcs = inverse_arcs(robot, pose)
        assert arcs.holds(q)
        end = descended(robot, pose, rng.uniform(robot.limits.lower, robot.limits.upper, (300, robot.n)))
        for other in end.q[end.arrived]:
            exact = solved(robot, pose, other, int(np.argmax(np.abs(null_direction(robot, other)))))
            if np.all((robot.limits.lower <= exact) & (exact <= robot.limits.upper)):
                found += 1
                assert arcs.holds(exact)
    assert found > 20


@pytest.mark.parametrize("name", ARMS)
def test_an_arc_has_one_configuration_for_each_value_of_its_joint(name: str) -> None:
    robot, rng = arm(name), np.random.default_rng(6)
    _, pose = drawn(robot, rng)
    arcs = inverse_arcs(robot, pose)
    assert len(arcs)
    for k in rng.integers(len(arcs), size=20).tolist():
        joint = int(arcs.joints[k])
        run = float(arcs.reach[k]) * float(rng.uniform(-1.0, 1.0))
        middle = arcs.q[k] + run * arcs.along[k]
        start = middle + arcs.half[k] * rng.uniform(-1.0, 1.0, robot.n)
        start[joint] = middle[joint]
        exact = solved(robot, pose, start, joint)
        assert exact[joint] == middle[joint]
        assert np.all(np.abs(exact - middle) <= arcs.half[k])


def test_what_is_beyond_reach_is_proven_to_be_and_a_free_axis_counts() -> None:
    robot = arm("panda")
    none = inverse_arcs(robot, Pose((0.9, 0.9, 0.9)))
    assert none.complete
    assert not len(none)
    locked = robot.locked({robot.joint_names[2]: 0.3})
    q = 0.5 * (locked.limits.lower + locked.limits.upper) + 0.3
    turned = Pose.from_matrix(locked.tool_pose(q)) @ Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    assert inverse_arcs(locked, PoseGoal(turned, free_axis=(0.0, 0.0, 1.0))).holds(q)


def test_values_are_copied_and_read_only() -> None:
    q = np.zeros((1, 2))
    arcs = InverseArcs(
        np.array([0]), np.ones(1), q, np.ones((1, 2)), np.zeros((1, 2)), np.zeros((0, 2, 2)), np.array([True, False]), 1
    )
    q[0, 0] = 5.0
    assert arcs.q[0, 0] == 0.0
    assert arcs.holds([2.0 * math.pi + 0.5, 0.5])
    assert not arcs.holds([0.5, 0.4])
    with pytest.raises(InvalidRequest, match="2 finite numbers"):
        arcs.holds([1.0])


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"robot": load_robot("ur5")}, "an arm of 7 joints for this goal: 'ur5' has 6"),
        ({"robot": "panda"}, "a Robot"),
        ({"pose": "up"}, "a Pose or a PoseGoal"),
        ({"still": [0.0]}, "finite numbers"),
    ],
)
def test_other_arms_and_goals_are_refused(changes: dict[str, Any], match: str) -> None:
    given: dict[str, Any] = {"robot": load_robot("panda"), "pose": Pose()} | changes
    with pytest.raises(InvalidRequest, match=match):
        inverse_arcs(**given)


def null_direction(robot: Robot, q: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.svd(robot.tool_jacobian(q))[2][-1])


def solved(robot: Robot, pose: Pose, q: FloatArray, joint: int) -> FloatArray:
    """Newton's method by all joints but one."""
    others = [j for j in range(robot.n) if j != joint]
    q = q.copy()
    for _ in range(20):
        T = robot.tool_pose(q)
        N = T[:3, :3] @ pose.rotation.T
        vector = np.array([N[2, 1] - N[1, 2], N[0, 2] - N[2, 0], N[1, 0] - N[0, 1]]) / 2.0
        off = np.concatenate([T[:3, 3] - np.array(pose.position), vector])
        q[others] -= np.linalg.solve(robot.tool_jacobian(q)[:, others], off)
    return q
