"""Where a setpoint can be: a simulated driver is never anywhere else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.gate import Setpoint, Tracking
from planner_service.geometry.arrays import FloatArray

ROUNDING = 1e-12


Run = tuple[list[FloatArray], list[tuple[FloatArray, FloatArray]]]


def driven(tracking: Tracking, start: FloatArray, targets: FloatArray, period: float, rng: np.random.Generator) -> Run:
    """Setpoints of a driver as each of targets (k, n) comes and after the last; and in between, with its share of the
    way; of many runs at once.
    """
    setpoint, arrivals, between = start, [start], []
    for target in targets:
        wait = period + tracking.jitter * rng.uniform(-1.0, 1.0, (len(start), 1))
        share = np.minimum(wait * rng.uniform(0.0, 3.0, wait.shape) / tracking.goal_time, 1.0)  # or nothing comes
        between.append((setpoint + share * (target - setpoint), share))
        setpoint = setpoint + np.minimum(wait / tracking.goal_time, 1.0) * (target - setpoint)
        arrivals.append(setpoint)
    return arrivals, between


@pytest.mark.parametrize(
    ("rate", "goal_time", "jitter"),
    [(30.0, 0.1, 0.01), (30.0, 0.02, 0.02), (200.0, 0.05, 0.004), (5.0, 0.1, 0.0)],
)
def test_a_setpoint_is_within_its_radius_of_its_edge_whatever_the_latency(
    rate: float, goal_time: float, jitter: float
) -> None:
    tracking, rng, n = Tracking(goal_time, 0.05, jitter), np.random.default_rng(3), 4
    for _ in range(20):
        first, targets = rng.uniform(-1.0, 1.0, n), rng.uniform(-1.0, 1.0, (13, n))
        start = first + tracking.of(n) * rng.uniform(-1.0, 1.0, (1000, n))
        course = Setpoint.at_rest(first, tracking.of(n)).course(targets, tracking.shares(1.0 / rate), goal_time)
        arrivals, between = driven(tracking, start, targets, 1.0 / rate, rng)
        for setpoints, place, radius in zip(arrivals, course.places, course.radii, strict=True):
            assert np.all(np.abs(setpoints - place) <= radius + ROUNDING)
        for k, (setpoints, share) in enumerate(between):
            edge = course.places[k] + share * (targets[k] - course.places[k])
            assert np.all(np.abs(setpoints - edge) <= course.radii[k] + ROUNDING)


def test_a_radius_is_reached() -> None:
    """It is no larger than latency makes it: the extremes of arrival and of the start are met together."""
    tracking = Tracking(goal_time=0.1, error=0.02, jitter=0.01)
    shares = tracking.shares(0.04)
    assert shares == pytest.approx((0.3, 0.4, 0.5))
    found = Setpoint.at_rest([0.0], tracking.of(1)).after(np.array([1.0]), shares, 0.1)
    assert found.place + found.radius >= 0.5 + 0.5 * 0.02 - ROUNDING
    assert found.place - found.radius == pytest.approx(0.3 - 0.7 * 0.02)


def test_where_it_is_due_is_where_targets_that_come_in_time_lead_even_where_the_room_is_not_about_that() -> None:
    tracking, targets = Tracking(goal_time=0.1, error=0.02, jitter=0.1), np.array([[1.0], [1.0], [0.0]])
    course = Setpoint.at_rest([0.0], tracking.of(1)).course(targets, tracking.shares(0.04), 0.1)
    assert course.due[:, 0] == pytest.approx([0.0, 0.4, 0.64, 0.384])
    assert course.places[1, 0] == pytest.approx(0.5)
    assert course.speeds[:, 0] == pytest.approx([10.0, 6.0, -6.4])
    assert course.at(1).course(targets[1:], tracking.shares(0.04), 0.1).due[:, 0] == pytest.approx([0.4, 0.64, 0.384])


def test_a_target_that_is_sent_again_is_never_gone_to_faster() -> None:
    rng = np.random.default_rng(5)
    for _ in range(500):
        tracking = Tracking(float(rng.uniform(0.01, 0.2)), 0.05, float(rng.uniform(0.0, 0.3)))
        target, shares = rng.uniform(-1.0, 1.0, 1), tracking.shares(float(rng.uniform(0.0, 0.4)))
        course = Setpoint.at_rest([0.0], tracking.of(1)).course(np.tile(target, (9, 1)), shares, tracking.goal_time)
        most = np.abs(target - course.places)[:, 0] + course.radii[:, 0]
        assert np.all(np.diff(most) <= ROUNDING)


def test_who_waits_long_enough_is_at_the_target() -> None:
    tracking = Tracking(goal_time=0.1, error=0.02)
    found = Setpoint.at_rest([0.0, 0.0], tracking.of(2)).after(np.array([1.0, 2.0]), tracking.shares(0.2), 0.1)
    np.testing.assert_array_equal(found.place, [1.0, 2.0])
    np.testing.assert_array_equal(found.radius, [0.0, 0.0])


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"goal_time": 0.0, "error": 0.1}, "goal_time"),
        ({"goal_time": 0.1, "error": 1.0}, "error"),
        ({"goal_time": 0.1, "error": float("nan")}, "error"),
        ({"goal_time": 0.1, "error": [[0.1]]}, "error"),
        ({"goal_time": 0.1, "error": 0.1, "jitter": -0.1}, "jitter"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidRequest, match=field):
        Tracking(**arguments)


def test_errors_are_of_all_joints_or_of_each() -> None:
    assert Tracking(0.1, 0.02).of(3).tolist() == [0.02] * 3
    assert Tracking(0.1, [0.01, 0.02]).of(2).tolist() == [0.01, 0.02]
    with pytest.raises(InvalidRequest, match="error"):
        Tracking(0.1, [0.01, 0.02]).of(3)
