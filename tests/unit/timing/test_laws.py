"""Timing laws: the lesson's numbers, the limits held exactly, and one profile for all joints."""

from __future__ import annotations

import logging
import math
import os
import subprocess
import sys
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

QUARTER = JointPath(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([0.0, 1.0, 0.0]))
"""One blend from stop to stop, on which no constant speed will do."""

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


def test_the_checkpoint_of_0_25_rad_is_a_triangle_of_0_7071_s() -> None:
    trajectory = Trapezoidal().time_path(line(0.25), limits(1, 1.0, 2.0))
    assert trajectory.duration == pytest.approx(math.sqrt(0.5), rel=1e-14)
    assert trajectory(trajectory.duration / 2, 1)[0] == pytest.approx(math.sqrt(0.5), rel=1e-14)


def test_the_triangle_ends_and_the_trapezoid_begins_at_0_493_rad() -> None:
    threshold = 1.57 * 1.57 / 5
    assert len(Trapezoidal().time_path(line(threshold - 1e-6), limits(1)).durations) == 2
    assert len(Trapezoidal().time_path(line(threshold + 1e-6), limits(1)).durations) == 3


@pytest.mark.parametrize(("jerk", "extra"), [(25, 0.185), (50, 0.093), (500, 0.009)])
def test_what_an_s_curve_costs_on_1_2_rad(jerk: float, extra: float) -> None:
    trapezoid = Trapezoidal().time_path(line(1.2), limits(1)).duration
    assert SCurve(jerk).time_path(line(1.2), limits(1)).duration / trapezoid - 1 == pytest.approx(extra, abs=5e-4)


@pytest.mark.parametrize(("jerk", "extra"), [(50, 0.587), (500, 0.051)])
def test_what_an_s_curve_costs_on_0_05_rad(jerk: float, extra: float) -> None:
    assert SCurve(jerk).time_path(line(0.05), limits(1)).duration / 0.2 - 1 == pytest.approx(extra, abs=5e-4)


def test_a_trapezoid_formula_misapplied_to_a_nudge_would_be_slower() -> None:
    assert seconds(Trapezoidal(), 0.05, 1.57, 5.0) < 0.05 / 1.57 + 1.57 / 5


def test_one_profile_for_all_joints_takes_up_to_a_quarter_longer_than_the_slowest_joint_alone() -> None:
    alone = [seconds(Trapezoidal(), 4.0, 1.0, 1e9), seconds(Trapezoidal(), 4.0, 1e9, 1.0)]
    together = Trapezoidal().time_path(line(4.0, 4.0), limits(2, [1.0, 1e9], [1e9, 1.0])).duration
    assert alone == pytest.approx([4.0, 4.0], rel=1e-8)
    assert together == pytest.approx(5.0, rel=1e-12)


# -- S-curve formula, all regimes


@pytest.mark.parametrize(
    ("distance", "v", "a", "j", "expected", "phases"),
    [
        (10.0, 1.0, 2.0, 4.0, 10 / 1 + 1 / 2 + 2 / 4, 5),  # acceleration reached, but for an instant: v j = a^2
        (10.0, 2.0, 2.0, 8.0, 10 / 2 + 2 / 2 + 2 / 8, 7),  # everything reached: D/v + v/a + a/j
        (10.0, 1.0, 9.0, 4.0, 10 / 1 + 2 * math.sqrt(1 / 4), 5),  # speed reached before the acceleration
        (2.0, 9.0, 2.0, 8.0, 0.25 + math.sqrt(0.25**2 + 4 * 2.0 / 2.0), 6),  # acceleration reached, speed not
        (0.01, 9.0, 9.0, 8.0, 4 * (0.01 / 16) ** (1 / 3), 4),  # neither
    ],
)
def test_s_curve_durations(distance: float, v: float, a: float, j: float, expected: float, phases: int) -> None:
    trajectory = SCurve().time_path(line(distance), limits(1, v, a, j))
    assert trajectory.duration == pytest.approx(expected, rel=1e-13)
    assert len(trajectory.durations) == phases


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
@settings(deadline=None, max_examples=300, derandomize=True)
@given(across_scales(-9, 2), across_scales(-3, 2), across_scales(-3, 3), across_scales(-3, 6))
def test_s_curves_are_optimal_and_hold_every_limit(distance: float, v: float, a: float, j: float) -> None:
    given_limits = limits(1, v, a, j)
    trajectory = SCurve().time_path(line(distance), given_limits)
    found = peaks(trajectory, given_limits)
    assert trajectory.duration == pytest.approx(optimal_seconds(distance, v, a, j), rel=1e-9)
    assert max(found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio) <= HELD
    assert found.jerk.ratio == pytest.approx(1.0, rel=1e-9)  # finite: acceleration never jumps


