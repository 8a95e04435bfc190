"""Laws of ``Sweep``: what it calls out of reach of some obstacles, FCL finds free of them at every fine sample.

The second opinion is the checker in a scene of these obstacles alone, the robot allowed to touch itself, with samples
a millimetre apart.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from planner_service.collision import CollisionChecker, MotionStep
from planner_service.collision import swept_bounds as module
from planner_service.collision.swept_bounds import Sweep
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Attached, Obstacle, Scene

REACH = {"wxai": 0.6, "planar2": 1.0, "ur5": 0.8, "panda_mbm": 0.8, "wxai_dual": 0.6}
"""Metres."""

KINDS = ("box", "sphere", "cylinder", "capsule", "mesh", "compound", "cloud", "heights")


def turned(rng: np.random.Generator, spread: float) -> Pose:
    x, y, z = rng.uniform(-spread, spread, 3).tolist()
    a, b, c = rng.uniform(-3.0, 3.0, 3).tolist()
    return Pose.from_rpy((x, y, z), (a, b, c))


def solid(rng: np.random.Generator, kind: str, size: float) -> Solid:
    a, b = (rng.uniform(0.3, 1.0, 2) * size).tolist()
    if kind == "box":
        return Box((a, b, size))
    if kind == "sphere":
        return Sphere(a / 2)
    if kind == "cylinder":
        return Cylinder(a / 2, b)
    if kind == "capsule":
        return Capsule(a / 3, b)
    if kind == "mesh":
        return Mesh(rng.normal(0.0, 0.3, (12, 3)) * size + rng.uniform(-1.0, 1.0, 3) * size)
    if kind == "compound":
        few = ("box", "mesh", "capsule", "cylinder")
        return Compound(tuple((solid(rng, part, 0.6 * size), turned(rng, 0.4 * size)) for part in few))  # type: ignore[misc]
    if kind == "cloud":
        return PointCloud(rng.uniform(-0.4, 0.4, (300, 3)) * size, 0.05 * size)
    return HeightField(rng.uniform(-0.3, 0.4, (12, 12)) * size, 0.08 * size, -0.3 * size)


class World:
    """A robot and two obstacles of each of some kinds, one of which came."""

    def __init__(self, name: str, kinds: tuple[str, ...], seed: int, *, padding: float, held: bool = False) -> None:
        rng = np.random.default_rng(seed)
        self.robot: Robot = load_robot(name)
        if held and self.robot.gripper is not None:
            self.robot = self.robot.with_gripper(self.robot.gripper.upper)
        standing = []
        for k, kind in enumerate(kinds * 2):
            way = rng.normal(size=3)
            x, y, z = (way / math.sqrt(float((way * way).sum())) * REACH[name] * rng.uniform(0.4, 1.1)).tolist()
            z *= name != "planar2"
            shape = solid(rng, kind, REACH[name] * rng.uniform(0.1, 0.3))
            standing.append(Obstacle(f"o{k}", shape, Pose((x, y, z)) @ turned(rng, 0.02)))
        load = Compound(((Box((0.3, 0.02, 0.02)), turned(rng, 0.05)), (Sphere(0.05), Pose((0.0, 0.1, 0.2)))))
        carried = (Attached("load", load, turned(rng, 0.05)),) if held else ()
        self.came = [f"o{k}" for k in range(len(kinds))]
        self.checker = CollisionChecker(self.robot, Scene(tuple(standing), carried), padding=padding)
        owners = sorted({shape.link for shape in self.robot.shapes} | {item.name for item in carried})
        self.judge = CollisionChecker(
            self.robot,
            Scene(tuple(o for o in standing if o.name in self.came), carried),
            padding=padding,
            edge_step=MotionStep(0.001),
            allowed=list(combinations(owners, 2)),
        )
        self.sweep = Sweep(self.checker, self.came)
        self.rng = rng

    def edges(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Edges of all lengths, of none too."""
        limits = self.robot.limits
        A = self.rng.uniform(limits.lower, limits.upper, (count, self.robot.n))
        B = self.rng.uniform(limits.lower, limits.upper, (count, self.robot.n))
        B = A + (B - A) * self.rng.uniform(0.0, 0.7, (count, 1)) ** 2
        B[::3, 1:] = A[::3, 1:]  # one joint alone: no bound of the motion is tighter
        B[::10] = A[::10]
        for k in range(1, count):
            hit = self.judge.edge_hit(A[k], B[k])
            if hit is not None and k % 10:  # up to just before the collision, or just beyond it
                B[k] = A[k] + (B[k] - A[k]) * min(1.0, hit.fraction * (0.98, 1.02)[k % 2])
        return A, B

    def shown(self, count: int) -> tuple[int, int]:
        """Edges out of reach, and those of them that are not free."""
        A, B = self.edges(count)
        told = self.sweep.still_free(A, B)
        wrong = [k for k in np.flatnonzero(told).tolist() if not self.judge.edge_is_free(A[k], B[k])]
        return int(told.sum()), len(wrong)


