"""The bounds on which the verifier rests hold for points that are drawn at random, of arms that are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from auditor.trails import Bundles, Curve, World, chain, placed
from benchmarks.worlds.random_trees import TreeDraw, draw_points, draw_tree


def test_no_point_moves_farther_than_its_levers_allow() -> None:
    chance = np.random.default_rng(7)
    for _ in range(60):
        draw: TreeDraw = draw_tree(chance)
        world = World(draw.robot, (), (), (), {}, 0.0)
        for _ in range(4):
            excess, _ = draw_points(world, chance, 60)
            assert excess <= 1e-12


def test_levers_of_several_pieces_reach_to_the_farthest_point_of_all() -> None:
    """Two discs of 0.4 m, 0.2 m to either side of the axis: their rims are 0.6 m from it, 5 cm up and down."""
    robot = draw_tree(np.random.default_rng(0)).robot
    nowhere = {"position": [0.0, 0.0, 0.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    disc = {"kind": "cylinder", "radius": 0.4, "length": 0.1}
    parts = [{"shape": disc, "pose": {**nowhere, "position": [x, 0.0, 0.0]}} for x in (-0.2, 0.2)]
    shape = {"link": "paddle", "body": 1, "pose": nowhere, "shape": {"kind": "compound", "parts": parts}}
    bodies = [{**body, "prismatic": False} for body in robot["bodies"][:2]]
    world = World({**robot, "bodies": bodies, "shapes": [shape], "tool_body": 1}, (), (), (), {}, 0.0)
    assert world.levers(0, 2, 0, np.zeros(9))[0] == pytest.approx(np.hypot(0.6, 0.05), rel=1e-12)


def test_joints_move_no_farther_along_a_curve_than_it_says() -> None:
    chance = np.random.default_rng(3)
    for _ in range(50):
        points = chance.uniform(-2, 2, (5, 4))
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        blends = [0.0, *(chance.uniform(0, 0.5, 3) * np.minimum(steps[1:], steps[:-1])), 0.0]
        curve = Curve(points, blends)
        s = np.sort(chance.uniform(0, curve.length, 200))
        q, walked = curve.at(s), curve.at(s, walked=True)
        assert (np.abs(np.diff(q, axis=0)) <= np.diff(walked, axis=0) + 1e-12).all()
        np.testing.assert_allclose(curve.at(np.array([0.0, curve.length])), points[[0, -1]], atol=1e-12)


def test_a_piece_reaches_as_far_along_a_direction_as_its_farthest_point() -> None:
    chance: Any = np.random.default_rng(5)
    for _ in range(40):
        world = World(draw_tree(chance).robot, (), (), (), {}, 0.0)
        at = placed(world.bodies, chance.uniform(-1, 1, (1, world.column + 1)))[:, 0]
        for k in range(len(world.of)):
            n = chance.normal(size=3)
            n /= np.linalg.norm(n)
            rows = slice(world.starts[k], world.starts[k + 1])
            turns = chance.normal(size=(4000, 3))
            disc = np.cross(world.axes[rows][0], turns)
            disc /= np.linalg.norm(disc, axis=1)[:, None]
            ball = turns / np.linalg.norm(turns, axis=1)[:, None]
            spread = world.discs[rows].max() * disc + world.balls[rows].max() * ball
            own = (world.points[rows][:, None] + spread).reshape(-1, 3)
            T = at[world.on[k]]
            farthest = ((own @ T[:3, :3].T + T[:3, 3]) @ n).max()
            reach = world.reach(np.array([k]), n[None], T[None])[0]
            size = world.discs[rows].max() + world.balls[rows].max()
            assert farthest <= reach + 1e-12
            assert reach - farthest <= 0.1 * size + 1e-12
    assert chain(world.bodies, 0) == []


def test_a_bundle_reaches_at_least_as_far_as_each_piece_in_it() -> None:
    """And no farther than a box that is alone in it, in its own axes."""
    chance: Any = np.random.default_rng(11)
    robot = draw_tree(chance).robot
    shapes: list[Any] = [{"kind": "box", "size": [0.1, 0.2, 0.3]}, {"kind": "cylinder", "radius": 0.1, "length": 0.5}]
    shapes += [{"kind": "sphere", "radius": 0.2}, {"kind": "capsule", "radius": 0.05, "length": 0.4}]
    stand = []
    for k in range(12):
        turn = (chance.normal(size=4)).tolist()
        pose = {"position": chance.normal(size=3).tolist(), "quaternion_wxyz": turn}
        parts = [{"shape": shape, "pose": pose} for shape in shapes[: 1 + k % 4]]
        shape = shapes[k % 4] if k % 3 else {"kind": "compound", "parts": parts}
        stand.append({"name": f"thing {k}", "shape": shape, "pose": pose})
    world = World(robot, stand, (), (), {}, 0.0)
    count = len(world.of)
    order = np.concatenate([np.arange(world.rides), world.rides + chance.permutation(count - world.rides)])
    begin = chance.integers(world.rides, count - 1, 60)
    end = np.array([chance.integers(low + 1, count + 1) for low in begin])
    bundles = Bundles(world, order, begin, end)
    for _ in range(20):
        n = chance.normal(size=(60, 3))
        n /= np.linalg.norm(n, axis=1)[:, None]
        reach = bundles.reach(np.arange(60), n)
        for k in range(60):
            pieces = order[begin[k] : end[k]]
            still, along = np.tile(np.eye(4), (len(pieces), 1, 1)), np.tile(n[k], (len(pieces), 1))
            farthest = world.reach(pieces, along, still).max()
            assert farthest <= reach[k] + 1e-12
            if end[k] - begin[k] == 1 and world.solids[world.of[pieces[0]]].record["kind"] == "box":
                assert reach[k] == pytest.approx(farthest, abs=1e-12)