@pytest.mark.slow
@settings(deadline=None, max_examples=300, derandomize=True)
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
@settings(deadline=None, max_examples=20, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_dense_samples_find_no_higher_peak_than_the_roots(law: Timing, seed: int) -> None:
    path, given_limits = mixed_case(seed)
    trajectory = law.time_path(path, given_limits)
    found, t = peaks(trajectory, given_limits), np.linspace(0.0, trajectory.duration, 4001)
    speeds = np.abs(trajectory(t, 1)) / given_limits.velocity
    rates = np.abs(trajectory(t, 2)) / given_limits.acceleration
    assert 0.9 * found.velocity.ratio <= speeds.max() <= found.velocity.ratio * HELD
    assert 0.9 * found.acceleration.ratio <= rates.max() <= found.acceleration.ratio * HELD


@law_cases
def test_a_straight_line_stays_straight_under_mixed_limits(law: Timing) -> None:
    path = JointPath(np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 0.5]]))
    q = law.time_path(path, limits(3, [0.4, 3.0, 1.0], [9.0, 1.0, 3.0], [20.0, 90.0, 5.0])).sample(0.01).q
    assert np.allclose(q, q[:, :1] * [1.0, -2.0, 0.5], rtol=0, atol=1e-15)


@law_cases
def test_the_trajectory_keeps_the_very_path_it_was_given(law: Timing) -> None:
    path, given_limits = mixed_case(3)
    assert law.time_path(path, given_limits).path is path


@law_cases
def test_stops_add_up(law: Timing) -> None:
    path, given_limits = mixed_case(5)
    pieces = [JointPath(path.waypoints[k : k + 2]) for k in range(len(path.waypoints) - 1)]
    total = sum(law.time_path(piece, given_limits).duration for piece in pieces)
    # the whole is stretched by the worst piece's dilation, TOPP-RA's rounding
    assert law.time_path(path, given_limits).duration == pytest.approx(total, rel=1e-6)


@law_cases
def test_waypoints_on_a_straight_line_do_not_stop_the_arm(law: Timing) -> None:
    points = np.linspace(0.0, 1.0, 60)[:, None] * np.array([1.2, -0.7])
    through = law.time_path(JointPath(points), limits(2)).duration
    assert through == pytest.approx(law.time_path(line(1.2, -0.7), limits(2)).duration, rel=1e-9)


@law_cases
def test_turning_back_is_a_stop(law: Timing) -> None:
    there_and_back = JointPath(np.array([[0.0, 0.0], [1.0, 0.5], [0.0, 0.0]]))
    one_way = law.time_path(line(1.0, 0.5), limits(2)).duration
    trajectory = law.time_path(there_and_back, limits(2))
    assert trajectory.duration == pytest.approx(2 * one_way, rel=1e-9)
    assert trajectory(trajectory.duration / 2) == pytest.approx([1.0, 0.5], abs=1e-12)
    assert np.abs(trajectory(trajectory.duration / 2, 1)).max() < 1e-6


@law_cases
def test_a_waypoint_on_top_of_another_costs_nothing(law: Timing) -> None:
    for gap in [0.0, 1e-15, 1e-13, 1e-12]:
        path = JointPath(np.array([[0.0, 0.0], [0.6, 0.0], [0.6, gap], [1.2, 0.0]]))
        straight = law.time_path(line(1.2, 0.0), limits(2)).duration
        assert law.time_path(path, limits(2)).duration == pytest.approx(straight, rel=1e-9)


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
def test_a_straight_line_of_tiny_pieces_is_one_move(law: Timing) -> None:
    # each piece leans by the rounding of its ends, some 1e-8
    start, way = np.array([2.9, -1.3, 0.7]), 1e-5 * np.array([0.48, -0.6, 0.64])
    pieces = JointPath(start + np.linspace(0.0, 1.0, 101)[:, None] * way)
    straight = law.time_path(JointPath(np.array([start, start + way])), limits(3)).duration
    assert law.time_path(pieces, limits(3)).duration == pytest.approx(straight, rel=1e-5)


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
def test_a_very_short_move_takes_a_very_short_time(law: Timing) -> None:
    for distance in [1e-14, 1e-9, 1e-6, 1e-4, 0.99e-3, 1.01e-3]:
        trajectory = law.time_path(line(distance, 0.0), limits(2, jerk=1e12))
        assert trajectory.duration == pytest.approx(2 * math.sqrt(distance / 5), rel=1e-3)
        assert trajectory(trajectory.duration).tolist() == [distance, 0.0]


