"""No motion is faster than each of its joints alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import planner_service as ps
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.timing.laws import Timing
from planner_service.timing.least_time import least_times, rest_to_rest_times
from planner_service.timing.profiles import s_curve, trapezoid

DRAWS = 1_000_000

KNOTS = 10

ROUNDING = 1e-9
"""Relative: of sums over a few knots."""


def drawn_distances(rng: np.random.Generator, count: int) -> tuple[FloatArray, ...]:
    """Of random motions from rest to rest, acceleration linear between knots: how far, how long, and the largest
    speed, acceleration and jerk."""
    h = 10.0 ** rng.uniform(-3, 1, (count, 1))
    g = (
        rng.uniform(0.9, 1.0, (count, KNOTS))
        * 10.0 ** rng.uniform(-2, 2, (count, 1))
        * rng.choice([-1.0, 0.0, 1.0], (count, KNOTS))
    )
    g[:, 0] = g[:, -1] = 0.0
    bump = rng.uniform(0.1, 1.0, (count, KNOTS))
    bump[:, 0] = bump[:, -1] = 0.0
    g -= bump * (g.sum(1, keepdims=True) / bump.sum(1, keepdims=True))  # so that the speed ends at zero
    one, two = g[:, :-1], g[:, 1:]
    u = np.concatenate((np.zeros((count, 1)), np.cumsum(h * (one + two) / 2.0, axis=1)), axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.nan_to_num(one / (one - two)), 0.0, 1.0)
    inner = u[:, :-1] + h * (share * one + share * share * (two - one) / 2.0)  # where the acceleration is zero
    moved = np.abs((h * u[:, :-1] + h * h * (2.0 * one + two) / 6.0).sum(1))
    speed = np.maximum(np.abs(u).max(1), np.abs(inner).max(1))
    found = moved, h[:, 0] * (KNOTS - 1), speed, np.abs(g).max(1), np.abs((two - one) / h).max(1)
    return tuple(each[speed > 0.0] for each in found)


def test_a_million_random_motions_are_not_faster_than_the_least_time() -> None:
    rng = np.random.default_rng(0)
    nearest = {"with jerk": math.inf, "without": math.inf}
    for _ in range(DRAWS // 100_000):
        moved, seconds, speed, acceleration, jerk = drawn_distances(rng, 100_000)
        for name, third in (("with jerk", jerk), ("without", np.full_like(jerk, math.inf))):
            least = rest_to_rest_times(moved, speed, acceleration, third)
            nearest[name] = min(nearest[name], float((seconds / least).min()))
    assert min(nearest.values()) >= 1.0 - ROUNDING
    assert max(nearest.values()) < 1.3, "some draws come near it"


@pytest.mark.parametrize("jerk", [False, True])
def test_it_is_the_duration_of_the_trapezoid_and_of_the_s_curve(jerk: bool) -> None:
    rng = np.random.default_rng(1)
    for d, v, a, j in 10.0 ** rng.uniform([-4, -1, -1, -1], [2, 1, 1.5, 3], (2000, 4)):
        phases = s_curve(d, v, a, j) if jerk else trapezoid(d, v, a)
        seconds = sum(phase.duration for phase in phases)
        assert float(rest_to_rest_times(np.array(d), v, a, j if jerk else math.inf)) == pytest.approx(
            seconds, rel=1e-12
        )


@pytest.mark.parametrize("timing", [ps.ToppRa(), ps.Trapezoidal(), ps.SCurve(), ps.SCurve(jerk=20.0)])
@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_no_timed_path_is_faster_and_straight_ones_are_hardly_slower(robot: str, timing: Timing) -> None:
    arm, rng = ps.load_robot(robot), np.random.default_rng(2)
    limits = ps.PlanRequest(arm.home, arm.home, timing=timing).pace.limits(arm)
    ratios = []
    for corners in (2, 2, 2, 3, 4, 6):
        Q = rng.uniform(*arm.bounds, (corners, arm.n)) * 0.5
        path = JointPath(Q) if corners == 2 else JointPath(Q, np.array([0.0, *[0.2] * (corners - 2), 0.0]))
        seconds = timing.time_path(path, limits).duration
        least = float(least_times(arm, limits, timing, Q[:1], Q[-1:])[0, 0])
        assert seconds >= least
        ratios.append(seconds / least)
    assert min(ratios) < 1.2


def test_a_joint_that_turns_without_end_goes_the_shorter_way() -> None:
    arm = ps.load_robot("planar2")
    endless = replace(arm, continuous=(True, True))
    Q, P = np.array([[0.0, 0.0]]), np.array([[3.0, 0.0], [2.0 * math.pi - 0.5, 0.0]])
    limits = arm.limits
    near, far = least_times(endless, limits, ps.Trapezoidal(), Q, P)[0]
    assert near == pytest.approx(3.0 + 0.5, rel=1e-8)  # 3 rad at 1 rad/s, and half a second of ramps
    assert far == pytest.approx(2.0 * math.sqrt(0.5 / 2.0), rel=1e-8)


@pytest.mark.parametrize("rows", [[[0.0]], [0.0, 0.0], [[math.nan, 0.0]], "ab", None])
def test_rows_are_of_the_robots_joints(rows: object) -> None:
    arm = ps.load_robot("planar2")
    with pytest.raises(ps.InvalidRequest, match="starts"):
        least_times(arm, arm.limits, ps.Trapezoidal(), rows, [[0.0, 0.0]])
