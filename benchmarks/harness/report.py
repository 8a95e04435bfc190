"""What a benchmark hands over: rows for machines, tables for people, and the promises it was to keep."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

from planner_service.files.writing import write_whole

__all__ = ["Promise", "Report", "cpu_ms", "grouped", "least_ms", "least_seconds", "merged", "p50", "p95", "show"]
__all__ += ["spread", "table", "table_of", "write_json"]

Row = dict[str, Any]
T = TypeVar("T")


@dataclass(frozen=True)
class Promise:
    """Something the product says of itself, what was measured, and whether that keeps it."""

    text: str
    measured: str
    kept: bool


@dataclass(frozen=True, eq=False)
class Report:
    """One benchmark's outcome.

    Attributes:
        parts: What it was merged from, if each of these has a place of its own in a text.
    """

    name: str
    rows: tuple[Row, ...]
    tables: tuple[Table, ...]
    promises: tuple[Promise, ...] = ()
    parts: tuple[Report, ...] = ()


def merged(name: str, reports: Sequence[Report]) -> Report:
    """The outcomes of all parts of a benchmark as one."""
    rows = tuple(row for report in reports for row in report.rows)
    tables = tuple(table for report in reports for table in report.tables)
    return Report(name, rows, tables, tuple(promise for report in reports for promise in report.promises))


def grouped(rows: Iterable[Row], key: str) -> dict[Any, list[Row]]:
    """The rows by one of their values, in the order in which these come."""
    groups = dict[Any, list[Row]]()
    for row in rows:
        groups.setdefault(row[key], []).append(row)
    return groups


def p50(values: Iterable[float]) -> float:
    """Median, interpolated."""
    return float(np.percentile(list(values), 50))


def p95(values: Iterable[float]) -> float:
    """95th percentile, interpolated."""
    return float(np.percentile(list(values), 95))


def spread(values: Sequence[float], digits: int = 0) -> str:
    """``p50 / p95`` as a cell."""
    return f"{p50(values):,.{digits}f} / {p95(values):,.{digits}f}"


def cpu_ms(work: Callable[[], T]) -> tuple[float, T]:
    """Milliseconds of CPU that some work takes, and its result."""
    clock = time.process_time()
    result = work()
    return (time.process_time() - clock) * 1e3, result


def least_ms(work: Callable[[], T], turns: int) -> tuple[float, list[T]]:
    """The least milliseconds of CPU of some turns, and the result of each."""
    found = [cpu_ms(work) for _ in range(turns)]
    return min(ms for ms, _ in found), [result for _, result in found]


def least_seconds(*works: Callable[[], Any], turns: int) -> list[float]:
    """CPU seconds of each, the least of some turns, taken by turns: what disturbs only adds."""
    best = [math.inf] * len(works)
    for _ in range(turns):
        for k, work in enumerate(works):
            clock = time.process_time()
            work()
            best[k] = min(best[k], time.process_time() - clock)
    return best


def table(title: str, columns: Sequence[str], rows: Iterable[Iterable[object]], *, caption: str = "") -> Table:
    """A table whose first column is text and whose other columns are numbers."""
    out = Table(title=title, caption=caption or None, title_justify="left", caption_justify="left")
    for k, column in enumerate(columns):
        out.add_column(column, justify="left" if k == 0 else "right")
    for row in rows:
        out.add_row(*map(str, row))
    return out


def table_of(title: str, lines: Iterable[Mapping[str, object]], *, caption: str = "") -> Table:
    """A table of at least one line; each holds its cells by heading, all the same headings."""
    first, *others = lines
    return table(title, tuple(first), [line.values() for line in (first, *others)], caption=caption)


def show(reports: Sequence[Report], console: Console) -> bool:
    """Print the promises of all reports; whether all were kept."""
    promises = [promise for report in reports for promise in report.promises]
    if promises:
        rows = [(p.text, p.measured, "kept" if p.kept else "BROKEN") for p in promises]
        console.print(table("Promises", ("promise", "measured", ""), rows))
    return all(promise.kept for promise in promises)


def write_json(reports: Sequence[Report], path: Path) -> None:
    """All rows and promises in one file, there whole or not at all."""
    content = {
        report.name: {"rows": list(report.rows), "promises": [vars(p) for p in report.promises]} for report in reports
    }
    write_whole(path, json.dumps(content, indent=1) + "\n")
