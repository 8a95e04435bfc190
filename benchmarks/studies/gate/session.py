"""A day with the simulated arm: connect, episodes of a scripted leader, resets, disconnect; with the gate and without.

All goes by the time of the simulation, so a machine that gives it little makes the day longer. Where this process gets
no time, the arm gets no commands, and the gate ends the day since it does not follow: the day is then begun again.

Without it the arm is moved as the vendor's package moves it: to fixed poses in two seconds from wherever it is, and
straight to whatever the leader says.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np

import planner_service as ps
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from planner_service.execute import ExecutionStopped, GatedArm, SimulatedArm, TargetStream
from planner_service.gate import ActionGate, TargetFilter, Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

EPISODES = 10
SECONDS, WAITS, RATE = 6.0, 1.5, 30.0
"""Of an episode, of which the leader waits at first, and targets a second."""

SCENE = "shelf"

GOAL_TIME, RESET = 0.1, 2.0
"""Seconds after which the leader's targets are due, and fixed poses without the gate."""

ERROR = (0.02, 0.02, 0.02, 0.03, 0.05, 0.06)
"""Radians by which the simulated arm is off its setpoint: its controller knows no speeds."""

LAG, JITTER = 0.1, 0.01
"""Seconds."""

STAGED = (0.0, np.pi / 3.0, np.pi / 6.0, np.pi / 5.0, 0.0, 0.0)
"""Where the vendor's package sends the arm first."""

AROUND = 0.8
"""Radians around the staged place where a leader goes; a third of that to begin with."""


DAYS, BEAT, LATE = 4, 0.004, 0.02
"""Days that are begun at most, seconds between two looks at the clock, and those by which this process may be late."""

RESTED = 1.5
"""Seconds after which an arm whose stream was stopped is at rest."""


def run(queries: int | None, seed: int, robot: str | None, _: Kept = NONE) -> Report:
    """The same leader twice."""
    episodes = EPISODES if queries is None else queries
    ended = list[Row]()
    while (gated := _day(episodes, seed, gated=True))["lost"] and gated["late"] > LATE and len(ended) + 1 < DAYS:
        ended.append(gated)
    gated |= {"begun_again": len(ended), "contacts": gated["contacts"] + sum(row["contacts"] for row in ended)}
    bare = _day(episodes, seed, gated=False)
    rows = [gated, bare]
    lines = [
        {
            "session": "with the gate" if row["gated"] else "without",
            "episodes": row["episodes"],
            "targets": f"{row['targets']:,}",
            "changed or refused": f"{row['changed']:,}",
            "travel, rad": f"{row['travel']:.1f}",
            "not proven": row["unproven"],
            "episodes with contact": row["touching_episodes"],
            "contacts": row["contacts"],
        }
        for row in rows
    ]
    promises = (
        Promise(
            "a session behind the gate: 0 moves that are not proven", str(gated["unproven"]), not gated["unproven"]
        ),
        Promise("and 0 contacts", f"{gated['contacts']}, {gated['travel']:.1f} rad", not gated["contacts"]),
        Promise("the same leader without it touches something", f"{bare['contacts']} contacts", bare["contacts"] > 0),
    )
    caption = f"{SECONDS:g} s each at {RATE:g} Hz in {SCENE}; a leader that jumps, jerks and goes through things."
    return Report("gate", tuple(rows), (table_of("A session in simulation", lines, caption=caption),), promises)


def leader(rng: np.random.Generator, robot: ps.Robot) -> Callable[[float], FloatArray]:
    """Joint values (n,) by the time: between places around the staged one, with a jump and now and then a jerk."""
    lower, upper = robot.bounds
    places = np.array(STAGED) + rng.uniform(-AROUND, AROUND, (4, robot.n)) * np.array([[0.3], [1.0], [1.0], [1.0]])
    jumps, shaken = rng.uniform(0.0, 0.3, robot.n), float(rng.choice((0.0, 0.0, 0.05)))

    def wanted(t: float) -> FloatArray:
        s = 3.0 * max(0.0, t - WAITS) / (SECONDS - WAITS)
        k = min(int(s), 2)
        u = 0.5 - 0.5 * np.cos(np.pi * min(s - k, 1.0))
        q = places[k] + u * (places[k + 1] - places[k]) + shaken * np.sin(40.0 * max(0.0, t - WAITS)) * np.ones(robot.n)
        return np.asarray(np.clip(q + (jumps if 3.0 < t < 3.2 else 0.0), lower, upper))

    return wanted


