"""All planners on a few queries of four scenes: do they find a path, at what price, and the same one again?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.harness.report import Promise, Report, Row, p50, table_of
from benchmarks.studies.states import plan
from benchmarks.worlds import queries
from planner_service import PlannerService, PlanResult, Stage
from planner_service.planners import PLANNERS
from planner_service.search.problem import Planner

__all__ = ["run"]

PLANNED_SCENES = ("bin", "shelf", "post", "clutter")
PER_SCENE = 3

SETTINGS: dict[str, dict[str, Any]] = {
    **{name: {"checks": 4000} for name in ("rrtstar", "informedrrtstar", "sorrtstar", "bitstar", "aorrtc")},
    "prm": {"milestones": 200, "neighbours": 8},
    "prmstar": {"milestones": 100},
}
"""Smaller than the defaults, for the benchmark's own time; states per planner stay comparable across scenes."""


def _planner(name: str) -> Planner:
    planner: Planner = PLANNERS[name](**SETTINGS.get(name, {}))
    return planner


def _pass(names: Sequence[str]) -> dict[tuple[str, str, int], PlanResult]:
    """Every planner, in the order of ``names``, on every query, with fresh services."""
    services = {scene: PlannerService(queries.ROBOT, scene) for scene in PLANNED_SCENES}
    return {
        (name, scene, query.number): plan(services[scene], query, planner=_planner(name))
        for name in names
        for scene in PLANNED_SCENES
        for query in queries.load(scene)[:PER_SCENE]
    }


def _same(a: PlanResult, b: PlanResult) -> bool:
    """Whether two results agree in every count and in every bit of the path."""
    counts = [[(report.stage, report.counts) for report in result.stages] for result in (a, b)]
    points = [None if result.path is None else result.path.waypoints.tobytes() for result in (a, b)]
    return counts[0] == counts[1] and points[0] == points[1]


def run() -> Report:
    """Run all planners twice, the second time in reverse order."""
    names = list(PLANNERS)
    first, again = _pass(names), _pass(names[::-1])
    rows = [_row(key, result, _same(result, again[key])) for key, result in first.items()]
    lines = [_line(name, scene, rows) for name in names for scene in PLANNED_SCENES]
    caption = (
        f"Medians over {PER_SCENE} queries a scene, MotionStep(0.010), default budget (fmt, bfmt: one try of 400,000 "
        "states); states include shortcutting, not the roadmap. Anytime planners stop improving at 4,000 states."
    )
    different = [f"{row['planner']} {row['query']}" for row in rows if not row["rerun_equal"]]
    text = "every planner: rerun in another order, equal counts and bits"
    promise = Promise(text, ", ".join(different) or "all", not different)
    return Report("planners", tuple(rows), (table_of("All planners", lines, caption=caption),), (promise,))


def _row(key: tuple[str, str, int], result: PlanResult, equal: bool) -> Row:
    name, scene, number = key
    roadmap = result.stage(Stage.ROADMAP).counts.states
    return {
        "planner": name,
        "scene": scene,
        "query": f"{scene}-{number:02d}",
        "solved": result.ok,
        "failure": None if result.failure is None else str(result.failure),
        "states": result.counts.states - roadmap,
        "search": result.stage(Stage.SEARCH).counts.states,
        "roadmap": roadmap,
        "found": result.stage(Stage.SEARCH).length,
        "final": None if result.path is None else result.path.length,
        "seconds": result.seconds,
        "rerun_equal": equal,
    }


def _line(name: str, scene: str, rows: Sequence[Row]) -> Row:
    here = [row for row in rows if (row["planner"], row["scene"]) == (name, scene)]
    solved = [row for row in here if row["solved"]]

    def middle(key: str, digits: int = 0) -> str:
        known = [row[key] for row in (here if digits == 0 else solved) if row[key] is not None]
        return f"{p50(known):,.{digits}f}" if known else "-"

    return {
        "planner": name,
        "scene": scene,
        "solved": f"{len(solved)}/{len(here)}",
        **{key: middle(key) for key in ("states", "search", "roadmap")},
        **{f"{key} rad": middle(key, 2) for key in ("found", "final")},
        "seconds": f"{p50(row['seconds'] for row in here):.2f}",
        "rerun equal": f"{sum(row['rerun_equal'] for row in here)}/{len(here)}",
    }
