"""What the kernel calls apart or colliding is, by how far a pair is apart or overlaps in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from planner_service.collision import CollisionChecker, MotionStep
from planner_service.collision.edge_sampling import interior
from planner_service.collision.native_kernel import MARGIN, build_kernel, configure_edges, instruction_sets
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose, Sphere
from planner_service.native.loading import load_core
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from tests.support.small_robots import CRANE, MIMIC, MIXED, SLIDER, TWINS, built

if TYPE_CHECKING:
    from planner_service.native import _core

Ends = tuple[list[float], list[float]]

ALONG = np.array([1.0, 0.0, 0.0])
SURE = 1e-4
"""Metres of overlap beyond which the kernel need not ask FCL."""


class Body(NamedTuple):
    """A solid as the kernel takes it: half lengths, ball and disc; or the corners of a hull about their centre."""

    R: FloatArray
    half: FloatArray
    ball: float = 0.0
    disc: float = 0.0
    corners: FloatArray | None = None

    def reach(self, d: FloatArray) -> float:
        """How far it reaches from its centre along a unit direction."""
        x = self.R.T @ d
        if self.corners is not None:
            return float((self.corners @ x).max())
        return float(np.abs(x) @ self.half) + self.ball + self.disc * float(np.hypot(x[0], x[1]))


def hull(corners: FloatArray, R: FloatArray) -> Body:
    centred = corners - 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return Body(R, np.abs(centred).max(axis=0), corners=np.ascontiguousarray(centred))


def bodies(rng: np.random.Generator) -> Iterator[Body]:
    """A box, a capsule, a cylinder and a hull, each some centimetres long and turned at random."""
    for kind in range(4):
        R = turned(rng)
        size = rng.uniform(0.01, 0.1, 3)
        along = np.array([0.0, 0.0, size[2]])
        if kind == 3:
            points = rng.normal(size=(60, 3))
            yield hull(points / np.linalg.norm(points, axis=1)[:, None] * size, R)
        else:
            yield (Body(R, size), Body(R, along, ball=size[0]), Body(R, along, disc=size[0]))[kind]


def turned(rng: np.random.Generator) -> FloatArray:
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.asarray(R * np.sign(np.linalg.det(R)))


def kernels_of(rider: Body, stander: Body) -> list[_core.CollisionKernel]:
    """A rider on a slide along x in front of a stander at the origin, with each instruction set."""
    core = load_core()
    if core is None:
        return []
    hulls = [body.corners for body in (rider, stander) if body.corners is not None]
    numbers = np.cumsum([body.corners is not None for body in (rider, stander)]) - 1
    joints = np.array([[0.0, 0.0, 1.0, *ALONG, *np.eye(3).ravel(), 0.0, 0.0, 0.0, 1.0]])
    riders, turns = np.array([[1.0, *rider.R.ravel(), 0.0, 0.0, 0.0]]), stander.R.reshape(1, 9)
    solids = np.array(
        [
            [*solid.half, solid.ball, solid.disc, number if solid.corners is not None else -1.0]
            for solid, number in zip((rider, stander), numbers, strict=True)
        ]
    )
    standing = np.array([[1, 0]]), np.zeros((1, 3)), np.array([[0, 1]])
    pairs = np.array([[0, 0, 1]]), 1
    names = instruction_sets()
    return [
        core.CollisionKernel(joints, solids, hulls, riders, turns, *standing, *pairs, MARGIN, name) for name in names
    ]


def at_gap(kernel: _core.CollisionKernel, rider: Body, stander: Body, gap: float) -> _core.RowCheck:
    """The check with the extents along x that far apart, which is a bound of the distance and of the overlap."""
    q = -(rider.reach(ALONG) + stander.reach(-ALONG) + gap)
    return kernel.check_rows(np.array([[q]]), 0, 1)


WALL = Body(np.eye(3), np.array([0.05, 1.0, 1.0]))
"""Its face looks along x, so that what is in front of it is as far from it, or overlaps it as far, as along x."""


def test_only_an_overlap_of_more_than_a_tenth_of_a_millimetre_is_certain() -> None:
    for seed in range(12):
        for rider in bodies(np.random.default_rng(seed)):
            for kernel in kernels_of(rider, WALL):
                for share in (0.0, 0.2, 0.5, 0.99):
                    assert not at_gap(kernel, rider, WALL, -SURE * share).colliding
                assert at_gap(kernel, rider, WALL, -0.01).colliding


def test_only_a_gap_of_more_than_the_margin_is_proven() -> None:
    for seed in range(12):
        for rider in bodies(np.random.default_rng(seed)):
            for kernel in kernels_of(rider, WALL):
                for share in (0.0, 0.2, 0.5, 0.99):
                    assert not at_gap(kernel, rider, WALL, MARGIN * share).free
                assert at_gap(kernel, rider, WALL, 1e-5).free


@pytest.mark.parametrize("name", ["panda_mbm"])
def test_tables_of_the_robots_own_pairs_prove_nothing_that_is_in_doubt_without_them(name: str) -> None:
    robot = load_robot(name)
    lower, upper = robot.limits.lower, robot.limits.upper
    Q = np.random.default_rng(1).uniform(lower, upper, (20_000, robot.n))
    ends = lower.tolist(), upper.tolist()
    args = (ends, ends, robot.reach().tolist(), MotionStep())
    for padding in (0.0, 0.02, 0.0):  # what is known of one is of no use for another; the last time all is known
        parts = CollisionChecker(robot, Scene(), padding=padding).parts
        for variant in instruction_sets():
            kernel = build_kernel(robot, parts, variant)
            assert kernel is not None
            without = kernel.candidates(Q)
            assert without[0]
            assert configure_edges(kernel, *args)
            assert kernel.candidates(Q) == without


SMALL = {"slider": SLIDER, "twins": TWINS, "crane": CRANE, "mixed": MIXED.replace(MIMIC, "")}


def robot_of(name: str, folder: Path) -> Robot:
    return built(folder, SMALL[name]) if name in SMALL else load_robot(name)


def around(robot: Robot, rng: np.random.Generator) -> Scene:
    """Spheres where the robot's pieces pass, a few of them in its way."""
    places = [robot.tool_pose(q)[:3, 3].tolist() for q in random_of(robot, 6, rng)]
    return Scene(tuple(Obstacle(f"ball{k}", Sphere(0.03), Pose(tuple(place))) for k, place in enumerate(places)))


