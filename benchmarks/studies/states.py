"""States by stage on the stored queries, next to the lesson's program on the same queries and the same counter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from benchmarks.baselines.lesson import Lesson, VertexShortcut, length_of
from benchmarks.harness.report import Promise, Report, p50, p95, spread, table
from benchmarks.worlds import queries
from benchmarks.worlds.queries import Query
from planner_service import JointStep, MotionStep, PlannerService, PlanRequest, PlanResult, Stage
from planner_service.collision import CollisionChecker, EdgeStep
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem

__all__ = ["SHOWN", "STEPS", "LessonRun", "plan", "run", "run_lesson"]

STEPS: dict[str, EdgeStep] = {"JointStep(0.02)": JointStep(0.02), "MotionStep(0.010)": MotionStep(0.010)}

SHOWN = (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH, Stage.SHORTCUT, Stage.POLISH)

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


def plan(service: PlannerService, query: Query, **changes: Any) -> PlanResult:
    """The service's plan of a query: the query's number is the seed, and no clock has a say."""
    request = PlanRequest(query.start, query.goal, **{"seed": query.number, "time_limit": None, **changes})
    return service.plan(request)


def run_lesson(checker: CollisionChecker, query: Query) -> LessonRun:
    """The lesson's program on a query: grown, then shortened, both counted by ``checker``."""
    limits, before = checker.robot.limits, checker.counts.states
    problem = SearchProblem(
        start=query.start,
        goals=query.goal[None],
        lower=limits.lower,
        upper=limits.upper,
        oracle=SearchOracle(checker),
        seed=query.number,
    )
    grown = Lesson().search(problem).waypoints
    growth = checker.counts.states - before
    if grown is None:
        return LessonRun(growth, 0, None)
    short = VertexShortcut(checker).shorten(grown, query.number)
    return LessonRun(growth, checker.counts.states - before - growth, short)


def _rows(scene: str) -> Iterator[dict[str, Any]]:
    """One row per query: the service with both steps, and the lesson."""
    from auditor.checker import IndependentChecker

    services = {name: PlannerService(queries.ROBOT, scene, edge_step=step) for name, step in STEPS.items()}
    second = IndependentChecker(data_folder("robots") / queries.ROBOT, data_folder("scenes") / f"{scene}.toml")
    lesson_checker = CollisionChecker(services["JointStep(0.02)"].robot, services["JointStep(0.02)"].scene)
    for query in queries.load(scene):
        row: dict[str, Any] = {"scene": scene, "query": query.name}
        for name, service in services.items():
            result = plan(service, query)
            row[name] = _told(result) | {"touch": _touch(second, result)}
        lesson = run_lesson(lesson_checker, query)
        row["lesson"] = {
            "growth": lesson.growth,
            "shortcut": lesson.shortcut,
            "states": lesson.states,
            "solved": lesson.path is not None,
            "length": None if lesson.path is None else length_of(lesson.path),
        }
        yield row


def _told(result: PlanResult) -> dict[str, Any]:
    return {
        "solved": result.ok,
        "failure": None if result.failure is None else str(result.failure),
        "states": result.counts.states,
        "sharp": result.counts.states - result.stage(Stage.POLISH).counts.states,
        "stages": {report.stage.value: report.counts.states for report in result.stages},
        "searched_to": result.stage(Stage.SEARCH).length,
        "length": None if result.path is None else result.path.length,
        "attempts": result.attempts,
        "padding": result.padding,
    }


def _touch(second: Any, result: PlanResult) -> str | None:
    """What the independent checker found on the path, in words."""
    touch = None if result.path is None else second.curve_touch(result.path, result.path.length, 0.001)
    return None if touch is None else f"{touch.a} x {touch.b}"


def run() -> Report:
    """Measure all scenes."""
    rows = tuple(row for scene in queries.SCENES for row in _rows(scene))
    tables = (*(_stage_table(rows, name) for name in STEPS), _lesson_table(rows))
    return Report("states", rows, tables, _promises(rows))


def _of(rows: Sequence[dict[str, Any]], scene: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["scene"] == scene]


