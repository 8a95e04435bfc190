"""What a plan promises of its motion, on the stored queries and on drawn ones, by judges that share no code with it.

The whole blended curve is free at 0.2 mm motion steps, the timed one is the same and keeps every limit, blends pay, and
what the certificate says is true. What no sampling can show, thin sheets planted between the samples, is shown too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

import planner_service as ps
from auditor.checker import IndependentChecker
from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, p50, spread, table, table_of
from benchmarks.studies.states import plan
from benchmarks.worlds import drawn, queries, sheets
from benchmarks.worlds.queries import Query
from planner_service.geometry.arrays import FloatArray
from planner_service.timing import Timing
from planner_service.timing.laws import stop_duration

__all__ = ["NAMES", "World", "measured", "planted", "promises", "rates", "run", "sampled_peaks"]

LAWS: dict[str, Timing] = {"toppra": ps.ToppRa(), "s-curve": ps.SCurve()}

KINDS = {"toppra": 2, "s-curve": 3}
"""How many of velocity, acceleration and jerk each law limits; acceleration jumps under TOPP-RA."""

PLANTED = 10
"""Queries of each scene on whose paths sheets are planted."""

DRAWN = "drawn"
"""The name under which all drawn scenes are listed."""

NAMES = (*queries.SCENES, DRAWN)

MOTION_STEP, GAP_STEP = 0.0002, 0.005
"""Metres that any point of the robot moves between samples: of touches, and of the smallest gap."""

INSTANTS = 20_000
"""Samples of a trajectory, at least eight on each piece of time."""

COAL_ERROR = 5e-6
"""Metres by which Coal's distances may be too small."""

LIMIT_TOLERANCE = 1e-6
"""Relative to a limit: what breaks it."""

SHARES = {"toppra": 0.75, "s-curve": 0.9}
"""What blends are to leave of the motion time with stops, ..."""

BLENDS_PAY = ("shelf", "clutter")
"""... in these scenes."""

MISSED = 20
"""Sheets that sampling must have missed at each step, before it says something that none was certified."""


@dataclass(frozen=True, eq=False)
class World:
    """A scene and its queries, with those who plan and judge in it."""

    name: str
    scene: ps.Scene
    queries: tuple[Query, ...]
    service: ps.PlannerService
    second: IndependentChecker

    @classmethod
    def of(cls, name: str, scene: ps.Scene, asked: Sequence[Query]) -> World:
        """The benchmark's robot in a scene."""
        return cls(
            name, scene, tuple(asked), ps.PlannerService(queries.ROBOT, scene), independent(queries.ROBOT, scene)
        )


