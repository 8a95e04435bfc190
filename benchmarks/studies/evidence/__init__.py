"""Proofs that others can check: trails, forgeries of them, and answers where there is no plan."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.harness.report import Report, merged
from benchmarks.studies.evidence import cell_forgeries, doors, explain, forgeries, levers, no_path, scara, trails

__all__ = ["run"]

PARTS: dict[str, Callable[[int | None, int], Report]] = {
    "trails": trails.run,
    "forgeries": forgeries.run,
    "cell-forgeries": cell_forgeries.run,
    "doors": doors.run,
    "levers": levers.run,
    "discs": no_path.discs,
    "pockets": no_path.pockets,
    "poses": no_path.poses,
    "scara": scara.run,
    "known-paths": no_path.known_paths,
    "explain": explain.run,
}


def run(part: str | None = None, queries: int | None = None, seed: int = 0) -> Report:
    """Measure a part, or all.

    Args:
        part: A name of ``PARTS``.
        queries: How many plans, forgeries, worlds or failures; as many as the part promises if None.
        seed: Of what is drawn.
    """
    return merged("evidence", [PARTS[name](queries, seed) for name in PARTS if part in (None, name)])
