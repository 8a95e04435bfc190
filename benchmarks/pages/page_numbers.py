"""What a report says of results: rows grouped by suite and contender, and what peers are compared by."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.harness import statistics
from benchmarks.harness.rows import Results, Row, states_of
from benchmarks.harness.statistics import FEW, Estimate

__all__ = ["OURS", "Group", "Pace", "Sheet", "paces", "planning_seconds", "rejected", "seconds", "sheets_of"]
__all__ += ["stage_seconds", "states"]

OURS = "planner_service"
ABSENT = "not_installed"
"""The failure of rows that only say that a peer could not be run here."""

NOT_PATH = ("setup", "certify", "timing")
"""Stages that neither find nor shorten a path."""

Measure = Callable[[Row], "float | None"]


@dataclass(frozen=True, eq=False)
class Group:
    """The rows of one contender on one suite.

    Attributes:
        name: What it is called in reports.
        tool, planner: As in its rows.
    """

    name: str
    tool: str
    planner: str
    rows: tuple[Row, ...]

    @property
    def absent(self) -> bool:
        """Whether it could not be run at all."""
        return all(row["failure"] == ABSENT for row in self.rows)

    @property
    def done(self) -> tuple[Row, ...]:
        """Rows with a path."""
        return tuple(row for row in self.rows if row["ok"])

    @property
    def counts(self) -> bool:
        """Whether anybody counted its checks."""
        return any(row["checks"] for row in self.rows)

    @property
    def rejects(self) -> tuple[Row, ...]:
        """Rows whose path or motion the independent checker refuses."""
        return tuple(row for row in self.done if rejected(row))

    @property
    def audited(self) -> int:
        """Rows that were put before that checker."""
        return sum(row["audit"]["verdict"] != "not_asked" for row in self.done)

    @property
    def solved(self) -> Estimate:
        """The share of rows with a path."""
        return statistics.wilson(len(self.done), len(self.rows))

    @property
    def versions(self) -> Mapping[str, str]:
        """What a peer's rows say of its packages."""
        return next((row["versions"] for row in self.rows if row.get("versions")), {})

    def of_kind(self, kind: str) -> Group:
        """Its rows of one kind."""
        return Group(self.name, self.tool, self.planner, tuple(row for row in self.rows if row["kind"] == kind))

    def values(self, measure: Measure, *, charged: bool = False) -> list[float]:
        """A measure of the rows with a path, or of all where failures are charged what they spent."""
        found = [measure(row) for row in (self.rows if charged else self.done)]
        return [value for value in found if value is not None]

    def quantile(self, measure: Measure, share: float, *, charged: bool = False) -> Estimate | None:
        """A quantile of ``values`` with its interval, None of none."""
        by_problem = _values(self.rows if charged else self.done, measure, _problem)
        return statistics.quantile(by_problem, share) if by_problem else None


@dataclass(frozen=True, eq=False)
class Sheet:
    """Everything about one suite: its contenders, and the headers of the files they come from."""

    suite: str
    groups: tuple[Group, ...]
    headers: tuple[Mapping[str, Any], ...]

    @property
    def present(self) -> tuple[Group, ...]:
        """The contenders that were run."""
        return tuple(group for group in self.groups if not group.absent)

    @property
    def several_tools(self) -> bool:
        """Whether there are peers."""
        return len({group.tool for group in self.groups}) > 1

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of problems, in the order of the rows."""
        return tuple(dict.fromkeys(row["kind"] for group in self.groups for row in group.rows))


def sheets_of(found: Iterable[Results]) -> tuple[Sheet, ...]:
    """A sheet for each suite, in the order of the files; a row that is in two files counts once."""
    rows: dict[str, dict[tuple[str, str], dict[tuple[str, int], Row]]] = {}
    headers: dict[str, list[Mapping[str, Any]]] = {}
    for results in found:
        for suite in dict.fromkeys([results.header["suite"], *(row["suite"] for row in results.rows)]):
            headers.setdefault(suite, []).append(results.header)
        for row in results.rows:
            group = rows.setdefault(row["suite"], {}).setdefault((row["tool"], row["planner"]), {})
            group.setdefault((row["problem"], row["seed"]), row)
    sheets = []
    for suite, groups in rows.items():
        several = len({tool for tool, _ in groups}) > 1
        named = [
            Group(_name(tool, planner, several), tool, planner, tuple(found.values()))
            for (tool, planner), found in groups.items()
        ]
        sheets.append(Sheet(suite, tuple(named), tuple(headers[suite])))
    return tuple(sheets)


def _name(tool: str, planner: str, several: bool) -> str:
    return f"{tool} {planner}" if several and tool != planner else planner


def rejected(row: Row) -> bool:
    """Whether the independent checker refuses what the row's path or motion is."""
    return row["audit"]["verdict"] in ("colliding", "outside_limits")


