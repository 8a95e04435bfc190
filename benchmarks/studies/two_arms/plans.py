"""Two arms with clocks of their own: how many random queries are solved, what it costs, and whether anything touches.

Starts and goals are drawn free, for both arms together. Each plan is carried out many times with arms that are late by
as much as it says that it tolerates, each for itself: by a constant, or by another amount at every moment. Coal judges
the motions. Beside it the same query is planned as one robot with one clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.progress import track
from rich.table import Table

import planner_service as ps
from benchmarks.harness.audit import Auditor
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, p95, spread, table_of
from benchmarks.studies.arms import arms_in, motions_of
from benchmarks.worlds.foreign import table_of_robot
from benchmarks.worlds.placed import table_of_arms
from planner_service.cell import Arm, Cell, CellPlan
from planner_service.geometry.arrays import FloatArray

__all__ = ["EXECUTIONS", "QUERIES", "dual", "run"]

QUERIES = 100
"""Of each scene."""

EXECUTIONS = 25
"""Of each plan, with arms that are late."""

MOMENTS = 60
"""Of an execution, at which it is judged."""

DELAY = 0.05
"""Seconds that plans are asked to tolerate."""

LARGEST_DELAY = 0.5
"""Seconds by which arms are late at most in an execution."""

SCENES = ("shelf", "bin")

MEDIAN, TAIL, SHARE = 30.0, 200.0, 0.85
"""Milliseconds of a plan, and the part of the time that the motion takes with one clock."""


def run(queries: int | None, seed: int, problems: Path | None) -> Report:
    """Plan that many random queries in each scene, and the published problems of Baxter if their folder is given."""
    rows = [row for scene in SCENES for row in _random(scene, QUERIES if queries is None else queries, seed)]
    if problems is not None:
        rows += _baxter(problems, seed)
    return Report("two-arms", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def arms_of(robot: ps.Robot) -> dict[str, list[str]]:
    """The joints of a left and a right arm, by their names."""
    return {side: [name for name in robot.joint_names if name.startswith(f"{side}_")] for side in ("left", "right")}


def dual(scene: str) -> Cell:
    """Two WidowX AI, which face each other, in a scene."""
    robot = ps.load_robot("wxai_dual")
    return Cell.of(robot, arms_of(robot), scene, tools={"right": "right_ee_gripper_link"})


def pandas(scene: str, folder: Path) -> tuple[Cell, Auditor]:
    """Two Pandas side by side in a scene, and who judges them."""
    places = {side: ("panda", ps.Pose((-0.15, y, 0.0))) for side, y in (("left", 0.3), ("right", -0.3))}
    cell = Cell({side: Arm(ps.load_robot(robot), base) for side, (robot, base) in places.items()}, scene)
    return cell, Auditor(table_of_arms(places, folder), cell.scene)


def _random(scene: str, queries: int, seed: int) -> Iterator[Row]:
    with TemporaryDirectory() as place:
        cell = dual(scene)
        cells = {"wxai_dual": (cell, Auditor("wxai_dual", cell.scene)), "two Pandas": pandas(scene, Path(place))}
        for name, (cell, auditor) in cells.items():
            rng = np.random.default_rng([seed, len(scene)])
            for k in track(range(queries), description=f"{name} in {scene}", transient=True):
                start, goal = (_free(cell, rng) for _ in range(2))
                yield {"cell": f"{name} in {scene}", "query": k} | _planned(cell, start, goal, 0, rng, auditor)


def _free(cell: Cell, rng: np.random.Generator) -> FloatArray:
    limits, checker = cell.robot.limits, cell.service.checker
    while True:
        q = rng.uniform(limits.lower, limits.upper)
        if checker.state_is_free(q):
            return np.asarray(q)


def _baxter(folder: Path, seed: int) -> Iterator[Row]:
    (arm,) = arms_in(folder, "baxter")
    robot = ps.load_robot(arm.source)
    rng = np.random.default_rng([seed, robot.n])
    with TemporaryDirectory() as place:
        known: Mapping[str, Any] = table_of_robot(robot, arm.source, Path(place))
        for motion in track(list(motions_of(arm, robot)), description="baxter", transient=True):
            cell = Cell.of(robot, arms_of(robot), motion.scene)
            goal = next(goal for goal in motion.goals if isinstance(goal, np.ndarray))
            auditor = Auditor(known, motion.scene)
            for turn in range(5):
                row = _planned(cell, motion.start, goal, turn, rng, auditor)
                yield {"cell": "baxter, published", "query": motion.id, "seed": turn} | row


def _planned(
    cell: Cell, start: FloatArray, goal: FloatArray, seed: int, rng: np.random.Generator, auditor: Auditor
) -> Row:
    """A query planned with own clocks and with one, and judged."""
    requests = {
        name: ps.PlanRequest(cell.of_arm(name, start), cell.of_arm(name, goal), seed=seed) for name in cell.arms
    }
    ms, plan = cpu_ms(partial(cell.plan, requests, delay=DELAY))
    one_ms, one = cpu_ms(partial(cell.service.plan, ps.PlanRequest(start, goal, seed=seed)))
    row: Row = {"ok": plan.ok, "ms": ms, "why": "" if plan.failure is None else str(plan.failure)}
    row |= {"one ok": one.ok, "one ms": one_ms, "rectangles": plan.rectangles, "start": start.tolist()}
    row |= {"goal": goal.tolist(), "shared": len(plan.clocks) == 1, "audit": None, "touched": 0, "executions": 0}
    if not plan.ok:
        return row
    row |= {"seconds": plan.duration, "tolerates": plan.tolerates, "states": plan.counts.states}
    row["one seconds"] = None if one.trajectory is None else one.trajectory.duration
    row["audit"] = auditor.judge(plan(np.linspace(0.0, plan.duration, 20 * MOMENTS)))["verdict"]
    row["executions"] = EXECUTIONS
    row["touched"] = sum(auditor.judge(Q)["verdict"] != "free" for Q in _late(cell, plan, rng))
    return row


def _late(cell: Cell, plan: CellPlan, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Executions (moments, n) with arms that are late."""
    most = min(plan.tolerates, LARGEST_DELAY)
    times = np.linspace(0.0, plan.duration, MOMENTS)
    for k in range(EXECUTIONS):
        constant = k % 2 == 0
        late = {name: rng.uniform(0.0, most, 1 if constant else MOMENTS) * np.ones(MOMENTS) for name in cell.arms}
        yield plan(times, late)


