"""What fingers need room for, which is where they can be at any width."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import PlannerService, Scene, load_robot
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.robot.gripper import Gripper
from planner_service.robot.kinematic_tree import LinkShape
from planner_service.scene.scene import Obstacle

ROUNDING = 1e-12
"""Metres."""


def gripper_of(name: str) -> Gripper:
    gripper = load_robot(name).gripper
    assert gripper is not None
    return gripper


def points_of(item: LinkShape) -> FloatArray:
    """Points of a shape, (at most 200, 3), farthest in as many directions, in the frame of its body."""
    directions = np.random.default_rng(0).normal(size=(200, 3))
    farthest = np.unique(item.shape.support(directions @ item.pose.rotation), axis=0)
    return farthest @ item.pose.rotation.T + item.pose.position


@pytest.mark.parametrize("name", ["wxai", "panda", "kinova_gripper"])
def test_the_room_of_a_gripper_has_its_fingers_in_it_at_every_width(name: str) -> None:
    gripper = gripper_of(name)
    rooms = gripper.room()
    for width in np.linspace(gripper.lower, gripper.upper, 17).tolist():
        for item, room in zip(gripper.shapes(width), rooms, strict=True):
            assert (item.link, item.body) == (room.link, room.body)
            assert float(room.shape.distance(points_of(item)).max()) <= ROUNDING


def test_the_room_of_a_finger_that_slides_is_no_larger_than_its_hull_at_both_ends() -> None:
    gripper = gripper_of("wxai")
    ends = [gripper.shapes(width) for width in (gripper.lower, gripper.upper)]
    for k, room in enumerate(gripper.room()):
        corners = np.concatenate([points_of(shapes[k]) for shapes in ends])
        assert np.allclose(room.shape.support(np.eye(3)).diagonal(), corners.max(axis=0), atol=ROUNDING)
        assert np.allclose(room.shape.support(-np.eye(3)).diagonal(), corners.min(axis=0), atol=ROUNDING)


def test_the_room_of_a_cup_is_the_cup() -> None:
    gripper = gripper_of("ur5_vacuum")
    assert gripper.room() == gripper.closed


def test_what_any_width_touches_is_touched_by_the_room() -> None:
    robot = load_robot("wxai")
    tool = Pose.from_matrix(robot.tool_pose(robot.home))
    beside = Scene(obstacles=(Obstacle("pin", Box((0.004, 0.004, 0.004)), tool @ Pose((0.0, 0.03, 0.0))),))
    free = [PlannerService(robot.with_gripper(w), beside).checker.state_is_free(robot.home) for w in (0.0, 0.08)]
    assert True in free
    roomy = robot.with_finger_room()
    assert roomy.gripper is None
    assert not PlannerService(roomy, beside).checker.state_is_free(robot.home)


def test_a_robot_without_a_gripper_needs_no_room_for_fingers() -> None:
    robot = load_robot("planar2")
    assert robot.with_finger_room() is robot
