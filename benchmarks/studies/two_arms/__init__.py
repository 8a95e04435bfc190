"""Several arms, each with its own clock: what plans cost, and whether anything touches, however late arms are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.harness.report import Report, merged
from benchmarks.studies.two_arms import peers, picks, plans, stops

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int, Path | None, Path | None], Report]] = {
    "plans": lambda queries, seed, problems, _: plans.run(queries, seed, problems),
    "stops": lambda queries, seed, _, __: stops.run(queries, seed),
    "picks": lambda schedules, seed, _, __: picks.run(schedules, seed),
    "peers": lambda queries, seed, _, python: peers.run(queries, seed, python),
}


def run(
    part: str | None = None,
    queries: int | None = None,
    seed: int = 0,
    problems: Path | None = None,
    against: Path | None = None,
) -> Report:
    """Take a part, or all.

    Args:
        part: One of ``PARTS``.
        queries: Plans of each scene, executions, or schedules of picks; as many as show what a part promises if None.
        seed: Of what is drawn.
        problems: The folder of published problems, for Baxter.
        against: The Python of an environment with SRMP, for ``peers``.
    """
    return merged("two-arms", [PARTS[name](queries, seed, problems, against) for name in PARTS if part in (None, name)])
