"""A module run in a process of its own, which prints what it finds as lines of JSON."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.harness.environment import ROOT
from benchmarks.harness.report import Row
from planner_service.files.disk_cache import CACHE_VARIABLE

__all__ = ["told_by"]


def told_by(module: str, *arguments: object, seconds: float, caches: str | Path | None = None) -> Row:
    """The last line that ``python -m module`` prints; with ``error`` if it fails or takes longer.

    Args:
        caches: The folder of the package's caches, where it is not the user's.
    """
    surroundings = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    if caches is not None:
        surroundings[CACHE_VARIABLE] = str(caches)
    command = [sys.executable, "-m", module, *map(str, arguments)]
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=surroundings, capture_output=True, text=True, check=False, timeout=seconds
        )
    except subprocess.TimeoutExpired:
        return {"error": f"not done in {seconds:g} s"}
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    row: Row = json.loads(lines[-1]) if lines else {}
    if done.returncode != 0 or not lines:
        row["error"] = (done.stderr.strip().splitlines() or ["no word"])[-1][:300]
    return row
