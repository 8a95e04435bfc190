"""``check``: the smoke suite costs what is stored, run by run and stage by stage; a change that is meant is stored.

Three gates. Exact counts and path bits, in the environment of constraints.txt: these are equal on every processor. The
ratio of all states now to then, paired, with its interval, for environments in which counts may differ. And a ceiling
for p95 of the states, which the suite's file states and ``--write`` does not lift.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import rows
from benchmarks.harness.environment import unpinned
from benchmarks.harness.report import p95, table
from benchmarks.harness.rows import Row
from benchmarks.harness.runner import jobs_of, made
from benchmarks.harness.statistics import ratio_of_totals
from benchmarks.harness.suite import Suite, load_suite
from planner_service.errors import InvalidFile
from planner_service.files.json_reader import Node, read_json
from planner_service.files.writing import require_writable, write_whole

__all__ = ["BASELINES", "REGENERATE", "Baseline", "Difference", "differences", "main", "stored_rows", "verdicts"]

BASELINES = Path(__file__).parents[1] / "pinned"

REGENERATE = "python -m benchmarks check --write"
"""What stores a change of counts that is meant."""

SURELY, PERHAPS = 1.01, 1.05
"""States now over then: the lower end of the interval may not be above the first, the upper end above the second."""

SHOWN = 40
"""Differences of a planner's runs that are printed one by one; after them their number."""

ABSENT = [0, 0, 0]

Baseline = Mapping[str, Row]
"""By run, its outcome, its counts by stage as [states, edges, distances], and the hash of its path."""


@dataclass(frozen=True)
class Difference:
    """One stage of one run that costs something else than is stored, or another outcome."""

    run: str
    what: str
    then: str
    now: str


def stored_rows(found: Iterable[Row]) -> dict[str, Row]:
    """What a baseline holds of rows."""
    return {
        f"{row['problem']} {row['planner']} seed {row['seed']}": {
            "outcome": row["failure"] or "planned",
            "path": row["path_hash"],
            "checks": {name: [c["states"], c["edges"], c["distances"]] for name, c in row["checks"].items()},
        }
        for row in found
    }


def differences(then: Baseline, now: Baseline) -> list[Difference]:
    """What of ``now`` is not as it was ``then``, run by run and stage by stage."""
    found = []
    for run, row in now.items():
        old = then.get(run)
        if old is None:
            found.append(Difference(run, "run", "not stored", row["outcome"]))
            continue
        for stage in dict.fromkeys([*old["checks"], *row["checks"]]):
            counts = [told["checks"].get(stage, ABSENT) for told in (old, row)]
            if counts[0] != counts[1]:
                found.append(Difference(run, stage, *(" / ".join(map(str, c)) for c in counts)))
        if old["outcome"] != row["outcome"]:
            found.append(Difference(run, "outcome", old["outcome"], row["outcome"]))
        elif old["path"] != row["path"]:
            found.append(Difference(run, "path", *(str(told["path"])[:12] for told in (old, row))))
    return found + [Difference(run, "run", row["outcome"], "gone") for run, row in then.items() if run not in now]


def verdicts(
    then: Baseline, now: Baseline, found: Sequence[Row], ceilings: Mapping[str, int]
) -> list[tuple[str, bool]]:
    """The gates that hold everywhere, in words, and whether each is kept."""
    out = []
    for planner, pairs in _totals(then, now, found).items():
        ratio = ratio_of_totals(pairs)
        kept = ratio.low <= SURELY and ratio.high <= PERHAPS
        limits = f"[{SURELY:g}, {PERHAPS:g}]"
        out.append((f"{planner}: states now / then {ratio.text(3)}, at most {limits}", kept))
    for planner, ceiling in ceilings.items():
        states = [rows.states_of(row) for row in found if row["planner"] == planner]
        if states:
            out.append(
                (f"{planner}: p95 of the states {p95(states):,.0f}, at most {ceiling:,}", p95(states) <= ceiling)
            )
    lost = [run for run, row in now.items() if row["outcome"] != "planned" and _outcome(then, run) == "planned"]
    out.append((f"plans lost: {', '.join(lost[:5]) or 'none'}", not lost))
    hit = [f"{r['problem']} {r['planner']} {r['audit']['pair']}" for r in found if r["ok"] and not _free(r)]
    return [*out, (f"paths rejected by the independent checker: {', '.join(hit[:5]) or 'none'}", not hit)]


