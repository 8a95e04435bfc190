"""Where a driver's setpoint can be while targets are replaced before they are due, in closed form.

A driver gets a target c every T seconds, and sends its setpoint s straight to it, to be there ``goal_time`` G later.
The next target comes after T, give or take a jitter J: until then the setpoint has covered a share ``u`` of the way,
which lies between ``low = (T - J) / G`` and ``high = (T + J) / G``, both cut to [0, 1].

Let s lie within r of m, in each joint, when a target comes. Then

- on its way s is ``(1 - u) (m + d) + u c`` with abs(d) <= r, so within r of the straight edge from m to c, whatever
  comes after the target, and if nothing does: that edge is also the way to a stop;
- when the next target comes, s is ``m + u (c - m) + (1 - u) d`` with u in [low, high]: within
  ``(1 - low) r + (high - low) / 2 abs(c - m)`` of ``m + (low + high) / 2 (c - m)``.

The arm itself is within ``error`` of where the setpoint is, or was in the last ``lag`` seconds. So the room that it
needs around each edge is r + error.

Towards c the setpoint goes at abs(c - s) / G, so by (abs(c - m) + r) / G at most. To send c once more is never faster:
abs(c - m') + r' is (1 - low) (abs(c - m) + r) with the middle of [low, high] as the share that leads to m'.

If each target comes after T exactly, the setpoint has covered ``due`` = T / G of its way, cut at 1: where low or high
is cut, that is not the middle of the two. Changes of speed are those of that setpoint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only, set_fields
from planner_service.geometry.validation import number, numbers, whole
from planner_service.native.loading import load_core

__all__ = ["Course", "Setpoint", "Tracking", "Whereabouts"]

MAX_ERROR = 0.5
"""Radians (or metres); more is a mistake in the unit."""

LONGEST = 0.2
"""Seconds of a goal time: drivers do not go straight at an even speed to targets that are due later."""

LATEST = 1.0
"""Seconds of a lag or a jitter; more is a mistake in the unit."""

EVEN = 1e-12
"""Of shares: less between two is rounding."""

ROUNDING = 1e-9
"""Radians (or metres) by which an arm that is exactly as far off as it may be can seem to be farther. That moves no
point of an arm by more than a hundredth of what a proof keeps beyond the padding."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """What is assumed of a driver: it goes straight to each target, at an even speed, and the arm follows closely.

    Attributes:
        goal_time: Seconds after which the setpoint is at a target that is not replaced.
        error: Radians (or metres) between the arm and the setpoint at most, of all joints or of each, (n,).
        jitter: Seconds by which the time between two targets may differ from the rate's, or from what a check is told.
        lag: Seconds by which the arm may be late: it is within ``error`` of some place where the setpoint was since.

    Raises:
        InvalidRequest: a goal time outside [1 ms, 0.2 s], a jitter or lag outside [0, 1 s], or an error outside
            [0, 0.5].
    """

    goal_time: float
    error: float | Sequence[float] | FloatArray
    jitter: float = 0.002
    lag: float = 0.0

    def __post_init__(self) -> None:
        goal_time = number("goal_time", self.goal_time, f"seconds in [0.001, {LONGEST:g}]", 0.001, LONGEST)
        jitter, lag = (
            number(name, getattr(self, name), f"seconds in [0, {LATEST:g}]", 0.0, LATEST) for name in ("jitter", "lag")
        )
        expected = f"radians (or metres) in [0, {MAX_ERROR:g}], one number or one for each joint"
        error = numbers("error", self.error, expected)
        if error.ndim > 1 or not np.all((error >= 0.0) & (error <= MAX_ERROR)):
            raise InvalidRequest("error", self.error, expected)
        error_of = read_only(error) if error.ndim else float(error)
        set_fields(self, goal_time=goal_time, jitter=jitter, lag=lag, error=error_of)

    def of(self, joints: int) -> FloatArray:
        """The error of each of so many joints, (n,).

        Raises:
            InvalidRequest: it was given for another number of them, or that is no number of joints.
        """
        whole("joints", joints, 1, 10_000)
        error = np.asarray(self.error, dtype=np.float64)
        if error.ndim and error.shape != (joints,):
            raise InvalidRequest("error", list(error.shape), f"one number, or {joints}")
        return np.broadcast_to(error, (joints,)).copy()

    def shares(self, elapsed: float) -> tuple[float, float, float]:
        """What a setpoint has covered of its way ``elapsed`` seconds after a target came.

        At least, without jitter, and at most.
        """
        low, due, high = ((elapsed + side * self.jitter) / self.goal_time for side in (-1.0, 0.0, 1.0))
        return min(max(low, 0.0), 1.0), min(max(due, 0.0), 1.0), min(max(high, 0.0), 1.0)


@dataclass(frozen=True, eq=False)
class Setpoint:
    """Where the setpoint can be when a target comes: within ``radius`` of ``place`` in each joint.

    Attributes:
        place: Shape (n,).
        radius: Shape (n,), >= 0.
        speed: How fast the setpoint went before, rad/s, (n,); 0 at rest.
        change: What the target before changed in that, rad/s, (n,).
        due: Where it is if all targets so far came in time, (n,); speed and change are of that.
    """

    place: FloatArray
    radius: FloatArray
    speed: FloatArray
    change: FloatArray
    due: FloatArray

    @classmethod
    def at_rest(cls, q: ArrayLike, error: FloatArray) -> Setpoint:
        """Of an arm that stands still, and whose setpoint is within ``error`` (n,) of q (n,)."""
        place = np.array(q, dtype=np.float64)
        return cls(place, error.copy(), np.zeros(len(place)), np.zeros(len(place)), place)

    def after(self, target: FloatArray, shares: tuple[float, float, float], goal_time: float) -> Setpoint:
        """Where it can be when the next target comes."""
        return self.course(target[None], shares, goal_time).at(1)

    def course(self, targets: FloatArray, shares: tuple[float, float, float], goal_time: float) -> Course:
        """Where it can be as each of targets (k, n) comes, and after the last."""
        low, due, high = shares
        aside = self.due is not self.place or abs(0.5 * (low + high) - due) > EVEN
        rows = (self.place, self.radius, self.speed, self.change, self.due, targets)
        return Course(*load_core().setpoints(*map(np.ascontiguousarray, rows), shares, goal_time, aside))

    def ahead(self, target: FloatArray | None, rows: FloatArray, tracking: Tracking, period: float) -> Whereabouts:
        """Where the arm can be until it rests at the last of rows (k, n), or on its way if no more are sent.

        Args:
            target: The last that was sent, (n,); None if there was none.
            rows: Targets, one each period.
            tracking: What is assumed of the driver.
            period: Seconds between targets.
        """
        course = self.course(rows, tracking.shares(period), tracking.goal_time)
        silent = self.place[None], (self.place if target is None else target)[None], self.radius[None]
        sent = course.places[:-1], rows, course.radii[:-1]
        starts, ends, radii = (np.concatenate(each) for each in zip(silent, sent, strict=True))
        return Whereabouts(starts, ends, radii + tracking.of(len(self.place)))


class Course(NamedTuple):
    """Where the setpoint can be as each of k targets comes, and after the last.

    Attributes:
        places: Where about it is each time, (k + 1, n).
        radii: How far from there at most, in each joint, (k + 1, n).
        speeds: How fast it goes to each target, (k, n), if all come in time.
        before: How fast it went before each target, and after the last, (k + 1, n); likewise.
        changes: What the target before each changed in that, (k + 1, n).
        due: Where it is each time, (k + 1, n), if all come in time.
    """

    places: FloatArray
    radii: FloatArray
    speeds: FloatArray
    before: FloatArray
    changes: FloatArray
    due: FloatArray

    def at(self, k: int) -> Setpoint:
        """As target k comes."""
        place, due = self.places[k], self.due[k]
        if self.due is self.places or np.array_equal(place, due):  # and so it stays until a share is cut
            due = place
        return Setpoint(place, self.radii[k], self.before[k], self.changes[k], due)


class Whereabouts(NamedTuple):
    """Where an arm can be: within a room of one of some straight edges.

    Attributes:
        starts: Of each edge, (k, n).
        ends: The same.
        rooms: Radians (or metres) beside each in each joint, (k, n).
    """

    starts: FloatArray
    ends: FloatArray
    rooms: FloatArray

    def holds(self, q: FloatArray) -> bool:
        """Whether q (n,) is there: of an edge, those points are that are near enough in every joint at once.

        Rounding aside: who is exactly as far off as its room is within it.
        """
        ways, off, rooms = self.ends - self.starts, q - self.starts, self.rooms + ROUNDING
        still = ways == 0.0
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # by next to nothing it is infinite
            one, two = (off - rooms) / ways, (off + rooms) / ways
        inside = np.where(np.abs(off) <= rooms, np.inf, -np.inf)
        first = np.where(still, -inside, np.minimum(one, two)).max(axis=1)
        last = np.where(still, inside, np.maximum(one, two)).min(axis=1)
        return bool((np.maximum(first, 0.0) <= np.minimum(last, 1.0)).any())
