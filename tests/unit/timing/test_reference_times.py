"""Durations, phases and peaks of every law on a few paths, so that no change of a law goes unseen.

The numbers are those of release 0.1.0, except where an S-curve has since changed speed on blends; the laws of the other
files say why they are right.
"""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.timing.laws import SCurve, Timing, ToppRa, Trapezoidal
from planner_service.timing.limit_check import peaks
from tests.unit.timing.test_limit_check import blended, rounded_corners
from tests.unit.timing.test_segments import mixed_limits


def slow_in_the_middle(s: FloatArray) -> FloatArray:
    return 0.2 + (s - 1.0) ** 2


def path_of(seed: int) -> JointPath:
    """Rounded corners; with a stop and a waypoint on a straight line too if the seed is odd."""
    path = rounded_corners(seed)
    if seed % 2 == 0:
        return path
    points = [*path.waypoints.tolist(), *(path.waypoints[-1] + [[0.3], [0.6]] * np.ones(path.n)).tolist()]
    return blended(points, [*path.blends.tolist(), 0.0, 0.0])


CASES: list[tuple[int, Timing, tuple[float, int], tuple[float, int]]] = [
    (1, Trapezoidal(), (6.204715255, 13), (21.00790268, 13)),
    (1, SCurve(), (8.184396358, 24), (21.09447192, 21)),
    (1, SCurve(25.0), (6.968933635, 28), (19.81749697, 24)),
    (1, ToppRa(), (6.106678703, 95), (9.78107517, 114)),
    (2, Trapezoidal(), (8.322068197, 19), (21.99571388, 18)),
    (2, SCurve(), (10.22543035, 34), (23.27244428, 31)),
    (2, ToppRa(), (7.905057553, 142), (10.76055335, 165)),
    (2, ToppRa(10), (8.038466963, 116), (10.76055335, 165)),
    (3, SCurve(), (8.769720589, 32), (13.3587953, 32)),
    (3, SCurve(25.0), (7.382583179, 32), (12.4306336, 32)),
    (3, ToppRa(), (5.632122714, 138), (8.809748421, 138)),
]
"""Seconds and phases, without a limit of speed and with one."""


@pytest.mark.parametrize(("seed", "law", "fast", "slow"), CASES)
def test_each_law_takes_its_time(seed: int, law: Timing, fast: tuple[float, int], slow: tuple[float, int]) -> None:
    path = path_of(seed)
    for speed_limit, (seconds, phases) in ((None, fast), (slow_in_the_middle, slow)):
        trajectory = law.time_path(path, mixed_limits(path, seed), speed_limit=speed_limit)
        assert trajectory.duration == pytest.approx(seconds, rel=1e-7)
        assert len(trajectory.durations) == phases


def test_peaks_are_named_with_joint_and_time() -> None:
    path = path_of(3)
    given_limits = mixed_limits(path, 3)
    found = peaks(SCurve(25.0).time_path(path, given_limits, speed_limit=slow_in_the_middle), given_limits)
    for peak, ratio, joint, time in (
        (found.velocity, 1.0, 1, 7.7748297858),
        (found.acceleration, 0.65737510652, 1, 10.970625096),
        (found.jerk, 3.0300104863, 0, 11.167013707),
    ):
        assert peak.ratio == pytest.approx(ratio, rel=1e-9)
        assert peak.joint == joint
        assert peak.time == pytest.approx(time, rel=1e-9)
