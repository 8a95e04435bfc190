"""A driver that goes straight to each target and has it replaced before it is there, simulated on its own.

It knows nothing of the gate: targets, the times between them, where its setpoint begins and how far the arm is from it
give the way of the arm. Between two targets the setpoint goes straight, so its way is a polyline, and so is the arm's
when the distance between them changes evenly from target to target.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner_service.geometry.arrays import FloatArray

__all__ = ["HABITS", "Driver", "Habit"]


@dataclass(frozen=True)
class Habit:
    """How a driver keeps within what is assumed of it.

    Attributes:
        name: What it is called in rows.
        late: Seconds by which each of the times between targets is longer than a period, as a share of the jitter:
            -1 always early, 1 always late, None drawn for each.
        side: Where the arm is, as a share of the error: 1 or -1 in all joints, 0 on the setpoint, None drawn for each
            joint and target, inf drawn once among the corners.
    """

    name: str
    late: float | None
    side: float | None


HABITS = (
    Habit("exact", 0.0, 0.0),
    Habit("early, one corner", -1.0, np.inf),
    Habit("late, one corner", 1.0, np.inf),
    Habit("drawn", None, None),
)
"""What each chunk is followed with; the first is what the others are compared with."""


@dataclass(frozen=True, eq=False)
class Driver:
    """What is assumed of a driver, and where it is.

    Attributes:
        rate: Targets a second.
        goal_time: Seconds after which the setpoint is at a target that is not replaced.
        jitter: Seconds by which the times between targets differ from a period.
        error: Between arm and setpoint at most, (n,).
        setpoint: Where that is, (n,).
        target: The last one, which it is on its way to, (n,).
        ago: Seconds since that came.
    """

    rate: float
    goal_time: float
    jitter: float
    error: FloatArray
    setpoint: FloatArray
    target: FloatArray
    ago: float = 0.0

    def waited(self, seconds: float) -> Driver:
        """After some more time without a target."""
        return replace(self, setpoint=self._at(self.ago + seconds), ago=self.ago + seconds)

    def told(self, target: FloatArray) -> Driver:
        """When another target comes now."""
        return replace(self, target=target, ago=0.0)

    def intervals(self, count: int, late: float | None, rng: np.random.Generator) -> FloatArray:
        """Seconds between that many targets and the ones after them."""
        shares = rng.uniform(-1.0, 1.0, count) if late is None else np.full(count, late)
        return 1.0 / self.rate + self.jitter * shares

    def followed(self, targets: FloatArray, intervals: FloatArray) -> tuple[FloatArray, Driver]:
        """The setpoint as each of targets (k, n) comes and when the next would, (k + 1, n), and the driver then."""
        if not len(targets):
            return self.setpoint[None], self
        place, places = self.setpoint, [self.setpoint]
        for target, seconds in zip(targets, intervals.tolist(), strict=True):
            share = seconds / self.goal_time
            place = target.copy() if share >= 1.0 else place + (target - place) * share
            places.append(place)
        return np.array(places), replace(self, setpoint=place, target=targets[-1], ago=seconds)

    def sides(self, count: int, side: float | None, rng: np.random.Generator) -> FloatArray:
        """Where the arm is beside that many places of the setpoint, (count, n)."""
        n, error = len(self.error), self.error
        if side is None:
            return rng.uniform(-1.0, 1.0, (count, n)) * error
        if np.isinf(side):
            return np.tile(rng.choice((-1.0, 1.0), n) * error, (count, 1))
        return np.tile(side * error, (count, 1))

    def _at(self, elapsed: float) -> FloatArray:
        """The setpoint so many seconds after the last target came: straight on from where it is now."""
        left = self.goal_time - self.ago
        if left <= 0.0 or elapsed >= self.goal_time:
            return self.target.copy()
        return np.asarray(self.setpoint + (self.target - self.setpoint) * ((elapsed - self.ago) / left))
