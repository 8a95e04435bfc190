"""Whole pick-and-places: straight lines on a clear table, the planner where a post stands in the way."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.harness.sources import block, tray
from benchmarks.worlds import queries
from planner_service import PlannerService, PlanRequest, Scene, Stage, load_scene
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.tasks.result import Segment

__all__ = ["clear_table", "run"]

SHOWN = (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH, Stage.SHORTCUT, Stage.POLISH)


def clear_table() -> Scene:
    """The table with a block and a tray to put it on, and nothing else."""
    return load_scene("table").with_obstacle(block(0.30, -0.10)).with_obstacle(tray(0.20, 0.28))


def _scenes() -> dict[str, Scene]:
    bin_ = load_scene("bin")
    return {"clear table": clear_table(), "bin without its post": bin_.without("demo_post"), "bin": bin_}


def run() -> Report:
    """Plan the task in each scene, the lines' step being MotionStep(0.010)."""
    rows: list[Row] = []
    for name, scene in _scenes().items():
        service = PlannerService(queries.ROBOT, scene)
        request = PlanRequest(service.robot.home, service.robot.home, time_limit=None)
        task = plan_pick_place(service, "blue_block", "tray", request)
        rows += [_row(name, segment) for segment in task.segments]
        whole = {"scene": name, "segment": "choosing grasps", "ok": task.failure is None}
        rows.append(whole | {"states": task.choosing.states, "edges": task.choosing.edges, "stages": {}})
    clear = [row for row in rows if row["scene"] == "clear table" and row["stages"]]
    searched = sum(row["stages"].get(Stage.SEARCH.value, 0) for row in clear)
    twice = [row["segment"] for row in clear if row["edges"] != row["pieces"]]
    promises = (
        Promise("every pick-and-place is planned", _names(rows, "ok"), all(row["ok"] for row in rows)),
        Promise("clear table: 0 states in SEARCH", str(searched), searched == 0),
        Promise("clear table: each piece of each segment judged once", ", ".join(twice) or "all", not twice),
    )
    return Report("tasks", tuple(rows), (table_of("Pick-and-place", map(_line, rows)),), promises)


def _names(rows: Iterable[Row], key: str) -> str:
    return ", ".join(f"{row['scene']}: {row['segment']}" for row in rows if not row[key]) or "all"


def _row(scene: str, segment: Segment) -> Row:
    result = segment.result
    return {
        "scene": scene,
        "segment": segment.name,
        "ok": result.ok,
        "states": result.counts.states,
        "edges": result.counts.edges,
        "pieces": 0 if result.path is None else len(result.path.waypoints) - 1,
        "stages": {report.stage.value: report.counts.states for report in result.stages},
        "length": None if result.path is None else result.path.length,
        "duration": None if result.trajectory is None else result.trajectory.duration,
        "seconds": result.seconds,
    }


def _line(row: Row) -> Row:
    def number(key: str, scale: float = 1.0, digits: int = 2) -> str:
        return "-" if row.get(key) is None else f"{row[key] * scale:.{digits}f}"

    return {
        **{key: row[key] for key in ("scene", "segment")},
        **{stage.value: row["stages"].get(stage.value, "-") for stage in SHOWN},
        **{key: row[key] for key in ("states", "edges")},
        "pieces": number("pieces", digits=0),
        "rad": number("length"),
        "motion s": number("duration"),
        "ms": number("seconds", 1e3, 0),
    }
