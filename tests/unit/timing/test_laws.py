"""Timing laws: the lesson's numbers, the limits held exactly, and one profile for all joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import JointLimits
from planner_service.timing.laws import SCurve, Timing, TimingFailed, ToppRa, Trapezoidal, within_limits
from planner_service.timing.limit_check import peaks

LAWS: tuple[Timing, ...] = (Trapezoidal(), SCurve(), ToppRa())
HELD = 1.0 + 1e-9
WITHIN_GRID = 1e-3  # TOPP-RA's 50 intervals per segment, denser at its ends: at most 0.06 % above the optimum

law_cases = pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)


@dataclass(frozen=True, eq=False)
class Limits:
    """What a timing law reads of a robot's limits, without the robot's own checks of them."""

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray


def limits(n: int, velocity: ArrayLike = 1.57, acceleration: ArrayLike = 5.0, jerk: ArrayLike = 50.0) -> JointLimits:
    rows = (np.ones(n) * np.asarray(row) for row in (velocity, acceleration, jerk))
    return cast(JointLimits, Limits(*rows))


def line(*distances: float) -> JointPath:
    return JointPath(np.array([np.zeros(len(distances)), distances]))


def seconds(law: Timing, distance: float, v: float, a: float, j: float = math.inf) -> float:
    return law.time_path(line(distance), limits(1, v, a, j)).duration


# -- the lesson's numbers


def test_a_shoulder_move_of_1_2_rad_takes_1_0783_s() -> None:
    trajectory = Trapezoidal().time_path(line(1.2), limits(1))
    assert trajectory.duration == pytest.approx(1.2 / 1.57 + 1.57 / 5, rel=1e-14)
    assert trajectory.duration == pytest.approx(1.0783, abs=5e-5)
    assert np.allclose(trajectory.durations, [0.314, 0.450331, 0.314], rtol=0, atol=5e-7)


def test_a_nudge_of_0_05_rad_is_a_triangle_of_0_2_s_peaking_at_0_5() -> None:
    trajectory = Trapezoidal().time_path(line(0.05), limits(1))
    assert trajectory.duration == pytest.approx(0.2, rel=1e-14)
    assert trajectory(0.1, 1)[0] == pytest.approx(0.5, rel=1e-14)
    assert len(trajectory.durations) == 2


@pytest.mark.parametrize(("jerk", "extra"), [(25, 0.185), (50, 0.093), (500, 0.009)])
def test_what_an_s_curve_costs_on_1_2_rad(jerk: float, extra: float) -> None:
    trapezoid = Trapezoidal().time_path(line(1.2), limits(1)).duration
    assert SCurve(jerk).time_path(line(1.2), limits(1)).duration / trapezoid - 1 == pytest.approx(extra, abs=5e-4)


def test_one_profile_for_all_joints_takes_up_to_a_quarter_longer_than_the_slowest_joint_alone() -> None:
    alone = [seconds(Trapezoidal(), 4.0, 1.0, 1e9), seconds(Trapezoidal(), 4.0, 1e9, 1.0)]
    together = Trapezoidal().time_path(line(4.0, 4.0), limits(2, [1.0, 1e9], [1e9, 1.0])).duration
    assert alone == pytest.approx([4.0, 4.0], rel=1e-8)
    assert together == pytest.approx(5.0, rel=1e-12)


# -- S-curve formula, all regimes


def ramp_seconds(speed: float, a: float, j: float) -> float:
    return speed / a + a / j if speed * j >= a * a else 2 * math.sqrt(speed / j)


def optimal_seconds(distance: float, v: float, a: float, j: float) -> float:
    """Found another way: bisect for the highest peak speed whose two ramps fit into the distance."""
    low, high = 0.0, v
    if v * ramp_seconds(v, a, j) > distance:
        for _ in range(200):
            middle = (low + high) / 2
            low, high = (low, middle) if middle * ramp_seconds(middle, a, j) > distance else (middle, high)
    return distance / high + ramp_seconds(high, a, j)


def across_scales(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


@pytest.mark.slow
@settings(deadline=None, max_examples=100, derandomize=True)
@given(across_scales(-9, 2), across_scales(-3, 2), across_scales(-3, 3), across_scales(-3, 6))
def test_s_curves_are_optimal_and_hold_every_limit(distance: float, v: float, a: float, j: float) -> None:
    given_limits = limits(1, v, a, j)
    trajectory = SCurve().time_path(line(distance), given_limits)
    found = peaks(trajectory, given_limits)
    assert trajectory.duration == pytest.approx(optimal_seconds(distance, v, a, j), rel=1e-9)
    assert max(found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio) <= HELD
    assert found.jerk.ratio == pytest.approx(1.0, rel=1e-9)  # finite: acceleration never jumps


@pytest.mark.slow
@settings(deadline=None, max_examples=100, derandomize=True)
@given(across_scales(-9, 2), across_scales(-3, 2), across_scales(-3, 3))
def test_trapezoids_are_optimal_and_hold_every_limit(distance: float, v: float, a: float) -> None:
    given_limits = limits(1, v, a)
    trajectory = Trapezoidal().time_path(line(distance), given_limits)
    found = peaks(trajectory, given_limits)
    expected = distance / v + v / a if distance >= v * v / a else 2 * math.sqrt(distance / a)
    assert trajectory.duration == pytest.approx(expected, rel=1e-12)
    assert max(found.velocity.ratio, found.acceleration.ratio) == pytest.approx(1.0, rel=1e-9)
    assert found.jerk.ratio == math.inf


# -- every law, several joints


def mixed_case(seed: int) -> tuple[JointPath, JointLimits]:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2, 2, (int(rng.integers(2, 6)), 6))
    rows = (10 ** rng.uniform(low, high, 6) for low, high in ((-0.3, 0.9), (0.0, 2.0), (1.0, 3.0)))
    return JointPath(points), limits(6, *rows)


@law_cases
@settings(deadline=None, max_examples=40, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_every_law_holds_mixed_limits_and_goes_from_rest_to_rest(law: Timing, seed: int) -> None:
    path, given_limits = mixed_case(seed)
    trajectory = law.time_path(path, given_limits)
    found = peaks(trajectory, given_limits)
    assert max(found.velocity.ratio, found.acceleration.ratio) <= HELD
    assert trajectory(0.0).tolist() == path.waypoints[0].tolist()
    assert trajectory(trajectory.duration).tolist() == path.waypoints[-1].tolist()
    assert not np.any(trajectory([0.0, trajectory.duration], 1))


@law_cases
def test_a_waypoint_next_to_another_on_a_straight_line_costs_nothing(law: Timing) -> None:
    for gap in [1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3]:
        for share in [0.0, 0.37, 1.0]:
            # along a skew direction, so that the short piece's direction is made of rounding
            start, way = np.array([2.9, -1.3, 0.7]), 1.2 * np.array([0.48, -0.6, 0.64])
            at = np.array([0.0, share * (1.2 - gap), share * (1.2 - gap) + gap, 1.2]) / 1.2
            straight = law.time_path(JointPath(np.array([start, start + way])), limits(3)).duration
            trajectory = law.time_path(JointPath(start + at[:, None] * way), limits(3))
            assert trajectory.duration == pytest.approx(straight, rel=5e-3)


@law_cases
def test_a_waypoint_next_to_another_costs_its_two_stops(law: Timing) -> None:
    for gap in [1e-11, 1e-9, 1e-6, 1e-4, 1e-3]:
        path = JointPath(np.array([[0.0, 0.0], [0.6, 0.0], [0.6, gap], [1.2, 0.0]]))
        alone = sum(law.time_path(line(d), limits(1)).duration for d in (0.6, gap, 0.6))
        trajectory = law.time_path(path, limits(2))
        found = peaks(trajectory, limits(2))
        assert trajectory.duration == pytest.approx(alone, rel=1e-5)  # the last piece leans by the gap
        assert max(found.velocity.ratio, found.acceleration.ratio) <= HELD


@law_cases
def test_start_equal_to_goal_takes_no_time(law: Timing) -> None:
    path = JointPath(np.array([[0.3, 0.4], [0.3, 0.4]]))
    trajectory = law.time_path(path, limits(2, velocity=0.0))
    assert trajectory.duration == 0.0
    assert peaks(trajectory, limits(2)).velocity.ratio == 0.0


# -- verification


def hasty(speed: float, acceleration: float) -> Trajectory:
    """A trajectory along joint 0 that reaches the given speed and acceleration."""
    ramp = speed / acceleration
    way = speed * ramp / 2
    c = [[0.0, 0.0, acceleration / 2, 0.0], [way, speed, 0.0, 0.0], [way + speed, speed, -acceleration / 2, 0.0]]
    return Trajectory(line(2 * way + speed), np.array([ramp, 1.0, ramp]), np.array(c))


def test_a_trajectory_within_its_limits_is_left_alone() -> None:
    trajectory = hasty(1.0, 5.0)
    assert within_limits(trajectory, limits(1))[0] is trajectory


def test_a_jump_of_acceleration_cannot_be_dilated_into_a_jerk_limit() -> None:
    trajectory, given_limits = hasty(1.0, 5.0), limits(1)
    with pytest.raises(TimingFailed, match="acceleration of joint 0 jumps at t = "):
        within_limits(trajectory, given_limits, jerk=True)


# -- bad limits


@law_cases
@pytest.mark.parametrize("name", ["velocity", "acceleration"])
@pytest.mark.parametrize("value", [0.0, math.nan, math.inf])
def test_an_unusable_limit_of_a_moving_joint_is_refused(law: Timing, name: str, value: float) -> None:
    path, bad = line(1.0, 0.5), replace(limits(2), **{name: np.array([1.0, value])})
    with pytest.raises(InvalidRequest, match=rf"limits.{name}\[1\]: .*joint 1 moves"):
        law.time_path(path, bad)


def test_an_s_curve_needs_a_jerk_limit() -> None:
    for value in [0.0, -1.0, math.nan, math.inf]:
        path, bad = line(1.0, 0.5), limits(2, jerk=[1.0, value])
        with pytest.raises(InvalidRequest, match=r"limits.jerk\[1\]"):
            SCurve().time_path(path, bad)


@law_cases
@pytest.mark.parametrize("value", [0.0, math.inf])
def test_a_joint_that_stands_still_may_have_any_limit(law: Timing, value: float) -> None:
    some = law.time_path(line(1.2, 0.0), limits(2, [1.57, value], [5.0, value], [50.0, value])).duration
    assert some == law.time_path(line(1.2), limits(1)).duration


def test_an_impossible_jerk_is_refused() -> None:
    jerk: Any
    for jerk in [0.0, -1.0, math.nan, math.inf, "50", True, 10**400, 1e308, 1e-320]:
        with pytest.raises(InvalidRequest, match="jerk: got"):
            SCurve(jerk)


@law_cases
@pytest.mark.parametrize(("velocity", "acceleration"), [(1e308, 1e308), (1.0, 1e308)])
def test_limits_too_large_to_compute_with_are_a_typed_failure_or_none(
    law: Timing, velocity: float, acceleration: float
) -> None:
    path, absurd = JointPath(np.array([[0.0, 0.0], [1.0, 2.0]])), limits(2, velocity, acceleration)
    try:
        found = peaks(law.time_path(path, absurd), absurd)
    except TimingFailed:
        return
    assert max(found.velocity.ratio, found.acceleration.ratio) <= HELD
