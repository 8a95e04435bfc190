"""Grasps from the side, and all kinds of grasps as one value."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from planner_service import Box, Cylinder, Obstacle, Pose, load_robot, top_grasps
from planner_service.errors import InvalidRequest
from planner_service.grasping import GraspKind, GraspKinds, antipodal_grasps, side_grasps, suction_grasps
from planner_service.grasping.guards import grasp_objection
from tests.support.optional import present

loaded = cache(load_robot)
CAN = Obstacle("can", Cylinder(0.03, 0.12), Pose((0.35, 0.0, 0.06)))


@pytest.mark.parametrize("name", ["wxai", "panda"])
def test_side_grasps_come_level_or_from_somewhat_above_and_close_level_around_the_middle(name: str) -> None:
    robot = loaded(name)
    gripper = present(robot.gripper)
    grasps = side_grasps(robot, CAN)
    rises = [float((grasp.rotation @ np.array(gripper.approach))[2]) for grasp in grasps]
    assert np.diff(rises).max() < 1e-12
    assert rises[:8] == pytest.approx([0.0] * 8, abs=1e-12)
    assert rises[-1] == pytest.approx(-math.sin(math.radians(30.0)))
    for grasp in grasps:
        assert abs((grasp.rotation @ np.array(gripper.closing))[2]) < 1e-12
        assert math.dist(grasp.position, CAN.pose.position) < 1e-12
        assert grasp_objection(CAN, grasp, robot) == ""


def test_what_is_too_wide_or_leans_too_far_is_refused_from_the_side_too() -> None:
    robot = loaded("wxai")
    with pytest.raises(InvalidRequest, match=r"target: got 'crate'; expected an object at most 0.080 m wide"):
        side_grasps(robot, Obstacle("crate", Box((0.2, 0.2, 0.2))))
    with pytest.raises(InvalidRequest, match=r"leans\[0\]: got 4.0; expected an angle"):
        side_grasps(robot, CAN, leans=(4.0,))
    with pytest.raises(InvalidRequest, match=r"leans: got .*; expected at least one angle"):
        side_grasps(robot, CAN, leans=())
    with pytest.raises(InvalidRequest, match="robot: got 'ur5_vacuum, whose gripper is a cup'"):
        side_grasps(loaded("ur5_vacuum"), CAN)


@pytest.mark.slow
def test_all_kinds_come_one_after_the_other_as_the_gripper_can() -> None:
    robot, cup = loaded("wxai"), loaded("ur5_vacuum")
    fingers = (*top_grasps(robot, CAN), *side_grasps(robot, CAN), *antipodal_grasps(robot, CAN, seed=3, most=20))
    assert GraspKinds(seed=3, most=20).poses(robot, CAN) == tuple(dict.fromkeys(fingers))
    cups = (*top_grasps(cup, CAN), *suction_grasps(cup, CAN))
    assert GraspKinds().poses(cup, CAN) == tuple(dict.fromkeys(cups))
    assert GraspKinds((GraspKind.SIDE,)).poses(robot, CAN) == side_grasps(robot, CAN)
    assert GraspKinds([GraspKind.SIDE]) == GraspKinds((GraspKind.SIDE,))


def test_a_kind_that_finds_nothing_is_passed_over_and_all_that_do_are_named() -> None:
    robot = loaded("wxai")
    crate = Obstacle("crate", Box((0.2, 0.2, 0.2)), Pose((0.3, 0.0, 0.1)))
    with pytest.raises(InvalidRequest, match=r"target: got 'crate'; expected top: .* side: .* antipodal: "):
        GraspKinds().poses(robot, crate)
    with pytest.raises(InvalidRequest, match=r"kinds: got 'suction'; expected some that a parallel gripper can do"):
        GraspKinds((GraspKind.SUCTION,)).poses(robot, CAN)


REFUSED = [
    ({"kinds": ()}, "kinds: got .*; expected at least one GraspKind, each once"),
    ({"kinds": (GraspKind.TOP, GraspKind.TOP)}, "kinds: got .*; expected at least one GraspKind, each once"),
    ({"kinds": ("top",)}, "kinds"),
    ({"friction": 0.0}, "friction: got 0.0"),
    ({"seed": 0.5}, "seed: got 0.5"),
    ({"most": 1_001}, "most: got 1001"),
]


@pytest.mark.parametrize(("given", "said"), REFUSED)
def test_a_value_out_of_its_range_is_named(given: dict[str, object], said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        GraspKinds(**given)  # type: ignore[arg-type]
