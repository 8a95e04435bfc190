"""What fingers hold: as wide as an exact maximum says, only the part that they reach, and how good the hold is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from planner_service import Box, Cylinder, Mesh, Obstacle, Pose, Sphere, load_robot
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import cross
from planner_service.geometry.composite import Compound, PointCloud
from planner_service.grasping.grasps import top_grasps, width_across
from planner_service.grasping.guards import grasp_objection
from planner_service.grasping.hand import HandCheck, jaws_of
from planner_service.grasping.held import grasp_quality, held_by
from planner_service.robot.model import Robot
from tests.support.optional import present
from tests.unit.grasping.solids import pose, solid

WXAI, PANDA = load_robot("wxai"), load_robot("panda")
DOWN = Pose(quaternion=(math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
"""A wxai's tool that points down with its fingers closing along y."""


@given(st.sampled_from([WXAI, PANDA]), st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_a_hull_is_as_wide_as_the_part_of_it_that_the_fingers_face(robot: object, seed: int) -> None:
    robot = WXAI if robot is WXAI else PANDA
    hull = solid("mesh", seed, 0.05)
    assert isinstance(hull, Mesh)
    target, gripper = Obstacle("thing", hull, pose(seed + 1)), present(robot.gripper)
    inside = hull.vertices.mean(axis=0).tolist()
    grasp = target.pose @ Pose((inside[0], inside[1], inside[2])) @ pose(seed + 2, 0.0)
    T = (target.pose.inverse() @ grasp).matrix
    x, y = np.array(gripper.approach), np.array(gripper.closing)
    axes = np.stack([x, y, cross(x, y)])
    A, b = hull.normals @ T[:3, :3] @ axes.T, hull.offsets - hull.normals @ T[:3, 3]
    far = {1.0: -math.inf, -1.0: -math.inf}
    for jaw in jaws_of(robot, 0.0):
        bounds = [(jaw.low[0], jaw.high[0]), (None, None), (jaw.low[1], jaw.high[1])]
        found = linprog([0.0, -jaw.side, 0.0], A, b, bounds=bounds)
        if found.status == 0:
            far[jaw.side] = max(far[jaw.side], -found.fun - jaw.recess)
    held = held_by(target, grasp, robot)
    assert held.reached
    assert held.width == pytest.approx(far[1.0] + far[-1.0], abs=1e-7)
    assert held.shift == pytest.approx((far[-1.0] - far[1.0]) / 2.0, abs=1e-7)
    assert held.width <= held.extent


@pytest.mark.parametrize("shape", [Box((0.04, 0.05, 0.06)), Sphere(0.02), Cylinder(0.02, 0.07)])
def test_of_simple_shapes_taken_through_their_middle_it_is_the_extent_to_the_last_bit(shape: Box | Sphere) -> None:
    target = Obstacle("thing", shape, Pose.from_rpy((0.3, 0.1, 0.05), (0.0, 0.0, 0.4)))
    for grasp in top_grasps(WXAI, target):
        held = held_by(target, grasp, WXAI)
        assert held.width == held.extent
        assert held.aside < 1e-12


DOOR = Compound(
    (
        (Box((0.4, 0.02, 0.6)), Pose((0.0, 0.0, 0.0))),
        (Box((0.02, 0.04, 0.02)), Pose((0.1, 0.029, 0.05))),
        (Box((0.02, 0.04, 0.02)), Pose((0.1, 0.029, -0.05))),
        (Cylinder(0.009, 0.14), Pose((0.1, 0.055, 0.0))),
    )
)
"""A door with a handle: its leaf is 40 cm wide, the bar of its handle 18 mm."""


def test_a_handle_is_as_wide_as_its_bar_not_as_its_door() -> None:
    door = Obstacle("door", DOOR, Pose())
    on_the_bar = Pose.from_matrix(
        np.array([[0.0, 1.0, 0.0, 0.1], [-1.0, 0.0, 0.0, 0.050], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    )  # approaching along -y, fingers closing along x
    assert width_across(door, on_the_bar, WXAI) == pytest.approx(0.018, abs=1e-9)
    assert grasp_objection(door, on_the_bar, WXAI) == ""
    in_the_leaf = Pose((0.0, -0.045, 0.0)) @ on_the_bar
    assert grasp_objection(door, in_the_leaf, WXAI) == "door is 400.0 mm wide between fingers that open 80.0 mm"


def tray(inner: float) -> Obstacle:
    """A tray of 3 mm walls, 30 mm high, its inside ``inner`` metres wide along y."""
    walls = [(Box((0.1, 0.003, 0.03)), Pose((0.0, s * (inner + 0.003) / 2.0, 0.015))) for s in (1.0, -1.0)]
    return Obstacle("tray", Compound(((Box((0.1, inner, 0.003)), Pose((0.0, 0.0, 0.0015))), *walls)), Pose())


def test_a_hollow_thing_is_held_across_or_by_one_wall_depending_on_where_the_fingers_are() -> None:
    across, wall = Pose((0.0, 0.0, 0.02)) @ DOWN, Pose((0.0, 0.0315, 0.02)) @ DOWN
    assert width_across(tray(0.06), across, WXAI) == pytest.approx(0.066, abs=1e-9)
    assert width_across(tray(0.06), wall, WXAI) == pytest.approx(0.003, abs=1e-9)
    assert grasp_objection(tray(0.06), across, WXAI) == ""
    assert grasp_objection(tray(0.06), wall, WXAI) == ""


def test_fingers_that_end_above_an_object_do_not_reach_it() -> None:
    box = Obstacle("box", Box((0.04, 0.04, 0.04)), Pose())
    assert grasp_objection(box, Pose((0.0, 0.0, 0.019)) @ DOWN, WXAI) == ""
    above = grasp_objection(box, Pose((0.0, 0.0, 0.025)) @ DOWN, WXAI)
    assert above == "the fingers would not reach both sides of box"
    beside = grasp_objection(tray(0.06), Pose((0.0, 0.028, 0.02)) @ DOWN, WXAI)
    assert "aside" in beside


@given(st.floats(0.005, 0.039), st.floats(0.0, 0.6), st.floats(0.0, 0.012))
@settings(max_examples=40, deadline=None)
def test_the_quality_of_a_hold_of_a_cylinder_has_a_closed_form(radius: float, lean: float, off: float) -> None:
    target = Obstacle("can", Cylinder(radius, 0.05), Pose())
    grasp = Pose((0.0, 0.0, off)) @ Pose.from_rpy((0.0, 0.0, 0.0), (lean, 0.0, 0.0)) @ DOWN
    found = grasp_quality(WXAI, target, grasp)
    length = 2.0 * radius / math.cos(lean)
    if length / 2.0 * math.sin(lean) + off >= 0.0249 or length > 0.079:
        return  # the line leaves through an end
    assert found.slope == pytest.approx(math.tan(lean), abs=1e-9)
    assert found.room == pytest.approx(1.0 - length / 0.08, abs=1e-9)
    assert found.lever == pytest.approx(off * math.cos(lean), abs=1e-9)
    reach = math.sqrt(2.0 * radius**2 + 0.025**2)
    parts = (1.0 - found.slope / 0.5, found.room, 1.0 - found.lever / reach)
    assert found.value == pytest.approx(math.prod(max(0.0, part) for part in parts), abs=1e-9)


def test_a_hold_of_nothing_is_worth_nothing() -> None:
    far = grasp_quality(WXAI, Obstacle("can", Sphere(0.02)), Pose((0.5, 0.0, 0.0)))
    assert (far.slope, far.room, far.value) == (math.inf, 0.0, 0.0)


def test_quality_is_of_fingers_and_of_objects_of_few_pieces() -> None:
    cloud = PointCloud(np.random.default_rng(0).uniform(-1.0, 1.0, (20_000, 3)), 0.005)
    with pytest.raises(InvalidRequest, match=r"target: got 'heap, .* pieces'; expected an object of at most 5,000"):
        grasp_quality(WXAI, Obstacle("heap", cloud), Pose())
    with pytest.raises(InvalidRequest, match=r"robot: got 'ur5_vacuum, whose gripper is a cup'"):
        grasp_quality(load_robot("ur5_vacuum"), Obstacle("can", Sphere(0.02)), Pose())
    with pytest.raises(InvalidRequest, match=r"friction: got 0.0; expected a coefficient of friction in \[0.01, 10\]"):
        grasp_quality(WXAI, Obstacle("can", Sphere(0.02)), Pose(), friction=0.0)


@pytest.fixture(scope="module")
def kinova() -> Robot:
    return load_robot("kinova_gripper")


def touching_sides(robot: Robot, grasp: Pose, ball: Obstacle, width: float) -> set[float]:
    """On which sides of the grip parts of fingers come nearer to a ball's middle than its radius."""
    assert isinstance(ball.shape, Sphere)
    gripper, tool = present(robot.gripper), Pose.from_matrix(robot.tool_placement).inverse()
    met = set[float]()
    for item, jaw in zip(gripper.shapes(width), jaws_of(robot, gripper.upper), strict=True):
        at = (grasp @ tool @ item.pose).inverse() @ ball.pose
        if float(item.shape.distance(np.array(at.position))) < ball.shape.radius:
            met.add(jaw.side)
    return met


@pytest.mark.parametrize("radius", [0.02, 0.03, 0.04, 0.05])
def test_fingers_that_turn_take_a_ball_only_where_they_meet_it(kinova: Robot, radius: float) -> None:
    ball = Obstacle("ball", Sphere(radius), Pose((0.4, 0.1, 0.1)))
    grasps = top_grasps(kinova, ball)
    for grasp in grasps[::7]:
        assert not grasp_objection(ball, grasp, kinova)
        assert touching_sides(kinova, grasp, ball, 2.0 * radius - 0.002) == {1.0, -1.0}
    at_the_tips = Pose(ball.pose.position, grasps[0].quaternion)
    meets = touching_sides(kinova, at_the_tips, ball, 2.0 * radius - 0.002) == {1.0, -1.0}
    assert meets == (radius < 0.03)
    refused = grasp_objection(ball, at_the_tips, kinova)
    assert refused == ("" if meets else "the fingers would not reach both sides of ball")


@given(
    st.sampled_from(["wxai", "panda", "wxai_mesh"]),
    st.sampled_from(["box", "sphere", "cylinder", "capsule", "mesh"]),
    st.integers(0, 10_000),
)
@settings(max_examples=40, deadline=None)
def test_where_fingers_are_said_to_hold_something_both_touch_it_if_they_close_a_little_more(
    name: str, kind: str, seed: int
) -> None:
    robot, rng = load_robot(name), np.random.default_rng(seed)
    target = Obstacle("thing", solid(kind, seed, 0.02), pose(seed + 1))
    x, y, z = rng.normal(0.0, 0.006, 3).tolist()
    grasp = target.pose @ pose(seed + 2, 0.0) @ Pose((x, y, z))
    held = held_by(target, grasp, robot)
    x, y, z = (held.shift * axis for axis in present(robot.gripper).closing)
    seen = Pose((x, y, z)) @ grasp.inverse() @ target.pose
    if not grasp_objection(target, grasp, robot):
        hand = HandCheck(robot, target.shape)
        assert len(hand.sides(hand.touching(seen, max(0.0, held.width - 0.002)))) == 2
