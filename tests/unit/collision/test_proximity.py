"""Distances of near pairs are true, their gradients are those of the distances, and both are counted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest

from planner_service import (
    CollisionChecker,
    Cylinder,
    InvalidRequest,
    Obstacle,
    Pose,
    Scene,
    Sphere,
    load_robot,
    load_scene,
)
from planner_service.collision.backends import NearPairs
from planner_service.collision.budget import TimeBoxSpent
from planner_service.geometry.arrays import FloatArray
from tests.support.coal_shapes import coal_shape
from tests.support.hull_arm import HELD, OBSTACLES, HullSetup, write_arm
from tests.support.small_robots import MIXED, built

COAL_ERROR = 1.2e-6
"""Metres: what Coal's own distances of round shapes are good to."""


def drawn(checker: CollisionChecker, count: int, seed: int = 0) -> FloatArray:
    limits = checker.robot.limits
    return np.random.default_rng(seed).uniform(limits.lower, limits.upper, (count, checker.robot.n))


def coal_distances(checker: CollisionChecker, Q: FloatArray, found: NearPairs) -> FloatArray:
    shapes = [coal_shape(part.shape) for part in checker.parts.parts]
    out = []
    for row, pair in zip(found.rows.tolist(), found.pairs.tolist(), strict=True):
        poses = checker.robot.body_poses(Q[row])
        numbers = checker._parts.pairs.of(np.array([pair]))[0].tolist()
        placed = []
        for number in numbers:
            part, T = checker.parts.parts[number], np.eye(4)
            if part.body >= 0:
                T[:3, :3], T[:3, 3] = np.array(poses[part.body][:9]).reshape(3, 3), poses[part.body][9:]
            T = T @ part.T
            placed.append(coal.Transform3s(T[:3, :3], T[:3, 3]))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.enable_signed_distance = True
        a, b = (shapes[number] for number in numbers)
        out.append(coal.distance(a, placed[0], b, placed[1], request, result))
    return np.array(out)


@pytest.mark.parametrize(("robot", "scene"), [("wxai", "clutter"), ("panda_mbm", "bin"), ("wxai_dual", "table")])
def test_distances_are_those_of_an_independent_library(robot: str, scene: str) -> None:
    checker = CollisionChecker(load_robot(robot), load_scene(scene))
    Q = drawn(checker, 60)
    found = checker.near(Q, 0.05)
    theirs = coal_distances(checker, Q, found)
    assert len(theirs) > 150
    assert (found.distances < 0.0).sum() > 20
    assert np.abs(found.distances - theirs).max() < COAL_ERROR


def test_no_pair_that_is_near_is_left_out() -> None:
    checker = CollisionChecker(load_robot("wxai"), load_scene("shelf"))
    Q = drawn(checker, 40)
    within = checker.near(Q, 0.05)
    farther = checker.near(Q, 0.5)
    near = farther.distances <= 0.05
    assert sorted(zip(within.rows.tolist(), within.pairs.tolist(), strict=True)) == sorted(
        zip(farther.rows[near].tolist(), farther.pairs[near].tolist(), strict=True)
    )


BENDING = 1e-3
"""Metres per radian by which a distance that bends by 20 m/rad^2 may leave both differences of 0.1 mrad."""


def lies_between(checker: CollisionChecker, Q: FloatArray, step: float = 1e-4) -> bool:
    """Whether every derivative at Q lies between both differences."""
    found = checker.near(Q, 0.05)
    keys = list(zip(found.rows.tolist(), found.pairs.tolist(), strict=True))
    assert len(keys) > 20
    for joint in range(checker.robot.n):
        sides = []
        for by in (step, -step):
            moved = Q.copy()
            moved[:, joint] += by
            there = checker.near(moved, 0.2)
            rows = zip(there.rows.tolist(), there.pairs.tolist(), strict=True)
            known = dict(zip(rows, there.distances.tolist(), strict=True))
            sides.append((np.array([known[key] for key in keys]) - found.distances) / by)
        low, high = np.minimum(*sides) - BENDING, np.maximum(*sides) + BENDING
        if not ((found.gradients[:, joint] >= low) & (found.gradients[:, joint] <= high)).all():
            return False
    return True


def judged(kind: str, folder: Path) -> tuple[CollisionChecker, FloatArray]:
    """A checker and configurations at which pairs are near: turning joints, sliding ones, or links of hulls."""
    if kind == "hulls":
        write_arm(folder)
        checker = HullSetup("hulls", folder, OBSTACLES, (HELD,)).checker()
    else:
        robot = load_robot("wxai") if kind == "turning" else built(folder, MIXED)
        checker = CollisionChecker(robot, load_scene("clutter"))
    limits = checker.robot.limits
    return checker, np.clip(drawn(checker, 60), limits.lower + 1e-3, limits.upper - 1e-3)