def _worlds(each: int) -> Iterator[World]:
    """The scenes of the stored queries, and the drawn ones."""
    for name in queries.SCENES:
        yield World.of(name, ps.load_scene(name), queries.load(name)[:each])
    for number in range(drawn.COUNT * each // queries.PER_SCENE):
        scene = drawn.draw_scene(number)
        yield World.of(DRAWN, scene, tuple(drawn.draw_queries(number, scene)))


def measured(world: World, query: Query) -> tuple[Row, ps.PlanResult]:
    """A query planned and its motion judged."""
    result = plan(world.service, query)
    failure = None if result.failure is None else result.failure.reason.value
    row: Row = {"world": world.name, "query": query.name, "failure": failure}
    path, trajectory, proof = result.path, result.trajectory, result.certificate
    if path is None or trajectory is None or proof is None:
        return row, result
    gaps = [min(world.second.gaps(q).values()) for q in world.second.along(path, path.length, GAP_STEP)]
    return row | {
        "touch": touch_on_curve(world.second, path, MOTION_STEP),
        "clearance": proof.clearance,
        "sampled_gap": min(gaps),
        "off_path": _off_path(trajectory),
        "bounds": result.stage(ps.Stage.CERTIFY).counts.distances,
        **{name: _law(path, world.service.robot.limits, name) for name in LAWS},
    }, result


def _off_path(trajectory: ps.Trajectory) -> float:
    """The largest distance of a joint from the path at the same s(t), and of s(t) from running from end to end."""
    t = np.linspace(0.0, trajectory.duration, 100)
    s = trajectory.s(t)
    if np.any(np.diff(s) < 0.0) or s[0] != 0.0 or s[-1] != trajectory.path.length:
        return float("inf")
    return float(np.abs(trajectory(t) - trajectory.path(s)).max())


def _law(path: ps.JointPath, limits: ps.JointLimits, name: str) -> Row:
    trajectory = LAWS[name].time_path(path, limits)
    worst = max(sampled_peaks(trajectory, limits)[: KINDS[name]])
    return {"duration": trajectory.duration, "stops": stop_duration(path, LAWS[name], limits), "worst": worst}


def sampled_peaks(trajectory: ps.Trajectory, limits: ps.JointLimits) -> tuple[float, float, float]:
    """The largest velocity, acceleration and jerk over their limits at many instants.

    No instant is one at which two pieces of time meet.
    """
    count = max(8, INSTANTS // len(trajectory.durations))
    share = (np.arange(count) + 0.5) / count
    t = (trajectory.knots[:-1, None] + trajectory.durations[:, None] * share).reshape(-1)
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    one, two, three = (
        float((np.abs(rate) / bound).max()) for rate, bound in zip(rates(trajectory, t), bounds, strict=True)
    )
    return one, two, three


def rates(trajectory: ps.Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Velocity, acceleration and jerk, (m, n) each, at t (m,): the full chain rule, not the trajectory's own."""
    s = trajectory.s(t)
    v, a, j = (trajectory.s(t, order)[:, None] for order in (1, 2, 3))
    q1, q2, q3 = (trajectory.path(s, order) for order in (1, 2, 3))
    return q1 * v, q2 * v * v + q1 * a, q3 * v * v * v + 3.0 * q2 * v * a + q1 * j


def planted(world: World, query: Query, path: ps.JointPath) -> Iterator[Row]:
    """Sheets on the path of a query, for each step of sampling."""

    def touches(scene: ps.Scene, start: float, end: float) -> bool:
        def stretch(s: Any) -> FloatArray:
            return path(start + s)

        return independent(queries.ROBOT, scene).curve_touch(stretch, end - start, MOTION_STEP) is not None

    site = sheets.Site(query.name, world.service.robot, world.scene, path, touches)
    for step in sheets.STEPS:
        yield {"world": "sheets", "query": query.name, "step": step, **vars(sheets.plant(site, step))}


def run(queries: int = queries.PER_SCENE) -> Report:
    """Plan, judge, plant; about a quarter of an hour.

    Args:
        queries: Of each scene; as large a share of the drawn ones.
    """
    rows: list[Row] = []
    planting: list[Row] = []
    for world in _worlds(queries):
        for query in world.queries:
            row, result = measured(world, query)
            rows.append(row)
            if world.name != DRAWN and query.number < PLANTED and result.path is not None:
                planting += planted(world, query, result.path)
    return Report("proven", (*rows, *planting), (_table(rows), _sheet_table(planting)), promises(rows, planting))


def _of(rows: Sequence[Row], *names: str) -> list[Row]:
    """The planned queries of these scenes."""
    return [row for row in rows if row["world"] in names and row["failure"] is None]


def _overstated(row: Row) -> bool:
    return bool(row["clearance"] > row["sampled_gap"] + COAL_ERROR)


def _share(rows: Sequence[Row], law: str) -> float:
    """Motion time over that with stops, of the medians."""
    return p50(row[law]["duration"] for row in rows) / p50(row[law]["stops"] for row in rows)


def _table(rows: Sequence[Row]) -> Table:
    def line(name: str) -> Row:
        here, all_ = _of(rows, name), [row for row in rows if row["world"] == name]
        times = {law: (p50(row[law][key] for row in here) for key in ("duration", "stops")) for law in LAWS}
        return {
            "scene": name,
            "planned": f"{len(here)}/{len(all_)}",
            "touch": sum(row["touch"] is not None for row in here),
            **{f"{law} / with stops s": " / ".join(f"{value:.2f}" for value in found) for law, found in times.items()},
            "worst limit - 1": f"{max(row[law]['worst'] for row in here for law in LAWS) - 1.0:+.1e}",
            "proven mm": f"{p50(row['clearance'] for row in here) * 1e3:.2f}",
            "sampled mm": f"{p50(row['sampled_gap'] for row in here) * 1e3:.2f}",
            "bounds": spread([row["bounds"] for row in here]),
        }

    caption = (
        f"Touch: by Coal at {MOTION_STEP * 1e3:g} mm motion steps along the blended curve. Times and clearances: p50. "
        f"Proven: the certificate's clearance; sampled: Coal's smallest distance at {GAP_STEP * 1e3:g} mm steps. Worst "
        f"limit: share of a limit at {INSTANTS:,} instants of each motion. Bounds: p50 / p95, of the certificate."
    )
    names = [name for name in NAMES if _of(rows, name)]
    return table_of("The whole curve, judged independently", map(line, names), caption=caption)


def _planted(planting: Sequence[Row], step: float) -> list[int]:
    here = [row for row in planting if row["step"] == step]
    return [sum(row[key] for row in here) for key in ("tried", "touched", "missed", "caught")]


def _sheet_table(planting: Sequence[Row]) -> Table:
    cells = [(f"{step:g} rad", *_planted(planting, step)) for step in sheets.STEPS]
    caption = (
        f"{sheets.THICKNESS * 1e3:g} mm thick. Touched: between two samples, by Coal at {MOTION_STEP * 1e3:g} mm "
        "motion steps, and not at these two. Missed: all samples of the path at the step are free by FCL."
    )
    columns = ("sampling", "sheets tried", "touched", "missed by sampling", "refused by the certificate")
    return table("Planted sheets", columns, cells, caption=caption)


def promises(rows: Sequence[Row], planting: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    done = _of(rows, *NAMES)
    touching = [f"{row['query']} {row['touch']}" for row in done if row["touch"] is not None]
    overstated = [row["query"] for row in done if _overstated(row)]
    lost = [row["query"] for row in rows if row["world"] != DRAWN and row["failure"] == "NOT_CERTIFIED"]
    off = max(row["off_path"] for row in done)
    free = f"0 of {len(done)} curves in collision at {MOTION_STEP * 1e3:g} mm motion steps"
    found = [
        Promise(free, ", ".join(touching) or "none", not touching),
        Promise("the timed curve is the certified one", f"{off:g} rad off", off == 0.0),
        Promise(
            "no certificate states more than Coal's smallest distance", ", ".join(overstated) or "none", not overstated
        ),
        Promise("stored queries: none NOT_CERTIFIED", ", ".join(lost) or "none", not lost),
    ]
    for law in LAWS:
        worst = max(row[law]["worst"] for row in done)
        text = f"{law}: no sample above its limits by {LIMIT_TOLERANCE:g} relative"
        found.append(Promise(text, f"{worst - 1.0:+.1e}", worst <= 1.0 + LIMIT_TOLERANCE))
        for name in BLENDS_PAY:
            share, wanted = _share(_of(rows, name), law), SHARES[law]
            text = f"{name}: {law} blended at most {wanted:g} x of with stops (p50)"
            found.append(Promise(text, f"{share:.3f}", share <= wanted))
    for step in sheets.STEPS:
        _, touched, missed, caught = _planted(planting, step)
        text = f"every {sheets.THICKNESS * 1e3:g} mm sheet is refused, {MISSED} and more that {step:g} rad samples miss"
        kept = caught == touched and missed >= MISSED
        found.append(Promise(text, f"{caught} of {touched}, {missed} of them missed", kept))
    return tuple(found)
