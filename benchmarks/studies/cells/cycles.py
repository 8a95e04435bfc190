"""What a cycle costs with what the cycles before it learned: a first round of a cell's jobs, and a second one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import planner_service as ps
from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, spread, table_of
from benchmarks.studies.cells.work import Work, kept_rows, objections, solved
from benchmarks.worlds.cells import Cell, Job
from planner_service.memory import Memory
from planner_service.planning.task_result import TaskResult

__all__ = ["run"]

TURNS = 3
"""Each round is taken so often, turn about; of each job the least CPU time counts, as what disturbs only adds."""

ASIDE = 0.002
"""Metres by which boxes stand aside on the belt, in the last round, from where they stood: as a camera finds them."""

CHECKS = 300_000
"""States of each motion, at most."""

FIRST, SECOND, SHARE = 90.0, 40.0, 1.0 / 3.0
"""Milliseconds of a job in the first and the second round, and the share of the states, at most."""

PALLET = "palletise"


@dataclass(frozen=True, eq=False)
class _Round:
    """CPU milliseconds and the result of each job, and what is remembered after the last."""

    ms: list[float]
    done: list[TaskResult]
    memory: Memory


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """Each cell: without a memory, with an empty one, with what that learned, and with objects that stand aside."""
    rows = kept_rows("cycles", _rows, queries, seed, robot, kept)
    lines = [
        {
            "cell": name,
            "round": which,
            "solved": f"{sum(row['ok'] for row in each)} of {len(each)}",
            "states": spread([row["states"] for row in each]),
            "bounds": spread([row["bounds"] for row in each]),
            "CPU ms": spread([row["ms"] for row in each]),
            "motion s": f"{p50(row['seconds'] for row in each):.1f}",
        }
        for name, mine in grouped(rows, "cell").items()
        for which, each in grouped(mine, "round").items()
    ]
    caption = f"p50 / p95 of a job; CPU time the least of {TURNS} turns. Moved: boxes stand {ASIDE * 1e3:g} mm aside."
    return Report("cells cycles", tuple(rows), (table_of("Cycles", lines, caption=caption),), _promises(rows))


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    wrong = [row for row in rows if row["objections"]]
    promises = [Promise("motions that the auditor finds touching", f"{len(wrong)} jobs", not wrong)]
    for name, mine in grouped(rows, "cell").items():
        by = grouped(mine, "round")
        share = sum(row["states"] for row in by["second"]) / max(1, sum(row["states"] for row in by["without"]))
        promises.append(Promise(f"{name}: states of a second round", f"{share:.1%}", share <= SHARE))
        if name.startswith(PALLET):
            for which, most in (("first", FIRST), ("second", SECOND)):
                middle = p50(row["ms"] for row in by[which])
                promises.append(Promise(f"{name}: CPU of a job, {which} round", f"{middle:.1f} ms", middle <= most))
    return tuple(promises)


def _rows(cell: Cell, queries: int | None) -> list[Row]:
    jobs = cell.jobs[:queries]
    moved = _aside(jobs)
    rounds: dict[str, _Round] = {}
    least: dict[str, list[float]] = {}
    for _ in range(TURNS):
        rounds["without"] = _round(cell, jobs, None)
        rounds["first"] = _round(cell, jobs, Memory())
        rounds["second"] = _round(cell, jobs, rounds["first"].memory)
        if cell.kind == PALLET:
            rounds["moved"] = _round(cell, moved, rounds["first"].memory)
        for which, each in rounds.items():
            least[which] = [min(pair) for pair in zip(least.get(which, each.ms), each.ms, strict=True)]
    return [
        {
            "part": "cycles",
            "cell": cell.name,
            "round": which,
            "job": job.name,
            "ok": done.ok,
            "failure": str(done.failure or ""),
            "states": done.counts.states,
            "bounds": done.counts.distances,
            "seconds": done.duration,
            "ms": ms,
            "objections": objections(cell.robot, done) if which in ("second", "moved") else [],
        }
        for which in rounds
        for job, ms, done in zip(jobs, least[which], rounds[which].done, strict=True)
    ]


def _aside(jobs: Sequence[Job]) -> tuple[Job, ...]:
    """The jobs with each object a little aside."""
    rng = np.random.default_rng(0)
    shifts = rng.uniform(-ASIDE, ASIDE, (len(jobs), 2)).tolist()
    places = [(job.at.position, shift) for job, shift in zip(jobs, shifts, strict=True)]
    return tuple(
        replace(job, at=ps.Pose((x + dx, y + dy, z), job.at.quaternion))
        for job, ((x, y, z), (dx, dy)) in zip(jobs, places, strict=True)
    )


def _round(cell: Cell, jobs: Sequence[Job], memory: Memory | None) -> _Round:
    """All jobs one after the other, each with what is remembered after the one before; one that fails is left out."""
    work, out = Work.begun(cell), _Round([], [], Memory() if memory is None else memory)
    for job in jobs:
        work = work.facing(job)
        request = ps.PlanRequest(work.q, work.q, max_checks=CHECKS, time_limit=None)
        ms, done = cpu_ms(partial(solved, work, job, request, memory))
        memory = None if memory is None else done.memory
        out.ms.append(ms)
        out.done.append(done)
        if done.ok:
            work = work.after(done)
    return replace(out, memory=Memory() if memory is None else memory)
