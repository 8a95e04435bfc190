"""A cup lies flat where it is put: on a face at least as large as itself, bare, the heaviest middle first."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Sphere, load_robot
from planner_service.errors import InvalidRequest
from planner_service.geometry.composite import Compound, Solid
from planner_service.grasping import suction_grasps, top_grasps
from tests.support.optional import present
from tests.unit.grasping.solids import KINDS, pose, solid

loaded = cache(load_robot)
CUP = loaded("ur5_vacuum")


@pytest.mark.slow
@given(st.sampled_from(KINDS), st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_the_rim_of_the_cup_lies_on_the_object_all_around_and_nothing_else_is_under_it(kind: str, seed: int) -> None:
    shape, at = solid(kind, seed, 0.06), pose(seed + 1)
    try:
        grasps = suction_grasps(CUP, Obstacle("thing", shape, at), most=12)
    except InvalidRequest as error:
        assert "a flat face at least 0.030 m wide" in str(error)  # noqa: PT017
        assert kind not in ("box", "cylinder") or min(extents(shape)) < 0.0301
        return
    gripper = present(CUP.gripper)
    angles = np.linspace(0.0, 2.0 * math.pi, 7)
    for grasp in grasps:
        for share in (0.0, 0.5, 0.999):
            rim = [(share * gripper.radius * math.cos(a), share * gripper.radius * math.sin(a), 0.0) for a in angles]
            local = [np.array((at.inverse() @ grasp @ Pose(spot)).position) for spot in rim]
            above = [np.array((at.inverse() @ grasp @ Pose((x, y, -2e-4))).position) for x, y, _ in rim]
            assert np.abs(shape.distance(np.array(local))).max() < 2e-6
            assert shape.distance(np.array(above)).min() > 1e-5


def extents(shape: Solid) -> list[float]:
    if isinstance(shape, Box):
        return sorted(shape.size)[1:]
    assert isinstance(shape, Cylinder)
    return [2.0 * shape.radius]


@pytest.mark.slow
def test_a_box_is_taken_on_any_face_in_the_middle_first_from_above_and_on_a_large_one_at_many_places() -> None:
    small = suction_grasps(CUP, Obstacle("box", Box((0.05, 0.06, 0.07)), Pose((0.4, 0.0, 0.1))))
    assert small[0].position == pytest.approx((0.4, 0.0, 0.135))
    faces = {tuple(np.round(grasp.rotation[:, 2], 6) + 0.0) for grasp in small}
    assert len(faces) == 6
    large = suction_grasps(CUP, Obstacle("box", Box((0.2, 0.3, 0.1)), Pose((0.4, 0.0, 0.1))), most=200)
    assert len({tuple(np.round(grasp.position, 3)) for grasp in large if grasp.position[2] > 0.149}) > 15


def test_a_covered_face_is_left_out_where_it_is_covered() -> None:
    handled = Compound(((Box((0.1, 0.1, 0.02)), Pose()), (Cylinder(0.02, 0.06), Pose((0.0, 0.0, 0.04)))))
    grasps = suction_grasps(CUP, Obstacle("lid", handled, Pose((0.4, 0.0, 0.1))), most=200)
    on_the_plate = [grasp for grasp in grasps if abs(grasp.position[2] - 0.11) < 1e-9]
    assert on_the_plate
    assert all(math.hypot(grasp.position[0] - 0.4, grasp.position[1]) > 0.035 for grasp in on_the_plate)


def test_a_mesh_is_taken_as_the_box_that_it_is() -> None:
    corners = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.04, 0.04) for z in (-0.02, 0.02)])
    at = Pose.from_rpy((0.4, 0.1, 0.1), (0.0, 0.0, 0.3))
    box, mesh = Obstacle("a", Box((0.06, 0.08, 0.04)), at), Obstacle("b", Mesh(corners), at)
    tops = [{tuple(np.round(grasp.position, 6)) for grasp in top_grasps(CUP, each)} for each in (box, mesh)]
    assert tops[0] == tops[1]
    assert len(suction_grasps(CUP, mesh)) == len(suction_grasps(CUP, box))


REFUSED = [
    ("wxai", Box((0.1, 0.1, 0.1)), {}, "robot: got 'wxai, whose gripper has fingers'; expected a robot with a vacuum"),
    ("ur5", Box((0.1, 0.1, 0.1)), {}, "robot: got 'ur5'; expected a robot with a vacuum gripper"),
    ("ur5_vacuum", Sphere(0.1), {}, "target: got 'thing'; expected an object with a flat face at least 0.030 m wide"),
    ("ur5_vacuum", Capsule(0.1, 0.1), {}, "flat face at least 0.030 m wide"),
    ("ur5_vacuum", Box((0.02, 0.02, 0.3)), {}, "flat face at least 0.030 m wide"),
    ("ur5_vacuum", Box((0.1, 0.1, 0.1)), {"most": 1.5}, "most: got 1.5; expected"),
]


@pytest.mark.parametrize(("name", "shape", "more", "said"), REFUSED)
def test_what_a_cup_cannot_take_is_named(name: str, shape: Solid, more: dict[str, int], said: str) -> None:
    robot, target = loaded(name), Obstacle("thing", shape, Pose((0.4, 0.0, 0.1)))
    with pytest.raises(InvalidRequest, match=said):
        suction_grasps(robot, target, **more)
