"""What may be asked of an arm: plans with noise, recorded episodes with noise, and ways into obstacles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.studies.gate.sessions import Session
from planner_service.gate import Verdict
from planner_service.geometry.arrays import FloatArray

__all__ = ["Policy", "attacker", "follower"]

LONGEST = 50
"""Targets of a chunk."""

NOISES = (0.0, 0.003, 0.02, 0.1)
"""Radians."""

Policy = Callable[[Session, Verdict | None], FloatArray]
"""Gives the next chunk (k, n), knowing the last verdict."""


def follower(
    line: Callable[[FloatArray], FloatArray],
    rng: np.random.Generator,
    rate: float,
    *,
    pace: float | None = None,
    size: float | None = None,
    longest: int = LONGEST,
) -> Policy:
    """Follows a motion with smooth noise.

    Args:
        line: Configurations (m, n) at times (m,).
        rate: Targets a second.
        pace: Times the motion's own speed; drawn if None.
        size: Radians of noise; drawn if None.
        longest: Targets of a chunk.
    """
    clock, pace = 0.0, float(rng.uniform(0.1, 1.0)) if pace is None else pace
    size = float(rng.choice(NOISES)) if size is None else size
    waves: list[FloatArray] = []

    def wanted(session: Session, last: Verdict | None) -> FloatArray:
        nonlocal clock
        n = session.world.n
        if not waves:
            waves.extend((rng.uniform(0.5, 8.0, n), rng.uniform(0.0, 2.0 * np.pi, n)))
        times = clock + np.arange(1, int(rng.integers(1, longest + 1)) + 1) / rate
        if last is None or last.accepted:
            clock = float(times[0 if last is None else min(last.accepted, len(times) - 1)])
        wave = np.sin(times[:, None] * waves[0] + waves[1]) - np.sin(waves[1])
        return np.asarray(line(pace * times) + size * wave)

    return wanted


def attacker(rng: np.random.Generator) -> Policy:
    """Goes where the gap shrinks most, or anywhere, as fast as it may; what is refused is tried more slowly."""
    size = 1.0
    way: FloatArray = np.zeros(0)

    def wanted(session: Session, last: Verdict | None) -> FloatArray:
        nonlocal size, way
        robot, rate = session.world.service.robot, session.world.rate
        refused = last is not None and last.accepted == 0
        size = min(1.0, size * (0.5 if refused else 1.5))
        if not len(way) or refused or rng.random() < 0.2:
            way = _direction(session, rng)
        count = int(rng.integers(1, LONGEST + 1))
        share = size * float(rng.uniform(0.3, 1.0))
        steps = np.minimum(np.arange(1, count + 1) * float((robot.limits.acceleration).min()) / rate, 1.0)
        speeds = share * float(robot.limits.velocity.min()) * steps / rate
        begun = session.driver.target + 0.5 * share * rng.normal(size=len(way)) * speeds[0]
        return np.asarray(np.clip(begun + np.cumsum(speeds)[:, None] * way, *robot.bounds))

    return wanted


def _direction(session: Session, rng: np.random.Generator) -> FloatArray:
    n, kind = session.world.n, rng.random()
    way: FloatArray = rng.normal(size=n)
    if kind < 0.6:
        way = 0.3 * float(rng.random()) * way - _unit(session.world.judge.slope(session.driver.target))
    elif kind < 0.8:
        way = session.world.goal - session.driver.target
    return _unit(way)


def _unit(way: FloatArray) -> FloatArray:
    return np.asarray(way / max(float(np.abs(way).max()), 1e-12))
