"""Requests that are withdrawn while they run: how long until a worker is free again, and the answer says so."""

from __future__ import annotations

import math
import time
from typing import Any

from benchmarks.harness.report import Promise, Report, Row, p50, p95, table_of
from benchmarks.studies.serve.processes import Link, connected, server

__all__ = ["run"]

TURNS, AFTER = 100, 0.1
"""Cancellations of each kind, and seconds for which a request runs before."""

CANCEL_MS = 50.0


def run(queries: int | None = None, seed: int = 0) -> Report:
    """Searches without an end, cancelled by DELETE and by a closed connection."""
    del seed
    turns = TURNS if queries is None else queries
    with server("--workers", "1") as running, connected(running.port) as link:
        body = _endless(link)
        deleted = [_deleted(link, body) for _ in range(turns)]
        closed = [_closed(running.port, link, body) for _ in range(turns)]
    rows: list[Row] = [
        {"part": "cancel", "way": way, "turns": len(ms), "p50_ms": p50(ms), "p95_ms": p95(ms)}
        for way, ms in (("DELETE", deleted), ("closed connection", closed))
    ]
    lines = [
        {"": row["way"], "cancelled": row["turns"], "p50 / p95 ms": f"{row['p50_ms']:.1f} / {row['p95_ms']:.1f}"}
        for row in rows
    ]
    caption = (
        "From the DELETE, or from when the connection is closed, until the request has ended, as its client sees it."
    )
    promise = Promise(
        f"a running request is cancelled within {CANCEL_MS:g} ms (p95)",
        "; ".join(f"{row['way']}: {row['p95_ms']:.1f} ms" for row in rows),
        all(row["p95_ms"] <= CANCEL_MS for row in rows),
    )
    return Report("serve", tuple(rows), (table_of("Cancel", lines, caption=caption),), (promise,))


def _endless(link: Link) -> dict[str, Any]:
    """A search that finds nothing: a wall stands between the start and the goal, around the arm and above it."""
    d, angle = math.sqrt(0.5), math.pi / 8
    across = [math.cos(angle), 0.0, 0.0, math.sin(angle)]
    boxes = {
        "far": ([1.0, 0.02, 1.8], [0.7 * d, 0.7 * d, 0.9]),
        "near": ([1.0, 0.02, 1.8], [-0.7 * d, -0.7 * d, 0.9]),
        "lintel": ([0.5, 0.02, 1.0], [0.0, 0.0, 1.1]),
    }
    obstacles = [
        {
            "name": name,
            "shape": {"kind": "box", "size": size},
            "pose": {"position": position, "quaternion_wxyz": across},
        }
        for name, (size, position) in boxes.items()
    ]
    reply = link.ask("PUT", "/scenes/walls", {"obstacles": obstacles})
    assert reply.status == 201, reply.data
    home = link.ask("GET", "/robot").document["robot"]["named_poses"]
    start = next(pose["q"] for pose in home if pose["name"] == "home")
    goal = [start[0] + 1.6, *start[1:]]
    request = {"start": start, "goals": [{"joints": goal}], "max_checks": 10**9, "time_limit": 60.0}
    return {"scene": "walls", "request": request}


def _deleted(link: Link, body: dict[str, Any]) -> float:
    """Milliseconds."""
    place = link.ask("POST", "/plans", body).headers["location"]
    _wait_until_running(link, place)
    time.sleep(AFTER)
    began = time.perf_counter()
    assert link.ask("DELETE", place).status == 202
    answer = link.ask("GET", place, Prefer="wait=60")
    seconds = time.perf_counter() - began
    assert answer.document["result"]["failure"]["reason"] == "PREEMPTED", answer.data[:500]
    return seconds * 1e3


def _closed(port: int, link: Link, body: dict[str, Any]) -> float:
    """The same; the connection is closed by a client that waits."""
    before = {job["id"] for job in link.ask("GET", "/plans?limit=5").document["plans"]}
    with connected(port) as waiting:
        waiting.send("POST", "/plans", body, Prefer="wait=60")
        place = ""
        while not place:
            new = [job["id"] for job in link.ask("GET", "/plans?limit=5").document["plans"] if job["id"] not in before]
            place = f"/plans/{new[0]}" if new else ""
        _wait_until_running(link, place)
        time.sleep(AFTER)
        began = time.perf_counter()
    answer = link.ask("GET", place, Prefer="wait=60")
    assert answer.document["result"]["failure"]["reason"] == "PREEMPTED", answer.data[:500]
    return (time.perf_counter() - began) * 1e3


def _wait_until_running(link: Link, place: str) -> None:
    while link.ask("GET", place).document.get("state") == "queued":
        time.sleep(0.005)
