"""Whether the compiled time law is toppra's optimum, and its reference in Python to the last bit, along random paths.

Paths lead through a few random configurations, or through some that are close to each other; most corners are blended.
No blend is narrower than those of plans. Joint limits are those of the robot, each lowered at random. Toppra solves the
same linear programs; on blends below a hundredth of a radian it does so to 1e-8, here and there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, least_ms, p50, spread, table_of
from planner_service import JointPath, Robot, Trajectory
from planner_service.robot.model import JointLimits, load_robot
from planner_service.smoothing.smoothing import MIN_BLEND
from planner_service.timing.laws import (
    ToppRa,
    reference_stop_duration,
    reference_time_with_peaks,
    stop_duration,
    time_with_peaks,
)
from planner_service.timing.limit_check import TOLERANCE, LimitPeaks, reference_peaks

__all__ = ["PATHS", "ROBOTS", "random_limits", "random_path", "run"]

PATHS = 2_000
"""Of all robots together."""

ROBOTS = ("wxai", "panda_mbm", "ur5", "planar2")

AGREE = 1e-9
"""Relative difference of durations that is promised."""

TURNS = 3
"""The least milliseconds of so many are taken, of compiled timing alone."""


def random_path(robot: Robot, rng: np.random.Generator) -> JointPath:
    """Through two to eight configurations; each corner that may be blended is with a probability of 0.8."""
    points = rng.uniform(robot.limits.lower, robot.limits.upper, (int(rng.integers(2, 9)), robot.n))
    if rng.random() < 0.3:
        scales = rng.choice([1e-3, 1e-2, 1.0], (len(points) - 1, 1))
        points[1:] = points[0] + np.cumsum(scales * np.diff(points, axis=0), axis=0)
    path = JointPath(points)
    lengths, widths = np.diff(path.knots), np.zeros(len(path.waypoints))
    for k in path.corners:
        if rng.random() < 0.8 and not path.turns_back(k):
            widths[k] = rng.choice([0.499, 0.2, 0.05]) * min(lengths[k - 1], lengths[k])
    return path.with_blends(np.where(widths < MIN_BLEND, 0.0, widths))


def random_limits(robot: Robot, rng: np.random.Generator) -> JointLimits:
    """The robot's limits, each times a number from 0.1 to 1."""
    shares = rng.uniform(0.1, 1.0, (2, robot.n))
    velocity, acceleration = robot.limits.velocity * shares[0], robot.limits.acceleration * shares[1]
    return replace(robot.limits, velocity=velocity, acceleration=acceleration)


def run(paths: int = PATHS, seed: int = 0) -> Report:
    """Time that many paths by all three; about a minute for 2,000."""
    rng = np.random.default_rng(seed)
    rows = tuple(_row(load_robot(ROBOTS[k % len(ROBOTS)]), rng) for k in range(paths))
    return Report("law", rows, (_table(rows),), tuple(_promises(rows)))


def _row(robot: Robot, rng: np.random.Generator) -> Row:
    path, limits, own, peer = random_path(robot, rng), random_limits(robot, rng), ToppRa(), ToppRa(backend="toppra")
    ms, found = least_ms(lambda: time_with_peaks(own, path, limits, None), TURNS)
    python_ms, reference = cpu_ms(lambda: reference_time_with_peaks(own, path, limits, None))
    toppra_ms, theirs = cpu_ms(lambda: reference_time_with_peaks(peer, path, limits, None))
    trajectory, peaks = found[0]
    exact = reference_peaks(trajectory, limits)
    return {
        "robot": robot.name,
        "apart": abs(trajectory.duration / theirs[0].duration - 1.0),
        "above": max(0.0, exact.velocity.ratio - 1.0, exact.acceleration.ratio - 1.0),
        "same": _bits(trajectory, peaks) == _bits(*reference)
        and stop_duration(path, own, limits) == reference_stop_duration(path, own, limits),
        "ms": ms,
        "python": python_ms,
        "toppra": toppra_ms,
    }


def _bits(trajectory: Trajectory, peaks: LimitPeaks) -> tuple[object, ...]:
    return (*(np.asarray(part).tobytes() for part in trajectory.tables), trajectory.dilation, peaks)


def _table(rows: Sequence[Row]) -> Table:
    def line(robot: str, here: Sequence[Row]) -> Row:
        ms, python, theirs = ([row[key] for row in here] for key in ("ms", "python", "toppra"))
        return {
            "robot": robot,
            "paths": len(here),
            "apart from toppra": f"{max(row['apart'] for row in here):.1e}",
            "above a limit": f"{max(row['above'] for row in here):.1e}",
            "other bits": sum(not row["same"] for row in here),
            "compiled, ms": spread(ms, 2),
            "Python, ms": spread(python, 1),
            "toppra, ms": spread(theirs, 1),
            "x p50": f"{p50(theirs) / p50(ms):.0f}",
        }

    caption = "From a path to its motion and exact peaks. Apart: durations, at most. CPU ms, p50 / p95; x: toppra's."
    lines = (line(*each) for each in grouped(rows, "robot").items())
    return table_of("The time law on random paths", lines, caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    apart, above = (max(row[key] for row in rows) for key in ("apart", "above"))
    unlike = sum(not row["same"] for row in rows)
    yield Promise(f"{len(rows):,} durations are toppra's to {AGREE:g}", f"{apart:.1e}", apart <= AGREE)
    yield Promise("no limit is exceeded, to rounding", f"{above:.1e}", above <= TOLERANCE)
    yield Promise("compiled motions have the bits of the reference", f"{unlike} have not", unlike == 0)
