"""``export --ompl-log``: results as a log of OMPL's benchmark, which Planner Arena shows.

``ompl_benchmark_statistics.py FILE -d FILE.db`` makes a database of it, one column of ``runs`` per property; what OMPL
does not know, such as the states of each stage, becomes further columns. The format: "How to Benchmark Planners" in
OMPL's documentation (Moll, Sucan & Kavraki, IEEE RAM 22(3), 2015). That script puts names into its SQL as they are:
ours are letters, digits and blanks only.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.harness import rows
from benchmarks.harness.rows import Results, Row, states_of
from planner_service.files.writing import write_whole

__all__ = ["STATUS", "main", "text_of"]

STATUS = (
    *("Unknown status", "Invalid start", "Invalid goal", "Unrecognized goal type", "Timeout"),
    *("Approximate solution", "Exact solution", "Crash", "Abort", "Infeasible"),
)
"""OMPL's ``PlannerStatus``, in its order."""

_STATUS_OF = {
    "START_IN_COLLISION": "Invalid start",
    "START_OUTSIDE_LIMITS": "Invalid start",
    "GOAL_IN_COLLISION": "Invalid goal",
    "GOAL_OUTSIDE_LIMITS": "Invalid goal",
    "NO_IK_SOLUTION": "Invalid goal",
    "TIMED_OUT": "Timeout",
    "CHECK_BUDGET_EXHAUSTED": "Timeout",
    "PLANNING_FAILED": "Timeout",
    "PREEMPTED": "Abort",
}

PLANNED = "planned"

Property = tuple[str, Callable[[Row], Any]]
"""Name and type, as the log has them, and how the value is read off a row."""


def text_of(results: Results, made: datetime) -> str:
    """The log: one experiment, all planners and their runs; which problem a run is of is an enumeration."""
    found: dict[str, list[Row]] = {}
    for row in results.rows:
        found.setdefault(_plain(f"{row['tool']}_{row['planner']}", "_"), []).append(row)
    enums = _enums(results.rows)
    properties = _properties(results.rows, enums)
    lines = [*_preamble(results, made, enums, most=max(map(len, found.values()))), f"{len(found)} planners"]
    for name, here in found.items():
        lines += [name, "2 common properties", f"tool = {here[0]['tool']}", f"planner = {here[0]['planner']}"]
        lines += [f"{len(properties)} properties for each run", *(named for named, _ in properties)]
        lines += [f"{len(here)} runs", *(_run(row, properties) for row in here), "."]
    return "\n".join(lines) + "\n"


def _preamble(results: Results, made: datetime, enums: Mapping[str, Sequence[str]], most: int) -> Iterator[str]:
    header = results.header
    environment = header["environment"]
    version = environment["versions"].get("planner-service", "0.0.0")
    yield f"planner_service version {version}"
    yield f"Experiment {_plain(header['suite'], '_')}"
    yield f"Running on {_plain(environment['platform'], '-')}"
    yield f"Starting at {made:%Y-%m-%d %H:%M:%S}"
    yield from ("<<<|", *json.dumps(header, indent=1).splitlines(), "|>>>")
    yield from ("<<<|", f"{environment['cpu']}, {environment['cores']} cores", "|>>>")
    yield "0 is the random seed"
    yield "inf seconds per run"
    yield "inf MB per run"
    yield f"{most} runs per planner"
    yield f"{sum(row['total_seconds'] for row in results.rows):.6f} seconds spent to collect the data"
    yield f"{len(enums)} enum types"
    yield from ("|".join([name, *values]) for name, values in enums.items())


def _enums(found: Iterable[Row]) -> dict[str, tuple[str, ...]]:
    def values(key: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(_cell(row[key]) for row in found if row[key] is not None))

    return {"status": STATUS, "failure": (PLANNED, *values("failure")), "problem": values("problem")}


def _properties(found: Sequence[Row], enums: Mapping[str, Sequence[str]]) -> list[Property]:
    """What OMPL's own logs have under its names, and then what they do not."""

    def rank(enum: str, text: str) -> int:
        return list(enums[enum]).index(text)

    stages = list(dict.fromkeys(stage for row in found for stage in row["checks"]))
    timed = list(dict.fromkeys(stage for row in found for stage in row["seconds"]))
    return [
        ("time REAL", lambda row: row["total_seconds"]),
        ("solved BOOLEAN", lambda row: row["ok"]),
        ("correct solution BOOLEAN", lambda row: _correct(row)),
        ("status ENUM", lambda row: rank("status", _status(row))),
        ("failure ENUM", lambda row: rank("failure", _cell(row["failure"] or PLANNED))),
        ("problem ENUM", lambda row: rank("problem", _cell(row["problem"]))),
        ("seed INTEGER", lambda row: row["seed"]),
        ("solution length REAL", lambda row: row["raw_length"]),
        ("simplified solution length REAL", lambda row: row["length"]),
        ("simplified solution clearance REAL", lambda row: row["clearance"]),
        ("simplification time REAL", lambda row: row["seconds"].get("shortcut")),
        ("motion duration REAL", lambda row: row["duration"]),
        ("cpu time REAL", lambda row: row["cpu_seconds"]),
        ("collision checks INTEGER", lambda row: states_of(row) if row["checks"] else None),
        *(_counted(stage, kind) for stage in stages for kind in ("states", "edges", "distances")),
        *((f"seconds {_plain(stage, ' ')} REAL", _read("seconds", stage)) for stage in timed),
    ]


def _counted(stage: str, kind: str) -> Property:
    return f"{kind} {_plain(stage, ' ')} INTEGER", lambda row: row["checks"].get(stage, {}).get(kind)


def _read(key: str, stage: str) -> Callable[[Row], Any]:
    return lambda row: row[key].get(stage)


def _correct(row: Row) -> bool | None:
    return None if row["audit"]["verdict"] == "not_asked" else row["audit"]["verdict"] == "free"


def _status(row: Row) -> str:
    return "Exact solution" if row["ok"] else _STATUS_OF.get(row["failure"], "Unknown status")


def _run(row: Row, properties: Sequence[Property]) -> str:
    return "".join(f"{_value(read(row))}; " for _, read in properties)


def _value(value: Any) -> str:
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(int(value))


def _plain(text: str, gap: str) -> str:
    """Letters and digits, and ``gap`` for everything between them."""
    return gap.join(re.findall(r"[A-Za-z0-9]+", text)) or "unnamed"


def _cell(text: str) -> str:
    """Without what would end an entry of an enumeration."""
    return re.sub(r"[|\r\n]", " ", text)


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0 when the file is written."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks export", description=__doc__)
    parser.add_argument("results", type=Path, metavar="FILE.jsonl")
    parser.add_argument("--ompl-log", type=Path, required=True, metavar="FILE", help="the log to write")
    asked = parser.parse_args(arguments)
    results = rows.read_some(asked.results)
    made = datetime.fromtimestamp(asked.results.stat().st_mtime, tz=timezone.utc)
    write_whole(asked.ompl_log, text_of(results, made))
    console.print(f"{len(results.rows)} runs in {asked.ompl_log}; ompl_benchmark_statistics.py makes a database of it")
    return 0
