"""Runs: a jerk-limited law changes speed on blends, too, and keeps all limits by closed bounds."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.path.corner_blend import BLEND_SHARE
from planner_service.path.joint_path import JointPath
from planner_service.timing.laws import SCurve
from planner_service.timing.limit_check import peaks
from planner_service.timing.profiles import speed_profile
from planner_service.timing.segments import path_segments
from tests.unit.timing.test_segments import mixed_limits


def chain(seed: int, corners: int, turn: float) -> JointPath:
    """A polyline of many corners whose blends touch each other."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    directions = np.cumsum(rng.normal(size=(corners + 1, n)) * turn, axis=0) + np.ones(n)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    path = JointPath(np.vstack([np.zeros(n), np.cumsum(directions * rng.uniform(0.1, 0.3, (corners + 1, 1)), axis=0)]))
    widths = np.zeros(corners + 2)
    for k in path.corners:
        room = np.diff(path.knots)[k - 1 : k + 1].min()
        widths[k] = 0.0 if path.turns_back(k) else BLEND_SHARE * room
    return path.with_blends(widths)


@given(seed=st.integers(0, 10_000), corners=st.integers(1, 30), turn=st.floats(1e-3, 0.7))
@settings(max_examples=60, deadline=None)
def test_no_limit_is_exceeded_without_stretching_time(seed: int, corners: int, turn: float) -> None:
    path = chain(seed, corners, turn)
    given_limits = mixed_limits(path, seed)
    trajectory = SCurve().time_path(path, given_limits)
    found = peaks(trajectory, given_limits)
    assert trajectory.dilation == 1.0
    assert max(found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio) <= 1.0 + 1e-9


@given(seed=st.integers(0, 10_000), corners=st.integers(1, 30), turn=st.floats(1e-3, 0.7))
@settings(max_examples=40, deadline=None)
def test_it_is_never_slower_than_with_a_constant_speed_on_each_blend(seed: int, corners: int, turn: float) -> None:
    path = chain(seed, corners, turn)
    given_limits = mixed_limits(path, seed)
    segments = path_segments(path, given_limits, None)
    constant = sum(phase.duration for segment in segments for phase in speed_profile(segment.sections(jerk=True)))
    assert SCurve().time_path(path, given_limits).duration <= constant * (1.0 + 1e-12)