def _outcome(then: Baseline, run: str) -> str:
    return str(then[run]["outcome"]) if run in then else ""


def _free(row: Row) -> bool:
    return bool(row["audit"]["verdict"] == "free")


def _totals(then: Baseline, now: Baseline, found: Iterable[Row]) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """By planner and problem, the states of each run then and now."""
    out: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for run, row in zip(now, found, strict=True):
        if run in then:
            pair = tuple(float(sum(c[0] for c in told[run]["checks"].values())) for told in (then, now))
            out[row["planner"]][row["problem"]].append((pair[0], pair[1]))
    return out


# --- the command


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0 if every gate is kept, or the baseline was written; else 1."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks check", description=__doc__)
    parser.add_argument("--suite", default="smoke", metavar="NAME", help="smoke if not given")
    parser.add_argument("--write", action="store_true", help="store the counts as they are now")
    asked = parser.parse_args(arguments)
    suite, file = load_suite(asked.suite), BASELINES / f"{Path(asked.suite).stem}.json"
    again = REGENERATE if asked.suite == "smoke" else f"{REGENERATE} --suite {asked.suite}"
    then = None if asked.write else _read(file, again)
    if then is None:
        require_writable(file)
    found = list(made(jobs_of(suite), console))
    now = stored_rows(found)
    if then is None:
        write_whole(file, _text(now))
        console.print(f"stored {len(now)} runs in {file.name}")
        return 0
    kept = _told(suite, then, now, found, console)
    if not kept:
        console.print(f"If that is meant, store it, with a line in CHANGELOG.md: {again}", soft_wrap=True)
    return 0 if kept else 1


def _told(suite: Suite, then: Baseline, now: Baseline, found: Sequence[Row], console: Console) -> bool:
    """Print what every gate says; whether all are kept."""
    changed, foreign = differences(then, now), unpinned()
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


def _tables(then: Baseline, now: Baseline, changed: Sequence[Difference]) -> list[Table]:
    """The differences one by one, and the sums by stage."""
    lines = [(each.run, each.what, each.then, each.now) for each in changed[:SHOWN]]
    more = f"... and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
    one = table("States / edges / distances that changed", ("run", "stage", "stored", "now"), lines, caption=more)
    stages = list(dict.fromkeys(stage for told in (then, now) for row in told.values() for stage in row["checks"]))
    sums = [(stage, *(_sum(told, stage) for told in (then, now))) for stage in stages]
    cells = [(stage, _shown(a), _shown(b), *(f"{y - x:+,}" for x, y in zip(a, b, strict=True))) for stage, a, b in sums]
    columns = ("stage", "stored", "now", "states", "edges", "distances")
    return [one, table("All runs, by stage", columns, cells)]


def _sum(told: Baseline, stage: str) -> list[int]:
    return [sum(row["checks"].get(stage, ABSENT)[k] for row in told.values()) for k in range(3)]


def _shown(counts: Sequence[int]) -> str:
    return " / ".join(f"{count:,}" for count in counts)


def _text(now: Baseline) -> str:
    """The stored file: one run a line, so that a change reads well in a diff."""
    lines = ",\n".join(f"  {json.dumps(run)}: {json.dumps(row)}" for run, row in now.items())
    return f'{{\n "regenerate": "{REGENERATE}",\n "runs": {{\n{lines}\n }}\n}}\n'


def _read(file: Path, again: str) -> Baseline:
    if not file.exists():
        raise InvalidFile(file, [f"there is no baseline; store one: {again}"])
    problems: list[str] = []
    runs = Node("", read_json(file), problems).at("runs")
    for run in list(runs.value) if isinstance(runs.value, dict) else ():
        row = runs.at(run)
        row.at("outcome").text()
        checks = row.at("checks")
        for stage in list(checks.value) if isinstance(checks.value, dict) else ():
            checks.at(stage).numbers(3)
    if problems or not isinstance(runs.value, dict):
        raise InvalidFile(file, problems or ["runs: expected an object"])
    return runs.value
