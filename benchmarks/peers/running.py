"""``python -m benchmarks peers``: install environments, list them, and run a peer on a suite into a results file."""

from __future__ import annotations

import argparse
import hashlib
import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from benchmarks import rows as results
from benchmarks.environment import environment
from benchmarks.peers.audit import STEPS, Finding, audited
from benchmarks.peers.catalogue import PEERS, Peer, peer_named
from benchmarks.peers.child import Child, Reply
from benchmarks.peers.environments import Environment
from benchmarks.peers.jobs import Task, job_of, placed_robot
from benchmarks.problems import ROBOT, kind_of, public_problems
from benchmarks.report import table
from planner_service.data import data_folder
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry import FloatArray
from planner_service.interchange import Problem
from planner_service.robot import Robot, load_robot

if TYPE_CHECKING:
    from tests.independent import IndependentChecker

__all__ = ["Run", "arguments", "main", "row_of", "tasks_of"]

SUITES = ("panda",)
"""Suites whose robot and obstacles a peer can be given."""

TIME_LIMIT = 10.0
"""Seconds a peer may take for a problem, where it can be told."""

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

    def key(self, problem: str, seed: int) -> results.Key:
        """What a row of it is a run of."""
        return (self.suite, self.peer.name, self.planner, problem, seed)

    def row(self, reply: Reply) -> results.Row:
        """The row of a reply."""
        return row_of(self, reply, self._problems[reply.problem["problem"]])

    @cached_property
    def _problems(self) -> Mapping[str, Problem]:
        return {task.problem.id: task.problem for task in self.tasks}


def tasks_of(suite: str, seeds: Sequence[int], only: int | None = None) -> tuple[Robot, tuple[Task, ...]]:
    """A suite's robot, and its problems with each seed.

    Args:
        only: So many problems, spread over the suite; all if None.

    Raises:
        UnknownName: there is no such suite, or not for peers.
    """
    if suite not in SUITES:
        raise UnknownName("suite", suite, SUITES)
    problems = public_problems().problems
    if only is not None:
        problems = tuple(problems[math.floor(k * len(problems) / only)] for k in range(min(only, len(problems))))
    return load_robot(ROBOT), tuple(Task(problem, seed) for seed in seeds for problem in problems)


def row_of(run: Run, reply: Reply, problem: Problem) -> results.Row:
    """What became of a problem, judged by the independent checker."""
    answer = reply.answer or {}
    path = _array(answer.get("waypoints"), run.robot.n)
    failure, detail = _failure(reply, path, problem)
    seconds = {stage: float(spent) for stage, spent in (answer.get("seconds") or {}).items()}
    row: results.Row = {
        "suite": run.suite,
        "problem": problem.id,
        "kind": kind_of(problem),
        "robot": run.robot.name,
        "tool": run.peer.name,
        "planner": run.planner,
        "seed": int(reply.problem["seed"]),
        "ok": failure is None,
        "failure": failure,
        "detail": detail,
        "checks": {
            stage: {"states": int(count), "edges": 0, "distances": 0}
            for stage, count in (answer.get("checks") or {}).items()
        },
        "seconds": seconds,
        "total_seconds": reply.waited + math.fsum(spent for stage, spent in seconds.items() if stage != "setup"),
        "cpu_seconds": float(answer.get("cpu_seconds") or 0.0),
        "raw_length": _length(_array(answer.get("raw"), run.robot.n)),
        "length": None if path is None else _length(path),
        "duration": None,
        "clearance": None,
        "peaks": None,
        "path_hash": None if path is None else hashlib.sha256(path.tobytes()).hexdigest(),
        "audit": {"step": None, "verdict": "not_asked", "depth": None, "pair": None},
        "versions": dict(reply.versions),
    }
    return row if path is None else row | _motion(run.robot, answer) | _judged(run, problem, path, answer)


def _failure(reply: Reply, path: FloatArray | None, problem: Problem) -> tuple[str | None, str]:
    if reply.answer is None:
        return reply.failure, reply.detail
    if path is None:
        return "no_path", str(reply.answer.get("error") or "no path, and no reason")[:2000]
    away = float(np.abs(path[0] - problem.start).max())
    if away > ENDS:
        return "wrong_start", f"the path begins {away:.2g} rad from the start it was given"
    missed = min(float(np.abs(path[-1] - goal).max()) for goal in problem.goals)
    return ("wrong_goal", f"the path ends {missed:.2g} rad from the goal") if missed > ENDS else (None, "")


def _judged(run: Run, problem: Problem, path: FloatArray, answer: Mapping[str, Any]) -> results.Row:
    """Audits of the path and of the motion, the worse of which is the row's."""
    checker = _checker(run.robot.name, problem)
    findings = {"path": audited(checker, path, clearance=True)}
    samples = _array(answer.get("samples"), run.robot.n)
    if samples is not None:
        findings["motion"] = audited(checker, samples)
    worst = max(findings.values(), key=_badness)
    return {
        "clearance": findings["path"].clearance,
        "audit": worst.row(),
        "audits": {name: finding.row() for name, finding in findings.items()},
    }


def _badness(finding: Finding) -> tuple[int, float]:
    return ("free", "outside_limits", "colliding").index(finding.verdict), finding.depth or 0.0


