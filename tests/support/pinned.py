"""What results come to, pinned line by line in tests/golden: ``python -m tests.support.pinned`` stores a change.

The counts of benchmarks/pinned are those of whole suites; these lines belong to the tests of single packages, and have
more of each result, so that no fault of a package goes unseen.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path

__all__ = ["pinned"]

FOLDER = Path(__file__).parents[1] / "golden"

MODULES = {
    "plans": "tests.unit.planning.test_reference_plans",
    "replans": "tests.unit.replanning.test_reference_replans",
    "small_roadmaps": "tests.unit.roadmap.test_reference_roadmaps",
    "executions": "tests.unit.execute.test_reference_executions",
}
"""Files, and the modules whose ``lines()`` are in them."""


def pinned(name: str) -> dict[str, str]:
    """The lines of a file by what is before their colon."""
    return dict(line.split(": ", 1) for line in (FOLDER / f"{name}.txt").read_text("utf-8").splitlines())


if __name__ == "__main__":
    for file, module in MODULES.items():
        lines: Mapping[str, str] = importlib.import_module(module).lines()
        (FOLDER / f"{file}.txt").write_text("".join(f"{key}: {line}\n" for key, line in lines.items()), "utf-8")
