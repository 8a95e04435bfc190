"""Five work cells, three robots: whether all that can be done is done, proven, and carried out without a contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.harness.kept import Kept
from benchmarks.harness.report import Report, merged
from benchmarks.studies.cells import cycles, executed, failures, order, script, solved

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int, str | None, Kept], Report]] = {
    "solved": solved.run,
    "executed": executed.run,
    "failures": failures.run,
    "script": script.run,
    "cycles": cycles.run,
    "order": order.run,
}


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
        queries: Objects of each cell, the first of them; all if None.
        seed: Which draw of the cells' sizes; 0 for those in the tables.
        robot: The only one to look at; all if None. What was kept of others is in the tables, too.
        keep: A file of the cells, and of the orders, that are done.
    """
    kept = Kept(keep)
    parts = tuple(PARTS[name](queries, seed, robot, kept) for name in PARTS if part in (None, name))
    return replace(merged("cells", parts), parts=parts)
