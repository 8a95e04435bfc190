"""Peers on a suite, each answer judged by the same auditor; ``python -m benchmarks peers`` makes their environments."""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.baselines.peers.catalogue import PEERS, Peer, peer_named
from benchmarks.baselines.peers.child import Child, Reply
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.jobs import Task, job_of, placed_robot
from benchmarks.harness.attempts import blank_row
from benchmarks.harness.audit import Auditor, between, worst
from benchmarks.harness.report import Row, table
from benchmarks.harness.sources import Motion
from benchmarks.harness.suite import load_suite
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot

__all__ = ["STEPS", "Run", "main", "path_of", "row_of", "rows_of", "tasks_of"]

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
    robot: Robot
    tasks: tuple[Task, ...]
    time_limit: float = TIME_LIMIT

    def row(self, reply: Reply) -> Row:
        """The row of a reply."""
        return row_of(self, reply, self._problems[reply.problem["problem"]])

    @cached_property
    def _problems(self) -> Mapping[str, Motion]:
        return {task.problem.id: task.problem for task in self.tasks}


def tasks_of(suite: str, seeds: Sequence[int], only: int | None = None) -> tuple[Robot, tuple[Task, ...]]:
    """A suite's robot, and its problems with each seed.

    Args:
        only: So many problems, spread over the suite; all if None.

    Raises:
        UnknownName: there is no such suite.
        InvalidRequest: its problems are of several robots.
    """
    motions = list(load_suite(suite).problems)
    if len({motion.robot for motion in motions}) != 1:
        raise InvalidRequest("suite", suite, "a suite of motions of one robot, such as panda")
    if only is not None:
        motions = [motions[k * len(motions) // only] for k in range(min(only, len(motions)))]
    return load_robot(motions[0].robot), tuple(Task(motion, seed) for seed in seeds for motion in motions)


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
        "raw_length": _length(_array(answer.get("raw"), run.robot.n)),
        "length": None if path is None else _length(path),
        "versions": dict(reply.versions),
    }
    if path is None:
        return row
    samples = _array(answer.get("samples"), run.robot.n)
    return row | _motion(run.robot, answer) | _judged(problem, path, samples)


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


def _judged(problem: Motion, path: FloatArray, samples: FloatArray | None) -> Row:
    """Audits of the path and of the motion, the worse of which is the row's."""
    auditor = Auditor(problem.robot, problem.scene)
    audits = {"path": _audited(auditor, path)}
    if samples is not None:
        audits["motion"] = _audited(auditor, samples)
    return {"audit": worst(list(audits.values())), "audits": audits}


def _audited(auditor: Auditor, rows: FloatArray) -> dict[str, Any]:
    """The audit at the first step at which anything is wrong, at the finest if nothing is."""
    audit: dict[str, Any] = {}
    for step in STEPS:
        audit = auditor.judge(between(rows, step), step)
        if audit["verdict"] != "free":
            break
    return audit


def _motion(robot: Robot, answer: Mapping[str, Any]) -> Row:
    """How long the timed motion takes, and its peaks over the limits, where the peer tells them."""
    times = answer.get("times")
    if not times:
        return {}
    peaks: dict[str, float | None] = {"velocity": None, "acceleration": None, "jerk": None}
    for key, told, limit in (
        ("velocity", "velocities", robot.limits.velocity),
        ("acceleration", "accelerations", robot.limits.acceleration),
    ):
        values = _array(answer.get(told), robot.n)
        if values is not None:
            peaks[key] = float((np.abs(values) / limit).max())
    return {"duration": float(times[-1]) - float(times[0]), "peaks": peaks}


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
    with tempfile.TemporaryDirectory(prefix="peer-") as folder:
        robot = placed_robot(run.robot, Path(folder) / "robot")
        job = job_of(run.peer, run.planner, robot, todo, run.time_limit)
        command = (str(child.python), "-m", run.peer.adapter)
        started = Child(command, child.surroundings(), Path(folder), problem_seconds=run.time_limit + GRACE)
        yield from map(run.row, started.replies(job))


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0; 1 if an installation failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks peers", description=__doc__)
    parser.add_argument("command", choices=["list", "install"], help="the peers and their state; or make environments")
    parser.add_argument("peers", nargs="*", metavar="PEER", help=f"{', '.join(PEERS)}; all if not given")
    asked = parser.parse_args(arguments)
    peers = [peer_named(name) for name in asked.peers or PEERS]
    if asked.command == "install":
        for peer in peers:
            console.print(f"{peer.name}: {Environment.of(peer).install()}", markup=False, soft_wrap=True)
    states = [Environment.of(peer).state for peer in peers]
    cells = [(p.name, " ".join(p.requirements), state) for p, state in zip(peers, states, strict=True)]
    console.print(table("Peers", ("peer", "requirements", "state"), cells))
    return 1 if asked.command == "install" and set(states) != {"installed"} else 0
