"""Grasps and places of objects whose own frame is not in their middle; those of others are in test_primitives."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.collision import CollisionChecker
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Pose
from planner_service.grasping.grasps import middle_of, offset_from, top_grasps
from planner_service.planning.task_result import Handling
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import robot_names
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.primitives import pick

LOPSIDED = Mesh(np.array([[x, y, z] for x in (0.10, 0.14) for y in (-0.21, -0.18) for z in (0.0, 0.06)]))


def test_a_mesh_beside_its_own_frame_is_grasped_in_its_middle() -> None:
    robot = load_robot("wxai")
    assert robot.gripper is not None
    target = Obstacle("cup", LOPSIDED, Pose.from_rpy((0.1, 0.3, 0.0), (0.0, 0.0, 0.5)))
    assert middle_of(target) == pytest.approx((target.pose @ Pose((0.12, -0.195, 0.03))).position, abs=1e-12)
    for grasp in top_grasps(robot, target):
        aside, beyond = offset_from(target, grasp, robot)
        assert aside < 1e-9
        assert beyond == 0.0


GRIPPING = ("panda", "wxai", "wxai_dual", "wxai_mesh")
BESIDE = {"wxai_dual": (0.25, 0.30)}
"""Where an arm that does not stand in the middle of its table reaches."""


def cube_on_a_table(name: str) -> Scene:
    x, y = BESIDE.get(name, (0.35, 0.10))
    return load_scene("table").with_obstacle(Obstacle("cube", Box((0.045, 0.045, 0.045)), Pose((x, y, 0.0235))))


def test_the_arms_with_a_gripper_are_these() -> None:
    kinds = {name: gripper.kind for name in robot_names() if (gripper := load_robot(name).gripper) is not None}
    assert tuple(name for name, kind in kinds.items() if kind == "parallel") == GRIPPING
    others = {name: kind for name, kind in kinds.items() if kind != "parallel"}
    assert others == {"kinova_gripper": "revolute", "ur5_vacuum": "vacuum", "xarm7_vacuum": "vacuum"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "wxai_dual"])
def test_every_arm_with_a_gripper_takes_a_cube_from_above_between_its_fingers(name: str) -> None:
    """The fingers as shapes in the world tell, not the tool frame: they hang from the palm, one on either side."""
    scene = cube_on_a_table(name)
    service, cube = PlannerService(name, scene), scene.obstacle("cube")
    task = pick(service, service.robot.home, "cube", top_grasps(service.robot, cube), Handling(support="table"))
    assert task.failure is None, task.failure
    lift = task.segments[2].result.unwrap()[0]
    gripper, hand = service.robot.gripper, service.robot.with_gripper(task.segments[2].width)
    assert gripper is not None
    bodies = hand.body_poses(lift.waypoints[0].tolist())
    poses = [Pose.from_matrix(body_matrix(body)) for body in bodies]
    left, right = (
        [(poses[item.body] @ item.pose).position for item in hand.shapes if item.link == link]
        for link in dict.fromkeys(item.link for item in gripper.closed)
    )
    tips = [np.array(min(side, key=lambda at: at[2])) for side in (left, right)]
    middle = np.array(cube.pose.position)
    across = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    sides = [float((tip - middle) @ across) for tip in tips]
    down = middle - np.array(bodies[hand.tool_body][9:])
    assert -down[2] >= np.cos(np.radians(30.5)) * np.linalg.norm(down)  # the palm is above the cube, but for the tilt
    assert max(sides) > 0.0 > min(sides)
    assert sides[0] == pytest.approx(-sides[1], abs=0.004)
    assert abs(across[2]) < 0.1
    touching = {contact.a for contact in CollisionChecker(hand, Scene(obstacles=(cube,))).contacts(lift.waypoints[0])}
    assert touching <= set(gripper.links)  # and nothing else of the arm is in the cube