@law_cases
def test_start_equal_to_goal_takes_no_time(law: Timing) -> None:
    path = JointPath(np.array([[0.3, 0.4], [0.3, 0.4]]))
    trajectory = law.time_path(path, limits(2, velocity=0.0))
    assert trajectory.duration == 0.0
    assert peaks(trajectory, limits(2)).velocity.ratio == 0.0


@law_cases
def test_five_hundred_waypoints_are_timed(law: Timing) -> None:
    points = np.random.default_rng(2).uniform(-2, 2, (500, 6))
    trajectory = law.time_path(JointPath(points), limits(6))
    found = peaks(trajectory, limits(6))
    assert max(found.velocity.ratio, found.acceleration.ratio) <= HELD
    assert trajectory.knots[0] == 0.0


@law_cases
def test_a_robot_s_own_limits_do(law: Timing) -> None:
    rows = (-3.0 * np.ones(2), 3.0 * np.ones(2), 1.57 * np.ones(2), 5.0 * np.ones(2), 50.0 * np.ones(2))
    own = JointLimits(*rows)
    assert law.time_path(line(1.2, 0.4), own).duration == law.time_path(line(1.2, 0.4), limits(2)).duration


def test_an_s_curve_s_own_jerk_replaces_a_robot_s() -> None:
    rows = (-3.0 * np.ones(2), 3.0 * np.ones(2), 1.57 * np.ones(2), 5.0 * np.ones(2), 50.0 * np.ones(2))
    assert SCurve(25.0).time_path(line(1.2, 0.4), JointLimits(*rows)).duration == pytest.approx(1.27833, abs=5e-6)


# -- TOPP-RA


def test_toppra_is_close_to_the_optimum_and_never_faster() -> None:
    for seed in range(20):
        path, given_limits = mixed_case(seed)
        optimum = Trapezoidal().time_path(path, given_limits).duration
        duration = ToppRa().time_path(path, given_limits).duration
        assert optimum * (1 - 1e-9) <= duration <= optimum * (1 + WITHIN_GRID)


@pytest.mark.parametrize("scale", [1e-3, 1e-1, 1e3])
def test_toppra_is_as_close_in_other_units(scale: float) -> None:
    path, given_limits = mixed_case(0)
    scaled = limits(6, given_limits.velocity * scale, given_limits.acceleration * scale * scale)
    duration = ToppRa().time_path(path, scaled).duration
    assert duration * scale == pytest.approx(ToppRa().time_path(path, given_limits).duration, rel=1e-6)


@pytest.mark.slow
def test_a_path_toppra_cannot_time_is_a_typed_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    import toppra.algorithm

    def uncontrollable(self: object, start: float, end: float) -> tuple[None, None, None]:
        code = toppra.algorithm.algorithm.ParameterizationReturnCode.FailUncontrollable
        self._problem_data.return_code = code  # type: ignore[attr-defined]
        return None, None, None

    monkeypatch.setattr(toppra.algorithm.TOPPRA, "compute_parameterization", uncontrollable)
    law, path, given_limits = ToppRa(backend="toppra"), QUARTER, limits(2)
    with pytest.raises(TimingFailed, match=r"no motion from s = 0 at ds/dt = 0 to rest keeps the limits"):
        law.time_path(path, given_limits)


def test_an_overshoot_of_toppra_is_dilated_away(monkeypatch: pytest.MonkeyPatch) -> None:
    import toppra.algorithm

    honest = toppra.algorithm.TOPPRA.compute_parameterization

    def hasty(self: object, start: float, end: float) -> tuple[FloatArray, FloatArray, None]:
        accelerations, speeds, _ = honest(self, start, end)
        return accelerations, speeds * 1.44, None

    law = ToppRa(backend="toppra")
    usual = law.time_path(QUARTER, limits(2))
    monkeypatch.setattr(toppra.algorithm.TOPPRA, "compute_parameterization", hasty)
    trajectory = law.time_path(QUARTER, limits(2))
    assert trajectory.dilation == pytest.approx(1.44 * usual.dilation, rel=1e-9)
    assert trajectory.duration == pytest.approx(usual.duration, rel=1e-9)