def _checker(robot: str, problem: Problem) -> IndependentChecker:
    from tests.independent import IndependentChecker, tables_of

    return IndependentChecker(data_folder("robots") / robot, tables_of(problem.scene))


def _motion(robot: Robot, answer: Mapping[str, Any]) -> results.Row:
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


def _rows(run: Run, child: Environment, todo: Sequence[Task]) -> Iterator[results.Row]:
    with tempfile.TemporaryDirectory(prefix="peer-") as folder:
        robot = placed_robot(run.robot, Path(folder) / "robot")
        job = job_of(run.peer, run.planner, robot, todo, run.time_limit)
        command = (str(child.python), "-m", run.peer.adapter)
        started = Child(
            command, child.surroundings(), Path(folder), problem_seconds=run.time_limit + GRACE
        )
        for reply in started.replies(job):
            yield run.row(reply)


def _unavailable(run: Run, state: str, todo: Sequence[Task]) -> Iterator[results.Row]:
    """Rows that say why the peer cannot be run."""
    for task in todo:
        problem = {"problem": task.problem.id, "seed": task.seed}
        yield run.row(Reply(problem, None, {}, "not_installed", state))


def run_into(run: Run, out: Path, child: Environment, console: Console) -> None:
    """Append the rows that are not yet in a results file."""
    header = {
        "version": results.VERSION,
        "suite": run.suite,
        "environment": environment(),
        "command": ["peers", "run", "--peer", run.peer.name, "--planner", run.planner, "--suite", run.suite],
        "settings": {**run.peer.planners[run.planner], "time_limit": run.time_limit, "audit_steps": list(STEPS)},
    }
    found = results.read(out) if out.exists() else results.Results(header, ())
    if found.header["environment"] != header["environment"]:
        message = f"{out}: its rows are from another environment or commit; give another --out, or remove it"
        raise InvalidRequest("out", str(out), "a file of this environment", message=message)
    have = {results.key_of(row) for row in found.rows}
    todo = [task for task in run.tasks if run.key(task.problem.id, task.seed) not in have]
    made = _rows(run, child, todo) if child.ready else _unavailable(run, child.state, todo)
    out.parent.mkdir(parents=True, exist_ok=True)
    with results.appending(out, found) as put:
        for count, row in enumerate(made, 1):
            put(row)
            console.print(f"{count}/{len(todo)} {run.peer.name} {_line(row)}", highlight=False, markup=False)


def _line(row: results.Row) -> str:
    audit = row["audit"]
    told = row["failure"] or audit["verdict"] + (f" {audit['pair'][0]} x {audit['pair'][1]}" if audit["pair"] else "")
    return f"{row['problem']} seed {row['seed']}: {told}, {row['total_seconds'] * 1e3:.0f} ms"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Put the command's arguments on a parser."""
    which = parser.add_subparsers(dest="peers_command", required=True)
    install = which.add_parser("install", help="make environments for these peers")
    install.add_argument("peers", nargs="+", metavar="PEER", help=", ".join(PEERS))
    install.add_argument("--python", type=Path, help="the interpreter to make them with; else one on the path")
    which.add_parser("list", help="the peers, and whether they are installed")
    run = which.add_parser("run", help="run a peer on a suite")
    run.add_argument("--peer", required=True, metavar="PEER")
    run.add_argument("--planner", help="one of the peer's; its first if not given")
    run.add_argument("--suite", default="panda", help=", ".join(SUITES))
    run.add_argument("--seeds", default="0:1", metavar="A:B", help="from A up to, but without B")
    run.add_argument("--problems", type=int, metavar="N", help="only N of them, spread over the suite")
    run.add_argument("--time-limit", type=float, default=TIME_LIMIT, metavar="S")
    run.add_argument("--out", type=Path, required=True, metavar="FILE.jsonl")


def main(asked: argparse.Namespace, console: Console) -> int:
    """Exit code 0; 1 if an installation failed."""
    if asked.peers_command == "list":
        cells = [(peer.name, " ".join(peer.requirements), Environment.of(peer).state, peer.note) for peer in PEERS.values()]
        console.print(table("Peers", ("peer", "requirements", "state", "note"), cells))
        return 0
    if asked.peers_command == "install":
        peers = [peer_named(name) for name in asked.peers]
        states = {}
        for peer in peers:
            console.print(f"{peer.name}: {peer.note}", markup=False)
            states[peer.name] = Environment.of(peer).install(asked.python)
            console.print(f"{peer.name}: {states[peer.name]}", markup=False)
        return 0 if set(states.values()) == {"installed"} else 1
    peer = peer_named(asked.peer)
    robot, tasks = tasks_of(asked.suite, _seeds(asked.seeds), asked.problems)
    planner = asked.planner or next(iter(peer.planners))
    run_into(Run(peer, planner, asked.suite, robot, tasks, asked.time_limit), asked.out, Environment.of(peer), console)
    return 0


def _seeds(text: str) -> range:
    first, colon, last = text.partition(":")
    if not (first.isdigit() and (last.isdigit() or not colon)):
        raise InvalidRequest("seeds", text, "A:B, such as 0:3 for 0, 1 and 2")
    return range(int(first), int(last) if colon else int(first) + 1)
