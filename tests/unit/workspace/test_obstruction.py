"""Boxes of joint values are dropped only if every configuration in them, with the tool as wanted, collides.

Free configurations are drawn next to collisions, and around configurations that collide the least boxes that still have
them: in a corner, with the tool in a corner of the box of positions and turned as far as is allowed.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planner_service import (
    Box,
    Capsule,
    CollisionChecker,
    Cylinder,
    Mesh,
    Obstacle,
    Pose,
    Robot,
    Scene,
    Sphere,
    load_robot,
    load_scene,
)
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.shapes import Shape
from planner_service.workspace import ToolOrientation
from planner_service.workspace.mapping import Arm
from planner_service.workspace.solids import obstructed
from planner_service.workspace.tree import Boxes, VoxelTree
from tests.support.hull_arm import lump
from tests.support.random_robots import random_robot

KINDS = ("pose", "own axis", "any axis", "any")


@pytest.mark.parametrize("seed", [1, 6, 7, 8, 11, 14])  # each notices some fault in the bound that others do not
def test_no_free_configuration_of_a_drawn_arm_is_dropped(seed: int, tmp_path: Path) -> None:
    scene = drawn_scene(seed)
    asked, dropped = attack(np.random.default_rng(seed), drawn_arm(seed, tmp_path, scene), scene, 300)
    assert asked == 300
    assert dropped > 10


@pytest.mark.parametrize(("name", "scene"), [("wxai", "bin"), ("ur5", "table")])
def test_no_free_configuration_of_an_arm_is_dropped(name: str, scene: str) -> None:
    _, dropped = attack(np.random.default_rng(1), Arm.of(load_robot(name), None).robot, load_scene(scene), 500)
    assert dropped > 10


def drawn_arm(seed: int, folder: Path, scene: Scene) -> Robot:
    """A chain of three to six joints that turn and slide, some in step with others, with branches on the way."""
    rng = np.random.default_rng([seed, 0])
    while True:
        (folder / "arm.urdf").write_text(random_robot(rng, joints=6, mimics=int(rng.integers(3))))
        robot = Robot.from_urdf(folder / "arm.urdf", package_dirs=[folder])
        try:
            arm = Arm.of(robot, None).robot
        except InvalidRequest:  # no joint moves the tool
            continue
        some = np.random.default_rng(0).uniform(arm.limits.lower, arm.limits.upper, (200, arm.n))
        free = CollisionChecker(arm, scene).states_are_free(some).mean()
        if arm.n >= 3 and 0.1 <= free <= 0.95:
            return arm


def drawn_scene(seed: int) -> Scene:
    """Obstacles of all shapes among which the arm stands."""
    rng = np.random.default_rng([seed, 1])
    obstacles = []
    for k in range(14):
        a, b, c = rng.uniform(0.03, 0.16, 3).tolist()
        shapes: list[Shape] = [
            Box((2 * a, 2 * b, 2 * c)),
            Sphere(a),
            Cylinder(a, 2 * b),
            Capsule(a / 2, 2 * b),
            Mesh(lump(k, 16, (a, b, c), (0.0, 0.0, 0.0))),
        ]
        x, y, z = (rng.normal(size=3) * 0.35).tolist()
        turn = rng.normal(size=4)
        qw, qx, qy, qz = (turn / math.sqrt(float(turn @ turn))).tolist()
        obstacles.append(Obstacle(f"o{k}", shapes[k % 5], Pose((x, y, z), (qw, qx, qy, qz))))
    return Scene(tuple(obstacles))


def attack(rng: np.random.Generator, robot: Robot, scene: Scene, draws: int) -> tuple[int, int]:
    """Fails if a box with a free configuration is dropped.

    Returns how many boxes were asked, and how many of those a third as wide, around what collides, were dropped.
    """
    solids, checker = obstructed(robot, scene), CollisionChecker(robot, scene)
    assert solids is not None
    Q, middles = beside_collisions(rng, robot, checker, draws)
    dropped = 0
    for k, (q, middle) in enumerate(zip(Q, middles, strict=True)):
        have, there = robot.tool_pose(q), robot.tool_pose(middle)
        kind, size = KINDS[k % len(KINDS)], np.abs(q - middle)
        half = np.abs(have[:3, 3] - there[:3, 3]) * (1.0 + 1e-9) + 1e-9
        axis, tolerance = orientation_for(rng, kind, have[:3, :3], there[:3, :3])
        for share in (1.0, 0.3):
            wanted = ToolOrientation(Pose.from_matrix(there).quaternion, share * tolerance, axis)
            if kind == "any":
                wanted = ToolOrientation(tolerance=math.pi)
            tree = VoxelTree(robot, wanted, solids, None)
            at, centre = where_searched(tree, middle), there[None, :3, 3]
            boxes = around(tree, at, share * size * (1.0 + 1e-9) + 1e-9).moved(index(0), centre)
            left, _, _, _ = tree.covered(boxes, share * half)
            if share < 1.0:
                dropped += not len(left.joints)
            else:
                own = at + (q - middle)
                inside = np.all((left.joints[:, 0] - 1e-9 <= own) & (own <= left.joints[:, 1] + 1e-9), axis=1)
                assert inside.any() or not np.all(boxes.joints[0, 0] <= own) or not np.all(own <= boxes.joints[0, 1]), (
                    k,
                    kind,
                    q.tolist(),
                    middle.tolist(),
                )
    return len(Q), dropped


def beside_collisions(
    rng: np.random.Generator, robot: Robot, checker: CollisionChecker, count: int
) -> tuple[FloatArray, FloatArray]:
    """Free configurations (count, n), most of them next to a collision, and ones nearby that collide, (count, n)."""
    low, high = robot.limits.lower, robot.limits.upper
    found: list[FloatArray] = []
    others: list[FloatArray] = []
    while sum(map(len, found)) < count:
        free, other = (rng.uniform(low, high, (8 * count, robot.n)) for _ in range(2))
        rows = np.flatnonzero(checker.states_are_free(free) & ~checker.states_are_free(other))
        free, other = free[rows], other[rows]
        for _ in range(int(rng.integers(4, 22))):
            middle = (free + other) / 2.0
            kept = checker.states_are_free(middle)[:, None]
            free, other = np.where(kept, middle, free), np.where(kept, other, middle)
        moved = rng.random(free.shape) < rng.choice([0.25, 0.5, 1.0], (len(free), 1))
        deep = free + moved * rng.normal(size=free.shape) * 10.0 ** rng.uniform(-3.0, -0.5, (len(free), 1))
        deep = np.clip(deep, low, high)
        rows = np.flatnonzero(~checker.states_are_free(deep))
        found.append(free[rows])
        others.append(deep[rows])
    return np.concatenate(found)[:count], np.concatenate(others)[:count]


def where_searched(tree: VoxelTree, q: FloatArray) -> FloatArray:
    """q with joints that go round turned by whole turns to where boxes are."""
    low, high = tree.whole(np.zeros((1, 3))).joints[0]
    rounds = np.abs(high - low - 2.0 * math.pi) < 1e-6
    turns = np.where(rounds, np.floor((q - low) / (2.0 * math.pi)), 0.0)
    return np.asarray(q - 2.0 * math.pi * turns)


def around(tree: VoxelTree, q: FloatArray, half: FloatArray) -> Boxes:
    """One box of joint values around q, as far as the joints go."""
    whole = tree.whole(np.zeros((1, 3)))
    ends = np.clip(np.stack([q - half, q + half]), whole.joints[0, 0], whole.joints[0, 1])
    return Boxes(index(0), whole.centre, index(0, 1), ends[None])


def index(*values: int) -> IntArray:
    return np.array(values, dtype=np.int64)


def orientation_for(
    rng: np.random.Generator, kind: str, have: FloatArray, there: FloatArray
) -> tuple[tuple[float, float, float] | None, float]:
    """A free axis, if the kind has one, and a tolerance by which one orientation is just within reach of the other."""
    if kind == "pose":
        return None, turned_by(have, there)
    about = rng.normal(size=3)
    if kind == "own axis":  # the axis of the turn between them: nothing but a spin
        turn = have.T @ there
        about = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        about = about if float(about @ about) > 1e-12 else np.array([0.0, 0.0, 1.0])
    x, y, z = (about / math.sqrt(float(about @ about))).tolist()
    apart = have @ np.array([x, y, z]) - there @ np.array([x, y, z])
    return (x, y, z), 2.0 * math.asin(min(1.0, math.sqrt(float(apart @ apart)) / 2.0)) * (1.0 + 1e-7) + 1e-9


def turned_by(a: FloatArray, b: FloatArray) -> float:
    """The angle between two orientations, and a little more."""
    size = math.sqrt(float(((a - b) ** 2).sum()) / 8.0)
    return min(math.pi - 1e-6, 2.0 * math.asin(min(1.0, size)) * (1.0 + 1e-7) + 1e-9)
