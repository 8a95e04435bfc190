"""The public Panda problems again, for speed: our search next to OMPL's with Coal, and what default plans take.

Both sides search with RRTConnect, the same range, seed and distance between the samples of an edge, without padding.
Every search starts from nothing; only the checkers of a scene stand ready. What counts is the least of a few turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.baselines.plain_ompl import BATCHED, Setup, coal_edges
from benchmarks.harness.audit import independent, touch_in_time
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, p50, p95, spread, table_of
from benchmarks.studies.problems import ROBOT, SEED, asked, by_kind, kind_of, public_problems
from planner_service import CollisionChecker, JointStep, PlannerService, PlanResult, Robot, RRTConnect, Stage
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.records.problem_set import Problem
from planner_service.robot.model import load_robot
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem

__all__ = ["AUDIT", "OURS", "STEP", "promises", "rows_of", "run"]

STEP = 0.05
"""Radians between samples of an edge at most, L2 over all joints."""

AUDIT = 0.005
"""Radians that a joint turns at most between two instants of a motion that Coal judges."""

TURNS = 3
GIVE_UP = 60.0
"""Seconds after which a search by hand counts as one without a path."""

OURS = "ours"

FASTER, SEARCH_P50, SEARCH_P95, SHORTENED_P50, LENGTH_P50 = 3.0, 2.0, 40.0, 8.0, 4.8
"""Promised: times as fast as OMPL with Coal at p50 and p95; milliseconds; radians."""


def _timed(works: dict[str, Callable[[], Any]], turns: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Milliseconds of CPU of each, the least of some turns taken by turns, and what each gave at last."""
    least, given = dict.fromkeys(works, np.inf), dict[str, Any]()
    for _ in range(turns):
        for name, work in works.items():
            ms, given[name] = cpu_ms(work)
            least[name] = min(least[name], ms)
    return least, given


def searched(robot: Robot, problem: Problem, turns: int = TURNS) -> Row:
    """The searches of both sides: milliseconds, the length of the path of each, and whether all are the same."""
    checker = CollisionChecker(robot, problem.scene, edge_step=JointStep(STEP))
    limits, planner = robot.limits, RRTConnect()
    (goal,) = problem.goals
    setup = Setup(problem.start, goal, limits.lower, limits.upper, STEP, planner.range, SEED, GIVE_UP)

    def ours() -> FloatArray | None:
        ends = (problem.start, goal[None], limits.lower, limits.upper)
        return planner.search(SearchProblem(*ends, oracle=SearchOracle(checker), seed=SEED)).waypoints

    works: dict[str, Callable[[], Any]] = {OURS: ours}
    for name, edges in coal_edges(robot, problem.scene).items():
        works[name] = lambda edges=edges: setup.search(edges)  # type: ignore[misc]
    ms, found = _timed(works, turns)
    raw = {name: None if points is None else JointPath(points).length for name, points in found.items()}
    points = [None if path is None else path.tolist() for path in found.values()]
    return {"ms": ms, "raw": raw, "same": points[1:] == points[:-1]}


def planned(robot: Robot, problem: Problem, turns: int = TURNS) -> Row:
    """Whole plans by the default service and request: the first, and the least of those that follow."""
    clock = time.process_time()
    service = PlannerService(robot, problem.scene)
    result = service.plan(asked(robot, problem))
    first = (time.process_time() - clock) * 1e3
    again = [cpu_ms(lambda: _stage_ms(service.plan(asked(robot, problem)))) for _ in range(turns)]
    row: Row = {
        "failure": None if result.failure is None else str(result.failure),
        "first ms": first,
        "whole ms": min(ms for ms, _ in again),
        "search ms": min(stages[0] for _, stages in again),
        "search and shortcut ms": min(sum(stages) for _, stages in again),
    }
    if result.path is None or result.certificate is None:
        return row | {"length": None, "certified": False, "rejected": None}
    assert result.trajectory is not None
    rejected = touch_in_time(independent(robot.name, problem.scene), result.trajectory, AUDIT)
    return row | {"length": result.path.length, "certified": result.certificate.certified, "rejected": rejected}


def _stage_ms(result: PlanResult) -> tuple[float, float]:
    """Milliseconds of the search, and of cutting its path short."""
    first, second = (result.stage(stage).seconds * 1e3 for stage in (Stage.SEARCH, Stage.SHORTCUT))
    return first, second


def rows_of(problems: Sequence[Problem], turns: int = TURNS) -> Iterator[Row]:
    """A row a problem."""
    robot = load_robot(ROBOT)
    searched(robot, problems[0], 1)  # what is imported and built once is not a problem's own
    for problem in problems:
        row = {"kind": kind_of(problem), "problem": problem.id}
        yield row | searched(robot, problem, turns) | {"plan": planned(robot, problem, turns)}