def _stage_table(rows: Sequence[dict[str, Any]], name: str) -> Table:
    def cells(scene: str) -> list[str]:
        here = [row[name] for row in _of(rows, scene)]
        stages = [[run["stages"].get(stage.value, 0) for run in here] for stage in SHOWN]
        lengths = [run["length"] for run in here if run["solved"]]
        kept = min(run["padding"] for run in here) * 1000
        return [
            scene,
            *(spread(values) for values in stages),
            spread([run["states"] for run in here]),
            spread(lengths, 2),
            str(max(run["attempts"] for run in here)),
            f"{kept:g}",
            f"{sum(run['solved'] for run in here)}/{len(here)}",
            str(sum(run["touch"] is not None for run in here)),
        ]

    columns = (
        "scene",
        *(stage.value for stage in SHOWN),
        "total",
        "length rad",
        "most tries",
        "least padding mm",
        "solved",
        "rejected",
    )
    caption = (
        "p50 / p95 over 20 queries. Padding: 0 for verdicts, 1 mm for the search (less near a close end). "
        "Rejected: paths on which the independent checker touches something at 1 mm motion steps."
    )
    return table(f"States by stage, {name}", columns, (cells(scene) for scene in queries.SCENES), caption=caption)


def _lesson_table(rows: Sequence[dict[str, Any]]) -> Table:
    def cells(scene: str) -> list[str]:
        here = _of(rows, scene)
        ours, lesson = [row["JointStep(0.02)"] for row in here], [row["lesson"] for row in here]
        states, theirs = [run["sharp"] for run in ours], [run["states"] for run in lesson]
        both = [(a["length"], b["length"]) for a, b in zip(ours, lesson, strict=True) if a["solved"] and b["solved"]]
        return [
            scene,
            spread([run["growth"] for run in lesson]),
            spread([run["shortcut"] for run in lesson]),
            spread(theirs),
            spread(states),
            f"{p50(theirs) / p50(states):.1f}",
            f"{p95(theirs) / p95(states):.1f}",
            f"{p50(b / a for a, b in zip(states, theirs, strict=True)):.1f}",
            spread([b for _, b in both], 2),
            spread([a for a, _ in both], 2),
            f"{sum(a < b for a, b in both)}/{len(both)}",
            f"{sum(run['solved'] for run in lesson)}/{len(lesson)}",
        ]

    columns = (
        "scene",
        "lesson growth",
        "lesson shortcut",
        "lesson total",
        "service total",
        "p50 ratio",
        "p95 ratio",
        "paired median",
        "lesson rad",
        "service rad",
        "shorter",
        "lesson solved",
    )
    caption = (
        "Same queries, same counter, JointStep(0.02). The lesson plans without padding; where it gives up it counts "
        "what it spent until then, without shortcuts: both are in its favour. It blends no corners: polish is left out."
    )
    return table("Against the lesson", columns, (cells(scene) for scene in queries.SCENES), caption=caption)


def _promises(rows: Sequence[dict[str, Any]]) -> tuple[Promise, ...]:
    promises = []
    for scene in queries.SCENES:
        here = _of(rows, scene)
        ours = [row["JointStep(0.02)"]["sharp"] for row in here]
        theirs = [row["lesson"]["states"] for row in here]
        for word, measure, share in (("p50", p50, P50_SHARE), ("p95", p95, P95_SHARE)):
            ratio = measure(ours) / measure(theirs)
            text = f"{scene}: {word} of states at most {share:g} of the lesson's"
            promises.append(Promise(text, f"{ratio:.3f}", ratio <= share))
        ours_, theirs_ = (
            p50(row[who]["length"] for row in here if row[who]["solved"]) for who in ("JointStep(0.02)", "lesson")
        )
        promises.append(
            Promise(f"{scene}: shorter final paths (p50)", f"{ours_:.2f} vs {theirs_:.2f} rad", ours_ < theirs_)
        )
    for name in STEPS:
        solved = sum(row[name]["solved"] for row in rows)
        touches = [f"{row['query']}: {row[name]['touch']}" for row in rows if row[name]["touch"] is not None]
        promises += [
            Promise(f"{name}: every query solved", f"{solved} of {len(rows)}", solved == len(rows)),
            Promise(f"{name}: no path rejected", ", ".join(touches) or "none", not touches),
        ]
    return tuple(promises)
