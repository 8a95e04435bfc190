"""The public Panda problems of MotionBenchMaker, planned as a newcomer would, and judged by code that is not ours.

Every motion is judged twice by Coal: as it is executed in time, at the step with which planners are usually audited,
and along its curve so finely that little can hide between two samples.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, p50, spread, table
from planner_service import PlannerService, PlanRequest, PlanResult, Robot, Stage, Trajectory
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.records.problem_set import Problem, ProblemSet, read_problems
from planner_service.robot.model import load_robot

if TYPE_CHECKING:
    from auditor.checker import IndependentChecker

__all__ = [
    "JOINT_STEP",
    "MOTION_STEP",
    "ROBOT",
    "SEED",
    "asked",
    "by_kind",
    "instants",
    "kind_of",
    "planned",
    "public_problems",
    "run",
]

ROBOT = "panda_mbm"
SEED = 0
FILE = Path(__file__).parents[1] / "problems" / "mbm_panda.json"

JOINT_STEP, MOTION_STEP = 0.01, 0.0002
"""Between samples of an audit: radians that a joint turns, metres that any point of the robot moves, at most."""

SOON = 1.0
"""Seconds that a person waits without a thought."""

STAGES = (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH, Stage.SHORTCUT, Stage.POLISH)


@cache
def public_problems() -> ProblemSet:
    """The 70 problems: ten of each of seven scenes."""
    return read_problems(FILE)


def kind_of(problem: Problem) -> str:
    """The scene of which a problem is one, such as ``cage``."""
    return problem.id.partition("/")[0]


def planned(robot: Robot, problem: Problem) -> PlanResult:
    """The plan of a default request, but that no clock has a say."""
    return PlannerService(robot, problem.scene).plan(asked(robot, problem))


def asked(robot: Robot, problem: Problem) -> PlanRequest:
    """A default request, but that no clock has a say."""
    return problem.request(robot, seed=SEED, time_limit=None)


def _rows() -> Iterator[Row]:
    from auditor.checker import IndependentChecker, tables_of

    robot = load_robot(ROBOT)
    planned(robot, public_problems().problems[0])  # what is imported and built once is not a problem's own
    for problem in public_problems().problems:
        clock = time.process_time()
        result = planned(robot, problem)
        seconds = time.process_time() - clock
        second = IndependentChecker(data_folder("robots") / ROBOT, tables_of(problem.scene))
        yield _told(problem, result, seconds) | _audited(second, result)


def _told(problem: Problem, result: PlanResult, seconds: float) -> Row:
    path, trajectory, proof = result.path, result.trajectory, result.certificate
    row: Row = {
        "kind": kind_of(problem),
        "problem": problem.id,
        "failure": None if result.failure is None else str(result.failure),
        "seconds": seconds,
        "states": {report.stage.value: report.counts.states for report in result.stages},
        "edges": result.counts.edges,
        "bounds": result.counts.distances,
        "attempts": result.attempts,
        "notes": list(result.notes),
    }
    if path is None or trajectory is None or proof is None:
        return row
    searched = result.stage(Stage.SEARCH).length
    return row | {
        "raw": path.length if searched is None else searched,
        "length": path.length,
        "clearance": proof.clearance,
        "duration": trajectory.duration,
    }


def _audited(second: IndependentChecker, result: PlanResult) -> Row:
    """What Coal says of a motion in time, and of its curve; None where nothing touches."""
    if result.path is None or result.trajectory is None:
        return {"in time": None, "on curve": None}
    touches = [
        next((second.touch(q) for q in instants(result.trajectory) if not second.free(q)), None),
        second.curve_touch(result.path, result.path.length, MOTION_STEP),
    ]
    in_time, on_curve = (None if touch is None else f"{touch.a} x {touch.b}" for touch in touches)
    return {"in time": in_time, "on curve": on_curve}


def instants(trajectory: Trajectory, step: float = JOINT_STEP) -> FloatArray:
    """Configurations (m, n) of a motion, no joint turning more than ``step`` (rad) from one to the next."""
    count = 2 + math.ceil(trajectory.path.length / step)
    while True:
        Q = trajectory(np.linspace(0.0, trajectory.duration, count))
        if np.abs(np.diff(Q, axis=0)).max() <= step:
            return np.asarray(Q)
        count *= 2


def run() -> Report:
    """Plan all problems, and audit."""
    rows = tuple(_rows())
    return Report("problems", rows, (_outcome_table(rows), _states_table(rows)), _promises(rows))


def by_kind(rows: Sequence[Row]) -> Iterator[tuple[str, list[Row]]]:
    """The rows of each scene, and all of them at last."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        yield kind, [row for row in rows if row["kind"] == kind]
    yield "all", list(rows)