def random_of(robot: Robot, count: int, rng: np.random.Generator) -> FloatArray:
    return rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.n))


def grazing(checker: CollisionChecker, count: int, rng: np.random.Generator) -> Iterator[Ends]:
    """Edges that begin where it is free and end shortly before or behind where something touches on the way."""
    for a, b in zip(random_of(checker.robot, count, rng), random_of(checker.robot, count, rng), strict=True):
        if not checker.state_is_free(a):
            continue
        low, high = 0.0, 1.0
        for _ in range(20):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if checker.state_is_free(a + middle * (b - a)) else (low, middle)
        end = min(1.0, low + rng.uniform(-0.01, 0.05))
        yield a.tolist(), (a + end * (b - a)).tolist()


@pytest.mark.parametrize(
    ("name", "alone"),
    [*((name, False) for name in ("panda_mbm", "wxai", *SMALL)), ("panda_mbm", True), ("ur5", True), ("twins", True)],
)
def test_an_edge_is_what_its_samples_are_one_by_one(name: str, alone: bool, tmp_path: Path) -> None:
    robot, rng = robot_of(name, tmp_path), np.random.default_rng(2)
    checker = CollisionChecker(robot, Scene() if alone else around(robot, rng))
    ends = robot.limits.lower.tolist(), robot.limits.upper.tolist()
    args = (ends, ends, checker.reach.tolist(), MotionStep())
    edges = list(grazing(checker, 300, rng))
    told = []
    for variant in instruction_sets():
        kernel = build_kernel(robot, checker.parts, variant)
        assert kernel is not None
        one_by_one = [fields(kernel.check_rows(interior(a, b, 200), 0, 199)) for a, b in edges]
        assert configure_edges(kernel, *args)
        assert [fields(kernel.check_edge_rows(a, b, 0, 200, 0, 199)) for a, b in edges] == one_by_one
        told += one_by_one
    late = [row for free, row, _ in told if not free and row > 16]
    assert len(told) / 20 < len(late) < len(told) or not told


def fields(check: _core.RowCheck) -> tuple[bool, int, list[int]]:
    return check.free, check.row, check.pairs
