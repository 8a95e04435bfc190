"""A log of what a gate refused or changed: lines of JSON, each appended at once."""

from __future__ import annotations

import json
import math
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner_service.files.writing import require_writable
from planner_service.gate.verdict import Refused, Verdict
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance

__all__ = ["MAX_LOG", "GateLog", "Logged"]

OURS = re.compile(rb'\{"time": ')

MAX_LOG = 64 * 1024 * 1024
"""Bytes of a log, some 200,000 refusals; what comes then is counted as not logged."""


@dataclass(frozen=True)
class Logged:
    """One line of a log: what was refused or changed, and where the arm was.

    Attributes:
        time: Seconds since 1970.
        chunk: Its number, from 1.
        accepted: Targets that passed.
        speed: As in ``Verdict``.
        repaired: Likewise.
        proven: Likewise.
        refused: Likewise.
        q: Where the arm was measured, (n,); empty if that is not known.
        rest: Where what had passed brings it to rest, (n,); empty likewise.
    """

    time: float
    chunk: int
    accepted: int
    speed: float
    repaired: bool
    proven: bool
    refused: Refused | None
    q: tuple[float, ...] = ()
    rest: tuple[float, ...] = ()

    @classmethod
    def of(cls, seconds: float, chunk: int, verdict: Verdict, q: FloatArray | None) -> Logged:
        """The verdict on a chunk that has such a number, of an arm measured at q (n,), so many seconds since 1970."""
        measured = () if q is None or not np.isfinite(q).all() else tuple(q.tolist())
        rest = tuple(verdict.rows[-1].tolist()) if len(verdict.rows) else ()
        return cls(
            seconds, chunk, verdict.accepted, verdict.speed, verdict.repaired, verdict.proven, verdict.refused,
            measured, rest,
        )  # fmt: skip


class GateLog:
    """Appends what was refused or changed to a file, one line of JSON each, in one piece.

    Args:
        path: The file; made if it is not there.

    Attributes:
        lost: Decisions that are not in the file: it is full, or cannot be written any more.

    Raises:
        InvalidRequest: no path.
        InvalidFile: a file that cannot be written, or of another kind.
    """

    def __init__(self, path: str | Path) -> None:
        instance("log", path, (str, Path), "the path of a file")
        self.path = Path(path)
        self.lost = 0
        require_writable(self.path, OURS)

    def write(self, chunk: int, verdict: Verdict, q: FloatArray | None) -> None:
        """Append the decision on a chunk that has such a number. Nothing stops the arm's caller if that fails.

        Args:
            q: Where the arm was measured, (n,); None if it was not.
        """
        logged = Logged.of(round(time.time(), 6), chunk, verdict, q)
        refused = verdict.refused
        names = ("time", "chunk", "accepted", "speed", "repaired", "proven", "q", "rest")
        line: dict[str, object] = {name: getattr(logged, name) for name in names}
        if refused is not None:
            line |= {
                "kind": refused.kind.value,
                "index": refused.index,
                "after": refused.time,
                "joint": refused.joint,
                "pair": refused.pair,
                "at": refused.at,
                "depth": refused.depth if math.isfinite(refused.depth) else None,
                "detail": refused.detail,
            }
        try:
            self._append(json.dumps(line).encode() + b"\n")
        except OSError:
            self.lost += 1

    def _append(self, line: bytes) -> None:
        descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            full = os.fstat(descriptor).st_size + len(line) > MAX_LOG
            self.lost += full or os.write(descriptor, line) != len(line)
        finally:
            os.close(descriptor)
