"""The hand against an object, judged as the checker judges the whole robot; the parts of its fingers seen along their
way."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service import Obstacle, Pose, Scene, load_robot
from planner_service.collision import CollisionChecker
from planner_service.geometry.composite import PointCloud, Solid
from planner_service.grasping.hand import HandCheck, jaws_of
from planner_service.robot.model import Robot
from planner_service.scene.names import Names
from tests.support.optional import present
from tests.unit.grasping.solids import pose, solids

CLOUD = PointCloud(np.random.default_rng(3).normal(size=(50, 3)) * 0.02, 0.01)
loaded = cache(load_robot)


@given(
    st.sampled_from(["panda", "wxai", "kinova_gripper", "ur5_vacuum"]),
    st.one_of(solids(), st.just(CLOUD)),
    st.integers(0, 10_000),
    st.floats(0.0, 1.0),
)
@settings(max_examples=60, deadline=None)
def test_the_links_of_a_hand_that_touch_an_object_are_those_that_the_checker_says(
    name: str, shape: Solid, seed: int, share: float
) -> None:
    robot = loaded(name)
    gripper = present(robot.gripper)
    width = gripper.lower + share * (gripper.upper - gripper.lower)
    seen = pose(seed, 0.06)
    tool = Pose.from_matrix(robot.tool_pose(robot.home))
    scene = Scene((Obstacle("thing", shape, tool @ seen),))
    checker = CollisionChecker(robot.with_gripper(width) if gripper.kind != "vacuum" else robot, scene)
    hand = {item.link for item in robot.shapes if item.body == robot.tool_body} | set(gripper.links)
    names = Names(robot, scene)
    labels = {names.link(link): link for link in hand}
    touching = {labels[contact.a] for contact in checker.contacts(robot.home) if contact.a in labels}
    assert HandCheck(robot, shape).touching(seen, width) == touching


@pytest.mark.parametrize("name", ["panda", "wxai", "wxai_mesh", "wxai_dual", "kinova_gripper"])
def test_the_fingers_are_on_either_side_and_one_part_of_each_is_where_the_width_is_measured(name: str) -> None:
    robot: Robot = loaded(name)
    gripper = present(robot.gripper)
    jaws = jaws_of(robot, gripper.upper / 2.0)
    for side in (1.0, -1.0):
        assert min(jaw.recess for jaw in jaws if jaw.side == side) < 1e-9
    assert HandCheck(robot, CLOUD).sides(frozenset(gripper.links)) == {1.0, -1.0}
    assert all(jaw.low[k] < jaw.high[k] for jaw in jaws for k in range(2))
