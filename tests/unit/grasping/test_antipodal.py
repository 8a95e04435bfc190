"""Antipodal grasps hold: judged by rays of another kind, by closed forms of widths, and by the checker."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service import Box, Cylinder, Obstacle, Pose, Scene, Sphere, load_robot
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.composite import PointCloud
from planner_service.grasping import antipodal_grasps, grasp_quality
from planner_service.grasping.guards import grasp_objection
from planner_service.grasping.held import held_by
from planner_service.robot.model import Robot
from tests.support.optional import present
from tests.unit.grasping.solids import KINDS, first_hit, pose, solid
from tests.unit.grasping.test_held import DOOR, tray

loaded = cache(load_robot)
NAMES = ["wxai", "panda", "wxai_mesh", "kinova_gripper"]


def found(robot: Robot, target: Obstacle, friction: float = 0.5, seed: int = 0, most: int = 64) -> tuple[Pose, ...]:
    """The grasps; none for an object that has none."""
    try:
        return antipodal_grasps(robot, target, friction=friction, seed=seed, most=most)
    except InvalidRequest as error:
        if error.field != "target":
            raise
        return ()


@pytest.mark.slow
@given(st.sampled_from(NAMES[:2]), st.sampled_from(KINDS), st.integers(0, 10_000), st.floats(0.1, 1.0))
@settings(max_examples=8, deadline=None)
def test_both_contacts_are_in_each_others_cone_of_friction_and_no_wider_than_the_gripper(
    name: str, kind: str, seed: int, friction: float
) -> None:
    robot = loaded(name)
    gripper, target = present(robot.gripper), Obstacle("thing", solid(kind, seed), pose(seed))
    for grasp in found(robot, target, friction, seed, 12):
        seen = target.pose.inverse() @ grasp
        axis, middle = seen.rotation @ np.array(gripper.closing), np.array(seen.position)
        contacts = []
        for sign in (1.0, -1.0):
            at, normal = first_hit(target.shape, middle + sign * 0.5 * axis, -sign * axis, 0.6)
            assert math.tan(math.acos(min(1.0, float(normal @ (sign * axis))))) <= friction + 1e-3
            contacts.append(at)
        across = float(np.linalg.norm(contacts[0] - contacts[1]))
        assert across <= gripper.upper
        assert across == pytest.approx(held_by(target, grasp, robot).width, abs=2e-3)


@pytest.mark.slow
@given(st.sampled_from(NAMES), st.sampled_from(KINDS), st.integers(0, 10_000))
@settings(max_examples=8, deadline=None)
def test_the_open_hand_is_free_of_the_object_and_closed_it_touches_it_on_both_sides_as_the_checker_says(
    name: str, kind: str, seed: int
) -> None:
    robot = loaded(name)
    gripper, target = present(robot.gripper), Obstacle("thing", solid(kind, seed), pose(seed))
    for grasp in found(robot, target, most=6):
        assert grasp_objection(target, grasp, robot) == ""
        there = Pose.from_matrix(robot.tool_pose(robot.home)) @ grasp.inverse() @ target.pose
        width = held_by(target, grasp, robot).width

        def touching(opening: float, at: Pose = there) -> set[str]:
            opening = min(max(opening, gripper.lower), gripper.upper)
            scene = Scene((Obstacle("thing", target.shape, at),))
            checker = CollisionChecker(robot.with_gripper(opening), scene)
            hand = {shape.link for shape in robot.shapes if shape.body == robot.tool_body} | set(gripper.links)
            return {contact.a for contact in checker.contacts(robot.home) if contact.a in hand}

        assert touching(width + 0.0062) == set() or width > gripper.upper - 0.0062
        fingers = touching(width - 0.0045)
        assert len({item.link for item in gripper.closed if item.link in fingers}) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.2, 1.0])
def test_a_box_is_held_by_opposite_faces_that_fit_and_a_ball_through_its_middle(friction: float) -> None:
    robot = loaded("wxai")
    box = Obstacle("box", Box((0.05, 0.12, 0.09)), pose(5))
    grasps = found(robot, box, friction)
    assert grasps
    widths = {round(held_by(box, grasp, robot).width, 9) for grasp in grasps}
    assert widths == {0.05}
    ball = Obstacle("ball", Sphere(0.03), pose(6))
    for grasp in found(robot, ball, friction):
        assert math.dist(grasp.position, ball.pose.position) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.015, 0.03, 0.035])
def test_fingers_that_turn_hold_a_ball_as_far_in_as_they_meet_it(radius: float) -> None:
    robot, ball = loaded("kinova_gripper"), Obstacle("ball", Sphere(radius), Pose((0.4, 0.1, 0.1)))
    gripper = present(robot.gripper)
    grasps = antipodal_grasps(robot, ball, most=8)
    x, y = np.array(gripper.approach), np.array(gripper.closing)
    for grasp in grasps:
        middle = (np.array(ball.pose.position) - np.array(grasp.position)) @ grasp.rotation
        along, across = float(middle @ x), float(middle @ y)
        assert -0.03 - 1e-9 <= along <= 1e-9
        assert math.sqrt(float(middle @ middle) - along**2) < 1e-9
        assert abs(across) < 1e-9


def test_the_best_come_first_and_no_two_are_nearly_equal() -> None:
    robot = loaded("panda")
    for shape in (Box((0.04, 0.06, 0.12)), DOOR):
        target = Obstacle("thing", shape, pose(7))
        grasps = antipodal_grasps(robot, target)
        values = [grasp_quality(robot, target, grasp).value for grasp in grasps]
        assert values == sorted(values, reverse=True) or np.diff(values).max() < 1e-6
        assert min(values) > 0.0
        for k, one in enumerate(grasps):
            for other in grasps[:k]:
                turn = 2.0 * math.acos(min(1.0, abs(float(np.dot(one.quaternion, other.quaternion)))))
                assert math.dist(one.position, other.position) / 0.01 + turn / math.radians(20.0) > 0.95


@pytest.mark.slow
def test_few_grasps_cover_what_many_do() -> None:
    robot, can = loaded("wxai"), Obstacle("can", Cylinder(0.03, 0.16), pose(9))
    many, few = antipodal_grasps(robot, can, most=1_000), antipodal_grasps(robot, can, most=10)
    assert 4 <= len(few) <= 10 < len(many)
    assert few[0] == many[0]
    for grasp in many:
        assert min(math.dist(grasp.position, other.position) for other in few) < 0.08


@pytest.mark.slow
@given(st.sampled_from(KINDS), st.integers(0, 1_000))
@settings(max_examples=3, deadline=None)
def test_the_same_seed_gives_the_same_grasps(kind: str, seed: int) -> None:
    target = Obstacle("thing", solid(kind, seed), pose(seed))
    once, again = (found(loaded("wxai"), target, seed=seed, most=8) for _ in range(2))
    assert once == again


@pytest.mark.slow
def test_another_seed_draws_other_lines() -> None:
    target = Obstacle("thing", solid("mesh", 3), pose(3))
    assert found(loaded("wxai"), target, seed=1) != found(loaded("wxai"), target, seed=2)


@pytest.mark.slow
def test_an_object_that_moves_takes_its_grasps_along() -> None:
    robot, shape = loaded("wxai"), solid("compound", 4)
    here, there = Pose((0.3, 0.1, 0.0)), Pose.from_rpy((-0.1, 0.4, 0.2), (0.0, 0.0, 1.1))
    first = found(robot, Obstacle("thing", shape, here), most=12)
    moved = found(robot, Obstacle("thing", shape, there @ here), most=12)
    assert first
    for one, other in zip(first, moved, strict=True):
        np.testing.assert_allclose((there @ one).matrix, other.matrix, atol=1e-7)


@pytest.mark.slow
def test_a_door_is_taken_by_its_handle_and_a_tray_by_its_walls() -> None:
    robot = loaded("wxai")
    door = Obstacle("door", DOOR, Pose())
    on_the_bar = [grasp for grasp in found(robot, door) if grasp.position[1] > 0.045]
    assert len(on_the_bar) >= 3
    assert min(held_by(door, grasp, robot).width for grasp in on_the_bar) == pytest.approx(0.018, abs=1e-6)
    widths = {round(held_by(tray(0.06), grasp, robot).width, 6) for grasp in found(robot, tray(0.06))}
    assert 0.003 in widths  # by one wall
    assert 0.066 in widths  # across both


@pytest.mark.slow
def test_a_cloud_is_taken_as_its_cells_and_one_of_too_many_is_refused() -> None:
    rng = np.random.default_rng(0)
    cloud = Obstacle("heap", PointCloud(rng.uniform(-0.02, 0.02, (300, 3)), 0.01), Pose((0.3, 0.0, 0.1)))
    assert found(loaded("wxai"), cloud)
    wide = PointCloud(rng.uniform(-1.0, 1.0, (20_000, 3)), 0.005)
    with pytest.raises(InvalidRequest, match=r"target: got 'heap, .* pieces'; expected an object of at most 5,000"):
        antipodal_grasps(loaded("wxai"), Obstacle("heap", wide))


REFUSED = [
    ({"robot": "ur5_vacuum"}, r"robot: got 'ur5_vacuum, whose gripper is a cup'; expected a robot with a gripper that"),
    ({"robot": "ur5"}, r"robot: got 'ur5'; expected a robot with a gripper that has fingers"),
    ({"friction": math.nan}, r"friction: got nan; expected a coefficient of friction in \[0.01, 10\]"),
    ({"seed": -1}, r"seed: got -1; expected"),
    ({"most": 0}, r"most: got 0; expected"),
    ({"target": Box((0.1, 0.1, 0.1))}, r"target: got .*; expected an Obstacle"),
    ({"target": Obstacle("crate", Box((0.3, 0.3, 0.3)))}, r"target: got 'crate'; expected an object with two sides"),
]


@pytest.mark.parametrize(("change", "said"), REFUSED)
def test_what_cannot_be_used_is_named(change: dict[str, object], said: str) -> None:
    given_: dict[str, object] = {"robot": "wxai", "target": Obstacle("ball", Sphere(0.02))} | change
    robot = loaded(str(given_.pop("robot")))
    with pytest.raises(InvalidRequest, match=said):
        antipodal_grasps(robot, **given_)  # type: ignore[arg-type]


@pytest.mark.slow
def test_an_object_near_its_limit_is_taken_and_one_beyond_it_is_not() -> None:
    robot = loaded("wxai")
    assert found(robot, Obstacle("box", Box((0.077, 0.2, 0.2)), Pose((0.3, 0.0, 0.1))))
    assert not found(robot, Obstacle("box", Box((0.0801, 0.2, 0.2)), Pose((0.3, 0.0, 0.1))))
