"""Peers on a suite, each answer judged by the same auditor."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.baselines.peers.catalogue import Peer
from benchmarks.baselines.peers.child import Child, Reply
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.jobs import Task, job_of, placed_robot
from benchmarks.harness.attempts import blank_row
from benchmarks.harness.audit import Auditor, between
from benchmarks.harness.report import Row
from benchmarks.harness.suite import Motion, suite_named
from planner_service.geometry.arrays import FloatArray

__all__ = ["STEPS", "Run", "path_of", "replies_of", "row_of", "rows_of", "tasks_of"]

STEPS = (0.01, 0.005)
"""Radians that a joint turns between two audited configurations at most, the coarser first."""

TIME_LIMIT = 10.0
"""Seconds that a peer may take for a problem, if it accepts a limit."""

GRACE = 20.0
"""Seconds beyond it before its process is ended: some limits hold for the search alone."""

ENDS = 1e-4
"""Radians by which a path may begin and end elsewhere than was asked: single precision, not another state."""


@dataclass(frozen=True, eq=False)
class Run:
    """A peer's planner on a suite."""

    peer: Peer
    planner: str
    suite: str
    robot: ps.Robot
    tasks: tuple[Task, ...]
    time_limit: float = TIME_LIMIT

    def row(self, reply: Reply) -> Row:
        """The row of a reply."""
        return row_of(self, reply, self._problems[reply.problem["problem"]])

    @cached_property
    def _problems(self) -> Mapping[str, Motion]:
        return {task.problem.id: task.problem for task in self.tasks}


def tasks_of(suite: str, seeds: Sequence[int], only: int | None = None) -> tuple[ps.Robot, tuple[Task, ...]]:
    """A suite's robot, and its problems with each seed.

    Args:
        only: So many problems, spread over the suite; all if None.

    Raises:
        UnknownName: there is no such suite.
        InvalidRequest: its problems are of several robots.
    """
    motions = list(suite_named(suite).problems)
    if len({motion.robot for motion in motions}) != 1:
        raise ps.InvalidRequest("suite", suite, "a suite of motions of one robot, such as panda")
    if only is not None:
        motions = [motions[k * len(motions) // only] for k in range(min(only, len(motions)))]
    return ps.load_robot(motions[0].robot), tuple(Task(motion, seed) for seed in seeds for motion in motions)


def row_of(run: Run, reply: Reply, problem: Motion) -> Row:
    """The outcome of a problem, judged by the independent checker."""
    answer = reply.answer or {}
    path, failure, detail = path_of(reply, problem)
    seconds = {stage: float(spent) for stage, spent in (answer.get("seconds") or {}).items()}
    row = {"suite": run.suite, **blank_row(problem, run.peer.name, run.planner, int(reply.problem["seed"]))}
    row |= {
        "ok": failure is None,
        "failure": failure,
        "detail": detail,
        "checks": {
            stage: {"states": int(count), "edges": 0, "distances": 0}
            for stage, count in (answer.get("checks") or {}).items()
        },
        "seconds": seconds,
        "total_seconds": reply.waited + math.fsum(spent for stage, spent in seconds.items() if stage != "setup"),
        "cpu_seconds": reply.waited + float(answer.get("cpu_seconds") or 0.0),
        "stage_cpu_seconds": answer.get("stage_cpu_seconds") or {},
        "length": _length(path),
        "versions": dict(reply.versions),
    }
    if path is None:
        return row
    times = answer.get("times")
    motion = {"duration": float(times[-1]) - float(times[0])} if times else {}
    return row | motion | {"audit": _audited(Auditor(problem.robot, problem.scene), path)}


def path_of(reply: Reply, problem: Motion) -> tuple[FloatArray | None, str | None, str]:
    """The path (m, n) of a reply, if it has one; why it does not solve the problem, None if it does; and in words."""
    if reply.answer is None:
        return None, reply.failure, reply.detail
    path = _array(reply.answer.get("waypoints"), len(problem.start))
    if path is None:
        return None, "no_path", str(reply.answer.get("error") or "no path, and no reason")[:2000]
    away = float(np.abs(path[0] - problem.start).max())
    if away > ENDS:
        return path, "wrong_start", f"the path begins {away:.2g} rad from the start it was given"
    missed = min(float(np.abs(path[-1] - goal).max()) for goal in problem.goals)
    return (path, "wrong_goal", f"the path ends {missed:.2g} rad from the goal") if missed > ENDS else (path, None, "")


def _audited(auditor: Auditor, rows: FloatArray) -> dict[str, Any]:
    """The audit at the first step at which anything is wrong, at the finest if nothing is."""
    audit: dict[str, Any] = {}
    for step in STEPS:
        audit = auditor.judge(between(rows, step), step)
        if audit["verdict"] != "free":
            break
    return audit


def _array(values: Any, n: int) -> FloatArray | None:
    """Rows (m, n) of finite numbers, None if that is not what they are."""
    try:
        rows = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    return rows if rows.ndim == 2 and rows.shape[1] == n and len(rows) and np.isfinite(rows).all() else None


def _length(path: FloatArray | None) -> float | None:
    """Radians, L2 over the joints."""
    return None if path is None else math.fsum(np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1)).tolist())


def rows_of(run: Run, child: Environment, todo: Sequence[Task]) -> Generator[Row, None, None]:
    """The rows of these tasks; each is planned when it is asked for."""
    yield from map(run.row, replies_of(child, run.planner, placed_robot(run.robot), todo, run.time_limit))


def replies_of(
    child: Environment, planner: str, robot: dict[str, Any], todo: Sequence[Task], time_limit: float = TIME_LIMIT
) -> Generator[Reply, None, None]:
    """What a peer's planner says to these tasks; each is planned when it is asked for.

    Args:
        robot: A job's.
    """
    with tempfile.TemporaryDirectory(prefix="peer-") as folder:
        job = job_of(child.peer, planner, robot, todo, time_limit)
        command = (str(child.python), "-m", child.peer.adapter)
        started = Child(command, child.surroundings(), Path(folder), problem_seconds=time_limit + GRACE)
        yield from started.replies(job)
