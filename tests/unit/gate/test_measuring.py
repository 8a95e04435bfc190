"""Measured figures are those of the driver that was recorded."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.gate.measuring import Log, measured_tracking
from planner_service.geometry.arrays import FloatArray

PERIOD = 1.0 / 30.0


def _log(goal_time: float, lag: float, off: float) -> Log:
    """A driver that goes straight to each target in ``goal_time``, stepped every millisecond, for ten seconds."""
    step, count = 0.001, 300
    sent = np.linspace(0.0, PERIOD * (count - 1), count)
    targets = 0.5 * np.stack([1.0 - np.cos(1.3 * sent), np.sin(2.0 * sent) - 2.0 * sent / sent[-1]], axis=1)
    times: FloatArray = np.linspace(0.0, sent[-1] - step, int(sent[-1] / step))
    places = list[FloatArray]()
    place: FloatArray = np.zeros(2)
    begun, start, due = 0.0, place, targets[0]
    k = 0
    for t in times:
        if k + 1 < count and t >= sent[k + 1]:
            k += 1
            begun, start, due = float(t), place, targets[k]
        place = start + min(1.0, (t - begun) / goal_time) * (due - start)
        places.append(place)
    late = round(lag / step)
    delayed: FloatArray = np.array([*[places[0]] * late, *places])[: len(times)]
    delayed[::2] += off
    return Log(np.asarray(sent), targets, np.asarray(times), delayed)


def test_goal_time_lag_and_error_are_those_of_the_driver() -> None:
    found = measured_tracking([_log(goal_time=0.1, lag=0.06, off=0.004)])
    assert found.rate == pytest.approx(30.0)
    assert found.goal_time + found.lag == pytest.approx(0.16, abs=0.01)
    assert 0.004 <= max(found.errors) <= 0.008


def test_assumptions_keep_the_spare_and_the_resolution_of_a_sensor() -> None:
    found = measured_tracking([_log(goal_time=0.1, lag=0.0, off=0.01)])
    assumed = found.tracking(2.0)
    assert np.allclose(assumed.of(2), 2.0 * np.array(found.errors))
    exact = measured_tracking([_log(goal_time=0.1, lag=0.0, off=0.0)]).tracking()
    assert (exact.of(2) > 0.0).all()


def test_a_log_whose_times_do_not_grow_is_refused() -> None:
    rows = np.zeros((3, 2))
    with pytest.raises(InvalidRequest, match="times that grow"):
        Log(np.array([0.0, 1.0, 1.0]), rows, np.array([0.0, 1.0, 2.0]), rows)


def test_a_log_that_ends_before_anything_can_be_compared_is_refused() -> None:
    rows, times = np.zeros((3, 2)), np.array([0.0, 0.01, 0.02])
    log = Log(times, rows, times, rows)
    with pytest.raises(InvalidRequest, match="measurements later than"):
        measured_tracking([log])
