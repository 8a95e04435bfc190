"""Every problem of a suite by every planner with every seed: a row each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.progress import track

from benchmarks.harness.attempts import Ask, attempt
from benchmarks.harness.report import Row
from benchmarks.harness.suite import Motion, Suite

__all__ = ["Job", "jobs_of", "made"]


@dataclass(frozen=True, eq=False)
class Job:
    """One row to be made."""

    suite: str
    problem: Motion
    ask: Ask

    def row(self) -> Row:
        """Plan, and have the plan judged."""
        return {"suite": self.suite, **attempt(self.problem, self.ask)}


def jobs_of(suite: Suite, planners: Sequence[str] = (), seeds: Sequence[int] = ()) -> list[Job]:
    """All jobs of a suite, problem by problem: what a scene needs is made once."""
    asks = [
        Ask(name, suite.planners[name], seed, suite.max_checks)
        for name in planners or suite.planners
        for seed in seeds or suite.seeds
    ]
    return [Job(suite.name, problem, ask) for problem in suite.problems for ask in asks]


def made(jobs: Iterable[Job], console: Console | None = None) -> Iterator[Row]:
    """The row of each job, in their order; progress is shown on the console. The process is warmed up first."""
    waiting = list(jobs)
    for job in waiting[:1]:
        attempt(job.problem, job.ask)
    quiet = console is None or not console.is_terminal
    for job in track(waiting, "planning", console=console, disable=quiet):
        yield job.row()