WORLDS: list[tuple[str, tuple[str, ...], float, bool, int, int]] = [
    ("wxai", ("box",), 0.0, False, 397, 25_740),
    ("wxai", ("sphere", "cylinder", "capsule"), 0.001, True, 378, 165_144),
    ("wxai", ("mesh", "compound"), 0.02, True, 387, 148_120),
    ("wxai", ("heights",), 0.0, True, 390, 33_040),
    ("planar2", KINDS, 0.001, False, 109, 33_308),
    ("panda_mbm", ("box", "mesh"), 0.1, False, 334, 44_840),
    ("ur5", ("cylinder", "compound"), 0.005, False, 348, 80_430),
]
"""Robot, obstacles, padding, whether something is held; then how many of 400 edges are out of reach, and the bounds of
distances that took."""


@pytest.mark.parametrize(("name", "kinds", "padding", "held", "told", "distances"), WORLDS)
def test_what_is_out_of_reach_is_free_at_every_fine_sample(
    name: str, kinds: tuple[str, ...], padding: float, held: bool, told: int, distances: int
) -> None:
    world = World(name, kinds, 7, padding=padding, held=held)
    before = world.checker.counts
    assert world.shown(400) == (told, 0)
    assert (world.checker.counts - before).distances == distances


def shrunk(parts: Any) -> Any:
    at, radius = _BALLS(parts)
    return at, 0.5 * radius


def some_missing(parts: Any) -> Any:
    return _BALLS(parts[::2])


def small_around(body: int, parts: Any) -> Any:
    return replace(_OF(body, parts), around=0.0)


_BALLS, _BOXES, _OF = module._balls, module._boxes, module._Cluster.of


@pytest.mark.parametrize(
    ("what", "fault"),
    [
        ("_balls", shrunk),
        ("_balls", some_missing),
        ("_Cluster.of", small_around),
        ("_boxes", lambda pieces: [(R, t, 0.7 * half) for R, t, half in _BOXES(pieces)]),
        ("_boxes", lambda pieces: [(R, t + 0.05, half) for R, t, half in _BOXES(pieces)]),
        ("GROWN", 1.0),
    ],
    ids=["shrunk balls", "pieces missing", "no ball around", "shrunk boxes", "boxes elsewhere", "corners forgotten"],
)
def test_a_planted_fault_shows(what: str, fault: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    padding = 0.1 if what == "GROWN" else 0.0
    monkeypatch.setattr(f"{module.__name__}.{what}", fault)
    assert any(World("wxai", ("box", "mesh"), seed, padding=padding).shown(300)[1] for seed in range(4))


def test_a_third_of_the_motion_shows() -> None:
    setup = World("planar2", ("sphere",), 1, padding=0.0)
    limits, rng = setup.robot.limits, np.random.default_rng(5)
    A = rng.uniform(limits.lower, limits.upper, (500, 2))
    B = A.copy()
    B[:, 0] = rng.uniform(limits.lower[0], limits.upper[0], 500)  # through what is in between
    blocked = np.array([not setup.judge.edge_is_free(a, b) for a, b in zip(A, B, strict=True)])
    assert not (blocked & setup.sweep.still_free(A, B)).any()
    setup.sweep._reach = [0.3 * reach for reach in setup.sweep._reach]
    assert (blocked & setup.sweep.still_free(A, B)).any()


@pytest.mark.parametrize("padding", [0.0, 0.004])
@pytest.mark.parametrize(("more", "clear"), [(1.1e-5, True), (0.9e-5, False)])
@pytest.mark.parametrize(("radius", "doubt"), [(0.02, 0.0), (0.0005, 0.0005)])
def test_a_motion_keeps_ten_micrometres_and_seven_quarters_of_the_padding_and_small_solids_half_a_millimetre(
    padding: float, more: float, clear: bool, radius: float, doubt: float
) -> None:
    robot = load_robot("wxai")
    x, y, z = (robot.tool_pose(robot.home) @ np.array([0.1, 0.0, 0.0, 1.0]))[:3].tolist()
    table = Obstacle("table", Box((0.04, 0.04, 0.02)), Pose((x, y, z - 0.01 - radius - doubt - 1.75 * padding - more)))
    scene = Scene((table,), (Attached("ball", Sphere(radius), Pose((0.1, 0.0, 0.0))),))
    home = robot.home[None]
    assert Sweep(CollisionChecker(robot, scene, padding=padding), ["table"]).still_free(home, home).tolist() == [clear]