def _done(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["failure"] is None]


def _rejected(rows: Sequence[Row], audit: str) -> list[str]:
    return [f"{row['problem']}: {row[audit]}" for row in rows if row[audit] is not None]


def _median(rows: Sequence[Row], key: str, digits: int = 2, scale: float = 1.0) -> str:
    return f"{p50(row[key] * scale for row in rows):,.{digits}f}" if rows else "-"


def _outcome_table(rows: Sequence[Row]) -> Table:
    def cells(kind: str, here: Sequence[Row]) -> list[str]:
        done = _done(here)
        return [
            kind,
            f"{len(done)}/{len(here)}",
            str(sum(row["seconds"] <= SOON for row in done)),
            *(str(len(_rejected(here, audit))) for audit in ("in time", "on curve")),
            spread([row["seconds"] * 1e3 for row in here]),
            _median(done, "raw"),
            _median(done, "length"),
            _median(done, "duration"),
            f"{min((row['clearance'] for row in done), default=math.nan) * 1e3:.2f}",
            _median(done, "clearance", scale=1e3),
        ]

    columns = (
        "scene",
        "solved",
        f"within {SOON:g} s",
        f"rejected {JOINT_STEP:g} rad",
        f"rejected {MOTION_STEP * 1e3:g} mm",
        "ms",
        "raw rad",
        "final rad",
        "motion s",
        "least proven mm",
        "proven mm p50",
    )
    caption = (
        f"Robot {ROBOT}; the default request with seed {SEED}, ended by checks and by no clock. Rejected: by Coal, in "
        f"time at {JOINT_STEP:g} rad per joint, on the curve at {MOTION_STEP * 1e3:g} mm motion steps. ms: CPU time of "
        "the whole plan, proof and timing included, p50 / p95, failures with what they spent. Other figures: p50."
    )
    return table("Public problems", columns, (cells(*each) for each in by_kind(rows)), caption=caption)


def _states_table(rows: Sequence[Row]) -> Table:
    def cells(kind: str, here: Sequence[Row]) -> list[str]:
        stages = [[row["states"].get(stage.value, 0) for row in here] for stage in STAGES]
        totals = [sum(row["states"].values()) for row in here]
        return [
            kind,
            *(spread(counts) for counts in stages),
            spread(totals),
            spread([row["edges"] for row in here]),
            spread([row["bounds"] for row in here]),
            str(max(row["attempts"] for row in here)),
        ]

    columns = ("scene", *(stage.value for stage in STAGES), "states", "edges", "bounds", "most tries")
    caption = "p50 / p95; failures with what they spent. Bounds: of the certificates."
    return table("What the public problems cost", columns, (cells(*each) for each in by_kind(rows)), caption=caption)


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    done, failed = _done(rows), [f"{row['problem']}: {row['failure']}" for row in rows if row["failure"] is not None]
    promises = [
        Promise(
            f"{len(rows)} of {len(rows)} public problems solved within the default checks, without a clock",
            "; ".join(failed) or f"all; {sum(row['seconds'] <= SOON for row in done)} within {SOON:g} s of CPU time",
            not failed,
        )
    ]
    for audit, step in (("in time", f"{JOINT_STEP:g} rad per joint"), ("on curve", f"{MOTION_STEP * 1e3:g} mm")):
        found = _rejected(done, audit)
        promises.append(Promise(f"0 rejected by Coal, {audit} at {step}", "; ".join(found) or "none", not found))
    return tuple(promises)
