"""A server and its workers, killed at random moments under load: what was answered or accepted before is there."""

from __future__ import annotations

import hashlib
import http.client
import os
import random
import shutil
import signal
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.attack.jail import give_to_nobody
from benchmarks.harness.report import Promise, Report, Row, table_of
from benchmarks.studies.serve import asked
from benchmarks.studies.serve.processes import Server, connected, server

__all__ = ["run"]

TURNS, CLIENTS, WORKERS = 20, 4, 2

SHORTEST, LONGEST = 0.2, 2.0
"""Seconds from the first request to the end of the server."""

PLANS = 100
"""Requests for plans, of which clients draw one; every fifth is for a whole pick-and-place."""

PAUSE = 0.05
"""Seconds after a request whose answer is not waited for: a full queue would have nothing answered."""


@dataclass
class _Told:
    """What clients were told: hashes of answers, and ids of what was accepted, by address."""

    answers: dict[str, str] = field(default_factory=dict)
    accepted: set[str] = field(default_factory=set)


def run(queries: int | None = None, seed: int = 0) -> Report:
    """Turns of load, each ended by kill -9 of a worker and then of the server; then everything is asked for again."""
    turns = TURNS if queries is None else queries
    draws, told = random.Random(seed), _Told()
    folder = Path(tempfile.mkdtemp(prefix="serve-kill-"))
    try:
        give_to_nobody(folder)
        for _ in range(turns):
            with server("--workers", str(WORKERS), folder=folder) as running:
                _killed_under_load(running, told, draws)
        with server("--workers", str(WORKERS), folder=folder) as running:
            row = _found(running, told)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    row |= {"part": "kill", "turns": turns}
    kept = f"{row['answers']} answers: {row['missing']} missing, {row['different']} different"
    ended = f"{row['accepted']} accepted: {row['answered']} answered, {row['lost']} lost, {row['unanswered']} neither"
    promises = (
        Promise("every answer survives kill -9", kept, row["missing"] == row["different"] == 0),
        Promise("whatever was accepted is answered or reported lost", ended, row["unanswered"] == 0),
    )
    caption = f"{turns} turns; in each, a worker and then the server are killed while {CLIENTS} clients ask."
    line = {"": "kill -9", "answers": kept, "accepted": ended}
    return Report("serve", (row,), (table_of("Kill", [line], caption=caption),), promises)


def _killed_under_load(running: Server, told: _Told, draws: random.Random) -> None:
    seconds = draws.uniform(SHORTEST, LONGEST)
    clients = [threading.Thread(target=_ask, args=(running.port, told, draws.random())) for _ in range(CLIENTS)]
    for client in clients:
        client.start()
    time.sleep(seconds / 2)
    workers = running.pids[1:]
    with suppress(ProcessLookupError, IndexError):
        os.kill(draws.choice(workers), signal.SIGKILL)
    time.sleep(seconds / 2)
    running.process.kill()
    for client in clients:
        client.join()


def _ask(port: int, told: _Told, seed: float) -> None:
    """Ask until the server is gone, and note what it tells."""
    draws, plans = random.Random(seed), asked.plan_bodies(asked.plan_requests(PLANS))
    with suppress(OSError, http.client.HTTPException), connected(port) as link:
        while True:
            path, body = "/plans", draws.choice(plans)
            if draws.random() < 0.2:
                path, (body,) = "/pick_place", asked.task_bodies([draws.randrange(1000)])
            if draws.random() < 0.5:
                reply = link.ask("POST", path, body)
                if reply.status == 202:
                    told.accepted.add(reply.headers["location"])
                time.sleep(PAUSE)
            else:
                reply = link.ask("POST", path, body, Prefer="wait=60")
                if reply.status == 200:
                    told.answers[reply.headers["content-location"]] = _hash(reply.data)


def _found(running: Server, told: _Told) -> Row:
    """How much of what clients were told is true."""
    counts = dict.fromkeys(("missing", "different", "answered", "lost", "unanswered"), 0)
    with connected(running.port, 300.0) as link:
        for place, answer in told.answers.items():
            reply = link.ask("GET", place)
            counts["missing"] += reply.status != 200
            counts["different"] += reply.status == 200 and _hash(reply.data) != answer
        for place in told.accepted:
            reply = link.ask("GET", place, Prefer="wait=60")
            failure = reply.document.get("failure") if reply.status == 200 else None
            lost = failure is not None and failure["reason"] == "WORKER_LOST"
            counts["lost" if lost else "answered" if reply.status == 200 else "unanswered"] += 1
    return {"answers": len(told.answers), "accepted": len(told.accepted), **counts}


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