def test_toppra_is_not_asked_about_a_straight_line(monkeypatch: pytest.MonkeyPatch) -> None:
    import toppra.algorithm

    monkeypatch.setattr(toppra.algorithm.TOPPRA, "compute_parameterization", None)
    path, given_limits = mixed_case(1)
    law = ToppRa(backend="toppra")
    assert law.time_path(path, given_limits).duration == Trapezoidal().time_path(path, given_limits).duration


@pytest.mark.slow
def test_timing_without_toppra_imports_neither_it_nor_matplotlib() -> None:
    code = (
        "import sys, planner_service.timing.laws; "
        "sys.exit(any(m.split('.')[0] in ('toppra', 'matplotlib', 'scipy') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_toppra_is_silent() -> None:
    ToppRa(backend="toppra").time_path(QUARTER, limits(2))
    assert not logging.getLogger("toppra.algorithm").isEnabledFor(logging.WARNING)


@pytest.mark.slow
def test_importing_toppra_and_matplotlib_prints_nothing_where_no_cache_can_be_written() -> None:
    code = (
        "from tests.unit.timing.test_laws import QUARTER, ToppRa, limits; "
        "ToppRa(backend='toppra').time_path(QUARTER, limits(2))"
    )
    environment = os.environ | {"MPLCONFIGDIR": "/dev/null/none"}
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert (done.stdout, done.stderr) == ("", "")


# -- verification


def hasty(speed: float, acceleration: float) -> Trajectory:
    """A trajectory along joint 0 that reaches the given speed and acceleration."""
    ramp = speed / acceleration
    way = speed * ramp / 2
    c = [[0.0, 0.0, acceleration / 2, 0.0], [way, speed, 0.0, 0.0], [way + speed, speed, -acceleration / 2, 0.0]]
    return Trajectory(line(2 * way + speed), np.array([ramp, 1.0, ramp]), np.array(c))


def test_a_planted_overshoot_of_speed_is_dilated() -> None:
    trajectory, _ = within_limits(hasty(3.14, 1.0), limits(1))
    assert trajectory.dilation == pytest.approx(2.0, rel=1e-12)
    assert peaks(trajectory, limits(1)).velocity.ratio == pytest.approx(1.0, rel=1e-12)


def test_a_planted_overshoot_of_acceleration_is_dilated_by_its_root() -> None:
    trajectory, _ = within_limits(hasty(1.0, 20.0), limits(1))
    assert trajectory.dilation == pytest.approx(2.0, rel=1e-12)
    assert peaks(trajectory, limits(1)).acceleration.ratio == pytest.approx(1.0, rel=1e-12)


def test_a_planted_overshoot_of_jerk_is_dilated_by_its_cube_root() -> None:
    fast = SCurve(400.0).time_path(line(0.01), limits(1))
    trajectory, _ = within_limits(fast, limits(1, jerk=50.0), jerk=True)
    assert trajectory.dilation == pytest.approx(2.0, rel=1e-12)


def test_a_trajectory_within_its_limits_is_left_alone() -> None:
    trajectory = hasty(1.0, 5.0)
    assert within_limits(trajectory, limits(1))[0] is trajectory


def test_a_jump_of_acceleration_cannot_be_dilated_into_a_jerk_limit() -> None:
    trajectory, given_limits = hasty(1.0, 5.0), limits(1)
    with pytest.raises(TimingFailed, match="acceleration of joint 0 jumps at t = "):
        within_limits(trajectory, given_limits, jerk=True)


def test_peaks_name_the_joint_and_the_time() -> None:
    trajectory = SCurve().time_path(line(1.0, -2.0), limits(2, jerk=[50.0, 20.0]))
    found = peaks(trajectory, limits(2, jerk=[50.0, 20.0]))
    assert (found.velocity.joint, found.acceleration.joint, found.jerk.joint) == (1, 1, 1)
    assert abs(trajectory(found.velocity.time, 1)[1]) / 1.57 == pytest.approx(found.velocity.ratio, rel=1e-9)
    assert abs(trajectory(found.acceleration.time, 2)[1]) / 5 == pytest.approx(found.acceleration.ratio, rel=1e-9)


def test_a_speed_peak_inside_a_piece_is_found() -> None:
    trajectory = Trajectory(line(1.0), np.array([1.0]), np.array([[0.0, 0.0, 3.0, -2.0]]))
    found = peaks(trajectory, limits(1))
    assert found.velocity.ratio * 1.57 == pytest.approx(1.5, rel=1e-12)
    assert found.velocity.time == pytest.approx(0.5, rel=1e-12)


# -- bad limits


@law_cases
@pytest.mark.parametrize("name", ["velocity", "acceleration"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_an_unusable_limit_of_a_moving_joint_is_refused(law: Timing, name: str, value: float) -> None:
    path, bad = line(1.0, 0.5), replace(limits(2), **{name: np.array([1.0, value])})
    with pytest.raises(InvalidRequest, match=rf"limits.{name}\[1\]: .*joint 1 moves"):
        law.time_path(path, bad)


def test_an_s_curve_needs_a_jerk_limit() -> None:
    for value in [0.0, -1.0, math.nan, math.inf]:
        path, bad = line(1.0, 0.5), limits(2, jerk=[1.0, value])
        with pytest.raises(InvalidRequest, match=r"limits.jerk\[1\]"):
            SCurve().time_path(path, bad)


@pytest.mark.parametrize("law", [Trapezoidal(), ToppRa(), SCurve(50.0)], ids=lambda law: law.name)
def test_a_law_that_does_not_use_jerk_limits_does_not_ask_for_them(law: Timing) -> None:
    assert law.time_path(line(1.0), limits(1, jerk=math.inf)).duration > 0.0


@law_cases
@pytest.mark.parametrize("value", [0.0, math.inf])
def test_a_joint_that_stands_still_may_have_any_limit(law: Timing, value: float) -> None:
    some = law.time_path(line(1.2, 0.0), limits(2, [1.57, value], [5.0, value], [50.0, value])).duration
    assert some == law.time_path(line(1.2), limits(1)).duration


@law_cases
def test_limits_of_another_robot_are_refused(law: Timing) -> None:
    path, other = line(1.0, 0.5), limits(3)
    with pytest.raises(InvalidRequest, match=r"limits.velocity: got \(3,\); .* path's 2 joints"):
        law.time_path(path, other)


def test_closed_forms_survive_absurd_limits() -> None:
    law: Any
    for law in [Trapezoidal(), SCurve()]:
        for scale in [1e-300, 1e-200, 1e-12, 1e12, 1e200, 1e300]:
            absurd = limits(1, scale, scale, scale)
            found = peaks(law.time_path(line(1.0), absurd), absurd)
            jerk = found.jerk.ratio if isinstance(law, SCurve) else 0.0
            assert max(found.velocity.ratio, found.acceleration.ratio, jerk) == pytest.approx(1.0, rel=1e-9)


def test_limits_too_small_for_toppra_are_a_typed_failure() -> None:
    law, path, absurd = ToppRa(), QUARTER, limits(2, 1e-300, 1e-300)
    with pytest.raises(TimingFailed, match="limits too extreme"):
        law.time_path(path, absurd)


def test_an_impossible_jerk_is_refused() -> None:
    jerk: Any
    for jerk in [0.0, -1.0, math.nan, math.inf, "50", True, 10**400, 1e308, 1e-320]:
        with pytest.raises(InvalidRequest, match="jerk: got"):
            SCurve(jerk)


def test_an_impossible_grid_is_refused() -> None:
    gridpoints: Any
    for gridpoints in [1, 0, -5, 10_001, 2.5, "50", True, 10**400]:
        with pytest.raises(InvalidRequest, match="gridpoints: got"):
            ToppRa(gridpoints)


@law_cases
@pytest.mark.parametrize(("velocity", "acceleration"), [(1e308, 1e308), (1e308, 1.0), (1.0, 1e308)])
def test_limits_too_large_to_compute_with_are_a_typed_failure_or_none(
    law: Timing, velocity: float, acceleration: float
) -> None:
    path, absurd = JointPath(np.array([[0.0, 0.0], [1.0, 2.0]])), limits(2, velocity, acceleration)
    try:
        found = peaks(law.time_path(path, absurd), absurd)
    except TimingFailed:
        return
    assert max(found.velocity.ratio, found.acceleration.ratio) <= HELD


@pytest.mark.parametrize("law", [Trapezoidal(), ToppRa()])
def test_a_law_without_jerk_does_not_mind_how_large_its_limit_is(law: Timing) -> None:
    path = JointPath(np.array([[0.0, 0.0], [1.0, 2.0]]))
    assert law.time_path(path, limits(2, jerk=1e308)).duration == law.time_path(path, limits(2)).duration


@pytest.mark.parametrize("jerk", [1e-6, 1e6])
def test_the_extreme_jerks_that_are_allowed_give_a_motion(jerk: float) -> None:
    path, lim = JointPath(np.array([[0.0, 0.0], [1.0, 2.0], [1.5, 0.0]])), limits(2)
    found = peaks(SCurve(jerk).time_path(path, lim), replace(lim, jerk=np.full(2, jerk)))
    assert max(found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio) <= HELD
