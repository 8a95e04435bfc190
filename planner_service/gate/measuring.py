"""How a driver tracks, by what it was sent and where the arm was then.

The setpoint is followed through what was sent, for each of many goal times and lags, as ``Tracking`` says it goes; the
pair with which the arm was least far from it is the driver's. A recording shows what happened, not what can happen: the
figures are of the motions that were recorded, at their speeds and loads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.gate.tracking import LONGEST, Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["Log", "Measured", "measured_tracking"]

GOAL_TIMES = 41
"""Goal times that are tried, evenly from half a period to the longest that there may be."""

LAGS = 0.004 * np.arange(51)
"""Seconds."""

AS_GOOD, TINY = 1.02, 1e-6
"""An error for which a shorter lag, or a longer goal time, is taken: so many times the least, and so much more."""

LEAST_ERROR = 1e-4
"""Radians (or metres) that are assumed at least: joints are measured no better."""


@dataclass(frozen=True, eq=False)
class Log:
    """What was sent to a driver that stood still before, and where the arm was.

    Attributes:
        sent: Seconds at which targets were sent, growing, (m,), at least two.
        targets: (m, n).
        times: Seconds at which the arm was measured, growing, (p,), at least one.
        measured: (p, n).

    Raises:
        InvalidRequest: other shapes, times that do not grow, or numbers that are not finite.
    """

    sent: FloatArray
    targets: FloatArray
    times: FloatArray
    measured: FloatArray

    def __post_init__(self) -> None:
        for name, times, rows, least in (
            ("targets", self.sent, self.targets, 2),
            ("measured", self.times, self.measured, 1),
        ):
            if rows.ndim != 2 or times.shape != (len(rows),) or len(rows) < least:
                raise InvalidRequest(name, rows.shape, f"a row for each of at least {least} times, {times.shape}")
            if not (np.isfinite(rows).all() and np.isfinite(times).all() and np.all(np.diff(times) > 0.0)):
                raise InvalidRequest(name, "times or rows", "finite numbers, and times that grow")
        if self.targets.shape[1] != self.measured.shape[1]:
            raise InvalidRequest("measured", self.measured.shape, f"as many joints as targets, {self.targets.shape[1]}")


@dataclass(frozen=True)
class Measured:
    """How a driver tracked.

    Attributes:
        rate: Targets a second, from the median of the times between them.
        goal_time: Seconds.
        lag: Seconds.
        jitter: Seconds by which a time between two targets differed from the period at most.
        errors: The largest distance of each joint from where ``goal_time`` and ``lag`` have it, rad or m, (n,).
        measurements: That were compared.
    """

    rate: float
    goal_time: float
    lag: float
    jitter: float
    errors: tuple[float, ...]
    measurements: int

    def tracking(self, spare: float = 1.0) -> Tracking:
        """What may be assumed of the driver, if it never does worse than so many times what was measured.

        Raises:
            InvalidRequest: more than a ``Tracking`` may assume.
        """
        errors = [max(LEAST_ERROR, spare * each) for each in self.errors]
        return Tracking(self.goal_time, error=errors, jitter=spare * self.jitter, lag=self.lag)


def measured_tracking(logs: Sequence[Log]) -> Measured:
    """How a driver tracked in logs, each of which begins with an arm that stands still.

    Raises:
        InvalidRequest: no log, logs of different robots, or none that goes on for longer than the driver may lag.
    """
    if not logs or len({log.targets.shape[1] for log in logs}) != 1:
        raise InvalidRequest("logs", len(logs), "at least one, all of one robot")
    gaps = np.concatenate([np.diff(log.sent) for log in logs])
    period = float(np.median(gaps))
    shortest = min(period, LONGEST)
    tried = np.sort([*np.linspace(0.5 * shortest, LONGEST, GOAL_TIMES), shortest])
    errors = np.array([_errors(logs, float(goal_time)) for goal_time in tried])  # (goal times, lags, n)
    largest = errors.max(axis=2)
    if not np.isfinite(largest).all():
        raise InvalidRequest(
            "logs", len(logs), f"measurements later than {LAGS[-1] + LONGEST:g} s after the first target"
        )
    lag = int(np.flatnonzero(largest.min(axis=0) <= AS_GOOD * largest.min() + TINY)[0])
    at = int(np.flatnonzero(largest[:, lag] <= AS_GOOD * largest[:, lag].min() + TINY)[-1])
    count = sum(int(np.sum(log.times >= log.sent[0] + LAGS[-1] + LONGEST)) for log in logs)
    jitter = float(np.abs(gaps - period).max())
    return Measured(1.0 / period, float(tried[at]), float(LAGS[lag]), jitter, tuple(errors[at, lag].tolist()), count)


def _errors(logs: Sequence[Log], goal_time: float) -> FloatArray:
    """The largest distance of each joint for each lag, (lags, n); infinite without a measurement."""
    out = np.full((len(LAGS), logs[0].targets.shape[1]), -np.inf)
    for log in logs:
        times, places = _setpoint(log, goal_time)
        late = log.times >= log.sent[0] + LAGS[-1] + LONGEST
        if not late.any():
            continue
        for k, lag in enumerate(LAGS):
            at = log.times[late] - lag
            for joint in range(out.shape[1]):
                off = np.abs(log.measured[late, joint] - np.interp(at, times, places[:, joint]))
                out[k, joint] = max(out[k, joint], float(off.max()))
    return np.where(np.isfinite(out), out, np.inf)


def _setpoint(log: Log, goal_time: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the setpoint's way, with their times."""
    place = log.measured[int(np.searchsorted(log.times, log.sent[0]).clip(0, len(log.times) - 1))]
    times, places = [float(log.sent[0])], [place]
    ends = [*log.sent[1:].tolist(), float(log.sent[-1]) + 2.0 * goal_time]
    for begun, end, target in zip(log.sent.tolist(), ends, log.targets, strict=True):
        if end - begun > goal_time:
            times.append(begun + goal_time)
            places.append(target)
        share = min(1.0, (end - begun) / goal_time)
        place = place + share * (target - place)
        times.append(end)
        places.append(place)
    return np.array(times), np.array(places)
