"""How long a check takes, of a step and of a chunk, while an arm follows plans among obstacles."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import count

import numpy as np

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.gate.driver import Driver
from benchmarks.studies.gate.worlds import ROBOTS, World, world
from planner_service.gate import Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["run"]

CHECKS = 1000
"""Of each kind, where no other number is asked for."""

RATES, CHUNK = (30.0, 200.0), 50
GOAL_TIMES = {30.0: 0.1, 200.0: 0.02}
"""Seconds after which a target is due, by the rate."""

ERROR = 0.005
"""Radians between arm and setpoint."""

PACES = (0.6, 0.5, 0.4, 0.3, 0.2)
"""Of the plan's own speed, one after the other."""

MOST = 400
"""Checks in one world."""

SENT = 0.1
"""Of a chunk, the share that is sent before the next check."""

STEP_P99, STEP_MAX, CHUNK_P99 = 2.0, 5.0, 5.0
"""Milliseconds that a check may take."""

EDGES = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Milliseconds, of the histogram."""


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """Checks of each robot, at both rates, of one target and of fifty."""
    rows = [
        _measured(name, rate, size, CHECKS if queries is None else queries, seed, kept)
        for name in (ROBOTS if robot is None else (robot,))
        for rate in RATES
        for size in (1, CHUNK)
    ]
    lines = [_line(row) for row in rows]
    steps, chunks = ([row for row in rows if row["targets"] == size] for size in (1, CHUNK))
    p99 = max(row["cpu_ms"]["p99"] for row in steps)
    most = max(row["cpu_ms"]["max"] for row in steps)
    chunk = max(row["cpu_ms"]["p99"] for row in chunks)
    promises = (
        Promise(f"a step takes at most {STEP_P99:g} ms of CPU at p99", f"{p99:.2f} ms", p99 <= STEP_P99),
        Promise(f"a step takes at most {STEP_MAX:g} ms of CPU", f"{most:.2f} ms", most <= STEP_MAX),
        Promise(f"a chunk of {CHUNK} takes at most {CHUNK_P99:g} ms at p99", f"{chunk:.2f} ms", chunk <= CHUNK_P99),
    )
    caption = "ms: of CPU, of this thread; by the clock in the last column. Shares: how many checks take no longer."
    return Report("gate", tuple(rows), (table_of("Times of a check", lines, caption=caption),), promises)


def _measured(name: str, rate: float, size: int, checks: int, seed: int, kept: Kept) -> Row:
    found: dict[str, list[float]] = {"cpu_ms": [], "wall_ms": [], "passed": []}
    for number in count():
        if len(found["cpu_ms"]) >= checks:
            break
        most = min(MOST, checks)
        key = f"times {seed} {name} {rate:g} {size} {most} {number}"
        done = kept.get(key)
        if done is None:
            place = world(name, seed, number)
            done = _followed(
                replace(place, rate=rate, tracking=Tracking(GOAL_TIMES[rate], ERROR, 0.1 / rate)), size, most
            )
            kept.put(key, done)
        for what, values in found.items():
            values.extend(done[what])
    row: Row = {"part": "times", "robot": name, "rate": rate, "targets": size, "checks": checks}
    row["passed"] = round(sum(found["passed"][:checks]))
    for what in ("cpu_ms", "wall_ms"):
        values = found[what][:checks]
        ranks = dict(zip(("p50", "p99", "p999"), np.percentile(values, (50.0, 99.0, 99.9)).tolist(), strict=True))
        row[what] = {**ranks, "max": max(values)}
    row["histogram"] = [float(np.mean(np.array(found["cpu_ms"][:checks]) <= edge)) for edge in EDGES]
    return row


def _followed(place: World, size: int, most: int) -> Row:
    """Follow a plan to its end some times, checking each period a step, or a chunk: how long each took, and passed."""
    plan, out = place.plan, Row(cpu_ms=[], wall_ms=[], passed=[])
    for pace in PACES if plan is not None else ():
        assert plan is not None
        gate, driver = place.gate(), place.driver(place.start)
        gate.reset(place.start)
        clock, sent = 0.0, None
        while pace * clock < plan.duration and len(out["cpu_ms"]) < most:
            times = clock + np.arange(1, size + 1) / place.rate
            chunk = np.asarray(plan(np.minimum(pace * times, plan.duration)))
            began, used = time.perf_counter(), time.thread_time()
            verdict = gate.check(driver.setpoint, chunk, sent=sent)
            out["cpu_ms"].append(round((time.thread_time() - used) * 1e3, 4))
            out["wall_ms"].append(round((time.perf_counter() - began) * 1e3, 4))
            out["passed"].append(verdict.accepted)
            sent = min(len(verdict.rows), max(1, round(SENT * size)))
            driver = _sent(driver, verdict.rows[:sent], place.rate)
            if verdict.accepted == 0:
                break
            clock += sent / place.rate
    return out


def _sent(driver: Driver, rows: FloatArray, rate: float) -> Driver:
    return driver.followed(rows, np.full(len(rows), 1.0 / rate))[1]


def _line(row: Row) -> dict[str, object]:
    cpu, wall = row["cpu_ms"], row["wall_ms"]
    what = "step" if row["targets"] == 1 else f"chunk of {row['targets']}"
    line: dict[str, object] = {"robot": f"{row['robot']}, {row['rate']:g} Hz, {what}", "checks": f"{row['checks']:,}"}
    line |= {key: f"{cpu[key]:.2f}" for key in ("p50", "p99", "p999", "max")}
    line |= {f"<= {edge:g} ms": f"{100 * share:.1f} %" for edge, share in zip(EDGES, row["histogram"], strict=True)}
    return line | {"clock p50 / p99 / max": f"{wall['p50']:.2f} / {wall['p99']:.2f} / {wall['max']:.2f}"}
