"""Contact that a motion was planned with stays meant only where it is still what was meant."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Box,
    CollisionChecker,
    Handling,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanResult,
    Pose,
    Sphere,
    pick,
    top_grasps,
)
from planner_service.replanning import Outcome, Replanned
from planner_service.scene.scene import Scene
from tests.support.optional import present
from tests.unit.replanning.test_replan import trajectory_of


@cache
def descend() -> PlanResult:
    """The way in of a pick, on which the fingers may touch the block."""
    service = PlannerService("wxai", "bin")
    grasps = top_grasps(service.robot, service.scene.obstacle("blue_block"))
    task = pick(service, service.robot.home, "blue_block", grasps, Handling(support="bin_floor"))
    assert task.failure is None
    return task.segments[1].result


def made_by(result: PlanResult) -> PlannerService:
    return PlannerService.of(present(result.origin).world)


def test_contact_stays_meant_with_an_object_that_stands_where_it_stood() -> None:
    service = made_by(descend())
    elsewhere = service.scene.with_obstacle(Obstacle("far", Sphere(0.01), Pose((-0.4, 0.0, 0.5))))
    found = service.replan(descend(), at_time=0.05, scene=elsewhere)
    assert found.outcome is Outcome.KEPT
    assert [stretch.pairs for stretch in found.result.exempt] == [stretch.pairs for stretch in descend().exempt]
    again = service.replan(found, at_time=0.05, scene=elsewhere)
    assert again.outcome is Outcome.KEPT
    assert again.result.exempt


def test_an_object_that_moved_is_not_touched() -> None:
    for steps in [1, 2]:
        for aside in [0.0035, 0.012, 0.02, 0.045]:
            service = made_by(descend())
            block = service.scene.obstacle("blue_block")
            closing = service.robot.tool_pose(descend().unwrap()[0].waypoints[-1])[:3, 1]
            x, y, z = (np.array(block.pose.position) + aside * closing).tolist()
            moved = service.scene.moved("blue_block", Pose((x, y, z), block.pose.quaternion))
            old: PlanResult | Replanned = descend() if steps == 1 else service.replan(descend(), at_time=0.05)
            found = service.replan(old, at_time=0.0, latency=0.1, scene=moved)
            assert found.result.exempt == ()
            assert any("finger_left x blue_block may no longer touch" in note for note in found.result.notes)
            motion = trajectory_of(found)
            there = CollisionChecker(service.robot, moved)
            assert all(there.state_is_free(motion(t)) for t in np.linspace(0.0, motion.duration, 100))


def turned_and_moved(service: PlannerService, tool: Any, steps: tuple[float, float, float], yaw: float) -> Scene:
    """The scene with the block moved by metres along the tool's axes, and turned about the vertical."""
    block = service.scene.obstacle("blue_block")
    x, y, z = (np.array(block.pose.position) + tool[:3, :3] @ np.array(steps)).tolist()
    return service.scene.moved("blue_block", Pose.from_rpy((x, y, z), (0.0, 0.0, yaw)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "yaw"),
    [((0.0, 1e-6, 0.0), 0.0), ((0.0, 0.002, 0.0), 0.0), ((0.0, -0.0025, 0.003), 0.02), ((-0.003, 0.0, 0.0), 0.02)],
)
def test_a_block_that_moved_so_little_that_the_grasp_is_sound_may_be_touched(
    steps: tuple[float, float, float], yaw: float
) -> None:
    service, end = made_by(descend()), descend().unwrap()[0].waypoints[-1]
    moved = turned_and_moved(service, service.robot.tool_pose(end), steps, yaw)
    found = service.replan(descend(), at_time=0.0, latency=0.5, scene=moved)
    assert found.outcome is Outcome.KEPT
    assert {pair for stretch in found.result.exempt for pair in stretch.pairs} == {
        pair for stretch in descend().exempt for pair in stretch.pairs
    }
    assert any("finger_left x blue_block may still touch" in note for note in found.result.notes)
    assert found.counts.states > service.replan(descend(), at_time=0.0, latency=0.5).counts.states
    motion, there = trajectory_of(found), CollisionChecker(service.robot, moved)
    contacts = [c for t in np.linspace(0.0, motion.duration, 200) for c in there.contacts(motion(t))]
    assert all(c.b == "blue_block" and c.depth <= 0.001 for c in contacts)
    gone = service.scene.without("blue_block")
    assert service.replan(found, at_time=0.0, latency=0.5, scene=gone).result.exempt == ()


@pytest.mark.parametrize(
    ("steps", "yaw", "why"),
    [
        ((0.0, 0.0035, 0.0), 0.0, "closing would push blue_block 4 mm aside"),
        ((0.036, 0.0, 0.0), 0.0, "mm away from blue_block"),
        ((0.0, 0.0, 0.034), 0.0, "mm away from blue_block"),
        ((0.0, 0.0, 0.0), 0.785, "blue_block is 63.6 mm wide between the fingers, not 45.0 mm"),
        ((-0.05, 0.0, 0.0), 0.0, "touch"),
    ],
)
def test_a_block_that_the_gripper_would_not_hold_where_it_is_may_not_be_touched(
    steps: tuple[float, float, float], yaw: float, why: str
) -> None:
    service, end = made_by(descend()), descend().unwrap()[0].waypoints[-1]
    moved = turned_and_moved(service, service.robot.tool_pose(end), steps, yaw)
    found = service.replan(descend(), at_time=0.0, latency=0.5, scene=moved)
    assert found.result.exempt == ()
    assert any("finger_left x blue_block may no longer touch" in note and why in note for note in found.result.notes)


def test_contact_with_what_changed_its_shape_or_comes_from_a_file_is_not_meant() -> None:
    service = made_by(descend())
    block = service.scene.obstacle("blue_block")
    larger = service.scene.without("blue_block").with_obstacle(replace(block, shape=Box((0.045, 0.046, 0.045))))
    assert service.replan(descend(), at_time=0.05, scene=larger).result.exempt == ()
    assert service.replan(replace(descend(), origin=None), at_time=0.05).result.exempt == ()


def test_a_motion_made_with_another_gripper_width_is_refused() -> None:
    service = made_by(descend())
    with pytest.raises(
        InvalidRequest, match=r"previous: got 'a motion of wxai, .*expected one of wxai, .*gripper as wide"
    ):
        service.changed(gripper=0.08).replan(descend(), at_time=0.05)
