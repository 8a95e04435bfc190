"""Arms side by side, each with a gate of its own: where one can be is where the other does not go."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlannerService, load_robot
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.gate import ActionGate, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound
from planner_service.geometry.shapes import Box, Pose
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene

RATE = 30.0
TRACKING = Tracking(goal_time=0.1, error=0.003, jitter=0.004, lag=0.05)
PLANAR = load_robot("planar2")
APART = 2.6
"""Metres between two arms that reach 2 m each."""

TURNED = Pose.from_rpy((APART, 0.0, 0.0), (0.0, 0.0, np.pi))
"""The base of either arm in the base frame of the other."""


def shapes_at(robot: Robot, q: FloatArray, base: Pose) -> tuple[Obstacle, ...]:
    """An arm at q as obstacles of its neighbour."""
    rotations, positions = (each[0] for each in robot.body_poses_batch(q[None]))
    out = []
    for k, item in enumerate(robot.shapes):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotations[item.body], positions[item.body]
        out.append(Obstacle(f"other {k}", item.shape, base @ Pose.from_matrix(matrix) @ item.pose))
    return tuple(out)


def extent_of(piece: Obstacle) -> tuple[FloatArray, FloatArray]:
    """The low and the high corner of a convex piece along the axes, (3,) each."""
    matrix = piece.pose.matrix
    corners = []
    for side in (-1.0, 1.0):
        points = [matrix[:3, :3] @ piece.shape.support(matrix[:3, :3].T @ (side * axis)) for axis in np.eye(3)]
        corners.append(np.array([point[k] for k, point in enumerate(points)]) + matrix[:3, 3])
    return corners[0], corners[1]


def gate_of(robot: Robot, start: FloatArray) -> ActionGate:
    gate = ActionGate(PlannerService(robot, Scene()), rate=RATE, tracking=TRACKING, slow=True, acceleration_scale=4.0)
    gate.reset(start)
    return gate


@pytest.mark.parametrize("name", ["planar2", "wxai", "scara"])
def test_an_arm_is_within_what_it_says_that_it_occupies_until_it_rests(name: str) -> None:
    """Every piece, at every place of a simulated arm that goes on with its rows, or gets no more of them."""
    robot, rng = load_robot(name), np.random.default_rng(3)
    for _ in range(4):
        start = robot.home + rng.uniform(-0.2, 0.2, robot.n)
        gate = gate_of(robot, np.clip(start, *robot.bounds))
        q = np.clip(start, *robot.bounds)
        for _ in range(6):
            verdict = gate.check(q, np.clip(q + rng.uniform(-0.3, 0.3, robot.n), *robot.bounds))
            body = gate.occupied("arm").obstacle
            assert isinstance(body.shape, Compound)
            lows = np.array(
                [
                    np.array(at.position) - 0.5 * np.array(box.size if isinstance(box, Box) else ())
                    for box, at in body.shape.parts
                ]
            )
            highs = np.array(
                [
                    np.array(at.position) + 0.5 * np.array(box.size if isinstance(box, Box) else ())
                    for box, at in body.shape.parts
                ]
            )
            setpoint = q
            for row in verdict.rows:
                for share in np.linspace(0.0, 1.0, 4):
                    at = setpoint + share * (row - setpoint)
                    at = np.clip(at + rng.uniform(-1.0, 1.0, robot.n) * TRACKING.of(robot.n), *robot.bounds)
                    for piece, low, high in zip(shapes_at(robot, at, Pose()), lows, highs, strict=True):
                        least, most = extent_of(piece)
                        assert np.all((least >= low) & (most <= high))
                setpoint = setpoint + (1.0 / RATE) / TRACKING.goal_time * (row - setpoint)
            q = q + (1.0 / RATE) / TRACKING.goal_time * (verdict.rows[0] - q)


def test_two_arms_that_are_sent_at_each_other_never_touch() -> None:
    rng = np.random.default_rng(5)
    starts = [np.array([1.2, 0.3]), np.array([1.2, -0.3])]
    gates = [gate_of(PLANAR, start) for start in starts]
    q, refused, nearest = list(starts), 0, np.inf
    for step in range(150):
        for me, other in ((0, 1), (1, 0)):
            if step % 10 == 0:
                goals = rng.uniform(-0.8, 0.8, (2, 2))
            wanted = q[me] + np.clip(goals[me] - q[me], -0.05, 0.05)
            verdict = gates[me].check(q[me], wanted, around=[gates[other].occupied("other", TURNED)])
            assert verdict.proven
            refused += verdict.refused is not None
            q[me] = q[me] + (1.0 / RATE) / TRACKING.goal_time * (verdict.rows[0] - q[me])
        scene = Scene(shapes_at(PLANAR, q[1], TURNED))
        checker = CollisionChecker(PLANAR, scene)
        assert checker.state_is_free(q[0])
        nearest = min(nearest, checker.clearance(q[0]))
    assert refused > 3
    assert nearest < 0.3


def test_nobody_knows_where_an_arm_is_before_its_first_check() -> None:
    gate = ActionGate(PlannerService(PLANAR, Scene()), rate=RATE, tracking=TRACKING)
    with pytest.raises(InvalidRequest, match="first check"):
        gate.occupied("arm")


def test_where_an_arm_was_before_its_last_verdict_is_no_place_to_keep_clear_of() -> None:
    starts = [np.array([1.2, 0.3]), np.array([1.2, -0.3])]
    left, right = (gate_of(PLANAR, start) for start in starts)
    for changed in (
        lambda: right.check(starts[1], starts[1], sent=0),
        lambda: right.update(Scene(), sent=0),
        right.late,
        lambda: right.reset(starts[1]),
    ):
        body = right.occupied("other", TURNED)
        assert not body.stale
        assert left.check(starts[0], starts[0], sent=0, around=[body]).ok
        changed()
        assert body.stale
        decided = left.counts.chunks
        with pytest.raises(InvalidRequest, match=r"around\[0\].*decided since"):
            left.check(starts[0], starts[0], sent=0, around=[body])
        assert left.counts.chunks == decided