def run() -> Report:
    """Search and plan all problems; about two minutes."""
    rows = tuple(rows_of(public_problems().problems))
    return Report("panda", rows, (_search_table(rows), _plan_table(rows)), promises(rows))


def _others(rows: Sequence[Row]) -> list[str]:
    return [name for name in rows[0]["ms"] if name != OURS]


def _ms(rows: Sequence[Row], name: str) -> list[float]:
    return [row["ms"][name] for row in rows]


def _ratios(rows: Sequence[Row], others: Sequence[str] = ()) -> tuple[float, float]:
    """How many times as long the fastest of some others, or of all, takes, at p50 and at p95."""
    names = others or _others(rows)
    first, second = (min(at(_ms(rows, name)) for name in names) / at(_ms(rows, OURS)) for at in (p50, p95))
    return first, second


def _search_table(rows: Sequence[Row]) -> Table:
    def line(kind: str, here: Sequence[Row]) -> Row:
        found = sum(row["raw"][OURS] is not None for row in here)
        times = {name: spread(_ms(here, name), 2) for name in (OURS, *_others(rows))}
        same, (ratio, ratio_p95) = sum(row["same"] for row in here), _ratios(here)
        told = {"scene": kind, "found": f"{found}/{len(here)}", "same": same}
        return told | times | {"x p50": f"{ratio:.1f}", "x p95": f"{ratio_p95:.1f}"}

    caption = (
        f"CPU ms, p50 / p95: RRTConnect(range={RRTConnect().range:g}), seed {SEED}, no padding, edges sampled at most "
        f"{STEP:g} rad apart (L2). Ours: OMPL through our checker. The others: OMPL with a validator in Python that "
        "has Coal judge each edge. x: the fastest of the others next to ours. Same: paths equal to the last bit."
    )
    return table_of("Searches of the public problems", (line(*each) for each in by_kind(rows)), caption=caption)


def _plan_table(rows: Sequence[Row]) -> Table:
    keys = ("search ms", "search and shortcut ms", "whole ms", "first ms")

    def line(kind: str, here: Sequence[Row]) -> Row:
        plans = [row["plan"] for row in here]
        lengths = [plan["length"] for plan in plans if plan["certified"]]
        return {
            "scene": kind,
            "certified": f"{len(lengths)}/{len(here)}",
            f"rejected {AUDIT:g} rad": sum(plan["rejected"] is not None for plan in plans),
            **{key: spread([plan[key] for plan in plans], 1) for key in keys},
            "rad p50": f"{p50(lengths):.2f}" if lengths else "-",
        }

    caption = (
        f"The default request, seed {SEED}, no clock: padded by 1 mm, no point moves 10 mm between samples of an edge. "
        f"Rejected: by Coal, in time at {AUDIT:g} rad per joint. p50 / p95; stages by the clock, whole plans in CPU "
        "time; first: by a new service, its checkers' making included."
    )
    return table_of("Default plans", (line(*each) for each in by_kind(rows)), caption=caption)


def promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    plans = [row["plan"] for row in rows]
    lost = [row["problem"] for row in rows if row["raw"][OURS] is None or not row["plan"]["certified"]]
    rejected = [f"{row['problem']}: {row['plan']['rejected']}" for row in rows if row["plan"]["rejected"] is not None]
    ours, ratios = _ms(rows, OURS), _ratios(rows, [name for name in _others(rows) if name in BATCHED])
    shortened = p50(plan["search and shortcut ms"] for plan in plans)
    lengths = [plan["length"] for plan in plans if plan["certified"]]
    length = p50(lengths) if lengths else np.inf
    search, most = (
        f"search at most {SEARCH_P50:g} ms at p50, {SEARCH_P95:g} ms at p95",
        f"at most {SHORTENED_P50:g} ms at p50",
    )
    return (
        Promise(f"{len(rows)} of {len(rows)} Panda problems searched, planned and certified", _all(lost), not lost),
        Promise(f"0 rejected by Coal in time at {AUDIT:g} rad per joint", _all(rejected, "none"), not rejected),
        Promise(
            f"OMPL with one Coal call an edge takes {FASTER:g} times as long to search, at p50 and p95",
            f"{_pair(ratios)}; the fastest way to ask Coal {_pair(_ratios(rows))}",
            min(ratios) >= FASTER,
        ),
        Promise(search, spread(ours, 2), p50(ours) <= SEARCH_P50 and p95(ours) <= SEARCH_P95),
        Promise(f"search and shortcut of a plan {most}", f"{shortened:.2f}", shortened <= SHORTENED_P50),
        Promise(f"certified length at most {LENGTH_P50:g} rad at p50", f"{length:.2f}", length <= LENGTH_P50),
    )


def _pair(ratios: tuple[float, float]) -> str:
    return " / ".join(f"{ratio:.1f}" for ratio in ratios)


def _all(exceptions: Sequence[str], none: str = "all") -> str:
    return "; ".join(exceptions) or none
