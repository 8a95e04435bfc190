"""Timing along blended corners, and under a limit of ds/dt: limits held, corners passed, in all three laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import JointLimits
from planner_service.timing.laws import SCurve, Timing, TimingFailed, ToppRa, Trapezoidal, stop_duration
from planner_service.timing.limit_check import peaks
from planner_service.timing.profiles import ScalarLimits, Section, TooFast, speed_profile
from tests.reference.times import least_time
from tests.unit.timing.test_laws import HELD, LAWS, WITHIN_GRID, law_cases, limits
from tests.unit.timing.test_limit_check import blended, rounded_corners

closed_forms = pytest.mark.parametrize("law", [Trapezoidal(), SCurve()], ids=lambda law: law.name)


def mixed_limits(path: JointPath, seed: int) -> JointLimits:
    rng = np.random.default_rng(seed)
    return limits(
        path.n, *(10 ** rng.uniform(low, high, path.n) for low, high in ((-0.3, 0.9), (0.0, 1.5), (0.7, 3.0)))
    )


def right_angle(width: float, leg: float = 1.0) -> JointPath:
    return blended([[0.0, 0.0], [leg, 0.0], [leg, leg]], [0.0, width, 0.0])


def highest(trajectory: Trajectory, given_limits: JointLimits, law: Timing) -> float:
    found = peaks(trajectory, given_limits)
    jerk = found.jerk.ratio if isinstance(law, SCurve) else 0.0
    return max(found.velocity.ratio, found.acceleration.ratio, jerk)


# -- every law on blends


@pytest.mark.slow
@law_cases
@settings(deadline=None, max_examples=60, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_every_law_holds_every_limit_on_blends_and_keeps_moving_along_the_path(law: Timing, seed: int) -> None:
    path = rounded_corners(seed)
    given_limits = mixed_limits(path, seed)
    trajectory = law.time_path(path, given_limits)
    assert highest(trajectory, given_limits, law) <= HELD
    t = np.linspace(0.0, trajectory.duration, 2001)
    s = trajectory.s(t)
    assert np.all(np.diff(s) > 0.0)  # no stop on the way: every corner is blended
    assert trajectory(t).tolist() == path(s).tolist()
    assert trajectory(0.0).tolist() == path.waypoints[0].tolist()
    assert trajectory(trajectory.duration).tolist() == path.waypoints[-1].tolist()
    assert not np.any(trajectory([0.0, trajectory.duration], 1))


@law_cases
@settings(deadline=None, max_examples=20, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_no_sample_of_the_joints_breaks_a_limit_on_blends(law: Timing, seed: int) -> None:
    path = rounded_corners(seed)
    given_limits = mixed_limits(path, seed)
    trajectory = law.time_path(path, given_limits)
    t = np.linspace(0.0, trajectory.duration, 20_001)
    q, step = trajectory(t), t[1]
    # by differences of positions alone, which know neither q' nor q''
    assert np.all(np.abs(np.diff(q, axis=0)) / step <= given_limits.velocity * (1 + 1e-6))
    assert np.all(np.abs(np.diff(q, 2, axis=0)) / step**2 <= given_limits.acceleration * (1 + 1e-4))


@law_cases
def test_a_blend_saves_the_time_of_a_stop(law: Timing) -> None:
    path = right_angle(0.3)
    assert law.time_path(path, limits(2)).duration < 0.9 * stop_duration(path, law, limits(2))


# -- closed forms


def test_a_trapezoid_passes_a_blend_at_the_speed_that_acceleration_allows() -> None:
    # both joints turn by 1: 5/8 v^2 / d = a
    trajectory = Trapezoidal().time_path(right_angle(0.2), limits(2, 10.0, 3.0))
    assert trajectory.s(trajectory.duration / 2, 1) == pytest.approx(math.sqrt(3.0 * 0.2 / 0.625), rel=1e-12)
    assert trajectory.s(trajectory.duration / 2, 2) == 0.0


def test_an_s_curve_passes_a_blend_at_the_speed_that_jerk_allows() -> None:
    # 5/2 v^3 / d^2 = j
    trajectory = SCurve().time_path(right_angle(0.2), limits(2, 10.0, 30.0, 20.0))
    assert trajectory.s(trajectory.duration / 2, 1) == pytest.approx((20.0 * 0.04 / 2.5) ** (1 / 3), rel=1e-12)


def test_a_straight_line_is_entered_at_most_as_fast_as_it_can_be_braked() -> None:
    section = Section(0.5, 1.0, ScalarLimits(10.0, 2.0, math.inf), False)
    assert speed_profile([section], 2.0 * (1.0 + 1e-12))[-1] == pytest.approx((1.0, 0.5, 2.0, -2.0, 0.0))
    with pytest.raises(TooFast, match="too fast to slow down in time"):
        speed_profile([section], 2.0 * (1.0 + 1e-6))


def test_a_blend_is_entered_at_most_as_fast_as_it_can_be_passed() -> None:
    sections = [
        Section(0.0, 0.4, ScalarLimits(1.0, math.inf, math.inf), True),
        Section(0.4, 1.0, ScalarLimits(10.0, 2.0, math.inf), False),
    ]
    assert speed_profile(sections, 0.8)[0] == (0.5, 0.0, 0.8, 0.0, 0.0)
    with pytest.raises(TooFast):
        speed_profile(sections, 1.1)


@pytest.mark.parametrize("start", [0.5, 2.5])
def test_what_goes_on_from_a_speed_rests_at_the_corners_ahead_and_holds_the_limits(start: float) -> None:
    path = blended([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0], [2.0, 2.0]], [0.0, 0.3, 0.0, 0.3, 0.0])
    slow = limits(2, 1.57, 1.0)
    phases = np.array(ToppRa().continue_to_rest(path, slow, start, 0.2))
    law = phases[:, 1:] / [1.0, 1.0, 2.0, 6.0]
    trajectory = Trajectory(path, phases[:, 0], law, 1.0, (start, path.length))
    assert trajectory.begin == start
    assert trajectory.s(0.0, 1) == 0.2
    at_rest = law[1:, 0][law[1:, 1] == 0.0]
    assert at_rest == pytest.approx(path.knots[[2]] if start < path.knots[2] else [])
    assert peaks(trajectory, slow).highest < 1.005


def test_a_short_way_to_a_stop_bounds_the_speed_on_a_blend_and_those_before_it() -> None:
    path = blended([[0.0, 0.0], [5.0, 0.0], [5.0, 1.0], [4.75, 1.0]], [0.0, 0.4, 0.2, 0.0])
    trajectory = Trapezoidal().time_path(path, limits(2, 10.0, [0.1, 0.2]))
    slow = math.sqrt(2 * 0.1 * 0.05)
    assert trajectory.coefficients[-2, 1] == pytest.approx(slow, rel=1e-12)
    assert trajectory.coefficients[-4, 1] <= math.sqrt(slow**2 + 2 * 0.2 * 0.4) * (1 + 1e-12)


@closed_forms
@pytest.mark.parametrize("short", [0.0, 1e-9])
def test_a_blend_that_reaches_a_stop_or_nearly_is_a_typed_failure(law: Timing, short: float) -> None:
    path, given_limits = right_angle(1.0 - short), limits(2)
    with pytest.raises(TimingFailed, match="blend that reaches a stop"):
        law.time_path(path, given_limits)


# -- TOPP-RA


@settings(deadline=None, max_examples=12, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_toppra_takes_the_least_time_and_no_law_takes_less(seed: int) -> None:
    rounded = rounded_corners(seed)
    for path in (rounded, rounded.with_blends(None)):
        given_limits = mixed_limits(path, seed)
        least = least_time(path, given_limits)
        for law in LAWS:
            assert law.time_path(path, given_limits).duration >= least * (1 - 1e-3)
        motion = ToppRa().time_path(path, given_limits)
        assert motion.duration / motion.dilation <= least * (1.01 if path is rounded else 1 + WITHIN_GRID)


@settings(deadline=None, max_examples=30, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_toppra_is_never_slower_than_trapezoids(seed: int) -> None:
    path = rounded_corners(seed)
    given_limits = mixed_limits(path, seed)
    quick, slow = ToppRa().time_path(path, given_limits), Trapezoidal().time_path(path, given_limits)
    assert quick.duration / quick.dilation <= slow.duration * (1 + 1e-9)


def test_where_toppra_fails_on_blends_trapezoids_take_over(monkeypatch: pytest.MonkeyPatch) -> None:
    import toppra.algorithm

    def fails(self: object, start: float, end: float) -> tuple[None, None, None]:
        code = toppra.algorithm.algorithm.ParameterizationReturnCode.FailUncontrollable
        self._problem_data.return_code = code  # type: ignore[attr-defined]
        return None, None, None

    monkeypatch.setattr(toppra.algorithm.TOPPRA, "compute_parameterization", fails)
    law, path = ToppRa(backend="toppra"), right_angle(0.3)
    assert law.time_path(path, limits(2)).duration == Trapezoidal().time_path(path, limits(2)).duration


# -- a limit of ds/dt


@law_cases
@settings(deadline=None, max_examples=20, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_a_varying_speed_limit_is_hardly_exceeded_anywhere(law: Timing, seed: int) -> None:
    path = rounded_corners(seed)
    given_limits = mixed_limits(path, seed)

    def varying(s: FloatArray) -> FloatArray:
        return np.asarray(0.3 + 0.1 * np.sin(3.0 * s))

    trajectory = law.time_path(path, given_limits, speed_limit=varying)
    t = np.linspace(0.0, trajectory.duration, 5001)
    share = trajectory.s(t, 1) / varying(trajectory.s(t))
    # between samples 0.05 rad apart it falls by 0.14 %; between TOPP-RA's grid points of up to 0.16 rad by 1.4 %
    assert share.max() <= (1.015 if isinstance(law, ToppRa) else 1.0005)
    assert highest(trajectory, given_limits, law) <= HELD


@law_cases
@pytest.mark.parametrize("value", [0.0, math.nan])
def test_a_speed_limit_that_is_not_positive_is_refused(law: Timing, value: float) -> None:
    path, given_limits = right_angle(0.3), limits(2)
    with pytest.raises(InvalidRequest, match="speed_limit: got"):
        law.time_path(path, given_limits, speed_limit=lambda s: np.where(s > 1.0, value, 1.0))
