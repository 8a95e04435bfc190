"""What optimising is worth: each searched plan optimised, next to shortcutting alone.

Both plans of a query have the same seed, are blended and proven, and are timed by the same law. Clearances are proven
lower bounds at many places of a curve, tight where pieces are apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from rich.table import Table

import planner_service as ps
from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray

__all__ = ["SCENES", "hybrid_rows", "promises", "run"]

SCENES = ("bin", "shelf", "post", "clutter")

POLISH = ps.Optimise()
LONG = ps.Optimise(waypoints=100, corners=16)
LONG_RUNS = 10
"""What a query's clearance is held against where neither its ends nor what was asked limit it."""

PLACES = 800
"""Of a curve, at which its clearance is taken; and between which its acceleration is integrated, five times as many."""

MOTION_STEP = 0.001
"""Metres of motion between two looks of the independent checker."""

LENGTH, ACCELERATION, DURATION, CLEAR_SHARE, STEP_MS = 1.05, 1 / 3, 0.85, 0.9, 10.0
"""Promised: ratios to shortcutting alone, a share of the queries, and milliseconds of an iteration."""


def _clearances(certifier: Certifier, path: ps.JointPath) -> FloatArray:
    limits = certifier.robot.limits
    return certifier.clearances(np.clip(path(np.linspace(0.0, path.length, PLACES)), limits.lower, limits.upper))


def _length(path: ps.JointPath) -> float:
    """Of the curve, in radians."""
    steps = np.diff(path(np.linspace(0.0, path.length, 5 * PLACES)), axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())


def _motion(result: ps.PlanResult, certifier: Certifier) -> Row:
    """A plan in numbers: length of the curve (rad), seconds, integral of squared acceleration, clearances."""
    path, trajectory = result.unwrap()
    t = np.linspace(0.0, trajectory.duration, 5 * PLACES + 1)
    middle = 0.5 * (t[1:] + t[:-1])
    clear = _clearances(certifier, path)
    return {
        "length": _length(path),
        "duration": trajectory.duration,
        "acceleration": float((trajectory(middle, 2) ** 2).sum() * (t[1] - t[0])),
        "clearance": float(clear.min()),
        "ends": float(min(clear[0], clear[-1])),
    }


def _best_of_long_runs(service: ps.PlannerService, certifier: Certifier, query: queries.Query) -> float:
    found = (plan(service, query, seed=seed, polish=LONG, max_checks=500_000) for seed in range(LONG_RUNS))
    return max((float(_clearances(certifier, one.path).min()) for one in found if one.path is not None), default=0.0)


def hybrid_rows(
    scenes: Sequence[str] = SCENES, count: int = queries.PER_SCENE, polish: ps.Optimise = POLISH
) -> Iterator[Row]:
    """Each query that has to be searched, by shortcutting alone and optimised."""
    for scene in scenes:
        service = ps.PlannerService(queries.ROBOT, scene)
        certifier = Certifier(service.robot, service.scene)
        second = independent(queries.ROBOT, service.scene)
        plan(service, queries.load(scene)[0], polish=polish)  # libraries load, a field is made
        for query in queries.load(scene)[:count]:
            plain_ms, plain = cpu_ms(partial(plan, service, query))
            if not plain.attempts:
                continue
            ms, result = cpu_ms(partial(plan, service, query, polish=polish))
            row: Row = {"scene": scene, "query": query.name}
            if result.polish is None or not plain.ok or not result.ok:
                yield row | {"failure": str(result.failure or plain.failure), "certified": False, "kept": False}
                continue
            before, after = _motion(plain, certifier), _motion(result, certifier)
            wanted = min(polish.clearance, before["ends"])
            if after["clearance"] < wanted:
                wanted = min(wanted, _best_of_long_runs(service, certifier, query))
            yield row | {
                "failure": None,
                "certified": result.certificate is not None and result.certificate.certified,
                "kept": result.polish.kept,
                "touch": touch_on_curve(second, result.unwrap()[0], MOTION_STEP),
                "before": before,
                "after": after,
                "wanted": wanted,
                "iterations": result.polish.iterations,
                "polish_ms": ms - plain_ms,
            }


