"""Roadmaps that last: what a warm query costs, what a single one, what a moved obstacle, and what a large one takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from benchmarks.harness.report import Report, merged
from benchmarks.studies.roadmaps import large, lazy, moved, warm

__all__ = ["PARTS", "run"]

PARTS: Mapping[str, Callable[[], Report]]
PARTS = {"warm": warm.measured, "lazy": lazy.measured, "moved": moved.measured, "large": large.measured}
"""What is measured, by the names that ``--part`` takes."""


def run(part: str | None = None) -> Report:
    """Measure a part, or all; that takes about four minutes."""
    return merged("roadmaps", [measured() for name, measured in PARTS.items() if part in (None, name)])
