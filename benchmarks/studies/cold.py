"""``cold``: from the start of a process to its first plan, and plan after plan once it is warm.

Every repeat is a fresh process. The clock is the system's monotonic one, which parent and child share; the files may be
in the system's cache from the second repeat on, and the first is told apart. On demand instructions are counted, which
hold where seconds are noise.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.harness.arguments import whole
from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import p50, table
from benchmarks.worlds import queries
from planner_service.errors import BrokenInvariant
from planner_service.files.writing import require_writable, write_whole

__all__ = ["main"]

STEPS = ("interpreter", "import planner_service", "robot and scene", "first plan")
"""What ends at the moments that a child tells."""

COUNTED = 10
"""Warm plans of the process whose instructions are counted."""

SHARES = (0.5, 0.95, 0.99)


def _born(scene: str, plans: int, before: Sequence[str] = ()) -> tuple[float, dict[str, Any]]:
    """When a child was started, and what it told."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    command = [*before, sys.executable, "-m", "benchmarks.studies.newborn", scene, str(plans)]
    start = time.monotonic()
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BrokenInvariant(f"a fresh process could not plan: {done.stderr.strip()[-500:]}")
    told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return start, told


COUNTERS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "perf": (("stat", "-e", "instructions:u", "-x", ",", "-o", "{out}"), r"^(\d+),"),
    "valgrind": (("--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file={out}"), r"^summary: (\d+)"),
}
"""What counts user instructions, with which arguments, and where its file says how many; the second is slow, but there
where a virtual machine hides the processor's counters."""


def _instructions(scene: str, plans: int) -> tuple[str, int] | None:
    """By what the user instructions of a whole child were counted, and how many; None where nothing can count."""
    for name, (arguments, pattern) in COUNTERS.items():
        if shutil.which(name) is None:
            continue
        with TemporaryDirectory() as folder:
            out = Path(folder) / "counted"
            try:
                _born(scene, plans, [name, *(argument.format(out=out) for argument in arguments)])
            except BrokenInvariant:
                continue
            counted = re.search(pattern, out.read_text("utf-8"), flags=re.MULTILINE) if out.exists() else None
        if counted is not None:
            return name, int(counted[1])
    return None


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks cold", description=__doc__)
    parser.add_argument("--scene", default="bin", choices=queries.SCENES, help="whose stored queries are planned")
    parser.add_argument("--repeats", type=whole(1), default=5, metavar="N", help="fresh processes (5)")
    parser.add_argument("--plans", type=whole(0), default=200, metavar="N", help="warm plans in each (200)")
    parser.add_argument("--instructions", action="store_true", help="count them too: minutes where only valgrind can")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all figures to FILE")
    asked = parser.parse_args(arguments)
    if asked.json is not None:
        require_writable(asked.json)
    births = [_born(asked.scene, asked.plans) for _ in range(asked.repeats)]
    console.print(*_tables(births), sep="\n\n")
    counted = _counted(asked.scene, console) if asked.instructions else None
    if asked.json is not None:
        content = {"births": [{"start": s, **told} for s, told in births], "instructions": counted}
        write_whole(asked.json, json.dumps(content) + "\n")
    return 0


def _counted(scene: str, console: Console) -> tuple[int, int] | None:
    """Instructions to the first plan and out, and per warm plan; None where nothing can count. Printed as well."""
    one, many = (_instructions(scene, plans) for plans in (0, COUNTED))
    if one is None or many is None:
        console.print(f"instructions: not counted: {' and '.join(COUNTERS)} are not there, or may not count")
        return None
    first, each = one[1], (many[1] - one[1]) // COUNTED
    by = f"(user instructions, {one[0]})"
    console.print(f"instructions: {first:,} to the first plan and out, {each:,} per warm plan {by}", highlight=False)
    return first, each


def _tables(births: Sequence[tuple[float, dict[str, Any]]]) -> Iterable[Any]:
    spans = [np.diff([start, *told["moments"]]) for start, told in births]
    steps = [(name, *_ms(span[k] for span in spans)) for k, name in enumerate(STEPS)]
    steps.append(("start to first plan", *_ms(float(span.sum()) for span in spans)))
    yield table("A fresh process, ms", ("until", "first", "p50", "least"), steps)
    warm = [second for _, told in births for second in told["seconds"]]
    if warm:
        cells = [f"{value * 1e3:,.1f}" for value in np.quantile(warm, SHARES)]
        yield table(f"{len(warm)} warm plans, ms", ("", "p50", "p95", "p99"), [("a plan", *cells)])
    peaks = [told["peak_mb"] for _, told in births if told["peak_mb"] is not None]
    yield f"peak memory: {max(peaks):,.0f} MB" if peaks else "peak memory: this system does not tell"


def _ms(values: Iterable[float]) -> tuple[str, str, str]:
    found = [value * 1e3 for value in values]
    return f"{found[0]:,.0f}", f"{p50(found):,.0f}", f"{min(found):,.0f}"
