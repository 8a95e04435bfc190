"""``check``: the smoke suite and all else that is pinned cost what they did; ``--write`` stores a change.

Counts and path bits are equal to the pins, in the environment of constraints.txt: these are equal on every processor.
Everywhere no plan is lost, none is rejected, and p95 of the states stays below a ceiling that the suite's file states
and ``--write`` does not lift.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import pinned_cases, pinned_queries, pinned_roadmaps, pins
from benchmarks.harness.attempts import states_of
from benchmarks.harness.environment import unpinned
from benchmarks.harness.pins import REGENERATE, Difference, Pins, differences, load_pins, store_pins
from benchmarks.harness.report import Row, p95, table
from benchmarks.harness.runner import jobs_of, made
from benchmarks.harness.suite import Suite, suite_named
from planner_service.files.writing import require_writable

__all__ = ["main", "pins_of", "verdicts"]

SHOWN = 40
"""Differences of a planner's runs that are printed one by one; after them their number."""

ABSENT = [0, 0, 0]


def pins_of(found: Iterable[Row]) -> dict[str, Row]:
    """What is pinned of a suite's rows."""
    return {
        f"{row['problem']} {row['planner']} seed {row['seed']}": {
            "outcome": row["failure"] or "planned",
            "path": row["path_hash"],
            "checks": {name: [c["states"], c["edges"], c["distances"]] for name, c in row["checks"].items()},
        }
        for row in found
    }


def verdicts(then: Pins, now: Pins, found: Sequence[Row], ceilings: Mapping[str, int]) -> list[tuple[str, bool]]:
    """The gates that hold everywhere, in words, and whether each is kept."""
    out = []
    for planner, ceiling in ceilings.items():
        states = [states_of(row) for row in found if row["planner"] == planner]
        if states:
            text = f"{planner}: p95 of the states {p95(states):,.0f}, at most {ceiling:,}"
            out.append((text, p95(states) <= ceiling))
    lost = [run for run, row in now.items() if row["outcome"] != "planned" and _outcome(then, run) == "planned"]
    out.append((f"plans lost: {', '.join(lost[:5]) or 'none'}", not lost))
    hit = [f"{r['problem']} {r['planner']} {r['audit']['pair']}" for r in found if r["ok"] and not _free(r)]
    return [*out, (f"paths rejected by the independent checker: {', '.join(hit[:5]) or 'none'}", not hit)]


def _outcome(then: Pins, run: str) -> str:
    return str(then[run]["outcome"]) if run in then else ""


def _free(row: Row) -> bool:
    return bool(row["audit"]["verdict"] == "free")


# --- the command


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0 if every gate is kept, or the pins were written; else 1."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks check", description=__doc__)
    parser.add_argument("--suite", metavar="NAME", help="only this suite; else smoke and what is pinned beside")
    parser.add_argument("--write", action="store_true", help="store the counts as they are now")
    given = parser.parse_args(arguments)
    name = given.suite or "smoke"
    suite, file = suite_named(name), pins.FOLDER / f"{name}.json"
    made_of = {"queries": pinned_queries.made, "roadmaps": pinned_roadmaps.made, "cases": pinned_cases.made}
    others = {} if given.suite else made_of
    if given.write:
        for each in (file, *(pins.FOLDER / f"{other}.json" for other in others)):
            require_writable(each)
    then = None if given.write else load_pins(file)
    found = list(made(jobs_of(suite), console))
    now = pins_of(found)
    kept = then is None or _kept(suite, then, now, found, console)
    if then is None:
        _store(file, now, console)
    for other, plan in others.items():
        beside = pins.FOLDER / f"{other}.json"
        if given.write:
            _store(beside, plan(), console)
        else:
            kept &= _equal(other, load_pins(beside), plan(), console)
    if not kept:
        command = f"{REGENERATE} --suite {given.suite}" if given.suite else REGENERATE
        console.print(f"If that is meant, store it, with a line in CHANGELOG.md: {command}", soft_wrap=True)
    return 0 if kept else 1


def _store(file: Path, now: Pins, console: Console) -> None:
    store_pins(file, now)
    console.print(f"stored {len(now)} runs in {file.name}")


def _equal(name: str, then: Pins, now: Pins, console: Console) -> bool:
    """Whether runs cost what is pinned, or need not here; prints what changed."""
    changed = [*differences(then, now), *_gone(then, now)]
    for each in changed[:SHOWN]:
        console.print(str(each), markup=False, highlight=False, soft_wrap=True)
    console.print(f"counts and paths of {len(now)} {name} as pinned: {_counted(changed)}")
    return not changed or bool(unpinned())


def _gone(then: Pins, now: Pins) -> list[Difference]:
    gone = {run: row for run, row in then.items() if run not in now}
    return [Difference(run, "run", str(row.get("outcome", "made")), "gone") for run, row in gone.items()]


def _kept(suite: Suite, then: Pins, now: Pins, found: Sequence[Row], console: Console) -> bool:
    """Print what every gate of a suite says; whether all are kept."""
    changed, foreign = [*differences(then, now), *_gone(then, now)], unpinned()
    if changed:
        console.print(*_tables(then, now, changed), sep="\n")
    gates = [(f"counts and paths of {len(now)} runs as stored: {_counted(changed)}", not changed or bool(foreign))]
    gates += verdicts(then, now, found, suite.ceilings)
    shown = [(text, "kept" if kept else "BROKEN") for text, kept in gates]
    console.print(table(f"Gates of the suite {suite.name}", ("", ""), shown))
    if foreign:
        console.print(f"not the pinned environment, so equal counts are not asked for: {'; '.join(foreign)}")
    return all(kept for _, kept in gates)


def _counted(changed: Sequence[Difference]) -> str:
    return f"{len({each.run for each in changed})} differ" if changed else "all equal"


def _tables(then: Pins, now: Pins, changed: Sequence[Difference]) -> list[Table]:
    """The differences one by one, and the sums by stage."""
    lines = [(each.run, each.what, each.then, each.now) for each in changed[:SHOWN]]
    more = f"... and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
    one = table("States / edges / distances that changed", ("run", "stage", "stored", "now"), lines, caption=more)
    rows_ = [row for told in (then, now) for row in told.values()]
    stages = dict.fromkeys(stage for row in rows_ for stage in row.get("checks", {}))
    sums = [(stage, *(_sum(told, stage) for told in (then, now))) for stage in stages]
    cells = [(stage, _shown(a), _shown(b), *(f"{y - x:+,}" for x, y in zip(a, b, strict=True))) for stage, a, b in sums]
    columns = ("stage", "stored", "now", "states", "edges", "distances")
    return [one, table("All runs, by stage", columns, cells)]


def _sum(told: Pins, stage: str) -> list[int]:
    return [sum(row.get("checks", {}).get(stage, ABSENT)[k] for row in told.values()) for k in range(3)]


def _shown(counts: Sequence[int]) -> str:
    return " / ".join(f"{count:,}" for count in counts)
