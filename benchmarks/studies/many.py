"""Many plans at once: how much faster two cores are than one, by processes and by threads, and what an engine adds."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

from rich.table import Table

import planner_service as ps
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.problems import ROBOT, public_problems
from benchmarks.worlds import queries
from planner_service.parallel import Engine, Processes

__all__ = ["run"]

SCENE, EASY_SCENE = "bin", "table"
"""About 11 ms a plan; and the same queries with nothing but a table in the way: the least that a plan takes."""

PANDA = "bookshelf_thin/0087"
"""The public problem of the Panda that threads of one service plan, with other seeds."""

PLANS, TURNS = 1000, 3
GAIN, OVERHEAD_MS, THREADS_GAIN = 1.8, 1.0, 1.9


def _requests() -> Iterator[ps.PlanRequest]:
    """The stored queries, again and again with other seeds."""
    stored, seed = queries.load(SCENE), 0
    while True:
        yield from (ps.PlanRequest(query.start, query.goal, seed=seed, time_limit=None) for query in stored)
        seed += 1


def _streamed(service: ps.PlannerService, engine: Engine, count: int) -> Row:
    """Milliseconds per plan from the first result on, by the clock and of CPU."""
    results = service.plan_stream(_requests(), engine=engine)
    next(results)
    workers = Path(f"/proc/self/task/{os.getpid()}/children").read_text("utf-8").split()
    with closing(results):
        return _told(lambda: sum(1 for _ in islice(results, count)), count, workers)


def _looped(service: ps.PlannerService, count: int) -> Row:
    """The same of a plain loop."""
    asked = islice(_requests(), count)
    return _told(lambda: [service.plan(request).ok for request in asked], count, ())


def _panda() -> tuple[ps.PlannerService, Callable[[int], ps.PlanRequest]]:
    """A service for the Panda, and its problem by the seed."""
    robot = ps.load_robot(ROBOT)
    problem = next(each for each in public_problems().problems if each.id == PANDA)
    return ps.PlannerService(robot, problem.scene), lambda seed: problem.request(robot, seed=seed, time_limit=None)


def _threaded(service: ps.PlannerService, asked: Sequence[ps.PlanRequest], threads: int) -> Row:
    """Milliseconds per plan of so many threads of one service."""
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(service.plan, asked[:threads]))
        return _told(lambda: list(pool.map(service.plan, asked)), len(asked), ())


def _told(work: Callable[[], Any], count: int, workers: Sequence[str]) -> Row:
    def computed() -> float:
        return sum(int((Path("/proc") / p / "schedstat").read_text("utf-8").split()[0]) for p in workers) / 1e9

    clock, here, there = time.perf_counter(), time.process_time(), computed()
    work()
    spent = (time.perf_counter() - clock, time.process_time() - here, computed() - there)
    return {key: value / count * 1e3 for key, value in zip(("ms", "here", "there"), spent, strict=True)}


def run(plans: int = PLANS) -> Report:
    """Plan by turns; some two minutes.

    Args:
        plans: In each scene, by each way, each turn.
    """
    rows: list[Row] = []
    for scene in (SCENE, EASY_SCENE):
        service = ps.PlannerService(queries.ROBOT, scene)
        service.plan(next(_requests()))
        ways: dict[str, Callable[[], Row]] = {
            "a loop": lambda service=service: _looped(service, plans),  # type: ignore[misc]
            "Processes(1)": lambda service=service: _streamed(service, Processes(1), plans),  # type: ignore[misc]
            "Processes(2)": lambda service=service: _streamed(service, Processes(2), plans),  # type: ignore[misc]
        }
        rows += _rows(scene, ways)
    service, request = _panda()
    asked = [request(seed) for seed in range(plans)]
    rows += _rows(PANDA, {f"threads: {n}": lambda n=n: _threaded(service, asked, n) for n in (1, 2)})  # type: ignore[misc]
    return Report("many", tuple(rows), (_table(rows, plans),), _promises(rows))


def _rows(scene: str, ways: Mapping[str, Callable[[], Row]]) -> Iterator[Row]:
    """A row for each way, the ways taken in turn."""
    turns = [{name: way() for name, way in ways.items()} for _ in range(TURNS)]
    for name in ways:
        told = {key: median(turn[name][key] for turn in turns) for key in ("ms", "here", "there")}
        yield {"scene": scene, "way": name, **told}


def _promises(rows: Sequence[Row]) -> tuple[Promise, ...]:
    at = {(row["scene"], row["way"]): row for row in rows}
    gain = at[SCENE, "a loop"]["ms"] / at[SCENE, "Processes(2)"]["ms"]
    alone, engine = (at[EASY_SCENE, way] for way in ("a loop", "Processes(1)"))
    added = engine["here"] + engine["there"] - alone["here"]
    adds = f"an engine adds less than {OVERHEAD_MS:g} ms of CPU to a plan, on both sides together ({EASY_SCENE})"
    threads = at[PANDA, "threads: 1"]["ms"] / at[PANDA, "threads: 2"]["ms"]
    return (
        Promise(
            f"two threads of one service plan {PANDA} at least {THREADS_GAIN} times as fast as one",
            f"{threads:.2f} times",
            threads >= THREADS_GAIN,
        ),
        Promise(f"two cores plan {SCENE} at least {GAIN} times as fast as one", f"{gain:.2f} times", gain >= GAIN),
        Promise(adds, f"{added:.2f} ms", added < OVERHEAD_MS),
    )


def _table(rows: Sequence[Row], plans: int) -> Table:
    lines = (
        {"scene": row["scene"], "": row["way"], "ms a plan": f"{row['ms']:.2f}"}
        | {f"CPU ms {where}": f"{row[where]:.2f}" for where in ("here", "there")}
        for row in rows
    )
    caption = (
        f"{plans:,} plans, medians of {TURNS} turns, from the first result on: wall time, CPU of the process that asks "
        "and of its workers."
    )
    return table_of("How fast", lines, caption=caption)
