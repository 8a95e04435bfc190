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

from rich.table import Table

from benchmarks.harness.audit import JOINT_STEP, independent, touch_in_time, touch_on_curve
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, spread, table_of
from planner_service import PlannerService, PlanRequest, PlanResult, Robot, Stage
from planner_service.records.problem_set import Problem, ProblemSet, read_problems
from planner_service.robot.model import load_robot

__all__ = ["MOTION_STEP", "ROBOT", "SEED", "asked", "by_kind", "kind_of", "planned", "public_problems", "run"]

ROBOT = "panda_mbm"
SEED = 0
FILE = Path(__file__).parents[1] / "problems" / "mbm_panda.json"

MOTION_STEP = 0.0002
"""Metres that any point of the robot moves at most between two samples of a curve that is audited."""

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
    robot = load_robot(ROBOT)
    planned(robot, public_problems().problems[0])  # what is imported and built once is not a problem's own
    for problem in public_problems().problems:
        clock = time.process_time()
        result = planned(robot, problem)
        seconds = time.process_time() - clock
        yield _told(problem, result, seconds) | _audited(problem, result)


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


def _audited(problem: Problem, result: PlanResult) -> Row:
    """What Coal says of a motion in time, and of its curve; None where nothing touches."""
    if result.path is None or result.trajectory is None:
        return {"in time": None, "on curve": None}
    second = independent(ROBOT, problem.scene)
    on_curve = touch_on_curve(second, result.path, MOTION_STEP)
    return {"in time": touch_in_time(second, result.trajectory), "on curve": on_curve}


def run() -> Report:
    """Plan all problems, and audit."""
    rows = tuple(_rows())
    return Report("problems", rows, (_outcome_table(rows), _states_table(rows)), _promises(rows))


def by_kind(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """The rows of each scene, and all of them at last."""
    return [*grouped(rows, "kind").items(), ("all", list(rows))]


def _done(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["failure"] is None]


def _rejected(rows: Sequence[Row], audit: str) -> list[str]:
    return [f"{row['problem']}: {row[audit]}" for row in rows if row[audit] is not None]


def _median(rows: Sequence[Row], key: str, scale: float = 1.0) -> str:
    return f"{p50(row[key] * scale for row in rows):,.2f}" if rows else "-"


def _outcome(kind: str, rows: Sequence[Row]) -> Row:
    done = _done(rows)
    return {
        "scene": kind,
        "solved": f"{len(done)}/{len(rows)}",
        f"within {SOON:g} s": sum(row["seconds"] <= SOON for row in done),
        f"rejected {JOINT_STEP:g} rad": len(_rejected(rows, "in time")),
        f"rejected {MOTION_STEP * 1e3:g} mm": len(_rejected(rows, "on curve")),
        "ms": spread([row["seconds"] * 1e3 for row in rows]),
        "raw rad": _median(done, "raw"),
        "final rad": _median(done, "length"),
        "motion s": _median(done, "duration"),
        "least proven mm": f"{min((row['clearance'] for row in done), default=math.nan) * 1e3:.2f}",
        "proven mm p50": _median(done, "clearance", scale=1e3),
    }


def _outcome_table(rows: Sequence[Row]) -> Table:
    caption = (
        f"Robot {ROBOT}; the default request with seed {SEED}, ended by checks and by no clock. Rejected: by Coal, in "
        f"time at {JOINT_STEP:g} rad per joint, on the curve at {MOTION_STEP * 1e3:g} mm motion steps. ms: CPU time of "
        "the whole plan, proof and timing included, p50 / p95, failures with what they spent. Other figures: p50."
    )
    return table_of("Public problems", (_outcome(*each) for each in by_kind(rows)), caption=caption)


def _cost(kind: str, rows: Sequence[Row]) -> Row:
    return {
        "scene": kind,
        **{stage.value: spread([row["states"].get(stage.value, 0) for row in rows]) for stage in STAGES},
        "states": spread([sum(row["states"].values()) for row in rows]),
        **{key: spread([row[key] for row in rows]) for key in ("edges", "bounds")},
        "most tries": max(row["attempts"] for row in rows),
    }


def _states_table(rows: Sequence[Row]) -> Table:
    caption = "p50 / p95; failures with what they spent. Bounds: of the certificates."
    return table_of("What the public problems cost", (_cost(*each) for each in by_kind(rows)), caption=caption)


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    done, failed = _done(rows), [f"{row['problem']}: {row['failure']}" for row in rows if row["failure"] is not None]
    text = f"{len(rows)} of {len(rows)} public problems solved within the default checks, without a clock"
    soon = f"all; {sum(row['seconds'] <= SOON for row in done)} within {SOON:g} s of CPU time"
    promises = [Promise(text, "; ".join(failed) or soon, not failed)]
    for audit, step in (("in time", f"{JOINT_STEP:g} rad per joint"), ("on curve", f"{MOTION_STEP * 1e3:g} mm")):
        found = _rejected(done, audit)
        promises.append(Promise(f"0 rejected by Coal, {audit} at {step}", "; ".join(found) or "none", not found))
    return tuple(promises)
