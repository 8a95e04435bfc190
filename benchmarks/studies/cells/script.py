"""What a pallet of 24 takes to write: the script among the examples, run as it is."""

from __future__ import annotations

import re
import runpy
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from benchmarks.harness.kept import NONE, Kept
from benchmarks.harness.report import Promise, Report, cpu_ms, table_of

__all__ = ["run"]

SCRIPT = Path(__file__).parents[3] / "examples" / "14_fill_a_pallet.py"

MOST_LINES = 25

BOXES = 24


def run(queries: int | None, seed: int, robot: str | None, kept: Kept = NONE) -> Report:
    """It has no options: they are ignored."""
    del queries, seed, robot, kept
    told = StringIO()
    with redirect_stdout(told):
        ms, _ = cpu_ms(lambda: runpy.run_path(str(SCRIPT), run_name="__main__"))
    placed = len(re.findall(r"^box_\d+: [\d.]+ s of motion", told.getvalue(), re.MULTILINE))
    lines = len(SCRIPT.read_text("utf-8").splitlines())
    row = {"part": "script", "script": SCRIPT.name, "lines": lines, "places": placed, "cpu_s": ms / 1e3}
    shown = {
        "script": SCRIPT.name,
        "lines": lines,
        "boxes in place": f"{placed} of {BOXES}",
        "CPU s": f"{ms / 1e3:.1f}",
    }
    promises = (
        Promise(f"a pallet of 24 in at most {MOST_LINES} lines", f"{lines} lines", lines <= MOST_LINES),
        Promise("and all 24 have a plan", f"{placed} of {BOXES}", placed == BOXES),
    )
    return Report("cells script", (row,), (table_of("A script", [shown]),), promises)