def seconds(row: Row) -> float:
    """Processor time of the call: on a machine that others use, too, wall clock says how busy these were."""
    return float(row["cpu_seconds"])


def stage_seconds(row: Row, stage: str) -> float:
    """Processor time of a stage: its share of the wall clock, which is what rows tell."""
    wall = math.fsum(spent for name, spent in row["seconds"].items() if name != "setup")
    return seconds(row) * row["seconds"].get(stage, 0.0) / wall if wall > 0.0 else 0.0


def planning_seconds(row: Row) -> float | None:
    """Of these what finding and shortening the path took, without proof, timing and set-up; None if not told."""
    told = [stage for stage in row["seconds"] if stage not in NOT_PATH]
    return math.fsum(stage_seconds(row, stage) for stage in told) if told else None


def states(row: Row) -> float | None:
    """Configurations judged in all stages; None where nobody counted."""
    return float(states_of(row)) if row["checks"] else None


@dataclass(frozen=True)
class Pace:
    """How long a peer takes next to us.

    Attributes:
        ratio: Median of its seconds over ours, over the problems both solved; where these are fewer than ``FEW``, over
            the runs of the same problem and seed.
        planning: The same of the stages that find and shorten the path alone: not proof, not timing; None where a side
            does not tell its stages.
        units: How many problems or runs those are.
        unit: What they are.
        faster: On how many of them it takes less than we do.
    """

    ours: str
    peer: str
    ratio: Estimate
    planning: Estimate | None
    units: int
    unit: str
    faster: int

    @property
    def verdict(self) -> str:
        """``faster``, ``slower`` or ``not shown``, by the interval of the ratio."""
        if self.units < FEW:
            return "not shown"
        if self.ratio.high < 1.0:
            return "faster"
        return "slower" if self.ratio.low > 1.0 else "not shown"


def paces(sheet: Sheet) -> tuple[Pace, ...]:
    """Every peer next to our first planner, on the problems both solved; none without us or without peers."""
    ours = next((group for group in sheet.present if group.tool == OURS), None)
    peers = [group for group in sheet.present if group.tool != OURS]
    found = [] if ours is None else [_pace(ours, peer) for peer in peers]
    return tuple(pace for pace in found if pace is not None)


def _pace(ours: Group, peer: Group) -> Pace | None:
    unit, key = "problems", _problem
    whole = _ratios(ours, peer, seconds, key)
    if len(whole) < FEW:
        unit, key = "runs", _run
        whole = _ratios(ours, peer, seconds, key)
    if not whole:
        return None
    planning = _ratios(ours, peer, planning_seconds, key)
    path = _median(planning) if planning else None
    faster = sum(ratio < 1.0 for ratio in whole.values())
    return Pace(ours.name, peer.name, _median(whole), path, len(whole), unit, faster)


def _problem(row: Row) -> str:
    return str(row["problem"])


def _run(row: Row) -> str:
    return f"{row['problem']} seed {row['seed']}"


def _ratios(ours: Group, peer: Group, measure: Measure, key: Callable[[Row], str]) -> dict[str, float]:
    """The peer's median over ours, of the rows of both that have the same key."""
    first, second = _medians(ours.done, measure, key), _medians(peer.done, measure, key)
    both = [unit for unit in first if unit in second]
    return {unit: second[unit] / first[unit] for unit in both if first[unit] > 0.0 and second[unit] > 0.0}


def _medians(rows: Sequence[Row], measure: Measure, key: Callable[[Row], str]) -> dict[str, float]:
    return {unit: float(np.median(found)) for unit, found in _values(rows, measure, key).items()}


def _values(rows: Iterable[Row], measure: Measure, key: Callable[[Row], str]) -> dict[str, list[float]]:
    """The values of the rows that have one, by problem or by run."""
    values: dict[str, list[float]] = {}
    for row in rows:
        value = measure(row)
        if value is not None:
            values.setdefault(key(row), []).append(value)
    return values


def _median(ratios: Mapping[str, float]) -> Estimate:
    return statistics.quantile({unit: [ratio] for unit, ratio in ratios.items()}, 0.5)
