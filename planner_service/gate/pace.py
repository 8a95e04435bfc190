"""The same line at another speed: slower where a chunk is too fast, and again from rest behind a plan."""

from __future__ import annotations

import math

import numpy as np

from planner_service.gate.limits import CommandLimits
from planner_service.gate.tracking import Setpoint, Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["Pace"]

SLOWER = 6
"""Halvings of the interval in which the largest speed is looked for that keeps the limits."""

SLOWEST = 1.0 / 64.0
"""Share of its speed: what would have to be slower is a jump, and refused."""

SLOWDOWNS = tuple(1.25**k for k in range(20))
"""How many times as long as it would be the rest of a chunk may take behind a plan, tried in turn: up to 70."""

RAMP = 1.5
"""Times the targets that it takes to get to the speed of a chunk if all of the acceleration went into that."""


class Pace:
    """Finds targets along a line that keep the limits.

    Args:
        limits: Those that are kept.
        rate: Targets a second.
        tracking: What is assumed of the driver.
    """

    def __init__(self, limits: CommandLimits, rate: float, tracking: Tracking) -> None:
        self._limits, self._rate = limits, rate
        self._shares, self._goal_time = tracking.shares(1.0 / rate), tracking.goal_time

    def slowed(self, now: Setpoint, begun: FloatArray, wanted: FloatArray) -> tuple[float, FloatArray] | None:
        """A chunk as fast as the limits allow, about: the share of its way that is done, and the targets (k, n).

        None if that is so little that it is no motion but a jump. The speed along its line goes to a share of its own,
        at once or over as many targets as the acceleration needs.

        Args:
            now: Where the setpoint is.
            begun: Where the line of the chunk begins, (n,).
            wanted: The chunk, (k, n).
        """
        line, k = np.concatenate([begun[None], wanted]), len(wanted)
        steps, least = np.diff(line, axis=0), float(np.finfo(np.float64).tiny)
        now_done = float(now.speed @ steps[0]) / self._rate / max(float(steps[0] @ steps[0]), least)
        going = min(max(now_done, 0.0), 1.0)
        needs = self._needed(steps)
        best: tuple[float, FloatArray] | None = None
        for ramp in {1.0, max(1.0, math.ceil(RAMP * needs))}:
            reached, low, high = np.minimum(np.arange(1, k + 1) / ramp, 1.0), 0.0, 1.0
            for _ in range(SLOWER):
                share = 0.5 * (low + high)
                done = np.cumsum(going + (share - going) * reached)
                targets = _along(line, done)
                if not self._kept(now, targets):
                    high = share
                    continue
                low = share
                if done[-1] / k > (SLOWEST if best is None else best[0]):
                    best = float(done[-1]) / k, targets
        return best

    def from_rest(self, place: FloatArray, wanted: FloatArray) -> FloatArray | None:
        """Targets that take an arm at rest at ``place`` (n,) along a line (k, n) to its end, about as fast as the
        limits allow; None if none do."""
        k, line = len(wanted), np.concatenate([place[None], wanted])
        if k == 0:
            return wanted
        rests, needs = Setpoint.at_rest(place, np.zeros(len(place))), self._needed(np.diff(line, axis=0))
        for slower in SLOWDOWNS:
            ramp = max(1.0, math.ceil(RAMP * needs / slower))
            count = math.ceil(slower * k + 0.5 * ramp)
            done = np.cumsum(np.minimum(np.arange(1, count + 1) / ramp, 1.0))
            targets = _along(line, done * (k / done[-1]))
            if self._kept(rests, targets):
                return targets
        return None

    def _kept(self, now: Setpoint, targets: FloatArray) -> bool:
        """Whether targets keep the limits, and what brakes the arm after them, too."""
        course = now.course(targets, self._shares, self._goal_time)
        return self._limits.objection(course, targets) is None and self._limits.may_brake(course.at(len(targets)))

    def _needed(self, steps: FloatArray) -> float:
        """In how many periods an arm at rest may get as fast as steps (k, n) are."""
        return float((np.abs(steps).max(axis=0) * self._rate**2 / self._limits.acceleration).max())


def _along(line: FloatArray, done: FloatArray) -> FloatArray:
    """Points (k, n) of a polyline (k + 1, n) after so many of its pieces, (k,)."""
    k = np.minimum(done.astype(np.intp), len(line) - 2)
    return np.asarray(line[k] + (line[k + 1] - line[k]) * (done - k)[:, None])
