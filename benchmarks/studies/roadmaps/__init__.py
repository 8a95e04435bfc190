"""Roadmaps that last: what a warm query costs, what a single one, what a moved obstacle, and what a large one takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from benchmarks.harness.report import Report
from benchmarks.studies.roadmaps import large, lazy, moved, warm

__all__ = ["PARTS", "run"]

PARTS: Mapping[str, Callable[[], Report]] = {
    "warm": warm.measured,
    "lazy": lazy.measured,
    "moved": moved.measured,
    "large": large.measured,
}
"""What is measured, by the names that ``--part`` takes."""


def run(part: str | None = None) -> Report:
    """Measure a part, or all; that takes about four minutes."""
    reports = [measured() for name, measured in PARTS.items() if part in (None, name)]
    return Report(
        "roadmaps",
        tuple(row for report in reports for row in report.rows),
        tuple(table for report in reports for table in report.tables),
        tuple(promise for report in reports for promise in report.promises),
    )