@pytest.mark.parametrize("kind", ["turning", "sliding", "hulls"])
def test_gradients_lie_between_both_differences(kind: str, tmp_path: Path) -> None:
    assert lies_between(*judged(kind, tmp_path))


def test_a_gradient_of_the_wrong_sign_would_be_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = CollisionChecker.near

    def wrong(self: CollisionChecker, Q: Any, within: float) -> NearPairs:
        found = asked(self, Q, within)
        return NearPairs(found.rows, found.pairs, found.distances, found.points, -found.gradients)

    monkeypatch.setattr(CollisionChecker, "near", wrong)
    assert not lies_between(*judged("turning", tmp_path))


def test_the_points_are_where_the_distance_is_measured() -> None:
    checker = CollisionChecker(load_robot("wxai"), load_scene("clutter"))
    found = checker.near(drawn(checker, 60), 0.05)
    between = found.points[:, 1] - found.points[:, 0]
    lengths = np.sqrt((between * between).sum(axis=1))
    assert np.abs(lengths - np.abs(found.distances)).max() < 2e-6


def test_many_rows_say_what_each_says_alone_to_the_last_bit() -> None:
    checker = CollisionChecker(load_robot("wxai"), load_scene("post"))
    Q = drawn(checker, 20)
    together = checker.near(Q, 0.05)
    alone = [checker.near(q[None], 0.05) for q in Q]
    for name in ("pairs", "distances", "points", "gradients"):
        assert getattr(together, name).tobytes() == np.concatenate([getattr(one, name) for one in alone]).tobytes()


def test_padding_is_not_forgotten() -> None:
    robot, scene = load_robot("wxai"), load_scene("post")
    plain, padded = (CollisionChecker(robot, scene, padding=padding) for padding in (0.0, 0.01))
    Q = drawn(plain, 20)
    free, close = plain.near(Q, 0.03), padded.near(Q, 0.02)
    known = dict(zip(zip(free.rows.tolist(), free.pairs.tolist(), strict=True), free.distances.tolist(), strict=True))
    apart = [
        (known[row, pair], d)
        for row, pair, d in zip(close.rows.tolist(), close.pairs.tolist(), close.distances.tolist(), strict=True)
        if known.get((row, pair), -1.0) > 0.0
    ]
    assert len(apart) > 20
    # boxes grow by half of it along their axes, so that two corners come nearer by up to sqrt(3) times as much
    assert all(plain_gap - 0.01 * math.sqrt(3.0) - 1e-9 <= gap <= plain_gap - 0.01 + 1e-9 for plain_gap, gap in apart)


def test_what_is_measured_is_counted_as_distances_and_as_nothing_else() -> None:
    checker = CollisionChecker(load_robot("planar2"), Scene(obstacles=(Obstacle("far", Sphere(0.1), Pose((9, 0, 0))),)))
    Q = drawn(checker, 5)
    assert len(checker.near(Q, 0.05).rows) == checker.counts.distances == 0
    close = CollisionChecker(
        load_robot("planar2"), Scene(obstacles=(Obstacle("disc", Cylinder(0.1, 0.2), Pose((0.8, 0, 0))),))
    )
    found = close.near(np.zeros((3, 2)), 0.05)
    assert (close.counts.states, close.counts.edges) == (0, 0)
    assert close.counts.distances == 3  # one link is near, in each row
    assert found.rows.tolist() == [0, 1, 2]


def test_limits_hold_while_distances_are_asked() -> None:
    checker = CollisionChecker(load_robot("planar2"), load_scene("discs"))
    with checker.limited(deadline=0.0), pytest.raises(TimeBoxSpent, match="time limit"):
        checker.near(np.zeros((1, 2)), 0.05)


def test_what_is_no_configuration_is_refused() -> None:
    for Q, within, told in [
        (np.zeros(2), 0.05, "shape"),
        (np.zeros((1, 3)), 0.05, "shape"),
        (np.array([[0.0, math.nan]]), 0.05, r"Q\[0\]"),
        (np.array([[0.0, 0.0], [0.0, 9.0]]), 0.05, r"Q\[1\]"),
        (np.zeros((1, 2)), -0.1, "within"),
        (np.zeros((1, 2)), 1.5, "within"),
        (np.zeros((1, 2)), math.nan, "within"),
    ]:
        checker = CollisionChecker(load_robot("planar2"), load_scene("discs"))
        with pytest.raises(InvalidRequest, match=told):
            checker.near(Q, within)
