"""One planner for many programs: under load, over its capacity, with requests withdrawn, killed, and under attack."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.harness.report import Report, merged
from benchmarks.studies.serve import cancel, hostile, kill, load, memory, overload

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int], Report]] = {
    "load": load.run,
    "memory": memory.run,
    "overload": overload.run,
    "cancel": cancel.run,
    "kill": kill.run,
    "hostile": hostile.run,
}


def run(part: str | None = None, queries: int | None = None, seed: int = 0, against: Path | None = None) -> Report:
    """Measure a part, or all.

    Args:
        part: One of ``PARTS``.
        queries: How many requests, where a number and not a time is what a part promises; as many as that if None.
        seed: Of what is drawn.
        against: The python of an environment with the version that ``load`` is compared with.
    """
    parts: dict[str, Callable[[int | None, int], Report]] = {**PARTS, "load": partial(load.run, against=against)}
    return merged("serve", [parts[name](queries, seed) for name in PARTS if part in (None, name)])
