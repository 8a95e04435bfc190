"""Plans per second of threads that plan with one service, next to as many separate processes with a service each.

Everybody makes the same plans. Rounds of threads and of processes take turns, and the best of each counts, for whatever
else the machine does only disturbs.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import IO

from rich.table import Table

from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.latency import free_lines
from benchmarks.studies.problems import ROBOT, asked, public_problems
from benchmarks.worlds import queries
from planner_service import PlannerService, PlanRequest, load_robot

__all__ = ["WORKS", "run"]

WORKERS = 2
ROUNDS = 7
SECONDS = 0.7
"""About what a round takes one worker alone."""

LEAST = 0.9
"""Promised share of the plans per second of separate processes."""

Work = Callable[[], int]
"""Makes some plans; returns how many."""


def _searches() -> Work:
    service = PlannerService(queries.ROBOT, "bin")
    stored = queries.load("bin")
    requests = [PlanRequest(query.start, query.goal, seed=query.number, time_limit=None) for query in stored]
    return lambda: len([service.plan(request) for request in requests])


def _public() -> Work:
    robot = load_robot(ROBOT)
    works = [(PlannerService(robot, each.scene), asked(robot, each)) for each in public_problems().problems[::4]]
    return lambda: len([service.plan(request) for service, request in works])


def _lines() -> Work:
    service = PlannerService(queries.ROBOT, "bin")
    requests = [PlanRequest(*ends, time_limit=None) for ends in free_lines(service.checker, 20)]
    return lambda: len([service.plan(request) for request in requests])


def _proofs() -> Work:
    service = PlannerService(queries.ROBOT, "bin")
    results = [service.plan(PlanRequest(query.start, query.goal, time_limit=None)) for query in queries.load("bin")]
    paths = [result.path for result in results if result.path is not None]
    return lambda: len([service.certify(path) for path in paths])


WORKS: dict[str, Callable[[], Work]] = {
    "wxai, bin": _searches,
    "Panda, public problems": _public,
    "wxai, free straight lines": _lines,
    "wxai, proofs alone": _proofs,
}


class _Process:
    """A separate process that repeats one kind of work as often as it is asked to."""

    def __init__(self, name: str) -> None:
        command = [sys.executable, "-m", "benchmarks.studies.throughput", name]
        self._process = subprocess.Popen(command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.answer()

    def ask(self, times: int) -> None:
        pipe = _pipe(self._process.stdin)
        pipe.write(f"{times}\n")
        pipe.flush()

    def answer(self) -> int:
        return int(_pipe(self._process.stdout).readline())

    def end(self) -> None:
        self._process.communicate()


def _pipe(pipe: IO[str] | None) -> IO[str]:
    assert pipe is not None
    return pipe


def _serve(name: str) -> None:
    """Be such a process."""
    work = WORKS[name]()
    print(work(), flush=True)
    for line in sys.stdin:
        print(sum(work() for _ in range(int(line))), flush=True)


def _in_threads(work: Work, times: int, workers: int) -> float:
    """Plans per second."""
    made = list[int]()
    threads = [threading.Thread(target=lambda: made.extend(work() for _ in range(times))) for _ in range(workers)]
    clock = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(made) / (time.perf_counter() - clock)


def _in_processes(processes: list[_Process], times: int) -> float:
    """Plans per second."""
    clock = time.perf_counter()
    for process in processes:
        process.ask(times)
    return sum(process.answer() for process in processes) / (time.perf_counter() - clock)


def measured(name: str, rounds: int = ROUNDS, seconds: float = SECONDS) -> Row:
    """Plans per second of one thread, and of several threads and processes."""
    work, processes = WORKS[name](), [_Process(name) for _ in range(WORKERS)]
    try:
        work()
        clock = time.perf_counter()
        work()
        times = max(1, round(seconds / (time.perf_counter() - clock)))
        found: Row = {"work": name, "one": 0.0, "threads": 0.0, "processes": 0.0}
        for _ in range(rounds):
            found["one"] = max(found["one"], _in_threads(work, times, 1))
            found["threads"] = max(found["threads"], _in_threads(work, times, WORKERS))
            found["processes"] = max(found["processes"], _in_processes(processes, times))
        return found
    finally:
        for process in processes:
            process.end()


def run() -> Report:
    """Measure it all; about a minute. It needs as many cores as there are workers, and a quiet machine."""
    rows = tuple(measured(name) for name in WORKS)
    return Report("throughput", rows, (_table(rows),), promises(rows))


def promises(rows: tuple[Row, ...]) -> tuple[Promise, ...]:
    """What these figures were to be."""
    text = f"{WORKERS} threads make at least {LEAST:g} of the plans per second of {WORKERS} processes"
    shares = {row["work"]: row["threads"] / row["processes"] for row in rows}
    told = "; ".join(f"{name} {share:.2f}" for name, share in shares.items())
    return (Promise(text, told, min(shares.values()) >= LEAST),)


def _table(rows: tuple[Row, ...]) -> Table:
    lines = (
        {
            "work": row["work"],
            "one thread": f"{row['one']:,.0f}",
            f"{WORKERS} threads": f"{row['threads']:,.0f}",
            f"{WORKERS} processes": f"{row['processes']:,.0f}",
            "threads / processes": f"{row['threads'] / row['processes']:.2f}",
        }
        for row in rows
    )
    return table_of("Plans per second", lines, caption="The best of a few rounds, taken in turns.")


if __name__ == "__main__":
    _serve(sys.argv[1])
