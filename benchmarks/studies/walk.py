"""How often README's first plan goes from one file of the package to another, counted at each call and each return."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import planner_service
import planner_service as ps
from benchmarks.harness.report import Promise, Report, table

__all__ = ["run", "walked"]

PACKAGE = str(Path(planner_service.__file__).parent)

MAX_FILES, MAX_CHANGES = 20, 255

PLANS = 5
"""Of which the shortest walk counts: the proof asks once a millisecond whether it has to end."""

MOST = 25
"""Pairs of files that the table shows."""

Step = tuple[str, str, str]
"""From which file to which, and the function that is called there; none for a return."""


def walked(act: Callable[[], object]) -> list[Step]:
    """The changes of file while ``act`` runs, in this thread; code outside the package does not change the file."""
    steps, last = list[Step](), ""

    def note(frame: FrameType, event: str, _: object) -> None:
        nonlocal last
        here = frame if event == "call" else frame.f_back if event == "return" else None
        if here is None or not here.f_code.co_filename.startswith(PACKAGE):
            return
        file = here.f_code.co_filename[len(PACKAGE) + 1 :]
        if file != last:
            steps.append((last, file, here.f_code.co_name if event == "call" else ""))
            last = file

    sys.setprofile(note)
    try:
        act()
    finally:
        sys.setprofile(None)
    return steps


def run() -> Report:
    """Later plans of a service: the first one prepares what all of them use."""
    service = ps.PlannerService("wxai", "bin")
    above_tray = ps.Pose((0.20, 0.28, 0.15), (0.5**0.5, 0.0, 0.5**0.5, 0.0))
    request = ps.PlanRequest(start=service.robot.home, goal=above_tray, seed=7)
    service.plan(request)
    steps = min((walked(lambda: service.plan(request)) for _ in range(PLANS)), key=len)
    files = {file for _, file, _ in steps}
    pairs = Counter(tuple(sorted(step[:2])) for step in steps[1:])
    rows = [(f"{a} - {b}", f"{count}") for (a, b), count in pairs.most_common(MOST)]
    return Report(
        "walk",
        ({"files": sorted(files), "changes": len(steps)},),
        (table("README's first plan", ("files", "changes"), rows),),
        (
            Promise(f"at most {MAX_FILES} files", f"{len(files)}", len(files) <= MAX_FILES),
            Promise(f"at most {MAX_CHANGES} changes of file", f"{len(steps):,}", len(steps) <= MAX_CHANGES),
        ),
    )
