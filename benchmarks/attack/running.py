"""``python -m benchmarks attack``: run the attacks, store what they find, and tell."""

from __future__ import annotations

import argparse
import importlib
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.attack.harness import Finding, Part, further, read_finding
from benchmarks.attack.jail import Jail
from benchmarks.harness.arguments import whole
from benchmarks.harness.markdown import write_part
from benchmarks.harness.report import Report, table_of
from planner_service.errors import InvalidFile

__all__ = ["PARTS", "Summary", "main", "maker", "replayed", "run_part"]

PARTS = {
    "api": 15,
    "files": 40,
    "curves": 15,
    "states": 20,
    "roadmaps": 10,
    "threads": 12,
    "kill": 8,
    "agents": 10,
    "cells": 8,
}
"""The attacks, and how a run of all of them shares its time."""

KINDS = ("crash", "hang", "untyped", "invariant", "wrong", "memory", "leftover")

USAGE = """\
attack [PART...]            run all attacks, or some, sharing the time; the exit code is 1 if anything was found
attack replay FILE...       run stored findings again; the exit code is 1 if any still does harm
attack table FOLDER...      the table of finished runs, added up; --markdown FILE puts it into a text
"""


@dataclass
class Summary:
    """What one part did."""

    name: str
    inputs: int = 0
    passed: int = 0
    refused: int = 0
    seconds: float = 0.0
    found: dict[str, int] = field(default_factory=dict)
    counted: dict[str, int] = field(default_factory=dict)
    extremes: dict[str, float] = field(default_factory=dict)

    def add(self, other: Summary) -> None:
        """Add what another run of the same part did."""
        for key in ("inputs", "passed", "refused", "seconds"):
            setattr(self, key, getattr(self, key) + getattr(other, key))
        self.found = dict(Counter(self.found) + Counter(other.found))
        self.counted = dict(Counter(self.counted) + Counter(other.counted))
        for key, value in other.extremes.items():
            self.extremes[key] = further(key, value, self.extremes.get(key))


def maker(name: str) -> Callable[[], Part]:
    """What makes a part of that name."""
    made: Callable[[], Part] = importlib.import_module(f"benchmarks.attack.{name}").Attack
    return made


def run_part(name: str, seed: int, seconds: float, most: int) -> tuple[Summary, list[Finding]]:
    """Attack for so many seconds or inputs; what was done, and one finding for each signature."""
    summary, found = Summary(name), dict[str, Finding]()
    began = time.perf_counter()

    def note(kind: str, signature: str, detail: str, number: int, case: dict[str, Any]) -> None:
        had = found.get(signature)
        new = Finding(name, kind, signature, detail, seed, number, case)
        found[signature] = new if had is None else replace(had, seen=had.seen + 1)
        summary.found[kind] = summary.found.get(kind, 0) + 1

    with Jail(maker(name), seconds=seconds * 1.5) as jail:
        for answer in jail.campaign(seed, 0, began + seconds, most):
            if answer[0] == "told":
                kinds, counted, extremes = answer[1:]
                told = Summary(name, *(kinds.get(key, 0) for key in ("inputs", "passed", "refused")))
                told.counted, told.extremes = counted, extremes
                summary.add(told)
            elif answer[0] == "found":
                _, number, outcome, case = answer
                note(outcome.kind, outcome.signature, outcome.detail, number, case)
            else:
                _, kind, signature, detail, number = answer
                note(kind, signature, detail, number, {})
                summary.inputs += 1
        summary.seconds = time.perf_counter() - began
        for pid in jail.end():
            note("leftover", "a process is left", f"process {pid}", -1, {})
        for file in jail.leftovers():
            note("leftover", "a half-written file is left", file, -1, {})
    return summary, list(found.values())


