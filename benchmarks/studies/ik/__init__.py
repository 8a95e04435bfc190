"""Complete inverse kinematics: held against other solvers, its proofs forged, and what is made of it: maps, lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.harness.kept import Kept
from benchmarks.harness.report import Report, merged
from benchmarks.studies.ik import forgeries, lines, maps, poses

__all__ = ["PARTS", "run"]

PARTS: dict[str, Callable[[int | None, int, str | None, Kept], Report]] = {
    "poses": poses.run,
    "forgeries": forgeries.run,
    "maps": maps.run,
    "lines": lines.run,
}


def run(
    part: str | None = None,
    queries: int | None = None,
    seed: int = 0,
    robot: str | None = None,
    keep: Path | None = None,
) -> Report:
    """Measure a part, or all.

    Args:
        part: A name of ``PARTS``.
        queries: Poses or lines of each arm, forgeries, or voxels held against brute force; as many as the part promises
            if None.
        seed: Of what is drawn.
        robot: The only arm of ``poses`` or ``lines``; all if None.
        keep: A file of what is done of ``poses`` and ``lines``.

    Raises:
        UnknownName: there is no such arm.
    """
    kept = Kept(keep)
    parts = tuple(PARTS[name](queries, seed, robot, kept) for name in PARTS if part in (None, name))
    return replace(merged("ik", parts), parts=parts)
