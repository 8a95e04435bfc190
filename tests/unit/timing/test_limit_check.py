"""Peaks on blends: found exactly, next to dense samples of the same trajectory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Peak, Trajectory
from planner_service.timing.laws import SCurve, within_limits
from planner_service.timing.limit_check import peaks
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


def smooth(path: JointPath) -> Trajectory:
    """Along a path with jerks everywhere, on blends too."""
    return SCurve().time_path(path, limits(path.n, 1.0, 3.0, 20.0))


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
    trajectory = smooth(path)
    rng = np.random.default_rng(seed)
    given_limits = limits(path.n, *10 ** rng.uniform(-0.5, 0.5, (3, path.n)))
    found: Peak = getattr(peaks(trajectory, given_limits), kind)
    sampled = densely(trajectory, getattr(given_limits, kind), ORDERS[kind])
    assert found.ratio == pytest.approx(sampled, rel=1e-9)


@settings(deadline=None, max_examples=20, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_a_motion_through_blends_is_slowed_down_until_it_just_holds_its_limits(seed: int) -> None:
    path = rounded_corners(seed)
    given_limits = limits(path.n, 0.3, 0.5, 2.0)
    trajectory, _ = within_limits(smooth(path), given_limits, jerk=True)
    found = peaks(trajectory, given_limits)
    assert trajectory.dilation > 1.0
    assert 1 - 1e-9 <= max(found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio) <= HELD
