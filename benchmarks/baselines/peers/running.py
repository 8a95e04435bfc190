"""``python -m benchmarks peers``: install environments, list them, and run a peer on a suite into a results file."""

from __future__ import annotations

import argparse
import hashlib
import math
import tempfile
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
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
from benchmarks.harness import rows as results
from benchmarks.harness.arguments import up_to_seconds, whole
from benchmarks.harness.attempts import blank_row
from benchmarks.harness.audit import Auditor, between, worst
from benchmarks.harness.environment import environment
from benchmarks.harness.report import table
from benchmarks.harness.sources import Motion
from benchmarks.harness.suite import load_suite, seeds_of
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot

__all__ = ["NOT_INSTALLED", "STEPS", "Run", "main", "path_of", "replies_of", "row_of", "rows_of", "run_into"]
__all__ += ["tasks_of"]

STEPS = (0.01, 0.005)
"""Radians that a joint turns between two audited configurations at most, the coarser first."""

TIME_LIMIT = 10.0
"""Seconds a peer may take for a problem, where it can be told."""

GRACE = 20.0
"""Seconds beyond it before its process is ended: some limits hold for the search alone."""

NOT_INSTALLED = "not_installed"
"""The failure of rows that only say that a peer is not there."""

ENDS = 1e-4
"""Radians by which a path may begin and end elsewhere than was asked: single precision, not another state."""


@dataclass(frozen=True, eq=False)
class Run:
    """A peer's planner on a suite.

    Attributes:
        clearance: Whether the clearance of each path is measured, which takes longer than the rest of its audit.
    """

    peer: Peer
    planner: str
    suite: str
    robot: Robot
    tasks: tuple[Task, ...]
    time_limit: float = TIME_LIMIT
    clearance: bool = True

    def key(self, problem: str, seed: int) -> results.Key:
        """What a row of it is a run of."""
        return (self.suite, self.peer.name, self.planner, problem, seed)

    def row(self, reply: Reply) -> results.Row:
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
        InvalidRequest: its problems are of several robots, or other than from one configuration to another.
    """
    problems = load_suite(suite).problems
    motions = [problem for problem in problems if isinstance(problem, Motion)]
    if len(motions) < len(problems) or len({motion.robot for motion in motions}) != 1:
        raise InvalidRequest("suite", suite, "a suite of motions of one robot, such as panda")
    if only is not None:
        motions = [motions[k * len(motions) // only] for k in range(min(only, len(motions)))]
    return load_robot(motions[0].robot), tuple(Task(motion, seed) for seed in seeds for motion in motions)


def row_of(run: Run, reply: Reply, problem: Motion) -> results.Row:
    """What became of a problem, judged by the independent checker."""
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
        "path_hash": None if path is None else hashlib.sha256(path.tobytes()).hexdigest(),
        "versions": dict(reply.versions),
    }
    if path is None:
        return row
    samples = _array(answer.get("samples"), run.robot.n)
    return row | _motion(run.robot, answer) | _judged(run, problem, path, samples)


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


def _judged(run: Run, problem: Motion, path: FloatArray, samples: FloatArray | None) -> results.Row:
    """Audits of the path and of the motion, the worse of which is the row's."""
    auditor = Auditor(problem.robot, problem.scene)
    audits = {"path": _audited(auditor, path)}
    if samples is not None:
        audits["motion"] = _audited(auditor, samples)
    clearance = auditor.clearance(between(path, STEPS[0])) if run.clearance else math.nan
    return {
        "clearance": clearance if math.isfinite(clearance) else None,
        "audit": worst(list(audits.values())),
        "audits": audits,
    }


def _audited(auditor: Auditor, rows: FloatArray) -> dict[str, Any]:
    """The audit at the first step at which anything is wrong, at the finest if nothing is."""
    audit: dict[str, Any] = {}
    for step in STEPS:
        audit = auditor.judge(between(rows, step), step)
        if audit["verdict"] != "free":
            break
    return audit


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


def rows_of(run: Run, child: Environment, todo: Sequence[Task]) -> Generator[results.Row, None, None]:
    """The rows of these tasks; each is planned when it is asked for."""
    with closing(replies_of(run, child, todo)) as replies:
        yield from map(run.row, replies)


def replies_of(run: Run, child: Environment, todo: Sequence[Task]) -> Generator[Reply, None, None]:
    """The same, as they come."""
    with tempfile.TemporaryDirectory(prefix="peer-") as folder:
        robot = placed_robot(run.robot, Path(folder) / "robot")
        job = job_of(run.peer, run.planner, robot, todo, run.time_limit)
        command = (str(child.python), "-m", run.peer.adapter)
        started = Child(command, child.surroundings(), Path(folder), problem_seconds=run.time_limit + GRACE)
        yield from started.replies(job)


def _unavailable(run: Run, state: str, todo: Sequence[Task]) -> Iterator[results.Row]:
    """Rows that say why the peer cannot be run."""
    for task in todo:
        problem = {"problem": task.problem.id, "seed": task.seed}
        yield run.row(Reply(problem, None, {}, NOT_INSTALLED, state))


