"""Reads the log of a gate again."""

from __future__ import annotations

import math
import os
from functools import cached_property

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import parse_json
from planner_service.files.reading import as_path, read_bytes
from planner_service.files.schema import Count, NamePair, Numbers, Reading, Record, Text, read_record
from planner_service.gate.log import MAX_LOG, Logged
from planner_service.gate.verdict import Kind, Refused
from planner_service.geometry.validation import whole

__all__ = ["read_log"]

MAX_LINES = 500_000
"""Of a log; a full one has about half of that."""


class LoggedLine(Record):
    """A line of the log. Older ones do not say where the arm was."""

    time: float
    chunk: Count
    accepted: Count
    speed: float
    repaired: bool
    proven: bool
    kind: Text | None = None
    index: Count = 0
    after: float = 0.0
    joint: Text = ""
    pair: NamePair | None = None
    at: Numbers | None = None
    depth: float | None = 0.0
    detail: Text = ""
    q: Numbers | None = None
    rest: Numbers | None = None

    @cached_property
    def value(self) -> Logged:
        """What was logged."""
        refused = None if self.kind is None else self._refused(self.kind)
        said = self.accepted, self.speed, self.repaired, self.proven, refused
        return Logged(self.time, self.chunk, *said, tuple(self.q or ()), tuple(self.rest or ()))

    def _refused(self, kind: str) -> Refused:
        kinds = {each.value: each for each in Kind}
        if kind not in kinds:
            raise InvalidRequest("kind", kind, f"one of {', '.join(kinds)}")
        pair = None if self.pair is None else (self.pair[0], self.pair[1])
        depth = math.inf if self.depth is None else self.depth
        return Refused(kinds[kind], self.index, self.detail, self.after, self.joint, pair, tuple(self.at or ()), depth)


def read_log(log: str | os.PathLike[str], joints: int) -> tuple[Logged, ...]:
    """What is in a log, of a robot with so many joints.

    Raises:
        InvalidRequest: no path, or no number of joints.
        InvalidFile: no file, one that is larger than a log can be, or a line that no gate has written, with its number.
    """
    path = as_path("log", log)
    whole("joints", joints, 1, 10_000)
    lines = [line for line in read_bytes(path, MAX_LOG).splitlines() if line.strip()]
    if len(lines) > MAX_LINES:
        raise InvalidFile(path, [f"more than {MAX_LINES:,} lines"])
    out = list[Logged]()
    for number, line in enumerate(lines, 1):
        logged: Logged = read_record(LoggedLine, parse_json(path, line), path, Reading(where=f"line {number}")).value
        at = () if logged.refused is None else logged.refused.at
        for name, values in (("at", at), ("q", logged.q), ("rest", logged.rest)):
            if len(values) not in (0, joints):
                raise InvalidFile(path, [f"line {number}.{name}: {len(values)} numbers; the robot has {joints} joints"])
        out.append(logged)
    return tuple(out)
