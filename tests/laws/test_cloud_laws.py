"""Laws of point clouds: they are their cells one by one, to geometry, checks and proofs, at once or bit by bit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner_service.certify import Certifier
from planner_service.certify import pairs as proof_pairs
from planner_service.collision import CollisionChecker, MotionStep
from planner_service.decomposition import walls
from planner_service.decomposition.no_path import prove_no_path
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Pieces, PointCloud
from planner_service.geometry.shapes import Box, Pose
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from tests.reference.clouds import cells_of, distances

EDGE = 0.04
PLACE = Pose.from_rpy((0.45, 0.1, 0.3), (0.2, -0.4, 0.7))


def drawn(seed: int, count: int = 300) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.uniform(-1.0, 1.0, (count, 3)) * rng.uniform(0.05, 0.3, 3))


def as_boxes(cloud: PointCloud) -> Scene:
    """The cells as obstacles of their own, with nothing joined."""
    size = (cloud.resolution,) * 3
    centres = [Pose(tuple(centre)) for centre in cloud.points.tolist()]
    return Scene(tuple(Obstacle(f"cell {k}", Box(size), PLACE @ centre) for k, centre in enumerate(centres)))


def as_cloud(cloud: PointCloud) -> Scene:
    return Scene((Obstacle("cloud", cloud, PLACE),))


def edges(robot: Robot, seed: int, count: int) -> list[tuple[FloatArray, FloatArray]]:
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        a, b = rng.uniform(robot.limits.lower, robot.limits.upper, (2, robot.n))
        out.append((a, a + (b - a) * min(1.0, 0.4 / math.dist(a, b))))
    return out


@pytest.mark.parametrize("seed", range(4))
def test_a_cloud_is_the_cells_that_hold_its_points(seed: int) -> None:
    points = drawn(seed)
    cloud, cells = PointCloud(points, EDGE), cells_of(points.tolist(), EDGE)
    assert {tuple(cell) for cell in cloud.cells.tolist()} == cells
    asked = np.random.default_rng(seed + 9).uniform(-0.6, 0.6, (200, 3))
    assert cloud.distance(asked) == pytest.approx(distances(asked, cells, EDGE), abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_a_cloud_with_points_is_the_one_that_is_made_at_once(seed: int) -> None:
    points, low, high = drawn(seed), np.full(3, -0.08), np.full(3, 0.08)
    grown = PointCloud(points[:7], EDGE)
    for some in np.array_split(points[7:], 5):
        grown = grown.with_points(some)
    assert grown == PointCloud(points, EDGE)
    assert [s.size for s in grown.pieces.shapes] == [s.size for s in PointCloud(points, EDGE).pieces.shapes]  # type: ignore[attr-defined]
    cells = {c for c in cells_of(points.tolist(), EDGE) if not all(abs((k + 0.5) * EDGE) <= 0.08 for k in c)}
    assert {tuple(c) for c in grown.with_points(np.zeros((0, 3)), instead_of=(low, high)).cells.tolist()} == cells
    again = grown.with_points([[0.01, 0.01, 0.01]], instead_of=(low, high))
    assert {tuple(c) for c in again.cells.tolist()} == cells | {(0, 0, 0)}


def test_points_that_make_no_cloud_are_refused() -> None:
    cloud = PointCloud(np.zeros((1, 3)), EDGE)
    everything = (np.full(3, -1.0), np.full(3, 1.0))
    with pytest.raises(InvalidRequest, match="points: got 0; expected a cell that is left"):
        cloud.with_points(np.zeros((0, 3)), instead_of=everything)
    with pytest.raises(InvalidRequest, match=r"instead_of: .*expected two corners"):
        cloud.with_points([[0.0, 0.0, 0.0]], instead_of=everything[::-1])
    with pytest.raises(InvalidRequest, match=r"points: got an array of shape .*expected 1 to 5,000,000 points"):
        cloud.with_points(np.zeros((0, 3)))
    with pytest.raises(InvalidRequest, match=r"resolution: 0\.001 m makes 1,060,\d+ cells; expected .*1,000,000 cells"):
        PointCloud(np.mgrid[0:103, 0:103, 0:100].reshape(3, -1).T * 0.001 + 0.0005, 0.001)


@pytest.mark.parametrize("name", ["wxai", "ur5"])
def test_verdicts_and_proofs_of_a_cloud_are_those_of_its_cells(name: str) -> None:
    robot = load_robot(name)
    for seed in range(2):
        cloud = PointCloud(drawn(seed)[:7], EDGE).with_points(drawn(seed)[7:])
        scenes = as_cloud(cloud), as_boxes(cloud)
        one, two = (CollisionChecker(robot, scene, edge_step=MotionStep(0.004)) for scene in scenes)
        proofs = [Certifier(robot, scene) for scene in scenes]
        found = set()
        for a, b in edges(robot, seed, 40):
            assert one.state_is_free(a) == two.state_is_free(a)
            assert one.edge_is_free(a, b) == two.edge_is_free(a, b)
            first, second = (proof.certify(np.array([a, b])) for proof in proofs)
            assert first.certified == second.certified
            assert not first.certified or one.edge_is_free(a, b)
            found.add(first.certified)
        assert found == {True, False}


def test_an_updated_cloud_is_proven_with_the_same_bits() -> None:
    robot, points = load_robot("ur5"), drawn(3)
    whole = PointCloud(points, EDGE)
    parts = PointCloud(points[200:], EDGE).with_points(points[:200])
    proofs = [Certifier(robot, as_cloud(cloud)) for cloud in (whole, parts)]
    for a, b in edges(robot, 5, 20):
        assert proofs[0].certify(np.array([a, b])) == proofs[1].certify(np.array([a, b]))


def test_the_comparison_notices_bundles_around_their_first_pieces_only(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = proof_pairs._extents

    def of_the_first(pieces: Pieces) -> tuple[FloatArray, FloatArray]:
        low, high = whole(pieces)
        return low[:1].repeat(len(low), axis=0), high[:1].repeat(len(low), axis=0)

    monkeypatch.setattr(proof_pairs, "_extents", of_the_first)
    with pytest.raises(AssertionError):
        test_verdicts_and_proofs_of_a_cloud_are_those_of_its_cells("wxai")


def test_no_proof_that_there_is_no_path_is_looked_for_among_too_many_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("planar2")
    points = np.mgrid[-30:30, -1:1, -30:30].reshape(3, -1).T * 0.05 + np.array([0.0, 0.8, 0.0])
    scene = Scene((Obstacle("wall", PointCloud(points, 0.05)),))
    ends = np.array([0.0, 0.0]), [np.array([3.0, 0.0])]
    assert prove_no_path(robot, scene, *ends) is not None
    monkeypatch.setattr(walls, "MOST_PAIRS", 10)
    assert prove_no_path(robot, scene, *ends) is None
