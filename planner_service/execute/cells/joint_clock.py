"""The clocks of arms that are driven together: how far each may go, and a stop of all in which none touches another.

An arm's clock reads u: where the motion is that it was commanded last, in seconds of the plan. It runs with the common
time, is late when that goes on without it, and never runs back. Let

- c be the most that an arm can have done: its clock, and its lag, by which commands are ahead;
- m be where it was last seen on its motion, and p where it is.

Lemma. An arm that is on its motion, not before where it was last seen and not beyond its commands, has m <= p <= c. If
no clock goes on to a u from which it cannot stop at c' <= m_j + d, for every other arm j, then p_i - p_j <= d for any
two arms and at any time, also while they stop, whenever each of them begins to, however quickly it does, and if one has
stopped long before. Proof: m_j never falls, so that once c' <= m_j + d holds, it stays so; c_i <= c' for the last u
that was gone on to, because the arm stops there at the latest; hence p_i - p_j <= c_i - m_j <= d.

So every two arms are always at a pair of places that is proven free for a delay of d, and each alone is on its own
proven path. Where a reading is off, so is the place that it stands for. The lemma needs no clock to be read in time,
and no thread to run when it should: an arm that hears nothing of another does not go on.

How far an arm goes while it stops is computed beforehand for each u, within its limits of acceleration. It is a limit,
too: where the stop would go farther by rounding, the arm brakes harder.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import FloatArray
from planner_service.path.trajectory import Trajectory

__all__ = ["Course", "JointClock", "Step"]

FINE = 0.001
"""Seconds of the plan between the rows of a course."""

GRID, MOST = 0.01, 4000
"""Seconds between moments whose stops are computed, and how many there are at most."""

LOOKS, FINEST = 200, 0.002
"""Places among which a reading is looked for: at most so many, and not finer than so many seconds of the plan."""

SAME = 1e-6
"""Radians (or metres) within which a reading matches a place; of several places that match, the last counts."""

RESTING = 1e-9
"""Radians or metres per second below which a joint does not brake an arm."""


class Course:
    """What one arm does, by its own clock.

    Args:
        trajectory: Of all joints of the plan.
        own: The arm's among them; None for all.
        start: Seconds of the plan at which it starts.
        acceleration: What the joints may brake with, (n,).
        rate: Seconds of the plan in one second.
        tick: Seconds between two commands.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        own: Sequence[int] | None,
        start: float,
        acceleration: FloatArray,
        rate: float,
        tick: float,
    ) -> None:
        self.start, self.end, self.rate = start, start + trajectory.duration, rate
        self._acceleration = acceleration
        times = np.linspace(0.0, trajectory.duration, math.ceil(trajectory.duration / FINE) + 2)
        rows = [trajectory(times, order) for order in (0, 1, 2)]
        self._rows = rows if own is None else [each[:, list(own)] for each in rows]
        self._step = float(times[1]) or 1.0
        coarse = np.unique(
            np.rint(np.linspace(0, len(times) - 1, min(MOST, math.ceil(trajectory.duration / GRID) + 2)))
        )
        self._grid = times[coarse.astype(np.intp)] + start
        self._ways = self._braking_ways(self._grid - start, trajectory.duration, tick)

    def at(self, u: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions, and their first and second derivatives by u, at clock readings u, each of shape (..., n).

        Between rows a millisecond apart positions are those of a cubic: off by less than 1/60 of what the acceleration
        jumps by, times 1e-6 s^2.
        """
        t = np.clip((np.asarray(u, dtype=np.float64) - self.start) / self._step, 0.0, len(self._rows[0]) - 1.0)
        k = np.minimum(t.astype(np.intp), len(self._rows[0]) - 2)
        x = (t - k)[..., None]
        q, v, a = self._rows
        y, h = 1.0 - x, self._step
        at = y * y * ((1.0 + 2.0 * x) * q[k] + h * x * v[k]) + x * x * ((1.0 + 2.0 * y) * q[k + 1] - h * y * v[k + 1])
        outside = (np.asarray(u) < self.start) | (np.asarray(u) >= self.end)
        moving = ~outside[..., None]
        return np.asarray(at), (y * v[k] + x * v[k + 1]) * moving, a[k] * moving

    def braking(self, u: FloatArray, rate: FloatArray, seconds: float) -> FloatArray:
        """By how much a clock at u may slow down for so many seconds, 1/s, at most 0, -inf where nothing moves.

        q'' r^2 + q' r' is the acceleration of the joints where the clock runs at r: r' = 0 keeps it within its limits
        if r <= 1. It is looked at where the clock is, and where it would be without braking.
        """
        softest = np.full(u.shape, -math.inf)
        for at in (u, u + rate * seconds):
            _, velocity, acceleration = self.at(at)
            speed = np.abs(velocity)
            moving = speed > RESTING
            room = np.maximum(self._acceleration + np.sign(velocity) * acceleration * (rate**2)[..., None], 0.0)
            slowing = np.where(moving, -room / np.where(moving, speed, 1.0), -math.inf)
            softest = np.maximum(softest, slowing.max(axis=-1))
        return softest

    def way(self, u: float) -> float:
        """Seconds of the plan by which the clock goes on at most if a stop begins at u."""
        if not self.start <= u < self.end:
            return 0.0 if u >= self.end else max(0.0, float(self._ways[0]) - (self.start - u))
        k = int(np.searchsorted(self._grid, u, side="right"))
        return float(self._ways[k - 1 : k + 1].max())

    @property
    def longest_way(self) -> float:
        """The most of these."""
        return float(self._ways.max())

    def seen_at(self, measured: FloatArray, least: float, most: float) -> float:
        """The reading of the clock at which the arm is where it was measured, no sooner than it may be.

        Args:
            least: Where it was seen before.
            most: Where its clock is.
        """
        looks = min(LOOKS, math.ceil((most - least) / FINEST) + 1)
        if looks < 2:
            return least
        if np.abs(self.at(most)[0] - measured).max() <= SAME:
            return max(least, most - FINEST)
        places = np.linspace(least, most, looks)
        off = np.abs(self.at(places)[0] - measured).max(axis=1)
        near = int(np.flatnonzero(off <= off.min() + SAME)[-1])
        return float(places[max(near - 1, 0)])

    def _braking_ways(self, times: FloatArray, end: float, tick: float) -> FloatArray:
        """How far the clock goes on from each of these, at full rate, until it stands."""
        u, rate = times.copy(), np.full_like(times, self.rate)
        while np.any(rate > 0.0):
            slower = np.maximum(rate + self.braking(u + self.start, rate, tick) * tick, 0.0)
            slower[u >= end] = 0.0
            u = u + 0.5 * (rate + slower) * tick
            rate = slower
        return np.minimum(u, end) - times + float(np.diff(times).max(initial=0.0)) + tick * self.rate


class Step(NamedTuple):
    """Where a clock is, how fast it runs, by how much it slows down, and whether all are to stop."""

    u: float
    rate: float
    slowing: float
    stopping: bool


@dataclass(eq=False)
class _Reading:
    """Of one arm: its clock, when that was last moved, how fast it runs, how far it may go, and where it was seen."""

    u: float = 0.0
    t: float = 0.0
    rate: float = 0.0
    limit: float = 0.0
    seen: float = 0.0
    lag: float = 0.0


@dataclass(eq=False)
class JointClock:
    """The clocks of several arms. Its methods may be called from any thread.

    Attributes:
        courses: What the arms do, by their names.
        delay: Seconds of the plan by which any may be late.
        rate: Seconds of the plan in one second.
        stopped: Why all were stopped; empty if they were not.
        behind: The most by which an arm was seen to be behind another's clock, in seconds of the plan.
    """

    courses: Mapping[str, Course]
    delay: float
    rate: float
    lags: Mapping[str, float]
    stopped: str = ""
    behind: float = 0.0
    _readings: dict[str, _Reading] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self._readings = {
            name: _Reading(rate=self.rate, limit=course.way(0.0), lag=self.rate * self.lags[name])
            for name, course in self.courses.items()
        }

    def advance(self, name: str, t: float) -> Step:
        """Where an arm is to be now, t seconds after the common start."""
        with self._lock:
            own, course = self._readings[name], self.courses[name]
            wanted = self.rate * t
            if not self.stopped:
                self._look(name, wanted)
            if not self.stopped:
                own.u, own.t, own.limit = max(own.u, wanted), t, max(own.limit, wanted + course.way(wanted))
                return Step(own.u, own.rate, 0.0, stopping=False)
            since, own.t = max(t - own.t, 0.0), max(t, own.t)
            if own.rate == 0.0 or since == 0.0:
                return Step(own.u, own.rate, 0.0, stopping=True)
            slowing = float(course.braking(np.array(own.u), np.array(own.rate), since))
            rate = max(own.rate + slowing * since, 0.0)
            u = own.u + 0.5 * (own.rate + rate) * since
            if u >= own.limit:
                u, rate = own.limit, 0.0
            slowing = (rate - own.rate) / since
            own.u, own.rate = u, rate
            return Step(u, rate, slowing if rate > 0.0 else 0.0, stopping=True)

    def seen(self, name: str, measured: FloatArray) -> float:
        """Note where an arm is, and return the reading of its clock at which it is to be there."""
        with self._lock:
            own = self._readings[name]
            own.seen = max(own.seen, self.courses[name].seen_at(measured, own.seen, own.u))
            return own.seen

    def through(self, name: str) -> None:
        """An arm stands at the end of its motion, and no other has to wait for it any more."""
        with self._lock:
            self._readings[name].seen = math.inf

    def stop(self, why: str) -> None:
        """Stop all; the first reason counts."""
        with self._lock:
            self.stopped = self.stopped or why

    def _look(self, name: str, wanted: float) -> None:
        """Stop all if an arm that goes on to there could not stop in time for what another is seen to have done."""
        farthest = wanted + self.courses[name].way(wanted) + self._readings[name].lag
        for other, reading in self._readings.items():
            if other == name:
                continue
            self.behind = max(self.behind, wanted - reading.seen)
            if farthest > reading.seen + self.delay:
                late = wanted - reading.seen
                self.stopped = (
                    f"{other} was last seen {late:.3f} s behind {name}, which needs {farthest - wanted:.3f} s to stop "
                    f"(in seconds of the plan, which tolerates {self.delay:.3f})"
                )
                return