def run(queries: int = queries.PER_SCENE) -> Report:
    """Measure it all; some two minutes.

    Args:
        queries: Of each scene.
    """
    rows = tuple(hybrid_rows(count=queries))
    return Report("optimise", rows, (_table(rows),), promises(rows))


def _ratios(rows: Sequence[Row], what: str) -> list[float]:
    return [row["after"][what] / row["before"][what] for row in rows if row["failure"] is None]


def _at_equal_time(rows: Sequence[Row]) -> list[float]:
    """Integrals of squared acceleration if the optimum is slowed down to the time of the shortcut."""
    pairs = zip(_ratios(rows, "acceleration"), _ratios(rows, "duration"), strict=True)
    return [acceleration * duration**3 for acceleration, duration in pairs]


def _clear(rows: Sequence[Row]) -> list[bool]:
    return [row["failure"] is None and row["after"]["clearance"] >= row["wanted"] for row in rows]


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    clear, by_scene = _clear(rows), grouped(rows, "scene")
    uncertified = sum(row["failure"] is None and not row["certified"] for row in rows)
    touched = [f"{row['query']}: {row['touch']}" for row in rows if row["failure"] is None and row["touch"]]

    def medians(values: Callable[[Sequence[Row]], list[float]], most: float, text: str) -> Promise:
        told = {scene: values(here) for scene, here in by_scene.items()}
        shown = "; ".join(f"{scene} {spread(some, 2)}" for scene, some in told.items())
        return Promise(text, shown, all(p50(some) <= most for some in told.values()))

    length, duration, acceleration = (partial(_ratios, what=what) for what in ("length", "duration", "acceleration"))
    step = [row["polish_ms"] / row["iterations"] for row in rows if row["failure"] is None]
    smallest = "smallest clearance at least min(20 mm, its ends', the best of 10 long runs) on 90 % of the queries"
    rejects = "the independent checker, at every millimetre of motion, rejects no optimum"
    return (
        Promise(smallest, f"{sum(clear)} of {len(clear)}", sum(clear) >= CLEAR_SHARE * len(clear)),
        medians(length, LENGTH, "length at most 1.05 x at p50 in each scene"),
        medians(duration, DURATION, "motion time at most 0.85 x at p50 in each scene"),
        medians(acceleration, ACCELERATION, "integral of squared acceleration at most 1/3, each at its own pace"),
        medians(_at_equal_time, ACCELERATION, "integral of squared acceleration at most 1/3 in the same motion time"),
        Promise("no result without a proof", f"{uncertified} uncertified", uncertified == 0),
        Promise(rejects, "; ".join(touched) or "none", not touched),
        Promise("an iteration takes less than 10 ms", f"ms p50 / p95: {spread(step, 1)}", p50(step) < STEP_MS),
    )


def _table(rows: Sequence[Row]) -> Table:
    def line(scene: str, here: Sequence[Row]) -> Row:
        good = [row for row in here if row["failure"] is None]
        ratios = {"length x": "length", "time x": "duration", "accel. x": "acceleration"}
        clearances = {"clear before": "before", "after mm": "after"}
        return {
            "scene": scene,
            "queries": len(here),
            **{name: spread(_ratios(here, what), 2) for name, what in ratios.items()},
            "same time x": spread(_at_equal_time(here), 2),
            **{name: f"{p50(row[side]['clearance'] * 1e3 for row in good):.1f}" for name, side in clearances.items()},
            "clear": f"{sum(_clear(here))}/{len(here)}",
            "iterations": spread([row["iterations"] for row in good]),
            "polish ms": spread([row["polish_ms"] for row in good]),
            "kept/certified": f"{sum(row['kept'] for row in here)}/{sum(row['certified'] for row in here)}",
        }

    caption = (
        "p50 / p95, ratios to shortcutting alone. Accel.: integral of squared joint acceleration over time, each at "
        "its own time-optimal pace, which always uses some joint's acceleration fully; same time: the optimum slowed "
        "down to the time of the shortcut. Clear: queries that keep 20 mm, or what their ends or the best of 10 long "
        "runs allow. Polish: CPU."
    )
    return table_of(
        "Optimised, next to shortcutting alone", (line(*e) for e in grouped(rows, "scene").items()), caption=caption
    )
