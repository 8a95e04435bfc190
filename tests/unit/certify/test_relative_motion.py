"""One frame in another, and how strongly it curves, where that has a closed form."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planner_service.certify.relative_motion import RelativeMotion
from planner_service.geometry.shapes import Pose
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import CRANE, TWINS, built


def test_what_slides_out_on_what_turns_curves_by_both(tmp_path: Path) -> None:
    """Turning at v, at a distance r and sliding at u: v^2 r towards the axis, and 2 v u square to it."""
    crane = built(tmp_path, CRANE)
    base, trolley = (crane.link_frame(name) for name in ("base", "trolley"))
    motion = RelativeMotion(crane, (base[0], Pose()), (trolley[0], Pose()))
    r, v, u = 0.1 + 0.7, 0.5, 3.0
    rates = motion.rates(np.array([[v, u]]), np.zeros((1, 2)), np.array([3.0, 0.7]))
    assert rates.position[0] == pytest.approx(v * v * r + 2.0 * v * u)
    assert (rates.turning[0], rates.orientation[0]) == (v, v * v / 4.0)
    bent = motion.rates(np.zeros((1, 2)), np.array([[2.0, 5.0]]), np.array([3.0, 0.7]))
    assert (bent.position[0], bent.orientation[0]) == (pytest.approx(2.0 * r + 5.0), 1.0)


def test_joints_that_move_both_frames_do_not_count(tmp_path: Path) -> None:
    twins = built(tmp_path, TWINS)
    bodies = [twins.link_frame(name)[0] for name in ("left", "right", "torso")]
    hand = Pose((0.5, 0.0, 0.0))
    motion = RelativeMotion(twins, (bodies[0], hand), (bodies[1], hand))
    assert motion.joints.tolist() == [1, 2]
    a, b = 0.3, -0.8
    q = np.array([[2.0, a, b], [-1.0, a, b]])
    x, y = 0.5 * math.cos(b) - 0.5 * math.cos(a), 0.5 * math.sin(b) - 0.5 * math.sin(a) - 0.4
    expected = (x * math.cos(a) + y * math.sin(a), y * math.cos(a) - x * math.sin(a), 0.0)
    for k in range(2):
        assert motion.positions(q)[:, k] == pytest.approx(expected, abs=1e-15)
        assert abs(2.0 * math.atan2(motion.orientations(q)[3, k], motion.orientations(q)[0, k])) == pytest.approx(1.1)
    nothing = RelativeMotion(twins, (bodies[2], hand), (bodies[2], Pose()))
    assert nothing.positions(q)[0].tolist() == [-0.5, -0.5]
    assert nothing.rates(np.ones((1, 3)), np.ones((1, 3)), np.ones(3)).position[0] == 0.0


def test_an_orientation_is_continuous_over_whole_turns() -> None:
    planar = load_robot("planar2")
    motion = RelativeMotion(planar, (0, Pose()), (planar.tool_body, Pose()))
    x = np.linspace(-9.0, 9.0, 401)
    Q = motion.orientations(np.stack([x, 0.4 * x], axis=1))
    assert np.abs(np.diff(Q, axis=1)).max() < 0.05
    assert np.abs((Q * Q).sum(axis=0) - 1.0).max() < 1e-14
