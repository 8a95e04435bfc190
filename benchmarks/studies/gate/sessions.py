"""An arm behind the gate, whatever is asked of it: each verdict is followed by simulated drivers, and judged by Coal.

What is judged of a verdict is its targets, its stop behind them, and that nothing more is sent after any of them; with
the driver exactly on time and the arm on the setpoint, and as badly as is assumed: always early, always late, drawn;
the arm at a corner of its error, and at the corner that is nearest to contact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from benchmarks.studies.gate.driver import HABITS, Driver, Habit
from benchmarks.studies.gate.judge import Corners
from benchmarks.studies.gate.worlds import World
from planner_service.gate import ActionGate, Verdict
from planner_service.geometry.arrays import FloatArray

__all__ = ["Session", "Tally", "Touched"]

LATE_CHECKS = 0.3
"""Share of the checks that are not a period after the last target was sent."""

TRAIL = 400
"""Places of the setpoint that are kept."""

NEARBY = 3.0
"""Times what the error moves any point: where contact is nearer, the corner of the error towards it is tried."""

SPEED_SLACK = 1e-9
"""Rounding of a speed."""


@dataclass(frozen=True)
class Touched:
    """An accepted motion that touches.

    Attributes:
        what: The pair, as ``a x b``.
        how: Of which driver.
        at: The configuration.
    """

    what: str
    how: str
    at: tuple[float, ...]


@dataclass(eq=False)
class Tally:
    """What came of checks."""

    chunks: int = 0
    targets: int = 0
    passed: int = 0
    slowed: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    ways: int = 0
    touched: list[Touched] = field(default_factory=list)
    unproven: int = 0
    unbegun: int = 0
    fast: int = 0
    outside: int = 0
    least: float = np.inf

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Tally:
        """Of a row that was kept."""
        touched = [Touched(each["what"], each["how"], tuple(each["at"])) for each in row["touched"]]
        counts = {each.name: row.get(each.name, 0) for each in fields(cls) if each.name not in ("touched", "least")}
        return cls(**counts, touched=touched, least=row["least_gap"])

    def join(self, other: Tally) -> None:
        """Count what another one counted."""
        for name in (each.name for each in fields(self) if each.name not in ("refused", "least")):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for kind, count in other.refused.items():
            self.refused[kind] = self.refused.get(kind, 0) + count
        self.least = min(self.least, other.least)

    def add(self, wanted: int, verdict: Verdict) -> None:
        """Count a verdict on so many targets."""
        self.chunks += 1
        self.targets += wanted
        self.passed += verdict.accepted
        self.slowed += verdict.speed < 1.0
        self.unproven += not verdict.proven
        if verdict.refused is not None:
            kind = verdict.refused.kind.value
            self.refused[kind] = self.refused.get(kind, 0) + 1


class Session:
    """Checks one after the other, with the driver that they move.

    Args:
        real: The driver as it is, where it differs from what is assumed of it; as assumed if None.
    """

    def __init__(self, world: World, rng: np.random.Generator, tally: Tally, real: Driver | None = None) -> None:
        self.world, self.rng, self.tally = world, rng, tally
        self.gate: ActionGate = world.gate()
        self.driver = world.driver(world.start) if real is None else real
        self.habit = HABITS[int(rng.integers(1, len(HABITS)))]
        self.lag = world.tracking.lag * float(rng.random())
        self.clock = 0.0
        self._trail = [(-1.0, self.driver.setpoint), (0.0, self.driver.setpoint)]
        self._side = self.driver.sides(1, self.habit.side, rng)[0]
        self._sent: tuple[int | None, float | None] = (None, None)

    @property
    def measured(self) -> FloatArray:
        """Where the arm is, (n,)."""
        times, places = zip(*self._trail, strict=True)
        then = self.clock - self.lag
        place = [np.interp(then, times, column) for column in np.array(places).T]
        return np.asarray(np.array(place) + self._side)

    def check(self, chunk: FloatArray, *, judged: bool = True) -> Verdict:
        """What passes of targets; it is judged, and some of it is sent."""
        sent, elapsed = self._sent
        verdict = self.gate.check(self.measured, chunk, sent=sent, elapsed=elapsed)
        self.tally.add(len(chunk), verdict)
        if judged and verdict.proven:
            self._judge(verdict)
        self._send(verdict)
        return verdict

    def moved(self, world: World) -> Verdict:
        """What is left of the last verdict in a scene that has changed; it is judged, and some of it is sent."""
        sent, elapsed = self._sent
        self.world = world
        verdict = self.gate.update(world.service.scene, sent=sent, elapsed=elapsed)
        self.tally.add(0, verdict)
        if verdict.proven and len(verdict.rows):
            self._judge(verdict)
        self._send(verdict)
        return verdict

    def _send(self, verdict: Verdict) -> None:
        """Some rows, the last of which may be long ago when the next are asked for."""
        rows, rng, period = verdict.rows, self.rng, 1.0 / self.world.rate
        passing = verdict.accepted or min(1, len(rows))
        if passing == 0:
            return
        count = passing if rng.random() < 0.5 else int(rng.integers(1, passing + 1))
        intervals = self.driver.intervals(count, self.habit.late, rng)
        said = None if count == passing and rng.random() < 0.5 else count
        elapsed = None
        if rng.random() < LATE_CHECKS:
            elapsed = float(rng.uniform(0.3, 4.0)) * period
            intervals[-1] = max(0.0, intervals[-1] + elapsed - period)
        places, self.driver = self.driver.followed(rows[:count], intervals)
        times = self.clock + np.cumsum(intervals)
        for row, place, begun, seconds in zip(rows, places[1:], times - intervals, intervals, strict=False):
            if seconds > self.driver.goal_time:
                self._trail.append((float(begun) + self.driver.goal_time, row))
            self._trail.append((float(begun + seconds), place))
        self.clock = float(times[-1])
        self._trail = [*self._trail[-TRAIL:]]
        self._side = self.driver.sides(1, None, rng)[0] if self.habit.side is None else self._side
        self._sent = (said, elapsed)

    def _judge(self, verdict: Verdict) -> None:
        """Follow a verdict with every driver; what touches goes into the tally."""
        rows, judge, tally, driver = verdict.rows, self.world.judge, self.tally, self.driver
        limits = self.world.service.robot.limits
        tally.outside += bool(((verdict.targets > limits.upper) | (verdict.targets < limits.lower)).any())
        ways = [_Way(driver, rows, habit, self.rng) for habit in HABITS]
        corners, judge.nearest = judge.corners(ways[0].points), (np.inf, np.empty(0))
        hit = self._first(ways, corners)
        if hit is None and judge.nearest[0] <= NEARBY * float(judge.reach @ driver.error):
            towards = -np.sign(judge.slope(judge.nearest[1])) * driver.error
            habits = (Habit("early, towards contact", -1.0, 0.0), Habit("late, towards contact", 1.0, 0.0))
            more = [_Way(driver, rows, habit, self.rng, towards) for habit in habits]
            ways, hit = [*ways, *more], self._first(more, corners)
        tally.ways += len(ways)
        tally.fast += sum(way.too_fast(limits.velocity) for way in ways)
        tally.least = min(tally.least, judge.nearest[0])
        if hit is not None:
            tally.touched.append(hit)

    def _first(self, ways: Sequence[_Way], corners: Corners) -> Touched | None:
        """What touches on some ways beside one."""
        m = len(corners.places) - 1
        near = np.stack([np.arange(m), np.arange(m) + 1], axis=1)
        ends = np.repeat(np.arange(1, m), 2).reshape(m - 1, 2)
        a = np.concatenate([part for way in ways for part in (way.points[:-1], way.points[1:-1])])
        b = np.concatenate([part for way in ways for part in (way.points[1:], way.silent)])
        hit = self.world.judge.touched(a, b, corners, np.tile(np.concatenate([near, ends]), (len(ways), 1)))
        if hit is None:
            return None
        return Touched(hit.what, HABITS[0].name if hit.line < 0 else ways[hit.line // (2 * m - 1)].name, hit.at)


class _Way:
    """The arm's way along rows (k, n): places as each comes and when the next would, and at rest, (k + 2, n)."""

    def __init__(
        self,
        driver: Driver,
        rows: FloatArray,
        habit: Habit,
        rng: np.random.Generator,
        towards: FloatArray | None = None,
    ) -> None:
        self.name = habit.name
        places, _ = driver.followed(rows, driver.intervals(len(rows), habit.late, rng))
        sides = driver.sides(len(rows) + 2, habit.side, rng)
        if towards is not None:
            sides = np.tile(towards, (len(sides), 1))
        self._speeds = np.abs(rows - places[:-1]) / driver.goal_time
        self.points = np.concatenate([places, rows[-1:]]) + sides
        self.silent = rows + sides[1:-1]

    def too_fast(self, limits: FloatArray) -> bool:
        """Whether the setpoint ever is faster than the joints' limits, (n,)."""
        return bool((self._speeds > limits * (1.0 + SPEED_SLACK)).any())
