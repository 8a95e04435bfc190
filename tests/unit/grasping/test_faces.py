"""The flat faces of objects: where they are, and how far their points are from a rim."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service import Box, Cylinder, Mesh, Obstacle, Pose, Sphere
from planner_service.geometry.composite import Compound, PointCloud
from planner_service.grasping.faces import flat_faces
from tests.unit.grasping.solids import pose

SIZE = (0.05, 0.08, 0.11)
CORNERS = np.array([[x, y, z] for x in (-0.025, 0.025) for y in (-0.04, 0.04) for z in (-0.055, 0.055)])


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_a_box_has_the_same_faces_as_a_mesh_and_as_a_compound(seed: int) -> None:
    at, inner = pose(seed), pose(seed + 1)
    inside = Compound(((Box(SIZE), inner),))
    there = {
        (tuple(np.round(face.outward, 6) + 0.0), tuple(np.round(face.middle, 6) + 0.0))
        for face in flat_faces(Obstacle("a", Box(SIZE), at), 0.01)
    }
    assert len(there) == 6
    for shape, place in ((Mesh(CORNERS), at), (inside, at @ inner.inverse())):
        found = list(flat_faces(Obstacle("b", shape, place), 0.01))
        assert len(found) == 6
        for face in found:
            assert any(np.allclose([face.outward, face.middle], each, atol=2e-6) for each in there)
            half = face.room(face.middle[None])[0]
            assert any(half == pytest.approx(size / 2.0, abs=1e-9) for size in SIZE[:2])


def test_points_of_a_face_are_as_far_from_its_rim_as_they_are() -> None:
    (top,) = (face for face in flat_faces(Obstacle("box", Box(SIZE)), 0.01) if face.outward[2] > 0.5)
    points = np.array([[0.0, 0.0, 0.055], [0.02, 0.0, 0.055], [0.0, 0.035, 0.055], [0.03, 0.0, 0.055]])
    assert top.room(points) == pytest.approx([0.025, 0.005, 0.005, -0.005])
    disc = next(flat_faces(Obstacle("can", Cylinder(0.03, 0.1)), 0.01))
    assert disc.room(np.array([[0.0, 0.02, 0.05], [0.0, 0.04, 0.05]])) == pytest.approx([0.01, -0.01])


def test_what_is_round_has_none_and_facets_smaller_than_a_disc_are_none() -> None:
    assert list(flat_faces(Obstacle("ball", Sphere(0.05)), 0.01)) == []
    around = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    prism = Mesh(np.array([[0.05 * math.cos(a), 0.05 * math.sin(a), z] for a in around for z in (-0.1, 0.1)]))
    found = list(flat_faces(Obstacle("prism", prism), 0.01))
    ends = [face for face in found if abs(face.outward[2]) > 0.5]
    assert len(ends) == 2
    assert all(face.room(face.middle[None])[0] == pytest.approx(0.05 * math.cos(math.pi / 24)) for face in ends)
    sides = [face for face in found if abs(face.outward[2]) <= 0.5]
    assert all(face.room(face.middle[None])[0] < 0.01 for face in sides)


def test_the_faces_of_a_cloud_are_those_of_its_cells() -> None:
    cloud = Obstacle("heap", PointCloud(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.25]]), 0.1), Pose())
    assert len(list(flat_faces(cloud, 0.01))) == 12
