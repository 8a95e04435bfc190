"""Every problem of a suite by every planner with every seed: a row each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from rich.console import Console
from rich.progress import track

from benchmarks.harness.attempts import Ask, attempt, warm
from benchmarks.harness.report import Row
from benchmarks.harness.sources import Motion
from benchmarks.harness.suite import Suite
from planner_service.errors import InvalidRequest

__all__ = ["Job", "jobs_of", "made"]

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Job:
    """One row to be made."""

    suite: str
    problem: Motion
    ask: Ask

    def row(self) -> Row:
        """Plan, and have the plan judged.

        Raises:
            InvalidRequest: this planner cannot plan this problem, which is named.
        """
        return {"suite": self.suite, **self._of(attempt)}

    def warm(self) -> None:
        """Plan once for nobody; refused like ``row``."""
        self._of(warm)

    def _of(self, do: Callable[[Motion, Ask], T]) -> T:
        try:
            return do(self.problem, self.ask)
        except InvalidRequest as error:
            message = f"problem {self.problem.id} of {self.suite}, {self.ask.planner}: {error}"
            raise InvalidRequest(error.field, error.value, error.expected, message=message) from error


def jobs_of(suite: Suite, planners: Sequence[str] = (), seeds: Sequence[int] = ()) -> list[Job]:
    """All jobs of a suite, problem by problem: what a scene needs is made once; a planner named twice plans once.

    Raises:
        UnknownName, InvalidRequest: no such planner, a setting it does not have, or problems that it cannot plan.
    """
    asks = [
        Ask(planner, seed, suite.max_checks)
        for planner in dict.fromkeys(planners or suite.planners)
        for seed in seeds or suite.seeds
    ]
    return [Job(suite.name, problem, ask) for problem in suite.problems for ask in asks]


def made(jobs: Iterable[Job], console: Console | None = None) -> Iterator[Row]:
    """The row of each job, in their order; progress is shown on the console. The process is warmed up first."""
    waiting = list(jobs)
    if waiting:
        waiting[0].warm()
    quiet = console is None or not console.is_terminal
    for job in track(waiting, "planning", console=console, disable=quiet):
        yield job.row()
