"""Tubes as the compiled proof judges them, and as the slow reference does; and that reference's bound, attacked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service.certify import MARGIN, Certifier
from planner_service.collision import CollisionChecker
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle, Scene
from tests.reference.tubes import Joint, Solid, Tubes, approach, moved_height
from tests.support.backends import case
from tests.support.small_robots import built, joint, link, solid, urdf

ROOT = Path(__file__).parents[3]

LARGEST = 0.3
"""Radians (or metres) of room for a joint: with more, directions that Coal and the proof take differ too much."""

WHEELS = urdf(
    "wheels",
    link("base"),
    link("arm", solid("cylinder", 'radius="0.25" length="0.02"', "0.2 0 0", "0.5 0.4 0")),
    link("wheel", solid("cylinder", 'radius="0.3" length="0.02"')),
    link("ball", solid("sphere", 'radius="0.2"', "0.1 0 0")),
    joint("turn", "revolute base arm -3 3", axis="1 0 0", xyz="0 0 0.5"),
    joint("tilt", "revolute arm wheel -3 3", axis="0 1 0", xyz="0.6 0 0"),
    joint("slide", "prismatic arm ball -0.5 0.5", axis="0 0.6 0.8", xyz="-0.4 0 0"),
)
"""Thin discs that turn about what is in their plane, and a ball: where a box around each would say something else."""


def wheels(folder: Path, rng: np.random.Generator) -> tuple[Robot, Scene, IndependentChecker]:
    robot = built(folder, WHEELS)
    shapes: tuple[Shape, ...] = (Box((0.3, 0.2, 0.1)), Sphere(0.1), Cylinder(0.1, 0.2), Capsule(0.06, 0.2))
    scene = Scene(
        tuple(
            Obstacle(f"o{k}", shape, Pose.from_rpy(tuple(rng.uniform(-0.9, 0.9, 3)), tuple(rng.uniform(-3.0, 3.0, 3))))
            for k, shape in enumerate(shapes)
        )
    )
    table = {"urdf": folder / "robot.urdf", "joints": list(robot.joint_names), "tool_frame": "ball"}
    neighbours = [("arm", "wheel"), ("arm", "ball")]
    return robot, scene, IndependentChecker(table, tables_of(scene), allowed=neighbours)


def known(name: str) -> tuple[Robot, Scene, IndependentChecker]:
    robot, scene = case(name)
    return robot, scene, IndependentChecker(ROOT / "robots" / name.split()[0], tables_of(scene))


def compare(
    robot: Robot, scene: Scene, second: IndependentChecker, rng: np.random.Generator, cases: int, least: float
) -> tuple[int, int]:
    """How many of so many rooms at the edge of what is proven both prove; each must prove most of the other's room."""
    certifier, tubes, checker = Certifier(robot, scene), Tubes(second), CollisionChecker(robot, scene)
    done = mixed = 0
    while done < cases:
        a = rng.uniform(*robot.bounds)
        b = np.clip(a + rng.choice([0.0, 0.05]) * rng.uniform(-1.0, 1.0, robot.n), *robot.bounds)
        shape = rng.uniform(0.0, 1.0, robot.n) * (rng.random(robot.n) < 0.7)
        if not shape.any() or not checker.edge_is_free(a, b) or certifier.certify_tubes([a], [b], [shape]).free:
            continue
        low, high = 0.0, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            free = certifier.certify_tubes([a], [b], [middle * shape]).free
            low, high = (middle, high) if free else (low, middle)
        if not 0.0 < low * shape.max() < LARGEST:
            continue
        done += 1
        assert tubes.free(a, b, least * low * shape, MARGIN), f"the reference proves less: {a} {b} {low * shape}"
        assert not tubes.free(a, b, high / least * shape, MARGIN), f"the reference proves more: {a} {b} {high * shape}"
        mixed += bool((a != b).any())
    return done, mixed


def test_discs_and_balls_are_proven_the_room_that_the_reference_proves(tmp_path: Path) -> None:
    rng, mixed = np.random.default_rng(3), 0
    for _ in range(6):
        mixed += compare(*wheels(tmp_path, rng), rng, 4, 0.8)[1]
    assert mixed > 5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wxai bin", "panda shelf", "ur5 clutter"])
def test_arms_are_proven_the_room_that_the_reference_proves(name: str) -> None:
    done, mixed = compare(*known(name), np.random.default_rng(4), 4, 0.8)
    assert done >= mixed > 0


def drawn(rng: np.random.Generator) -> tuple[Solid, list[Joint]]:
    """Any convex solid, and up to six joints that carry it."""
    corners = rng.normal(size=(int(rng.integers(1, 12)), 3)) * rng.uniform(0.01, 0.5, 3) + rng.normal(size=3) * 0.3
    normal = rng.normal(size=3)
    disc = float(rng.choice([0.0, 0.4]))
    body = Solid(corners, disc, float(rng.choice([0.0, 0.3])), normal / np.linalg.norm(normal) if disc else None)
    axes = rng.normal(size=(int(rng.integers(1, 7)), 3))
    joints = [
        Joint(axis / np.linalg.norm(axis), rng.normal(size=3) * 0.4, bool(rng.random() < 0.25), k)
        for k, axis in enumerate(axes)
    ]
    return body, joints


@pytest.mark.slow
def test_no_motion_of_a_million_brings_a_solid_lower_than_the_bound_says() -> None:
    rng, share = np.random.default_rng(5), list[float]()
    for _ in range(1000):
        body, joints = drawn(rng)
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        moved = rng.uniform(0.0, rng.choice([0.05, 0.3, 1.0]), len(joints))
        by = moved * rng.choice([-1.0, 1.0], (1000, len(joints)))
        by[500:] *= rng.uniform(0.0, 1.0, (500, len(joints)))
        still = float(moved_height(body, joints, n, np.zeros((1, len(joints))))[0])
        lowest = still - float(moved_height(body, joints, n, by).min())
        bounds = [approach(body, joints, n, moved, order) for order in (0, 1, 2)]
        assert lowest <= min(bounds) + 1e-12
        share.append(lowest / min(bounds))
    assert np.median(share) > 0.5  # and it is no bound that proves little
