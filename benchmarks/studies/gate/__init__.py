"""The gate between a policy and an arm: attacked, measured, and tried on the simulated arm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.harness.kept import Kept
from benchmarks.harness.report import Report, merged
from benchmarks.studies.gate import chunks, kill, refusals, session, times, tubes, violations

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int, str | None, Kept], Report]] = {
    "chunks": chunks.run,
    "tubes": tubes.run,
    "planted": chunks.planted,
    "violations": violations.run,
    "refusals": refusals.run,
    "times": times.run,
    "session": session.run,
    "kill": kill.run,
}
"""Of these ``chunks`` and ``times`` may take hours, and go on where they were ended."""


def run(
    part: str | None = None,
    queries: int | None = None,
    seed: int = 0,
    robot: str | None = None,
    keep: Path | None = None,
) -> Report:
    """Take a part, or all.

    Args:
        part: One of ``PARTS``.
        queries: Chunks, or checks, of a part; as many as show what it promises if None.
        seed: Of what is drawn.
        robot: The only one to look at; all if None.
        keep: A file of what is done of ``chunks`` and ``times``.
    """
    kept = Kept(keep)
    return merged("gate", [PARTS[name](queries, seed, robot, kept) for name in PARTS if part in (None, name)])
