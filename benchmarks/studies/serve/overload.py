"""Ten times as many requests as a server can do: refusals are quick, and what is accepted keeps its deadline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from benchmarks.harness.report import Promise, Report, Row, p50, p95, table_of
from benchmarks.studies.serve import asked
from benchmarks.studies.serve.processes import Reply, Server, connected, server

__all__ = ["run"]

WORKERS, QUEUE, TIMES, SECONDS = 2, 8, 10.0, 20.0

DEADLINE, LATE = 10.0, 0.5
"""Seconds of each request, and by how much a client may see its answer later than that."""

THREADS = 32

REFUSED_MS = 10.0


def run(queries: int | None = None, seed: int = 0) -> Report:
    """Pick-and-places at ten times the rate at which the same server does them."""
    del queries, seed
    bodies = [{**body, "deadline": DEADLINE} for body in asked.task_bodies(asked.task_requests(40))]
    with server("--workers", str(WORKERS), "--queue", str(QUEUE)) as running:
        capacity = _capacity(running, bodies)
        replies = _flooded(running, bodies, TIMES * capacity)
    refused = [reply.seconds * 1e3 for reply in replies if reply.status == 429]
    hints = sum("retry-after" not in reply.headers for reply in replies if reply.status == 429)
    ends = [reply.seconds for reply in replies if reply.status == 200]
    late = [end for end in ends if end > DEADLINE + LATE]
    others = [reply.status for reply in replies if reply.status not in (200, 429)]
    row: Row = {
        "part": "overload",
        "capacity": capacity,
        "sent": len(replies),
        "refused": len(refused),
        "refused_p50_ms": p50(refused) if refused else None,
        "refused_p95_ms": p95(refused) if refused else None,
        "accepted": len(ends),
        "longest": max(ends, default=None),
        "late": len(late),
        "others": others,
    }
    line = {
        "capacity, a second": f"{capacity:.1f}",
        "sent": len(replies),
        "refused (429)": len(refused),
        "p50 / p95 ms": f"{row['refused_p50_ms']:.1f} / {row['refused_p95_ms']:.1f}" if refused else "",
        "accepted": len(ends),
        "longest s": f"{max(ends, default=0.0):.1f}",
        "past their deadline": len(late),
    }
    caption = f"{WORKERS} workers, a queue of {QUEUE}, {TIMES:g} times the capacity for {SECONDS:g} s."
    promises = (
        Promise(
            f"at {TIMES:g} times the capacity a refusal takes at most {REFUSED_MS:g} ms (p95), with Retry-After",
            f"{row['refused_p95_ms'] or 0.0:.1f} ms; {hints} without Retry-After",
            bool(refused) and p95(refused) <= REFUSED_MS and not hints,
        ),
        Promise(
            f"what is accepted is answered within its deadline of {DEADLINE:g} s",
            f"{len(late)} of {len(ends)} were not; other statuses: {others[:5] or 'none'}",
            bool(ends) and not late and not others,
        ),
    )
    return Report("serve", (row,), (table_of("Overload", [line], caption=caption),), promises)


def _capacity(running: Server, bodies: Sequence[dict[str, Any]]) -> float:
    """Tasks per second with as many clients as workers and two to spare."""

    def send(first: int) -> None:
        with connected(running.port) as link:
            for body in bodies[first :: WORKERS + 2]:
                assert link.ask("POST", "/pick_place", body, Prefer="wait=60").status == 200

    began = time.perf_counter()
    with ThreadPoolExecutor(WORKERS + 2) as threads:
        list(threads.map(send, range(WORKERS + 2)))
    return len(bodies) / (time.perf_counter() - began)


def _flooded(running: Server, bodies: Sequence[dict[str, Any]], rate: float) -> list[Reply]:
    """The answers to requests that are sent at fixed times, whether or not earlier ones are answered."""
    began, numbers, replies = time.perf_counter() + 0.2, iter(range(int(rate * SECONDS))), list[Reply]()

    def send(_: int) -> None:
        with connected(running.port) as link:
            for k in numbers:  # each number for one thread: the next that is free
                time.sleep(max(0.0, began + k / rate - time.perf_counter()))
                replies.append(link.ask("POST", "/pick_place", bodies[k % len(bodies)], Prefer="wait=60"))

    with ThreadPoolExecutor(THREADS) as threads:
        list(threads.map(send, range(THREADS)))
    return replies
