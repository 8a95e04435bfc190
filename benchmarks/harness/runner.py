"""``run``: every problem of a suite by every planner with every seed, each row on disk as soon as it is there."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.harness import rows
from benchmarks.harness.arguments import whole
from benchmarks.harness.attempts import Ask, attempt, unplanned, warm
from benchmarks.harness.environment import environment
from benchmarks.harness.rows import Key, Results, Row
from benchmarks.harness.sources import Problem, Task, ToyQuery
from benchmarks.harness.suite import LESSON, ROADMAP, Suite, load_suite, require_planner, seeds_of, suite_names
from benchmarks.pages.page import tables_of
from planner_service import Reason
from planner_service.errors import InvalidRequest
from planner_service.files.writing import require_writable
from planner_service.parallel import Engine, Lost, Sequential, engine_named

__all__ = ["Job", "jobs_of", "made", "main", "run"]

T = TypeVar("T")

INTERRUPTED = 130
"""The exit code of a program that was ended by Ctrl-C."""


@dataclass(frozen=True, eq=False)
class Job:
    """One row to be made."""

    suite: str
    problem: Problem
    ask: Ask

    @property
    def key(self) -> Key:
        """The key of its row."""
        tool = LESSON if self.ask.planner == LESSON else "planner_service"
        return (self.suite, tool, self.ask.planner, self.problem.id, self.ask.seed)

    def row(self) -> Row:
        """Plan, audit, tell.

        Raises:
            InvalidRequest: this planner cannot be asked this problem, which is named.
        """
        return {"suite": self.suite, **self._of(attempt)}

    def lost(self, detail: str) -> Row:
        """Its row if it cost two workers their life."""
        told: Row = {"failure": Reason.WORKER_LOST.value, "detail": detail}
        return {"suite": self.suite, **unplanned(self.problem, self.ask), **told}

    def warm(self) -> None:
        """Plan once for nobody; refused like ``row``."""
        self._of(warm)

    def _of(self, do: Callable[[Problem, Ask], T]) -> T:
        try:
            return do(self.problem, self.ask)
        except InvalidRequest as error:
            message = f"problem {self.problem.id} of {self.suite}, {self.ask.planner}: {error}"
            raise InvalidRequest(error.field, error.value, error.expected, message=message) from error


def jobs_of(suite: Suite, planners: Sequence[str] = (), seeds: Sequence[int] = ()) -> list[Job]:
    """All jobs of a suite, problem by problem: what a scene needs is made once; a planner named twice plans once.

    Raises:
        UnknownName, InvalidRequest: no such planner, a setting it does not have, or problems that it cannot be asked.
    """
    for text in planners:
        require_planner(text)
    asked = dict.fromkeys(planners or suite.planners)
    tasks = [problem.id for problem in suite.problems if isinstance(problem, Task)]
    if LESSON in asked and tasks:
        raise InvalidRequest("planner", LESSON, f"one that picks and places, for {tasks[0]} of {suite.name}")
    toys = [problem.id for problem in suite.problems if isinstance(problem, ToyQuery)]
    before = [text for text in asked if text.partition(":")[0] == ROADMAP]
    if before and toys:
        raise InvalidRequest("planner", before[0], f"one that is not built before, for {toys[0]} of {suite.name}")
    asks = [Ask(p, s, suite.max_checks) for p in asked for s in seeds or suite.seeds]
    return [Job(suite.name, problem, ask) for problem in suite.problems for ask in asks]


@dataclass(frozen=True, eq=False)
class _Rows:
    """The work of a process that makes rows, warmed up before its first row."""

    first: Job

    def prepare(self) -> None:
        self.first.warm()

    def __call__(self, job: Job) -> Row:
        return job.row()


def made(jobs: Iterable[Job], console: Console | None = None, engine: Engine | None = None) -> Iterator[Row]:
    """The row of each job, in their order; progress is shown on the console.

    Args:
        engine: Who makes them; one after the other in this process if not given.
    """
    waiting = list(jobs)
    if not waiting:
        return
    with _bar(console) as bar, closing((engine or Sequential()).run(_Rows(waiting[0]), waiting)) as answers:
        task = bar.add_task(_told(waiting[0]), total=len(waiting))
        for index, answer in answers:
            yield waiting[index].lost(answer.detail) if isinstance(answer, Lost) else answer
            bar.update(task, advance=1, description=_told(waiting[min(index + 1, len(waiting) - 1)]))


def _told(job: Job) -> str:
    return f"{job.problem.id} {job.ask.planner} seed {job.ask.seed}"


def _bar(console: Console | None) -> Progress:
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, TextColumn("{task.description}"), console=console, disable=console is None)


def run(
    jobs: Sequence[Job], out: Path, command: Sequence[str], console: Console, engine: Engine | None = None
) -> Results:
    """Make the rows that are not in the file yet, and return all that are in it.

    Args:
        engine: As for ``made``.

    Raises:
        InvalidRequest: the file holds rows of another suite, environment or commit.
    """
    header = {"version": rows.VERSION, "suite": jobs[0].suite, "environment": environment(), "command": list(command)}
    before = rows.read(out) if out.exists() else Results(header, ())
    _require_same(before.header, header, out)
    done = {rows.key_of(row) for row in before.rows}
    left = [job for job in jobs if job.key not in done]
    if len(left) < len(jobs):
        console.print(f"{len(jobs) - len(left)} of {len(jobs)} rows are in {out} already")
    new: list[Row] = []
    with rows.appending(out, before) as put:
        for row in made(left, console, engine):
            put(row)
            new.append(row)
    return Results(before.header, (*before.rows, *new))


def _require_same(old: dict[str, Any], new: dict[str, Any], out: Path) -> None:
    """Refuse to put rows beside others that were made elsewhere or by other code."""
    then, now = old["environment"], new["environment"]
    changed = [f"{key} {then.get(key)} is now {now[key]}" for key in now if then.get(key) != now[key]]
    if old["suite"] != new["suite"]:
        changed.insert(0, f"suite {old['suite']} is now {new['suite']}")
    if changed:
        message = f"--out: {out} holds rows made elsewhere: {'; '.join(changed)}. Name another file, or remove it"
        raise InvalidRequest("--out", str(out), "a file of the same code, made in the same place", message=message)


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0 when all rows are there, whatever they tell; 130 when interrupted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks run", description=__doc__)
    parser.add_argument("--suite", required=True, metavar="NAME", help=f"{', '.join(suite_names())}, or a TOML file")
    parser.add_argument(
        "--planner", action="append", default=[], metavar="NAME[:SETTING=VALUE,...]", help="several may be given"
    )
    parser.add_argument("--seeds", metavar="A:B", help="seeds A to B - 1, or one")
    parser.add_argument("--out", type=Path, metavar="FILE", help="results/SUITE.jsonl if not given; gone on with")
    parser.add_argument("--workers", type=whole(1), metavar="N", help="processes that share the problems; 1 by default")
    parser.add_argument(
        "--engine", default="processes", metavar="NAME", help="processes, ray, or ray=ADDRESS of a cluster"
    )
    asked = parser.parse_args(arguments)
    engine = engine_named(asked.engine, asked.workers or (1 if asked.engine == "processes" else None))
    suite = load_suite(asked.suite)
    jobs = jobs_of(suite, asked.planner, seeds_of(asked.seeds) if asked.seeds is not None else ())
    out = asked.out or Path("results") / f"{suite.name}.jsonl"
    rows.make_folder(out)
    require_writable(out)
    try:
        results = run(jobs, out, ["run", *arguments], console, engine)
    except KeyboardInterrupt:
        count = len(rows.read(out).rows) if out.exists() else 0
        console.print(f"interrupted: {count} finished rows are in {out}; the same command goes on from there")
        return INTERRUPTED
    console.print(*tables_of(results), sep="\n\n")
    console.print(f"{len(results.rows)} rows in {out}")
    return 0
