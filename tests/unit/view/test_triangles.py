"""The triangles that are drawn: closed, outward, of the volume of what is judged, and where it is judged."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    Capsule,
    Compound,
    Cylinder,
    HeightField,
    Mesh,
    Obstacle,
    PointCloud,
    Pose,
    Scene,
    Sphere,
    load_robot,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Solid as Shape
from planner_service.view.triangles import TOOL, Solid, placements, robot_solids, scene_solids

TURNED = Pose((0.3, -0.2, 0.5), (0.5, 0.5, -0.5, 0.5))
TETRAHEDRON = Mesh(np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0], [0, 0, 0.5]]))
STEPS = np.array([[0.1, 0.2, 0.0], [0.3, 0.3, 0.1]])
CELLS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-3, 2, -1]])

VOLUMES: dict[str, tuple[Shape, float]] = {
    "box": (Box((0.1, 0.2, 0.3)), 0.006),
    "sphere": (Sphere(0.2), 4 / 3 * math.pi * 0.2**3),
    "cylinder": (Cylinder(0.1, 0.5), math.pi * 0.1**2 * 0.5),
    "capsule": (Capsule(0.1, 0.5), math.pi * 0.1**2 * (0.5 + 4 / 3 * 0.1)),
    "mesh": (TETRAHEDRON, 0.3 * 0.4 * 0.5 / 6),
    "compound": (Compound(((Box((0.1, 0.1, 0.1)), TURNED), (Sphere(0.05), Pose()))), 0.001 + 4 / 3 * math.pi * 0.05**3),
    "cloud": (PointCloud.from_cells(CELLS, 0.1), 4 * 0.1**3),
    "heights": (HeightField(STEPS, 0.1), 0.01 * float(STEPS.sum())),
}


def corners(solid: Solid) -> FloatArray:
    """The corners of the triangles, (m, 3, 3)."""
    return solid.vertices[solid.faces]


def volume(solid: Solid) -> float:
    a, b, c = corners(solid).transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6)


def require_closed(solid: Solid) -> None:
    """Each edge belongs to two triangles, which run along it in opposite directions; none is degenerate."""
    edges = [edge for a, b, c in solid.faces.tolist() for edge in ((a, b), (b, c), (c, a))]
    assert set(Counter(edges).values()) == {1}
    assert {(b, a) for a, b in edges} == set(edges)
    a, b, c = corners(solid).transpose(1, 0, 2)
    assert (np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=-1)) / 2 > 1e-12).all()


def drawn(shape: Shape, pose: Pose = TURNED) -> Solid:
    (solid,) = scene_solids(Scene((Obstacle("thing", shape, pose),)))
    return solid


@pytest.mark.parametrize("kind", VOLUMES)
def test_a_shape_is_closed_has_its_volume_and_reaches_as_far_where_its_pose_says(kind: str) -> None:
    shape, expected = VOLUMES[kind]
    solid, plain = drawn(shape), drawn(shape, Pose()).vertices
    require_closed(solid)
    flat = kind in ("box", "mesh", "cloud", "heights")  # polyhedra inscribed in what is round have less
    assert volume(solid) == pytest.approx(expected, rel=1e-12 if flat else 0.01)
    assert float(shape.distance(plain).max()) < 1e-12
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        farthest = float(shape.support(direction) @ direction)
        assert float((plain @ direction).max()) == pytest.approx(farthest, abs=1e-12)
    assert solid.vertices == pytest.approx(plain @ TURNED.rotation.T + np.array(TURNED.position), abs=1e-12)


@pytest.mark.parametrize("name", ["wxai_dual", "ur5"])
def test_each_link_is_one_closed_solid_of_its_frame(name: str) -> None:
    robot = load_robot(name)
    solids = robot_solids(robot)
    assert [solid.name for solid in solids] == list(dict.fromkeys(item.link for item in robot.shapes))
    assert [solid.frame for solid in solids] == [solid.name for solid in solids]
    for solid in solids:
        require_closed(solid)


def test_links_are_where_they_are_judged() -> None:
    robot = load_robot("wxai").with_gripper(0.03)
    q = robot.home + 0.1
    frames = placements(robot, q)
    bodies = robot.body_poses(q)
    for solid in robot_solids(robot):
        T = frames[solid.name]
        world = solid.vertices @ T[:3, :3].T + T[:3, 3]
        gaps = []
        for item in (item for item in robot.shapes if item.link == solid.name):
            pose = bodies[item.body]
            local = (world - np.array(pose[9:])) @ np.array(pose[:9]).reshape(3, 3)
            gaps.append(item.shape.distance((local - item.pose.position) @ item.pose.rotation))
        assert float(np.min(gaps, axis=0).max()) < 1e-12


def test_what_is_carried_moves_with_the_tool() -> None:
    robot = load_robot("wxai")
    held = Attached("cup", Box((0.02, 0.04, 0.06)), Pose((0.01, 0.02, 0.03)))
    (solid,) = scene_solids(Scene(attached=(held,)))
    assert solid.frame == TOOL
    assert np.allclose(solid.vertices.mean(axis=0), (0.01, 0.02, 0.03), atol=1e-15)
    assert np.array_equal(placements(robot, robot.home)[TOOL], robot.tool_pose(robot.home))
