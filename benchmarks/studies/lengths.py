"""How long plans of four arms are, next to the shortest known, with and without further searches (``improve``).

``python -m benchmarks.studies.lengths [FOLDER]`` plans anew what ``known_lengths.json`` holds, and keeps what is
shorter: the plans of a few seeds, each improved in many rounds, and with an optimised polish. No clock has a say.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, cpu_ms, grouped, p50, p95, spread, table_of
from benchmarks.harness.suite import PUBLIC
from planner_service.files.writing import write_whole
from planner_service.records import Problem

__all__ = ["rows_of", "shown", "written"]

FILE = PUBLIC.parent / "known_lengths.json"
METHOD = "the shortest, and the fastest, of plans with improve=32 and of the same with polish=Optimise(), seeds 100 on"

KNOWN_ROUNDS, KNOWN_SEEDS = 32, (100, 101)
ROUNDS = 16
"""What is promised of ``improve``."""

CHECKS = 10_000_000

DEFAULT_P95, IMPROVED_P95 = 1.35, 1.05
"""Promised: times the shortest known length, and the least known duration."""


def known() -> Mapping[str, Mapping[str, tuple[float, float]]]:
    """By arm and problem: the shortest length known (rad), and the least duration (s)."""
    told = json.loads(FILE.read_text("utf-8")) if FILE.is_file() else {"arms": {}}
    return {arm: {id: (one[0], one[1]) for id, one in here.items()} for arm, here in told["arms"].items()}


def rows_of(arm: str, robot: ps.Robot, problems: Sequence[Problem], seeds: int) -> Iterator[Row]:
    """A row of each problem, seed and number of rounds; problems that nobody has solved are left out."""
    best = known().get(arm, {})
    for problem in problems:
        if problem.id not in best:
            continue
        length, seconds = best[problem.id]
        service = ps.PlannerService(robot, problem.scene)
        service.plan(problem.request(robot, time_limit=None))
        for seed in range(seeds):
            for rounds in (0, ROUNDS):
                request = problem.request(robot, seed=seed, improve=rounds, time_limit=None, max_checks=CHECKS)
                ms, result = cpu_ms(lambda service=service, request=request: service.plan(request))  # type: ignore[misc]
                if result.path is None or result.motion is None:
                    continue
                yield {
                    "arm": arm,
                    "improve": rounds,
                    "problem": problem.id,
                    "seed": seed,
                    "ms": ms,
                    "length": result.path.length / length,
                    "seconds": result.motion.duration / seconds,
                    "rounds": 0 if result.improvement is None else result.improvement.rounds,
                    "states": result.stage(ps.Stage.IMPROVE).counts.states,
                }


def shown(rows: Sequence[Row]) -> Report:
    """The table of the rows, and what is promised of them."""
    return Report("arms", tuple(rows), (_table(rows),), tuple(_promises(rows)))


def _table(rows: Sequence[Row]) -> Table:
    lines = [
        {
            "arm": arm,
            "improve": rounds,
            "plans": len(some),
            "length": spread([row["length"] for row in some], 3),
            "motion": spread([row["seconds"] for row in some], 3),
            "rounds": spread([row["rounds"] for row in some]),
            "states of the rounds": spread([row["states"] for row in some]),
            "ms": spread([row["ms"] for row in some], 1),
        }
        for arm, here in grouped(rows, "arm").items()
        for rounds, some in grouped(here, "improve").items()
    ]
    caption = f"Times the best known length, and motion time, p50 / p95; CPU ms of the whole plan. Known: {METHOD}."
    return table_of("Length over best known", lines, caption=caption)


def _promises(rows: Sequence[Row]) -> Iterator[Promise]:
    for rounds, here in grouped(rows, "improve").items():
        most = IMPROVED_P95 if rounds else DEFAULT_P95
        for arm, some in grouped(here, "arm").items():
            for what, key in (("length", "length"), ("motion time", "seconds")):
                values = [row[key] for row in some]
                text = f"{arm}, improve={rounds}: {what} over best known at most {most:g} at p95"
                yield Promise(text, f"{p50(values):.3f} / {p95(values):.3f}", p95(values) <= most)


def written(arm: str, robot: ps.Robot, problems: Sequence[Problem]) -> None:
    """Plan an arm's problems, and keep in the file what is shorter or faster than what it holds."""
    best = {name: dict(here) for name, here in known().items()}
    mine = best.setdefault(arm, {})
    for problem in problems:
        service = ps.PlannerService(robot, problem.scene)
        for seed in KNOWN_SEEDS:
            for polish in (None, ps.Optimise()):
                request = problem.request(
                    robot, seed=seed, improve=KNOWN_ROUNDS, polish=polish, time_limit=None, max_checks=CHECKS
                )
                result = service.plan(request)
                if result.path is not None and result.motion is not None:
                    length, seconds = mine.get(problem.id, (float("inf"), float("inf")))
                    new = min(length, result.path.length), min(seconds, result.motion.duration)
                    mine[problem.id] = (round(new[0], 6), round(new[1], 6))
        _write(best)


def _write(best: Mapping[str, Mapping[str, tuple[float, float]]]) -> None:
    told = {"method": METHOD, "units": "rad, s", "arms": {arm: dict(here) for arm, here in best.items()}}
    write_whole(FILE, json.dumps(told, indent=0) + "\n")


def _main(folder: Path | None, robot: str | None) -> None:
    from benchmarks.studies.arms import arms_in
    from planner_service.records import read_problems

    for arm in arms_in(folder, robot):
        written(arm.name, ps.load_robot(arm.source), read_problems(arm.problems).problems)


if __name__ == "__main__":
    _main(Path(sys.argv[1]) if len(sys.argv) > 1 else None, sys.argv[2] if len(sys.argv) > 2 else None)