def replayed(finding: Finding) -> tuple[str, str]:
    """How the input of a finding goes now: passed, refused or the kind of a finding, and more in words."""
    with Jail(maker(finding.part)) as jail:
        outcome, _ = jail.ask(finding.case or (finding.seed, finding.number))
    return outcome.kind, outcome.detail


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 1 if anything was found."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks attack", epilog=USAGE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="*", help=f"{', '.join(PARTS)}; replay FILE...; table FOLDER...")
    parser.add_argument("--minutes", type=float, default=8.0, metavar="N", help="for all parts together")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="S", help="of what is drawn")
    parser.add_argument("--inputs", type=whole(1), metavar="N", help="end each part after so many")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where findings and the summary go")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="put the table into its part of a text")
    asked = parser.parse_args(arguments)
    if asked.what[:1] == ["replay"]:
        return _replay([Path(name) for name in asked.what[1:]], console)
    if asked.what[:1] == ["table"]:
        return _tell([Path(name) for name in asked.what[1:]], asked.markdown, console)
    if unknown := [name for name in asked.what if name not in PARTS]:
        parser.error(f"unknown attack {unknown[0]!r}; there are {', '.join(PARTS)}")
    if not (math.isfinite(asked.minutes) and asked.minutes > 0.0):
        parser.error("argument --minutes: more than 0")
    return _attack(asked, console)


def _attack(asked: argparse.Namespace, console: Console) -> int:
    names = asked.what or list(PARTS)
    out = asked.out or Path("results") / f"attack-{asked.seed}"
    out.mkdir(parents=True, exist_ok=True)
    whole_share, bad = sum(PARTS[name] for name in names), 0
    most = asked.inputs or 2**62
    for name in names:
        for old in (*out.glob(f"{name}.json"), *out.glob(f"finding-{name}-*.json")):
            old.unlink()
    for name in names:
        seconds = 60.0 * asked.minutes * PARTS[name] / whole_share
        summary, findings = run_part(name, asked.seed, seconds, most)
        (out / f"{name}.json").write_text(json.dumps(asdict(summary), indent=1) + "\n", "utf-8")
        for k, finding in enumerate(findings):
            file = out / f"finding-{name}-{k}.json"
            file.write_text(finding.text(), "utf-8")
            line = f"{name}: {finding.signature}, {finding.seen} times: {finding.detail[:300]}; {file}"
            console.print(line, markup=False, highlight=False, soft_wrap=True)
        bad += len(findings)
    _tell([out], asked.markdown, console)
    return 1 if bad else 0


def _replay(files: Sequence[Path], console: Console) -> int:
    bad = 0
    for file in files:
        try:
            finding = read_finding(file)
        except (OSError, ValueError, TypeError) as error:
            raise InvalidFile(file, [f"no stored finding: {error}"]) from None
        kind, detail = replayed(finding)
        bad += kind not in ("passed", "refused")
        console.print(f"{file}: {kind} {detail}", markup=False, highlight=False, soft_wrap=True)
    return 1 if bad else 0


def _summaries(folders: Sequence[Path]) -> list[Summary]:
    out = dict[str, Summary]()
    for name in PARTS:
        for folder in folders:
            if (file := folder / f"{name}.json").is_file():
                out.setdefault(name, Summary(name)).add(Summary(**json.loads(file.read_text("utf-8"))))
    return list(out.values())


COLUMNS = ("attack", "inputs", "answered", "refused", *KINDS, "minutes")


def _tell(folders: Sequence[Path], text: Path | None, console: Console) -> int:
    """Print the table of finished runs, and write it into a text."""
    report = reported(_summaries(folders))
    console.print(*report.tables)
    if text is not None:
        write_part(report, text)
    return 0


def reported(summaries: Sequence[Summary]) -> Report:
    """The table; its caption says what was counted and measured, part by part."""
    lines = [
        {"attack": one.name, "inputs": f"{one.inputs:,}", "answered": f"{one.passed:,}", "refused": f"{one.refused:,}"}
        | {kind: one.found.get(kind, 0) for kind in KINDS}
        | {"minutes": f"{one.seconds / 60.0:.1f}"}
        for one in summaries
    ]
    told = [
        f"{one.name}: "
        + ", ".join(
            [f"{value:,} {key}" for key, value in sorted(one.counted.items())]
            + [f"{key} {value:.3g}" for key, value in sorted(one.extremes.items())]
        )
        for one in summaries
        if one.counted or one.extremes
    ]
    return Report("attack", (), (table_of("Attacks", lines, caption=". ".join(told)),))