def _day(episodes: int, seed: int, *, gated: bool) -> Row:
    robot, scene, rng = ps.load_robot("wxai"), ps.load_scene(SCENE), np.random.default_rng(seed)
    counts: dict[str, float] = {"targets": 0, "changed": 0, "unproven": 0, "travel": 0.0, "touching_episodes": 0}
    with SimulatedArm(robot, scene, robot.home) as arm, _beating() as late:
        driver = arm.connect()
        try:
            follow = _Gated(robot, scene, driver, arm) if gated else _Bare(driver, arm)
            follow.to(np.array(STAGED))
            for _ in range(episodes):
                before = len(arm.contacts())
                _episode(follow, leader(rng, robot), counts, arm)
                follow.to(np.array(STAGED))
                counts["touching_episodes"] += len(arm.contacts()) > before
                if follow.lost:
                    break
            follow.to(np.array(robot.home))
            follow.close()
            contacts = arm.contacts()
        finally:
            driver.close()
    told = [str(contact) for contact in contacts]
    return {
        "part": "session",
        "gated": gated,
        "episodes": episodes,
        **counts,
        "contacts": len(told),
        "touched": told,
        "lost": follow.lost,
        "late": max(late),
        "decided": dict(follow.refused),
    }


@contextlib.contextmanager
def _beating() -> Iterator[list[float]]:
    """A list that gets the seconds by which this process runs late, at each beat."""
    late, ended = [0.0], threading.Event()

    def beat() -> None:
        last = time.perf_counter()
        while not ended.wait(BEAT):
            now = time.perf_counter()
            late.append(now - last - BEAT)
            last = now

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield late
    finally:
        ended.set()
        thread.join()


def _wait(arm: SimulatedArm, until: float) -> None:
    """Until the simulation is there."""
    while (left := until - arm.time()) > 0.0:
        time.sleep(left)


def _episode(
    follow: _Gated | _Bare, wanted: Callable[[float], FloatArray], counts: dict[str, float], arm: SimulatedArm
) -> None:
    began, last = arm.time(), wanted(0.0)
    for k in range(round(SECONDS * RATE)):
        _wait(arm, began + k / RATE)
        sent, proven = follow.send(wanted(k / RATE))
        counts["targets"] += 1
        counts["changed"] += not np.array_equal(sent, wanted(k / RATE))
        counts["unproven"] += not proven
        counts["travel"] += float(np.abs(sent - last).max()) if k else 0.0
        last = sent
        if follow.lost:
            break


class _Gated:
    def __init__(
        self, robot: ps.Robot, scene: ps.Scene, driver: ps.execute.TrossenDriver, simulated: SimulatedArm
    ) -> None:
        tracking = Tracking(GOAL_TIME, ERROR, JITTER, LAG)
        gate = ActionGate(ps.PlannerService(robot, scene), rate=RATE, tracking=tracking, slow=True)
        self._arm = GatedArm(
            driver,
            TargetFilter(gate),
            clock=simulated.time,
            wait=lambda seconds: _wait(simulated, simulated.time() + seconds),
        )
        self.refused, self.stopped, self._simulated = Counter[str](), "", simulated

    @property
    def lost(self) -> str:
        """Why the arm goes no further."""
        return self._arm.lost or self.stopped

    def send(self, q: FloatArray) -> tuple[FloatArray, bool]:
        sent = self._arm.send(q)
        refused = sent.verdict.refused
        self.refused["planned" if sent.planned else "passed" if refused is None else refused.kind.value] += 1
        return sent.q, sent.verdict.proven

    def to(self, q: FloatArray) -> None:
        """A stream that was stopped, as the machine was too late, is planned again from where that left the arm."""
        for _ in range(DAYS):
            if self.lost:
                return
            try:
                self._arm.move_to(q)
                return
            except ExecutionStopped as stopped:
                why = str(stopped)
                _wait(self._simulated, self._simulated.time() + RESTED)
        self.stopped = why

    def close(self) -> None:
        self._arm.close()


class _Bare:
    lost = ""

    def __init__(self, driver: ps.execute.TrossenDriver, simulated: SimulatedArm) -> None:
        self._stream, self.refused = TargetStream(driver, clock=simulated.time), Counter[str]()
        self._simulated = simulated

    def send(self, q: FloatArray) -> tuple[FloatArray, bool]:
        self._stream.go(q, GOAL_TIME)
        return q, False

    def to(self, q: FloatArray) -> None:
        self._stream.go(q, RESET)
        _wait(self._simulated, self._simulated.time() + RESET + 0.5)

    def close(self) -> None:
        self._stream.close()
