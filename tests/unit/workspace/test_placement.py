"""Bases: witnesses are what they are said to be, and no base is found where it is proven that there is none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planner_service import (
    Box,
    CollisionChecker,
    Obstacle,
    Pose,
    PoseGoal,
    Robot,
    Scene,
    load_robot,
    load_scene,
)
from planner_service.errors import InvalidRequest
from planner_service.view.still.maps import draw_base
from planner_service.workspace import BaseRegion, place_base, seen_from

DOWN = (0.5**0.5, 0.0, 0.5**0.5, 0.0)
POSES = (Pose((0.3, -0.15, 0.1), DOWN), Pose((0.2, 0.28, 0.15), DOWN), Pose((0.33, 0.0, 0.12), DOWN))
APART = (Pose((-0.62, 0.0, 0.1), DOWN), Pose((0.62, 0.0, 0.1), DOWN))
"""Farther apart than twice the WidowX AI's reach with its tool down."""


@pytest.fixture(scope="module")
def wxai() -> Robot:
    return load_robot("wxai")


def test_every_base_has_witnesses(wxai: Robot, tmp_path: Path) -> None:
    scene = load_scene("bin")
    found = place_base(wxai, POSES, BaseRegion((-0.2, -0.2, 0.0), (0.1, 0.2, 0.0), (-0.6, 0.6)), scene)
    assert len(found.bases) == 5
    assert not found.proven
    assert [base.margin for base in found.bases] == sorted((base.margin for base in found.bases), reverse=True)
    for base in found.bases:
        judge = CollisionChecker(wxai, seen_from(base.pose, scene), backend="fcl")
        for pose, q, clear, room in zip(POSES, base.witnesses, base.clearances, base.rooms, strict=True):
            assert np.allclose(base.pose.matrix @ wxai.tool_pose(q), pose.matrix, atol=1e-6)
            assert judge.state_is_free(q)
            assert judge.clearance(q) >= clear - 1e-9
            assert min((q - wxai.limits.lower).min(), (wxai.limits.upper - q).min()) == pytest.approx(room)
    draw_base(wxai, scene, found.bases[0], tmp_path / "base.png")
    assert (tmp_path / "base.png").stat().st_size > 10_000


def test_margins_that_are_asked_for_are_kept(wxai: Robot) -> None:
    region = BaseRegion((-0.2, -0.2, 0.0), (0.1, 0.2, 0.0), (-0.6, 0.6))
    found = place_base(wxai, POSES[:1], region, clearance=0.02, room=0.06)
    assert found.bases
    for base in found.bases:
        assert base.clearances.min() >= 0.02
        assert base.rooms.min() >= 0.06
    assert not place_base(wxai, POSES[:1], region, clearance=1.0, most_boxes=20).bases


def test_poses_too_far_apart_are_proven_to_have_no_base(wxai: Robot) -> None:
    found = place_base(wxai, APART, BaseRegion((-0.4, -0.2, 0.0), (0.4, 0.2, 0.0), (-0.2, 0.2)))
    assert found.proven
    assert (found.bases, found.unsettled) == ((), 0.0)
    assert found.ruled_out.sum() == pytest.approx(1.0)
    assert str(found).startswith("no base in the region, proven: ruled out by pose 0")


@pytest.mark.parametrize("seed", range(3))
def test_a_region_with_a_base_is_never_ruled_out(wxai: Robot, seed: int) -> None:
    """A base that has a configuration, at joint limits, is in a corner of the region, or somewhere in it."""
    rng = np.random.default_rng(seed)
    low, high, checker = wxai.limits.lower, wxai.limits.upper, CollisionChecker(wxai, Scene())
    most = 0.0
    for _ in range(50):
        while True:
            q = rng.uniform(low, high)
            q = np.where(rng.random(6) < 0.5, np.where(rng.random(6) < 0.5, low + 1e-7, high - 1e-7), q)
            if checker.state_is_free(q):
                break
        at = np.array([*rng.uniform(-1.0, 1.0, 3), rng.uniform(-3.0, 3.0)])
        size = rng.uniform(0.0, 1.0, 4) * np.array([0.2, 0.2, 0.1, 0.5]) * (rng.random(4) < 0.6)
        corner = rng.random(4) if rng.random() < 0.3 else rng.integers(0, 2, 4)
        first, last = (at - corner * size).tolist(), (at + (1.0 - corner) * size).tolist()
        base = Pose.from_rpy(tuple(at[:3].tolist()), (0.0, 0.0, float(at[3])))
        pose = base @ Pose.from_matrix(wxai.tool_pose(q))
        region = BaseRegion(
            (first[0], first[1], first[2]),
            (last[0], last[1], last[2]),
            (min(first[3], last[3]), max(first[3], last[3])),
        )
        found = place_base(wxai, [pose], region, most_bases=1, most_boxes=40)
        assert not found.proven, (q.tolist(), at.tolist(), region)
        most = max(most, float(found.ruled_out[0]))
    assert most > 0.5


def test_obstacles_rule_bases_out_without_a_proof(wxai: Robot) -> None:
    walls = Scene((Obstacle("block", Box((0.1, 0.1, 0.1)), POSES[0]),))
    found = place_base(wxai, POSES[:1], BaseRegion((-0.02, -0.02, 0.0), (0.0, 0.0, 0.0)), walls, most_boxes=60)
    assert not found.bases
    assert not found.proven
    assert str(found).startswith("none found; 100 % of the region unsettled")


def test_an_arm_of_five_joints_may_turn_about_an_axis() -> None:
    arm = load_robot("example-robot-data:so101")
    T = Pose.from_matrix(arm.tool_pose(arm.home))
    goal = PoseGoal(Pose((1.0, 2.0, 0.0)) @ T, free_axis=(0.0, 0.0, 1.0))
    found = place_base(arm, [goal], BaseRegion((0.98, 1.99, 0.0), (1.02, 2.01, 0.0)), most_bases=1)
    assert found.bases
    assert not place_base(arm, [goal], BaseRegion((3.0, 2.0, 0.0), (4.0, 3.0, 0.0))).bases


def test_bad_input_is_refused_by_name(wxai: Robot) -> None:
    region = BaseRegion((0.0, 0.0, 0.0), (0.1, 0.1, 0.0))
    for given, words in (
        ({"poses": []}, "poses"),
        ({"poses": [(0.0, 0.0, 0.0)]}, r"poses\[0\]"),
        ({"region": None}, "region"),
        ({"scene": "bin"}, "scene"),
        ({"clearance": -1.0}, "clearance"),
        ({"room": math.nan}, "room"),
        ({"most_bases": 0}, "most_bases"),
        ({"most_boxes": 0.5}, "most_boxes"),
        ({"robot": load_robot("panda")}, "lock some"),
    ):
        with pytest.raises(InvalidRequest, match=words):
            place_base(**({"robot": wxai, "poses": POSES, "region": region} | given))  # type: ignore[arg-type]
    for lower, upper, yaw, words in (
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0), "upper"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1e3), (0.0, 0.0), "upper"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 7.0), "yaw"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0), "yaw"),
    ):
        with pytest.raises(InvalidRequest, match=words):
            BaseRegion(lower, upper, yaw)
