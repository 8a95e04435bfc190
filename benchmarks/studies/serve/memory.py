"""A hundred thousand requests, and the memory that a server and its workers have then."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.serve import asked
from benchmarks.studies.serve.processes import Server, connected, server

__all__ = ["run"]

REQUESTS, THREADS, WORKERS = 100_000, 8, 2

WARM = 0.2
"""Part of the requests after which memory is taken to be as large as it gets: all that is kept for a while is kept."""

GROWTH = 0.05
"""Part by which it may be larger at the end."""


def run(queries: int | None = None, seed: int = 0) -> Report:
    """Plans of a straight line, and looks at the memory after every twentieth of them."""
    del seed
    count = REQUESTS if queries is None else queries
    bodies = [{**body, "scene": "table"} for body in asked.plan_bodies(asked.plan_requests(40))]
    with server("--workers", str(WORKERS), "--queue", "64", scenes=("table",)) as running:
        marks, failed = _sent(running, bodies, count)
    rows: list[Row] = [{"part": "memory", "requests": done, "megabytes": megabytes} for done, megabytes in marks]
    warm = max(row["megabytes"] for row in rows if row["requests"] <= WARM * count)
    end = rows[-1]["megabytes"]
    caption = "Resident memory of the server and its workers, shared pages counted for each."
    lines = [{"requests": f"{row['requests']:,}", "MB": f"{row['megabytes']:.0f}"} for row in rows]
    text = f"memory is flat over {count:,} requests: within {GROWTH:.0%} of what it was after a fifth of them"
    told = f"{warm:.0f} MB, then {end:.0f} MB; {failed} requests failed"
    promise = Promise(text, told, end <= (1.0 + GROWTH) * warm and not failed)
    return Report("serve", tuple(rows), (table_of("Memory", lines, caption=caption),), (promise,))


def _sent(running: Server, bodies: Sequence[dict[str, Any]], count: int) -> tuple[list[tuple[int, float]], int]:
    """Memory after so many requests, and how many of all were not answered with 200."""
    lock, marks, every = threading.Lock(), list[tuple[int, float]](), max(1, count // 20)
    done = failed = 0

    def send(first: int) -> None:
        nonlocal done, failed
        with connected(running.port) as link:
            for k in range(first, count, THREADS):
                status = link.ask("POST", "/plans", bodies[k % len(bodies)], Prefer="wait=60").status
                with lock:
                    done, failed = done + 1, failed + (status != 200)
                    if done % every == 0 or done == count:
                        marks.append((done, running.megabytes))

    with ThreadPoolExecutor(THREADS) as threads:
        for thread in [threads.submit(send, first) for first in range(THREADS)]:
            thread.result()
    return marks, failed
