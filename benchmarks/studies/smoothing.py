"""Whether compiled smoothing finds what its reference in Python finds, with as many states and edges, and how fast.

Both smooth what the default planner finds for the public Panda problems, each with an oracle of its own on the same
kernel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from benchmarks.studies.problems import ROBOT, kind_of, public_problems
from planner_service import BalancedRRTConnect, CheckCounts, CollisionChecker, JointPath, Robot
from planner_service.collision.edge_sampling import Known
from planner_service.geometry.arrays import FloatArray
from planner_service.records.problem_set import Problem
from planner_service.robot.model import load_robot
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import CoarseOracle, Configuration, SearchProblem
from planner_service.smoothing.smoothing import blended, pulled_in, shortcut, without_short_pieces

__all__ = ["PATHS", "run"]

PATHS = 500

BLEND, PADDING = 0.4, 0.001
"""The widest blend in radians, and metres that are kept from everything."""

Smoothed = tuple[list[bytes], CheckCounts]
"""What each step makes of a path, and what all steps counted."""


class _Uncompiled:
    """An oracle without its compiled part."""

    def __init__(self, oracle: SearchOracle) -> None:
        self._oracle = oracle

    @property
    def states(self) -> int:
        return self._oracle.states

    def state_is_free(self, q: Configuration) -> bool:
        return self._oracle.state_is_free(q)

    def edge_is_free(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        return self._oracle.edge_is_free(q1, q2, known=known)

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        return self._oracle.edge_is_free_coarse(q1, q2, known=known)


def run(paths: int = PATHS) -> Report:
    """Smooth that many paths twice; about a minute for 500."""
    rows = tuple(_rows(paths))
    return Report("smoothing", rows, (_table(rows),), tuple(_promises(rows)))


def _rows(paths: int) -> Iterator[Row]:
    robot, problems, seed = load_robot(ROBOT), public_problems().problems, 0
    while paths > 0:
        for problem in problems[:paths]:
            checker = CollisionChecker(robot, problem.scene, padding=PADDING)
            found = _found(robot, checker, problem, seed)
            if found is not None:
                yield {"kind": kind_of(problem), "problem": problem.id, "seed": seed} | _row(checker, found, seed)
        paths, seed = paths - len(problems), seed + 1


def _found(robot: Robot, checker: CollisionChecker, problem: Problem, seed: int) -> FloatArray | None:
    """The path of a search, if it finds one."""
    limits, ends = robot.limits, (problem.start, np.array(problem.goals))
    searching = SearchProblem(*ends, limits.lower, limits.upper, oracle=SearchOracle(checker), seed=seed)
    return BalancedRRTConnect().search(searching).waypoints


def _row(checker: CollisionChecker, found: FloatArray, seed: int) -> Row:
    ms, python = cpu_ms(lambda: _smoothed(checker, found, seed, compiled=False))
    compiled_ms, compiled = cpu_ms(lambda: _smoothed(checker, found, seed, compiled=True))
    return {"states": compiled[1].states, "same": compiled == python, "ms": compiled_ms, "python": ms}


def _smoothed(checker: CollisionChecker, found: FloatArray, seed: int, *, compiled: bool) -> Smoothed:
    before, oracle = checker.ledger.counts, SearchOracle(checker)
    asked: CoarseOracle = oracle if compiled else _Uncompiled(oracle)
    cut = shortcut(found, asked, np.random.default_rng(seed))  # type: ignore[arg-type]
    pulled = pulled_in(cut, asked)
    kept = without_short_pieces(pulled, asked)  # type: ignore[arg-type]
    path = blended(JointPath(kept), checker.blend_is_free, np.full(len(kept), BLEND), oracle=asked)
    return [array.tobytes() for array in (cut, pulled, kept, path.blends)], checker.ledger.counts - before


def _table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "scene": kind,
            "paths": len(here),
            "states": spread([row["states"] for row in here]),
            "other path or count": sum(not row["same"] for row in here),
            "compiled, ms": spread([row["ms"] for row in here], 2),
            "Python, ms": spread([row["python"] for row in here], 2),
            "x p50": f"{p50(row['python'] for row in here) / p50(row['ms'] for row in here):.1f}",
        }
        for kind, here in (*grouped(rows, "kind").items(), ("all", rows))
    )
    caption = f"Cut, pulled in, without short pieces, blended by at most {BLEND:g} rad. CPU ms with checks, p50 / p95."
    return table_of("Smoothing of searched Panda paths", lines, caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    unlike = [f"{row['problem']} seed {row['seed']}" for row in rows if not row["same"]]
    what = f"{len(rows)} paths are smoothed alike, with the same counts"
    yield Promise(what, "; ".join(unlike) or "all", not unlike)
