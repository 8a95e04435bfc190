"""Contact that a motion was planned with stays meant only where it is still what was meant."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.replanning import Outcome, Replanned
from planner_service.scene.scene import Scene
from tests.support.optional import present
from tests.unit.replanning.test_replan import trajectory_of


@cache
def descend() -> ps.PlanResult:
    """The way in of a pick, on which the fingers may touch the block."""
    service = ps.PlannerService("wxai", "bin")
    grasps = ps.top_grasps(service.robot, service.scene.obstacle("blue_block"))
    home = service.robot.home
    handling = ps.Handling(support="bin_floor", request=ps.PlanRequest(home, home, time_limit=None))
    task = ps.pick(service, home, "blue_block", grasps, handling)
    assert task.failure is None
    return task.segments[1].result


def made_by(result: ps.PlanResult) -> ps.PlannerService:
    return ps.PlannerService.of(present(result.origin).world)


def test_contact_stays_meant_with_an_object_that_stands_where_it_stood() -> None:
    service = made_by(descend())
    elsewhere = service.scene.with_obstacle(ps.Obstacle("far", ps.Sphere(0.01), ps.Pose((-0.4, 0.0, 0.5))))
    found = service.replan(descend(), at_time=0.05, scene=elsewhere)
    assert found.outcome is Outcome.KEPT
    assert [stretch.pairs for stretch in found.result.exempt] == [stretch.pairs for stretch in descend().exempt]
    again = service.replan(found, at_time=0.05, scene=elsewhere)
    assert again.outcome is Outcome.KEPT
    assert again.result.exempt


def test_an_object_that_moved_is_not_touched() -> None:
    for aside in [0.0035, 0.02]:
        service = made_by(descend())
        moved = turned_and_moved(service, tool_at_the_end(service), (0.0, aside, 0.0), 0.0)
        old: ps.PlanResult | Replanned = descend() if aside > 0.01 else service.replan(descend(), at_time=0.05)
        found = service.replan(old, at_time=0.0, latency=0.1, scene=moved)
        assert found.result.exempt == ()
        assert any("finger_left x blue_block may no longer touch" in note for note in found.result.notes)
        motion = trajectory_of(found)
        assert ps.CollisionChecker(service.robot, moved).states_are_free(motion.sample(0.01).q).all()


def tool_at_the_end(service: ps.PlannerService) -> Any:
    return service.robot.tool_pose(descend().unwrap()[0].waypoints[-1])


def turned_and_moved(service: ps.PlannerService, tool: Any, steps: tuple[float, float, float], yaw: float) -> Scene:
    """The scene with the block moved by metres along the tool's axes, and turned about the vertical."""
    block = service.scene.obstacle("blue_block")
    x, y, z = (np.array(block.pose.position) + tool[:3, :3] @ np.array(steps)).tolist()
    return service.scene.moved("blue_block", ps.Pose.from_rpy((x, y, z), (0.0, 0.0, yaw)))


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "yaw"), [((0.0, 1e-6, 0.0), 0.0), ((0.0, -0.0025, 0.003), 0.02)])
def test_a_block_that_moved_so_little_that_the_grasp_is_sound_may_be_touched(
    steps: tuple[float, float, float], yaw: float
) -> None:
    service = made_by(descend())
    moved = turned_and_moved(service, tool_at_the_end(service), steps, yaw)
    found = service.replan(descend(), at_time=0.0, latency=0.5, scene=moved)
    assert found.outcome is Outcome.KEPT
    assert {pair for stretch in found.result.exempt for pair in stretch.pairs} == {
        pair for stretch in descend().exempt for pair in stretch.pairs
    }
    assert any("finger_left x blue_block may still touch" in note for note in found.result.notes)
    assert found.counts.states > service.replan(descend(), at_time=0.0, latency=0.5).counts.states
    motion, there = trajectory_of(found), ps.CollisionChecker(service.robot, moved)
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
    service = made_by(descend())
    moved = turned_and_moved(service, tool_at_the_end(service), steps, yaw)
    found = service.replan(descend(), at_time=0.0, latency=0.5, scene=moved)
    assert found.result.exempt == ()
    assert any("finger_left x blue_block may no longer touch" in note and why in note for note in found.result.notes)


def test_contact_with_what_changed_its_shape_or_comes_from_a_file_is_not_meant() -> None:
    service = made_by(descend())
    block = service.scene.obstacle("blue_block")
    larger = service.scene.without("blue_block").with_obstacle(replace(block, shape=ps.Box((0.045, 0.046, 0.045))))
    assert service.replan(descend(), at_time=0.05, scene=larger).result.exempt == ()
    assert service.replan(replace(descend(), origin=None), at_time=0.05).result.exempt == ()
