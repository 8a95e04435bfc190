"""How an adapter talks: it reads one job file and answers each of its problems with one line of JSON.

This file and the adapters beside it are run by the peer's interpreter, in which nothing of ours is installed: they
import the standard library, the peer and this file. Whatever the peer itself prints goes to standard error.

A problem is answered when it is called for by a line on standard input, so that several peers can take turns.

A job: ``{"version": 1, "robot": {...}, "settings": {...}, "time_limit": s, "problems": [...]}``. The first line that
comes back is ``{"ready": {name: version, ...}}``, the others have "problem" and "seed" beside what ``Answer`` holds.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any, Protocol

__all__ = ["Answer", "Table", "clock", "matrix_of", "serve"]

Table = Mapping[str, Any]


@dataclass
class Answer:
    """What a peer makes of a problem.

    Attributes:
        waypoints: The final path, straight in joint space between two rows; None if there is none.
        times: Of the waypoints, where the peer times.
        seconds: Wall clock by stage: "setup" (the world), "search", "shortcut", "timing".
        cpu_seconds: Processor time of all stages but "setup".
        stage_cpu_seconds: Processor time by stage.
        checks: States that were judged by stage, where somebody counts.
        error: Why there is no path.
    """

    waypoints: Any = None
    times: Any = None
    seconds: dict[str, float] = field(default_factory=dict)
    cpu_seconds: float = 0.0
    stage_cpu_seconds: dict[str, float] = field(default_factory=dict)
    checks: dict[str, int] = field(default_factory=dict)
    error: str = ""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is done inside."""
        began, spent = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
            used = time.process_time() - spent
            self.stage_cpu_seconds[name] = self.stage_cpu_seconds.get(name, 0.0) + used
            if name != "setup":
                self.cpu_seconds += used


class Peer(Protocol):
    """A peer with its robot loaded."""

    def solve(self, problem: Table, seed: int, answer: Answer) -> None:
        """Fill in the answer to a problem."""


def serve(packages: tuple[str, ...], make: Callable[[Table], Peer]) -> None:
    """Answer the job file named on the command line.

    Args:
        packages: Distributions whose versions are told.
        make: The peer, given the job.
    """
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints must not get among the answers
    with open(sys.argv[1], encoding="utf-8") as file:
        job = json.load(file)
    peer = make(job)
    _say(channel, {"ready": {name: metadata.version(name) for name in packages}})
    for problem, _ in zip(job["problems"], sys.stdin, strict=False):
        _say(channel, _answered(peer, problem))


def _answered(peer: Peer, problem: Table) -> dict[str, Any]:
    answer = Answer()
    try:
        peer.solve(problem, problem["seed"], answer)
    except Exception as error:  # whatever it is, it is this problem's answer
        traceback.print_exc()
        answer.waypoints, answer.error = None, f"{type(error).__name__}: {error}".strip()
    told = {name: _plain(value) for name, value in vars(answer).items()}
    return {"problem": problem["problem"], "seed": problem["seed"]} | told


def _plain(value: Any) -> Any:
    """Arrays as lists."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def _say(channel: Any, content: Mapping[str, Any]) -> None:
    channel.write(json.dumps(content, separators=(",", ":")) + "\n")
    channel.flush()


def clock(answer: Answer, limit: float) -> float:
    """Seconds left of a limit for search, shortcut and timing together."""
    return max(0.01, limit - sum(spent for stage, spent in answer.seconds.items() if stage != "setup"))


def matrix_of(body: Table) -> list[list[float]]:
    """An obstacle's pose as a 4 x 4 matrix."""
    w, x, y, z = body["quaternion_wxyz"]
    px, py, pz = body["position"]
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), px],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), py],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), pz],
        [0.0, 0.0, 0.0, 1.0],
    ]
