"""Peaks on blends: found exactly, next to dense samples of the same trajectory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Peak, Trajectory
from planner_service.timing.laws import within_limits
from planner_service.timing.limit_check import peaks
from planner_service.timing.profiles import s_curve
from tests.unit.timing.test_laws import HELD, limits

ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}


def blended(points: ArrayLike, widths: ArrayLike) -> JointPath:
    return JointPath(np.array(points), np.array(widths))


def rounded_corners(seed: int) -> JointPath:
    """A polyline with blends of random width, none of which reaches a stop."""
    rng = np.random.default_rng(seed)
    shape = int(rng.integers(3, 7)), int(rng.integers(2, 7))
    points = rng.uniform(-1.5, 1.5, shape)
    while any(JointPath(points).turns_back(k) for k in range(1, len(points) - 1)):
        points = rng.uniform(-1.5, 1.5, shape)
    lengths = np.diff(JointPath(points).knots)
    widths = rng.uniform(0.02, 0.45) * np.minimum(lengths[:-1], lengths[1:])
    return blended(points, [0.0, *widths, 0.0])


def s_curve_through(path: JointPath, speed: float, acceleration: float, jerk: float) -> Trajectory:
    """One S-curve from end to end, so that s(t) is a cubic with jerk on blends too, cut where they begin and end."""
    durations: list[float] = []
    coefficients: list[FloatArray] = []
    for phase in s_curve(path.length, speed, acceleration, jerk):
        cubic = np.polynomial.Polynomial([phase.position, phase.speed, phase.acceleration / 2, phase.jerk / 6])
        inside = path.breaks[(path.breaks > phase.position + 1e-9) & (path.breaks < cubic(phase.duration) - 1e-9)]
        cuts = [0.0, *(when(cubic, s, phase.duration) for s in inside), phase.duration]
        starts = [phase.position, *inside]
        for (a, b), s in zip(pairwise(cuts), starts, strict=True):
            shifted = [s, cubic.deriv(1)(a), cubic.deriv(2)(a) / 2, phase.jerk / 6]
            durations.append(b - a)
            coefficients.append(np.array(shifted))
    return Trajectory(path, np.array(durations), np.array(coefficients))


def when(cubic: np.polynomial.Polynomial, s: float, end: float) -> float:
    low, high = 0.0, end
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if cubic(middle) < s else (low, middle)
    return low


def densely(trajectory: Trajectory, limit: FloatArray, order: int) -> float:
    """The largest ratio at 100,000 instants, just before each knot, and at 100,000 more around the best of them."""
    t = np.union1d(np.linspace(0.0, trajectory.duration, 100_000), np.nextafter(trajectory.knots, 0.0))
    best = 0.0
    for _ in range(2):
        ratios = (np.abs(trajectory(t, order)) / limit).max(axis=1)
        best, k = max(best, float(ratios.max())), int(ratios.argmax())
        t = np.linspace(t[max(k - 1, 0)], t[min(k + 1, len(t) - 1)], 100_000)
    return best


@pytest.mark.slow
@pytest.mark.parametrize("kind", ORDERS)
@settings(deadline=None, max_examples=8, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_peaks_on_blends_are_those_of_dense_samples(kind: str, seed: int) -> None:
    path = rounded_corners(seed)
    trajectory = s_curve_through(path, 1.0, 3.0, 20.0)
    rng = np.random.default_rng(seed)
    given_limits = limits(path.n, *10 ** rng.uniform(-0.5, 0.5, (3, path.n)))
    found: Peak = getattr(peaks(trajectory, given_limits), kind)
    sampled = densely(trajectory, getattr(given_limits, kind), ORDERS[kind])
    assert found.ratio == pytest.approx(sampled, rel=1e-9)


def test_peaks_on_blends_name_the_joint_and_the_time() -> None:
    for kind in ORDERS:
        for seed in range(5):
            path = rounded_corners(seed)
            trajectory, given_limits = s_curve_through(path, 1.0, 3.0, 20.0), limits(path.n)
            found: Peak = getattr(peaks(trajectory, given_limits), kind)
            # both sides, since jerk is right-sided where two pieces of time meet
            near = np.clip(found.time + np.array([-1e-10, 0.0, 1e-10]), 0.0, trajectory.duration)
            there = np.abs(trajectory(near, ORDERS[kind])[:, found.joint]).max()
            assert there / getattr(given_limits, kind)[found.joint] == pytest.approx(found.ratio, rel=1e-6)


@settings(deadline=None, max_examples=20, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_a_motion_through_blends_is_slowed_down_until_it_just_holds_its_limits(seed: int) -> None:
    path = rounded_corners(seed)
    given_limits = limits(path.n, 0.3, 0.5, 2.0)
    trajectory, _ = within_limits(s_curve_through(path, 1.0, 3.0, 20.0), given_limits, jerk=True)
    found = peaks(trajectory, given_limits)
    assert trajectory.dilation > 1.0
    assert 1 - 1e-9 <= max(found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio) <= HELD
