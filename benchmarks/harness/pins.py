"""What is pinned: the outcome, the checks by stage and every bit of the path of stored runs, in ``benchmarks/pinned``.

A file of pins holds one run a line, so that a change reads well in a diff. ``python -m benchmarks check`` plans the
runs again and says what changed; ``--write`` stores them as they are now.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import planner_service as ps
from benchmarks.harness.report import Row
from planner_service.files.json_reader import read_json
from planner_service.files.writing import write_whole

__all__ = ["FOLDER", "REGENERATE", "Difference", "Pins", "differences", "fingerprint", "load_pins", "store_pins"]

FOLDER = Path(__file__).parents[1] / "pinned"

REGENERATE = "python -m benchmarks check --write"
"""What stores a change of counts that is meant."""

Pins = Mapping[str, Row]
"""By the name of a run, what is pinned of it."""


@dataclass(frozen=True)
class Difference:
    """One value of one run that is not as it was."""

    run: str
    what: str
    then: str
    now: str

    def __str__(self) -> str:
        return f"{self.run}: {self.what} {self.then} -> {self.now}"


def fingerprint(result: ps.PlanResult) -> Row:
    """Outcome, checks by stage as [states, edges, distances], and a hash of every bit of the path."""
    bits = None
    if result.path is not None:
        values = [*result.path.waypoints.ravel().tolist(), *result.path.blends.tolist()]
        bits = hashlib.sha256(" ".join(value.hex() for value in values).encode()).hexdigest()
    return {
        "outcome": "planned" if result.failure is None else result.failure.reason.value,
        "path": bits,
        "checks": {r.stage.value: [r.counts.states, r.counts.edges, r.counts.distances] for r in result.stages},
    }


def differences(then: Pins, now: Pins) -> list[Difference]:
    """What of the runs of ``now`` is not as it was ``then``, run by run and value by value."""
    found = []
    for run, row in now.items():
        if run not in then:
            found.append(Difference(run, "run", "not stored", str(row.get("outcome", "made"))))
            continue
        old, new = _flat(then[run]), _flat(row)
        found += [
            Difference(run, what, _shown(old.get(what)), _shown(new.get(what)))
            for what in dict.fromkeys([*old, *new])
            if old.get(what) != new.get(what)
        ]
    return found


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row with the checks of each stage as values of their own; a stage that asked nothing is left out."""
    checks = {stage: counts for stage, counts in row.get("checks", {}).items() if any(counts)}
    return {**{key: value for key, value in row.items() if key != "checks"}, **checks}


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return " / ".join(f"{number:,}" for number in value)
    return "nothing" if value is None else str(value)[:12]


def load_pins(file: Path) -> Pins:
    """The runs of a file of pins.

    Raises:
        InvalidFile: there is none, or it holds something else.
    """
    if not file.exists():
        raise ps.InvalidFile(file, [f"there are no pins; store some: {REGENERATE}"])
    content = read_json(file)
    if not isinstance(content, dict) or not all(isinstance(row, dict) for row in content.values()):
        raise ps.InvalidFile(file, ["expected an object that holds one for each run"])
    return content


def store_pins(file: Path, pins: Pins) -> None:
    """Write a file of pins."""
    lines = ",\n".join(f" {json.dumps(run)}: {json.dumps(row)}" for run, row in pins.items())
    write_whole(file, f"{{\n{lines}\n}}\n")