def _table(rows: Sequence[Row]) -> Table:
    def line(name: str, here: Sequence[Row]) -> Row:
        done = [row for row in here if row["ok"]]
        both = [row["seconds"] / row["one seconds"] for row in done if row["one seconds"]]
        return {
            "cell": name,
            "queries": len(here),
            "planned": len(done),
            "with one clock": sum(row["one ok"] for row in here),
            "CPU ms": spread([row["ms"] for row in here], 1),
            "one clock, CPU ms": spread([row["one ms"] for row in here], 1),
            "share of its time": spread(both, 2) if both else "",
            "tolerates s": f"{p50([min(row['tolerates'], 9.9) for row in done]):.2f}" if done else "",
            "shared clocks": sum(row["shared"] for row in done),
            "touching": sum(row["audit"] != "free" for row in done),
            "late executions touching": f"{sum(r['touched'] for r in done)} of {sum(r['executions'] for r in done):,}",
        }

    caption = "p50 / p95, failures included in the times. Share of its time: of the same query planned with one clock."
    return table_of("Two arms", [line(*each) for each in grouped(rows, "cell").items()], caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    for name, here in grouped(rows, "cell").items():
        done = [row for row in here if row["ok"]]
        missed = sum(row["one ok"] and not row["ok"] for row in here)
        ms = [row["ms"] for row in here]
        yield Promise(f"{name}: whatever is planned with one clock is planned", f"{missed} missed", not missed)
        yield Promise(f"{name}: at most {MEDIAN:g} ms p50", f"{p50(ms):.1f} ms", p50(ms) <= MEDIAN)
        yield Promise(f"{name}: at most {TAIL:g} ms p95", f"{p95(ms):.1f} ms", p95(ms) <= TAIL)
        shares = [row["seconds"] / row["one seconds"] for row in done if row["one seconds"]]
        if shares:
            text = f"{name}: at most {SHARE} of the time with one clock, p50"
            yield Promise(text, f"{p50(shares):.2f}", p50(shares) <= SHARE)
    touching = sum(row["audit"] not in (None, "free") for row in rows)
    late, executions = (sum(row[key] for row in rows) for key in ("touched", "executions"))
    yield Promise("no plan touches, by Coal", f"{touching} of {len(rows)}", not touching)
    yield Promise("no execution with late arms touches, by Coal", f"{late} of {executions:,}", not late)
