"""Taking the robot out of a cloud, against the distances of its shapes and with a simulated depth camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    Compound,
    Cylinder,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Reason,
    Robot,
    Scene,
    Sphere,
    load_robot,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Composite
from planner_service.geometry.shapes import Shape
from planner_service.scene import remove_robot
from tests.support.optional import present

CUP = Attached("cup", Cylinder(0.03, 0.1), Pose((0.02, 0.0, 0.0), (0.6, 0.0, 0.8, 0.0)))
RACK = Attached("rack", Compound(((Box((0.1, 0.02, 0.02)), Pose((0.0, 0.05, 0.0))), (Sphere(0.03), Pose()))), Pose())
CRUMBS = Attached("crumbs", PointCloud(np.random.default_rng(0).uniform(-0.05, 0.05, (300, 3)), 0.01), Pose())


def placed(
    robot: Robot, q: FloatArray, attached: tuple[Attached, ...] = ()
) -> list[tuple[Shape | Composite, FloatArray]]:
    """Each shape of the robot and of what it carries, with its pose in the base frame."""
    R, t = robot.body_poses_batch(q[np.newaxis])
    bodies = np.repeat(np.eye(4)[np.newaxis], len(robot.bodies), axis=0)
    bodies[:, :3, :3], bodies[:, :3, 3] = R[0], t[0]
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


@pytest.mark.parametrize("margin", [0.0, 0.004, 0.05])
@pytest.mark.parametrize("name", ["wxai", "panda", "ur5"])
def test_what_is_left_are_the_points_farther_than_the_margin(name: str, margin: float) -> None:
    robot = load_robot(name)
    for q in (robot.home, np.random.default_rng(3).uniform(robot.limits.lower, robot.limits.upper)):
        solids = placed(robot, q, (CUP, RACK, CRUMBS))
        points = np.concatenate([around(solids, 12, 0.003), around(solids, 6, 0.05)])
        off = distances(points, solids)
        assert np.abs(off - margin)[off > 0.0].min() > 1e-7, "or rounding would decide"
        assert 0.1 < (off > margin).mean() < 0.95 or margin == 0.05
        assert remove_robot(points, robot, q, margin, (CUP, RACK, CRUMBS)).tobytes() == points[off > margin].tobytes()


def test_an_open_gripper_leaves_what_is_between_its_fingers(wxai: Robot) -> None:
    tip = wxai.tool_pose(wxai.home)[:3, 3][np.newaxis]
    assert len(remove_robot(tip, wxai.with_gripper(0.08), wxai.home, 0.01)) == 1
    assert len(remove_robot(tip, wxai.with_gripper(0.0), wxai.home, 0.01)) == 0


def test_a_cloud_without_points_or_far_away_stays_as_it_is(wxai: Robot) -> None:
    assert remove_robot(np.zeros((0, 3)), wxai, wxai.home, 0.01).shape == (0, 3)
    far = np.random.default_rng(0).uniform(2.0, 3.0, (50, 3))
    assert remove_robot(far, wxai, wxai.home, 0.01).tobytes() == far.tobytes()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"points": [[0.0, math.nan, 0.0]]}, r"points\[0\]: got \[0.0, nan, 0.0\]; expected finite points"),
        ({"points": [[0.0, 0.0, 2000.0]]}, r"points\[0\]: got"),
        ({"points": np.zeros((3, 2))}, r"points: got an array of shape \(3, 2\)"),
        ({"points": np.zeros((5_000_001, 3))}, "points: got an array of shape"),
        ({"robot": "wxai"}, "robot: got 'wxai'"),
        ({"q": [0.0]}, "q: got"),
        ({"q": [math.inf] * 6}, "q: got"),
        ({"margin": -0.01}, "margin: got -0.01"),
        ({"margin": math.nan}, "margin: got nan"),
        ({"attached": [Obstacle("cup", Sphere(0.1))]}, r"attached\[0\]: got"),
    ],
)
def test_what_makes_no_sense_is_refused(wxai: Robot, changed: dict[str, object], told: str) -> None:
    given = {"points": np.ones((1, 3)), "robot": wxai, "q": wxai.home, "margin": 0.01, "attached": (), **changed}
    with pytest.raises(InvalidRequest, match=told):
        remove_robot(**given)  # type: ignore[arg-type]


# --- with a depth camera


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole camera that looks along +z of its frame; rays advance by their distance to what there is."""

    T: FloatArray
    width: int = 120
    height: int = 90
    focal: float = 100.0

    def points(self, solids: list[tuple[Shape | Composite, FloatArray]], noise: float) -> FloatArray:
        """Where the rays end, (n, 3) in the base frame; rays that meet nothing within 3 m are left out."""
        u, v = np.meshgrid(np.arange(self.width) - self.width / 2, np.arange(self.height) - self.height / 2)
        rays = np.stack([u.ravel() / self.focal, v.ravel() / self.focal, np.ones(u.size)], axis=1)
        rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ self.T[:3, :3].T
        along: FloatArray = np.zeros(len(rays))
        for _ in range(60):  # sphere tracing
            left = distances(self.T[:3, 3] + along[:, np.newaxis] * rays, solids)
            along = np.minimum(along + left, 3.0)
        seen = (left < 1e-3) & (along < 3.0)
        off = np.random.default_rng(0).uniform(-noise, noise, int(seen.sum()))
        return np.asarray(self.T[:3, 3] + (along[seen] + off)[:, np.newaxis] * rays[seen])


def looking_at(eye: tuple[float, float, float], at: tuple[float, float, float]) -> FloatArray:
    """The pose of a camera, its x to the right and its y down."""
    z = np.subtract(at, eye) / math.dist(at, eye)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), eye
    return T


def test_a_scene_seen_by_a_camera_is_planned_in_once_the_robot_is_taken_out(wxai: Robot) -> None:
    cell, noise, margin = 0.01, 0.002, 0.025  # more than a cell's diagonal, the noise and the padding
    q = wxai.pose("ready")
    held = (Attached("block", Box((0.04, 0.04, 0.04)), Pose(), touch_links=("finger_left", "finger_right")),)
    things = (
        Obstacle("post", Cylinder(0.04, 0.3), Pose((0.25, 0.3, 0.15))),
        Obstacle("crate", Box((0.15, 0.2, 0.1)), Pose((0.3, -0.3, 0.05))),
    )
    rest = [(thing.shape, thing.pose.matrix) for thing in things]
    own = placed(wxai, q, held)
    seen = DepthCamera(looking_at((1.0, 0.8, 0.9), (0.25, 0.0, 0.15))).points([*own, *rest], noise)
    kept = remove_robot(seen, wxai, q, margin, held)
    off = distances(seen, own)
    assert min((off < 0.01).sum(), (distances(seen, rest) < 0.01).sum()) > 100, "it sees both"
    assert distances(kept, own).min() > margin
    assert kept.tobytes() == seen[off > margin].tobytes()

    def service(points: FloatArray) -> PlannerService:
        return PlannerService(wxai, Scene((Obstacle("seen", PointCloud(points, cell)),), held))

    asked = PlanRequest(q, [q[0] + 1.4, *q[1:]], time_limit=None)
    assert present(service(seen).plan(asked).failure).reason is Reason.START_IN_COLLISION
    result = service(kept).plan(asked)
    assert result.ok
    assert result.padding == asked.padding
