"""Five work cells, three robots: whether all that can be done is done, proven, and carried out without a contact."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.harness.report import Report, merged
from benchmarks.studies.cells import cycles, executed, failures, order, script, solved

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int, str | None], Report]] = {
    "solved": solved.run,
    "executed": executed.run,
    "failures": failures.run,
    "script": script.run,
    "cycles": cycles.run,
    "order": order.run,
}


def run(part: str | None = None, queries: int | None = None, seed: int = 0, robot: str | None = None) -> Report:
    """Take a part, or all.

    Args:
        part: One of ``PARTS``.
        queries: Objects of each cell, the first of them; all if None.
        seed: Which draw of the cells' sizes; 0 for those in the tables.
        robot: The only one to look at; all if None.
    """
    return merged("cells", [PARTS[name](queries, seed, robot) for name in PARTS if part in (None, name)])
