"""States by stage on the stored queries, next to the lesson's program on the same queries and the same counter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

import planner_service as ps
from benchmarks.baselines.lesson import Lesson, VertexShortcut, length_of
from benchmarks.harness.audit import independent, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, p95, spread, table_of
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service.collision import EdgeStep
from planner_service.geometry.arrays import FloatArray
from planner_service.search.problem import SearchOracle, SearchProblem

__all__ = ["STEPS", "LessonRun", "plan", "run", "run_lesson"]

STEPS: dict[str, EdgeStep] = {"JointStep(0.02)": ps.JointStep(0.02), "MotionStep(0.010)": ps.MotionStep(0.010)}

CURVE_STEP = 0.001
"""Metres that any point of the robot moves between two looks of the independent checker."""

P50_SHARE, P95_SHARE = 1 / 5, 1 / 4
"""What the service may spend of the lesson's states."""


@dataclass(frozen=True, eq=False)
class LessonRun:
    """States the lesson's program judged, and where it ended; ``path`` is None when it gave up."""

    growth: int
    shortcut: int
    path: FloatArray | None

    @property
    def states(self) -> int:
        """All of them."""
        return self.growth + self.shortcut


def plan(service: ps.PlannerService, query: Query, **changes: Any) -> ps.PlanResult:
    """The service's plan of a query: the query's number is the seed, and no clock has a say."""
    request = ps.PlanRequest(query.start, query.goal, **{"seed": query.number, "time_limit": None, **changes})
    return service.plan(request)


def run_lesson(checker: ps.CollisionChecker, query: Query) -> LessonRun:
    """The lesson's program on a query: grown, then shortened, both counted by ``checker``."""
    limits, before = checker.robot.limits, checker.counts.states
    ends = (query.start, query.goal[None], limits.lower, limits.upper)
    grown = Lesson().search(SearchProblem(*ends, oracle=SearchOracle(checker), seed=query.number)).waypoints
    growth = checker.counts.states - before
    if grown is None:
        return LessonRun(growth, 0, None)
    short = VertexShortcut(checker).shorten(grown, query.number)
    return LessonRun(growth, checker.counts.states - before - growth, short)


def _rows(scene: str) -> Iterator[Row]:
    """One row per query: the service with both steps, and the lesson."""
    services = {name: ps.PlannerService(queries.ROBOT, scene, edge_step=step) for name, step in STEPS.items()}
    first = services["JointStep(0.02)"]
    second, lesson_checker = independent(queries.ROBOT, first.scene), ps.CollisionChecker(first.robot, first.scene)
    for query in queries.load(scene):
        row: Row = {"scene": scene, "query": query.name}
        for name, service in services.items():
            result = plan(service, query)
            touch = None if result.path is None else touch_on_curve(second, result.path, CURVE_STEP)
            row[name] = _told(result) | {"touch": touch}
        lesson = run_lesson(lesson_checker, query)
        row["lesson"] = {
            "states": lesson.states,
            "solved": lesson.path is not None,
            "length": None if lesson.path is None else length_of(lesson.path),
        }
        yield row


def _told(result: ps.PlanResult) -> Row:
    return {
        "solved": result.ok,
        "failure": None if result.failure is None else str(result.failure),
        "sharp": result.counts.states - result.stage(ps.Stage.POLISH).counts.states,
        "length": None if result.path is None else result.path.length,
    }


def run() -> Report:
    """Measure all scenes."""
    rows = tuple(row for scene in queries.SCENES for row in _rows(scene))
    return Report("states", rows, (_lesson_table(rows),), _promises(rows))


def _lesson_table(rows: Sequence[Row]) -> Table:
    def line(scene: str, here: Sequence[Row]) -> Row:
        ours, lesson = [row["JointStep(0.02)"] for row in here], [row["lesson"] for row in here]
        states, theirs = [run["sharp"] for run in ours], [run["states"] for run in lesson]
        both = [(b["length"], a["length"]) for a, b in zip(ours, lesson, strict=True) if a["solved"] and b["solved"]]
        return {
            "scene": scene,
            "lesson": spread(theirs),
            **{name: spread([row[name]["sharp"] for row in here]) for name in STEPS},
            "share": f"{p50(states) / p50(theirs):.2f} / {p95(states) / p95(theirs):.2f}",
            "path, lesson -> ours, rad": " -> ".join(f"{p50(lengths):.2f}" for lengths in zip(*both, strict=True)),
        }

    caption = (
        "Same queries, same counter; share and path of JointStep(0.02). The lesson plans without padding; where it "
        "gives up it counts "
        "what it spent until then, without shortcuts: both are in its favour. It blends no corners: polish is left out."
    )
    lines = (line(*each) for each in grouped(rows, "scene").items())
    return table_of("Against the lesson", lines, caption=caption)


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    promises = []
    for scene, here in grouped(rows, "scene").items():
        ours = [row["JointStep(0.02)"]["sharp"] for row in here]
        theirs = [row["lesson"]["states"] for row in here]
        for word, measure, share in (("p50", p50, P50_SHARE), ("p95", p95, P95_SHARE)):
            ratio = measure(ours) / measure(theirs)
            text = f"{scene}: {word} of states at most {share:g} of the lesson's"
            promises.append(Promise(text, f"{ratio:.3f}", ratio <= share))
        solved = ([row[who]["length"] for row in here if row[who]["solved"]] for who in ("JointStep(0.02)", "lesson"))
        a, b = map(p50, solved)
        promises.append(Promise(f"{scene}: shorter final paths (p50)", f"{a:.2f} vs {b:.2f} rad", a < b))
    for name in STEPS:
        count = sum(row[name]["solved"] for row in rows)
        touches = [f"{row['query']}: {row[name]['touch']}" for row in rows if row[name]["touch"] is not None]
        promises += [
            Promise(f"{name}: every query solved", f"{count} of {len(rows)}", count == len(rows)),
            Promise(f"{name}: no path rejected", ", ".join(touches) or "none", not touches),
        ]
    return tuple(promises)