def run_into(run: Run, out: Path, child: Environment, console: Console, command: Sequence[str] = ()) -> None:
    """Append the rows that are not yet in a results file.

    Args:
        command: What was asked for, for the header of a new file.

    Raises:
        InvalidRequest: the peer has no such planner; or the file's rows are of another suite, from another environment
            or commit, or made with other settings.
    """
    if run.planner not in run.peer.planners:
        raise InvalidRequest("planner", run.planner, f"one of {', '.join(run.peer.planners)} of {run.peer.name}")
    header = {
        "version": results.VERSION,
        "suite": run.suite,
        "environment": environment(),
        "command": ["peers", *command],
        "settings": {**run.peer.planners[run.planner], "time_limit": run.time_limit, "audit_steps": list(STEPS)},
    }
    found = results.read(out) if out.exists() else results.Results(header, ())
    _require_same(found.header, header, out)
    keys = [run.key(task.problem.id, task.seed) for task in run.tasks]
    if child.ready:  # rows that say that it was not there are made anew
        wanted = set(keys)
        kept = (row for row in found.rows if row["failure"] != NOT_INSTALLED or results.key_of(row) not in wanted)
        found = results.Results(found.header, tuple(kept))
    else:
        install = f"python -m benchmarks peers install {run.peer.name}"
        console.print(f"{run.peer.name}: {child.state}; its rows say so; {install} makes it", markup=False)
    have = {results.key_of(row) for row in found.rows}
    todo = [task for task, key in zip(run.tasks, keys, strict=True) if key not in have]
    if len(todo) < len(keys):
        console.print(f"{len(keys) - len(todo)} of {len(keys)} rows are in {out} already", markup=False)
    made = rows_of(run, child, todo) if child.ready else _unavailable(run, child.state, todo)
    results.make_folder(out)
    with results.appending(out, found) as put:
        for count, row in enumerate(made, 1):
            put(row)
            console.print(f"{count}/{len(todo)} {run.peer.name} {_line(row)}", highlight=False, markup=False)


def _require_same(old: Mapping[str, Any], new: Mapping[str, Any], out: Path) -> None:
    """Refuse to put rows beside others of which the header would say what does not hold for them."""
    named = {
        "suite": "of another suite",
        "settings": "made with other settings or another time limit",
        "environment": "from another environment or commit",
    }
    changed = [what for key, what in named.items() if old.get(key) != new[key]]
    if changed:
        message = f"{out}: its rows are {', and '.join(changed)}; give another --out, or remove it"
        raise InvalidRequest("out", str(out), "a file of the same", message=message)


def _line(row: results.Row) -> str:
    audit = row["audit"]
    told = row["failure"] or audit["verdict"] + (f" {audit['pair'][0]} x {audit['pair'][1]}" if audit["pair"] else "")
    return f"{row['problem']} seed {row['seed']}: {told}, {row['cpu_seconds'] * 1e3:.0f} ms"


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0; 1 if an installation failed."""
    asked = _asked(arguments)
    if asked.command == "list":
        cells = [
            (peer.name, " ".join(peer.requirements), Environment.of(peer).state, peer.note) for peer in PEERS.values()
        ]
        console.print(table("Peers", ("peer", "requirements", "state", "note"), cells))
        return 0
    if asked.command == "install":
        return _install([peer_named(name) for name in asked.peers], asked.python, console)
    peer = peer_named(asked.peer)
    robot, tasks = tasks_of(asked.suite, seeds_of(asked.seeds), asked.problems)
    planner = asked.planner or next(iter(peer.planners))
    run = Run(peer, planner, asked.suite, robot, tasks, asked.time_limit)
    run_into(run, asked.out, Environment.of(peer), console, arguments)
    return 0


def _install(peers: Sequence[Peer], python: Path | None, console: Console) -> int:
    states = []
    for peer in peers:
        console.print(f"{peer.name}: {peer.note}", markup=False)
        states.append(Environment.of(peer).install(python))
        console.print(f"{peer.name}: {states[-1]}", markup=False, soft_wrap=True)
    return 0 if set(states) == {"installed"} else 1


def _asked(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks peers")
    which = parser.add_subparsers(dest="command", required=True)
    install = which.add_parser("install", help="make environments for these peers")
    install.add_argument("peers", nargs="+", metavar="PEER", help=", ".join(PEERS))
    install.add_argument("--python", type=Path, help="the interpreter to make them with; else one on the path")
    which.add_parser("list", help="the peers, and whether they are installed")
    run = which.add_parser("run", help="run a peer on a suite")
    run.add_argument("--peer", required=True, metavar="PEER", help=", ".join(PEERS))
    run.add_argument("--planner", help="one of the peer's; its first if not given")
    run.add_argument("--suite", default="panda", help="a suite of motions of one robot")
    run.add_argument("--seeds", default="0", metavar="A:B", help="A to B - 1")
    run.add_argument("--problems", type=whole(1), metavar="N", help="only N of them, spread over the suite")
    run.add_argument("--time-limit", type=up_to_seconds(3600.0), default=TIME_LIMIT, metavar="S")
    run.add_argument("--out", type=Path, required=True, metavar="FILE.jsonl")
    return parser.parse_args(arguments)
