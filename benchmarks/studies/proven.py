"""What a plan promises of its motion, on the stored queries and on drawn ones, by judges that share no code with it.

The whole blended curve is free at 0.2 mm motion steps, the timed one is the same and keeps every limit, blends pay, and
what the certificate says is true and was found cheaply. What no sampling can show, thin sheets planted between the
samples, is shown too.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from auditor.checker import IndependentChecker
from benchmarks.baselines.plain_bisection import plain_bisection_bounds
from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Report, Row
from benchmarks.studies.proven_tables import DRAWN, GAP_STEP, INSTANTS, KINDS, MOTION_STEP, all_promises, all_tables
from benchmarks.studies.states import plan
from benchmarks.worlds import drawn, queries, sheets
from benchmarks.worlds.queries import Query
from planner_service import PlannerService, PlanResult, Scene, SCurve, Stage, ToppRa
from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import JointLimits
from planner_service.scene.scene import load_scene
from planner_service.timing.laws import Timing, stop_duration
from planner_service.timing.limit_check import peaks

__all__ = ["World", "measured", "planted", "rates", "run", "sampled_peaks", "worlds"]

LAWS: dict[str, Timing] = {"toppra": ToppRa(), "s-curve": SCurve()}

PLANTED = 10
"""Queries of each scene on whose paths sheets are planted."""


@dataclass(frozen=True, eq=False)
class World:
    """A scene and its queries, with those who plan, prove and judge in it."""

    name: str
    scene: Scene
    queries: tuple[Query, ...]
    service: PlannerService
    certifier: Certifier
    second: IndependentChecker

    @classmethod
    def of(cls, name: str, scene: Scene, asked: Sequence[Query]) -> World:
        """The benchmark's robot in a scene."""
        service, second = PlannerService(queries.ROBOT, scene), independent(queries.ROBOT, scene)
        return cls(name, scene, tuple(asked), service, Certifier(service.robot, scene), second)


def worlds() -> Iterator[World]:
    """The scenes of the stored queries, and the drawn ones."""
    for name in queries.SCENES:
        yield World.of(name, load_scene(name), queries.load(name))
    for number in range(drawn.COUNT):
        scene = drawn.draw_scene(number)
        yield World.of(DRAWN, scene, tuple(drawn.draw_queries(number, scene)))


def measured(world: World, query: Query) -> tuple[Row, PlanResult]:
    """A query planned and its motion judged."""
    result = plan(world.service, query)
    asked = result.stage(Stage.CERTIFY).counts.distances
    row: Row = {
        "world": world.name,
        "query": query.name,
        "failure": None if result.failure is None else result.failure.reason.value,
        "ms": {report.stage.value: report.seconds * 1e3 for report in result.stages},
        "notes": list(result.notes),
    }
    if result.path is None or result.trajectory is None or result.certificate is None:
        return row, result
    path, limits = result.path, world.service.robot.limits
    row |= {
        "first_refused": asked > result.certificate.distances,
        "searched_again": any(note.startswith("searched again") for note in result.notes),
        "corners": [len(path.with_blends(None).corners), len(path.corners)],
        "off_path": _off_path(result.trajectory),
        **{name: _law(path, limits, name) for name in LAWS},
        "distances": result.certificate.distances,
        "plain": plain_bisection_bounds(world.certifier, path),
    }
    return row | _judged(world.second, path, result.certificate.clearance), result


def _judged(second: IndependentChecker, path: JointPath, clearance: float) -> Row:
    """The curve by the independent checker."""
    started = time.perf_counter()
    touch = touch_on_curve(second, path, MOTION_STEP)
    seconds = time.perf_counter() - started
    gap = min(min(second.gaps(q).values()) for q in second.along(path, path.length, GAP_STEP))
    return {"touch": touch, "judging_seconds": seconds, "clearance": clearance, "sampled_gap": gap}


def _off_path(trajectory: Trajectory) -> float:
    """The largest distance of a joint from the path at the same s(t), and of s(t) from running from end to end."""
    t = np.linspace(0.0, trajectory.duration, 100)
    s = trajectory.s(t)
    if np.any(np.diff(s) < 0.0) or s[0] != 0.0 or s[-1] != trajectory.path.length:
        return float("inf")
    return float(np.abs(trajectory(t) - trajectory.path(s)).max())


def _law(path: JointPath, limits: JointLimits, name: str) -> Row:
    law = LAWS[name]
    started = time.perf_counter()
    trajectory = law.time_path(path, limits)
    seconds = time.perf_counter() - started
    found = peaks(trajectory, limits)
    exact = (found.velocity.ratio, found.acceleration.ratio, found.jerk.ratio)
    return {
        "ms": seconds * 1e3,
        "duration": trajectory.duration,
        "stops": stop_duration(path, law, limits),
        "dilation": trajectory.dilation,
        "peaks": dict(zip(KINDS[name], exact, strict=False)),
        "sampled": dict(zip(KINDS[name], sampled_peaks(trajectory, limits), strict=False)),
    }


def sampled_peaks(trajectory: Trajectory, limits: JointLimits) -> tuple[float, float, float]:
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


def rates(trajectory: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Velocity, acceleration and jerk, (m, n) each, at t (m,): the full chain rule, not the trajectory's own."""
    s = trajectory.s(t)
    v, a, j = (trajectory.s(t, order)[:, None] for order in (1, 2, 3))
    q1, q2, q3 = (trajectory.path(s, order) for order in (1, 2, 3))
    return q1 * v, q2 * v * v + q1 * a, q3 * v * v * v + 3.0 * q2 * v * a + q1 * j


def planted(world: World, query: Query, path: JointPath) -> Iterator[Row]:
    """Sheets on the path of a query, for each step of sampling."""

    def touches(scene: Scene, start: float, end: float) -> bool:
        def stretch(s: Any) -> FloatArray:
            return path(start + s)

        return independent(queries.ROBOT, scene).curve_touch(stretch, end - start, MOTION_STEP) is not None

    site = sheets.Site(query.name, world.service.robot, world.scene, path, touches)
    for step in sheets.STEPS:
        yield {"world": "sheets", "query": query.name, "step": step, **vars(sheets.plant(site, step))}


def run() -> Report:
    """Plan, judge, plant."""
    rows: list[Row] = []
    planting: list[Row] = []
    for world in worlds():
        for query in world.queries:
            row, result = measured(world, query)
            rows.append(row)
            if world.name != DRAWN and query.number < PLANTED and result.path is not None:
                planting += planted(world, query, result.path)
    return Report("proven", (*rows, *planting), all_tables(rows, planting), all_promises(rows, planting))
