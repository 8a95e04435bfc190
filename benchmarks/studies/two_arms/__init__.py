"""Several arms, each with its own clock: what plans cost, and whether anything touches, however late arms are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.harness.report import Report, merged
from benchmarks.studies.two_arms import picks, plans, stops

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int, Path | None], Report]] = {
    "plans": plans.run,
    "stops": lambda queries, seed, _: stops.run(queries, seed),
    "picks": lambda schedules, seed, _: picks.run(schedules, seed),
}


def run(part: str | None = None, queries: int | None = None, seed: int = 0, problems: Path | None = None) -> Report:
    """Take a part, or all.

    Args:
        part: One of ``PARTS``.
        queries: Plans of each scene, executions, or schedules of picks; as many as show what a part promises if None.
        seed: Of what is drawn.
        problems: The folder of published problems, for Baxter.
    """
    return merged("two-arms", [PARTS[name](queries, seed, problems) for name in PARTS if part in (None, name)])
