"""The tube that is drawn has room for the arm wherever it can be, and its margin is one that everything keeps."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlannerService, load_robot
from planner_service.collision import CollisionChecker
from planner_service.gate import ActionGate, Decision, Tracking
from planner_service.geometry.arrays import FloatArray
from planner_service.scene.scene import Scene
from planner_service.view.gate.tube import WIDEST, margin_of, tube_of
from planner_service.view.triangles import placements, robot_solids
from tests.support.optional import present
from tests.unit.certify.test_certifier import ball_beyond
from tests.unit.gate.test_action_gate import START, gate_of, ramp

TRACKING = Tracking(goal_time=0.1, error=0.01, jitter=0.004, lag=0.03)


def moving(name: str, count: int) -> Decision:
    """An arm on its way, with so many targets ahead."""
    robot = load_robot(name)
    gate = ActionGate(PlannerService(robot, Scene()), rate=30.0, tracking=TRACKING, slow=True)
    rng = np.random.default_rng(4)
    step = 0.01 * rng.uniform(-1.0, 1.0, robot.n)
    gate.reset(robot.home)
    gate.check(robot.home, np.clip(robot.home + np.arange(1, 1 + count)[:, None] * step, *robot.bounds))
    return present(gate.decision)


def drawn(decision: Decision) -> FloatArray:
    return np.concatenate([part.triangles[0] for part in tube_of(decision)])


@pytest.mark.parametrize("name", ["planar2", "wxai", "panda"])
@pytest.mark.parametrize("count", [1, 40])
def test_the_tube_reaches_as_far_as_what_moves_of_the_arm_can_in_every_direction(name: str, count: int) -> None:
    decision = moving(name, count)
    robot, rng = decision.certifier.robot, np.random.default_rng(5)
    directions = rng.normal(size=(60, 3))
    reach = (drawn(decision) @ directions.T).max(axis=0)
    ways = [decision.here, decision.ahead]
    still = {item.link for item in robot.shapes if item.body == 0}
    solids = [solid for solid in robot_solids(robot) if solid.name not in still]
    for _ in range(60):
        way = ways[rng.integers(2)]
        k = rng.integers(len(way.starts))
        q = way.starts[k] + rng.uniform() * (way.ends[k] - way.starts[k])
        q = np.clip(q + way.rooms[k] * rng.choice([-1.0, 1.0], robot.n), *robot.bounds)
        frames = placements(robot, q)
        for solid in solids:
            pose = frames[str(solid.frame)]
            points = solid.vertices @ pose[:3, :3].T + pose[:3, 3]
            assert np.all((points @ directions.T).max(axis=0) <= reach)


def test_what_passes_and_what_brakes_are_drawn_apart() -> None:
    gate = gate_of(ball_beyond(-0.05))
    gate.check(START, ramp(90))
    passing, braking = tube_of(present(gate.decision))
    assert min(passing.places, braking.places) > 0
    assert min(len(passing.triangles[1]), len(braking.triangles[1])) > 0


def test_everything_keeps_the_margin_wherever_the_arm_can_be() -> None:
    gate = gate_of(ball_beyond(-0.05))
    gate.check(START, ramp(90))
    decision, rng = present(gate.decision), np.random.default_rng(6)
    margin, checker = margin_of(decision), CollisionChecker(gate.robot, gate.service.scene)
    least = np.inf
    for start, end, room in zip(*decision.ahead, strict=True):
        for share in (0.0, 0.5, 1.0):
            q = start + share * (end - start) + room * rng.choice([-1.0, 1.0], 2)
            least = min(least, checker.clearance(np.clip(q, *gate.robot.bounds)))
    assert 0.0 < margin <= least < margin + 0.05


def test_a_wide_margin_is_told_as_the_widest_and_without_a_proof_there_is_none() -> None:
    gate = gate_of(Scene())
    gate.check(START, ramp(5))
    free = margin_of(present(gate.decision))
    gate.check(START + 1.0, ramp(5), sent=0)
    lost = present(gate.decision)
    assert (free, lost.verdict.proven, margin_of(lost)) == (WIDEST, False, 0.0)
