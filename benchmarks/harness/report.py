"""What a benchmark hands over: rows for machines, tables for people, and the promises it was to keep."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from planner_service.files.writing import write_whole

__all__ = ["Promise", "Report", "least_seconds", "p50", "p95", "show", "spread", "table", "write_json"]

Row = dict[str, Any]


@dataclass(frozen=True)
class Promise:
    """Something the product says of itself, what was measured, and whether that keeps it."""

    text: str
    measured: str
    kept: bool


@dataclass(frozen=True, eq=False)
class Report:
    """One benchmark's outcome."""

    name: str
    rows: tuple[Row, ...]
    tables: tuple[Table, ...]
    promises: tuple[Promise, ...] = ()


def p50(values: Iterable[float]) -> float:
    """Median, interpolated."""
    return float(np.percentile(list(values), 50))


def p95(values: Iterable[float]) -> float:
    """95th percentile, interpolated."""
    return float(np.percentile(list(values), 95))


def spread(values: Sequence[float], digits: int = 0) -> str:
    """``p50 / p95`` as a cell."""
    return f"{p50(values):,.{digits}f} / {p95(values):,.{digits}f}"


def least_seconds(*works: Callable[[], Any], turns: int) -> list[float]:
    """CPU seconds of each, the least of some turns, taken by turns: what disturbs only adds."""
    best = [math.inf] * len(works)
    for _ in range(turns):
        for k, work in enumerate(works):
            clock = time.process_time()
            work()
            best[k] = min(best[k], time.process_time() - clock)
    return best


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str = "") -> Table:
    """A table whose first column is text and whose other columns are numbers."""
    out = Table(title=title, caption=caption or None, title_justify="left", caption_justify="left")
    for k, column in enumerate(columns):
        out.add_column(column, justify="left" if k == 0 else "right")
    for row in rows:
        out.add_row(*row)
    return out


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
