"""Taking the robot out of a cloud, against the distances of its shapes and with a simulated depth camera."""

from __future__ import annotations

import math

import numpy as np
import pytest

import planner_service as ps
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Composite
from planner_service.geometry.shapes import Shape
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.scene import remove_robot

CUP = ps.Attached("cup", ps.Cylinder(0.03, 0.1), ps.Pose((0.02, 0.0, 0.0), (0.6, 0.0, 0.8, 0.0)))
RACK = ps.Attached(
    "rack",
    ps.Compound(((ps.Box((0.1, 0.02, 0.02)), ps.Pose((0.0, 0.05, 0.0))), (ps.Sphere(0.03), ps.Pose()))),
    ps.Pose(),
)
CRUMBS = ps.Attached("crumbs", ps.PointCloud(np.random.default_rng(0).uniform(-0.05, 0.05, (300, 3)), 0.01), ps.Pose())


def placed(
    robot: ps.Robot, q: FloatArray, attached: tuple[ps.Attached, ...] = ()
) -> list[tuple[Shape | Composite, FloatArray]]:
    """Each shape of the robot and of what it carries, with its pose in the base frame."""
    bodies = [body_matrix(pose) for pose in robot.body_poses(q)]
    links = [(item.shape, bodies[item.body] @ item.pose.matrix) for item in robot.shapes]
    return [*links, *((held.shape, robot.tool_pose(q) @ held.pose.matrix) for held in attached)]


def distances(points: FloatArray, solids: list[tuple[Shape | Composite, FloatArray]]) -> FloatArray:
    each = [shape.distance((points - T[:3, 3]) @ T[:3, :3]) for shape, T in solids]
    return np.asarray(np.min(each, axis=0))


def around(solids: list[tuple[Shape | Composite, FloatArray]], count: int, spread: float) -> FloatArray:
    """Points on and off the surfaces, corners among them."""
    rng = np.random.default_rng(1)
    ends = [shape.support(rng.normal(size=(count, 3))) @ T[:3, :3].T + T[:3, 3] for shape, T in solids]
    middles = [
        a * u + b * (1 - u)
        for a, b, u in zip(ends, ends[1:] + ends[:1], rng.random((len(ends), count, 1)), strict=True)
    ]
    points = np.concatenate([*ends, *middles])
    return np.asarray(points + rng.normal(size=points.shape) * spread)


@pytest.mark.parametrize(("name", "margin"), [("wxai", 0.0), ("panda", 0.004), ("ur5", 0.05)])
def test_what_is_left_are_the_points_farther_than_the_margin(name: str, margin: float) -> None:
    robot = ps.load_robot(name)
    for q in (robot.home, np.random.default_rng(3).uniform(robot.limits.lower, robot.limits.upper)):
        solids = placed(robot, q, (CUP, RACK, CRUMBS))
        points = np.concatenate([around(solids, 12, 0.003), around(solids, 6, 0.05)])
        off = distances(points, solids)
        assert np.abs(off - margin)[off > 0.0].min() > 1e-7, "or rounding would decide"
        assert 0.1 < (off > margin).mean() < 0.95 or margin == 0.05
        assert remove_robot(points, robot, q, margin, (CUP, RACK, CRUMBS)).tobytes() == points[off > margin].tobytes()


def test_an_open_gripper_leaves_what_is_between_its_fingers(wxai: ps.Robot) -> None:
    tip = wxai.tool_pose(wxai.home)[:3, 3][np.newaxis]
    assert len(remove_robot(tip, wxai.with_gripper(0.08), wxai.home, 0.01)) == 1
    assert len(remove_robot(tip, wxai.with_gripper(0.0), wxai.home, 0.01)) == 0


def test_a_cloud_without_points_or_far_away_stays_as_it_is(wxai: ps.Robot) -> None:
    assert remove_robot(np.zeros((0, 3)), wxai, wxai.home, 0.01).shape == (0, 3)
    far = np.random.default_rng(0).uniform(2.0, 3.0, (50, 3))
    assert remove_robot(far, wxai, wxai.home, 0.01).tobytes() == far.tobytes()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"points": [[0.0, math.nan, 0.0]]}, r"points\[0\]: got \[0.0, nan, 0.0\]; expected finite points"),
        ({"points": np.zeros((3, 2))}, r"points: got an array of shape \(3, 2\)"),
        ({"robot": "wxai"}, "robot: got 'wxai'"),
        ({"q": [math.inf] * 6}, "q: got"),
        ({"margin": -0.01}, "margin: got -0.01"),
        ({"attached": [ps.Obstacle("cup", ps.Sphere(0.1))]}, r"attached\[0\]: got"),
    ],
)
def test_what_makes_no_sense_is_refused(wxai: ps.Robot, changed: dict[str, object], told: str) -> None:
    given = {"points": np.ones((1, 3)), "robot": wxai, "q": wxai.home, "margin": 0.01, "attached": (), **changed}
    with pytest.raises(ps.InvalidRequest, match=told):
        remove_robot(**given)  # type: ignore[arg-type]


# --- with a depth camera
