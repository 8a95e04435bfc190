"""Grasps and places of objects whose own frame is not in their middle; those of others are in test_primitives."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.geometry import Box, Pose
from planner_service.grasps import middle_of, offset_from, top_grasps
from planner_service.mesh import Mesh
from planner_service.pick_place import places_on
from planner_service.robot import load_robot
from planner_service.scene import Obstacle

LOPSIDED = Mesh(np.array([[x, y, z] for x in (0.10, 0.14) for y in (-0.21, -0.18) for z in (0.0, 0.06)]))


def test_a_mesh_beside_its_own_frame_is_grasped_in_its_middle() -> None:
    robot = load_robot("wxai")
    assert robot.gripper is not None
    target = Obstacle("cup", LOPSIDED, Pose.from_rpy((0.1, 0.3, 0.0), (0.0, 0.0, 0.5)))
    assert middle_of(target) == pytest.approx((target.pose @ Pose((0.12, -0.195, 0.03))).position, abs=1e-12)
    for grasp in top_grasps(robot, target):
        aside, beyond = offset_from(target, grasp, robot.gripper)
        assert aside < 1e-9
        assert beyond == 0.0


def test_a_mesh_is_set_down_by_its_middle() -> None:
    target = Obstacle("cup", LOPSIDED, Pose((0.1, 0.3, 0.0)))
    support = Obstacle("tray", Box((0.2, 0.2, 0.02)), Pose((0.2, -0.1, 0.01)))
    for pose in places_on(target, support):
        x, y, z = middle_of(Obstacle("cup", LOPSIDED, pose))
        assert (x, y, z) == pytest.approx((0.2, -0.1, 0.05), abs=1e-12)
