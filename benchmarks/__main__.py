"""``python -m benchmarks``: the one door to all benchmarks; without an argument it lists what there is."""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

import planner_service as ps
from benchmarks.harness.arguments import whole
from benchmarks.harness.report import Report, show, table, write_json
from planner_service.files.writing import require_writable

COMMANDS = {
    "check": ("harness.gate", "the gate: counts and paths of the smoke suite and of all else that is pinned"),
    "attack": ("attack.running", "hostile inputs of every kind"),
    "mutants": ("studies.mutants", "whether the tests notice small faults in a package"),
    "lines": ("studies.lines", "lines of code by folder, now and at commits"),
}
"""Subcommands with options of their own: modules whose ``main(arguments, console)`` they are, and what they do."""

STUDIES = {
    "toy": "the textbook's two-joint program gives the counts and lengths that it prints",
    "states": "a plan takes at most a fifth of the states that the textbook's program takes",
    "solved": "random queries and the public Panda problems are solved, and Coal rejects no plan",
    "proven": "whole curves are free and within limits to an independent checker; planted sheets are refused",
    "starts": "starts that overlap by a little have a plan, whose way out grows no depth",
    "walk": "README's first plan is a short walk through the files of the package",
    "latency": "whole plans take at most 0.35 of 0.1.0's CPU time, lines 0.25 ms, importing 0.3 s, a cold plan 0.8 s",
    "scaling": "what whole plans cost among 10 to 10,000 obstacles",
    "clouds": "what clouds of 10,000 to 1,000,000 points cost to build, to update and to plan among",
    "panda": "the public Panda problems next to 0.1.0 and to other planners, in turn, by one auditor",
    "arms": "four arms on public problems: a part of an older version's CPU time, none given up, none rejected",
    "suites": "suites of problems by several planners, each path judged by Coal",
    "roadmaps": "a warm query takes at most 150 states and a fifth of a search's",
    "optimise": "optimised plans keep 20 mm where they can, and are shorter and faster",
    "replan": "a moving arm is replanned every 0.1 s, certified, without a jump",
    "constrained": "plans under constraints leave no tolerance, and take 15 to 150 ms",
    "many": "two cores plan at least 1.8 times as fast as one; what two threads of one service gain",
    "episodes": "data sets of episodes, every motion certified and audited",
    "robots": "robots out of packages on PyPI plan from their files, judged by Coal",
    "evidence": "proofs that others check, and proofs that there is no path, forged and attacked",
    "mcp": "twenty tabletop tasks as an agent's tool calls, on the simulated arm: no motion that is not proven",
    "frames": "the viewer's page draws 200 obstacles and a cloud of 20,000 points 30 times a second, by hardware GL",
    "serve": "a server under load, over its capacity, cancelled, killed and attacked",
    "gate": "no target that passes the gate touches, by Coal, whatever is asked of it and however the driver follows",
    "cells": "five work cells for three robots: what can be done is done, proven, and carried out without a contact",
    "ik": "complete inverse kinematics misses no solution; its proofs, maps and lines are not contradicted",
    "two-arms": "two arms, each with its own clock, do not touch, by Coal, however late they are",
    "differential": "the kernel says what FCL says pair by pair, with every instruction set, and how fast",
}
"""What each study shows; its module in ``studies`` has a ``run`` whose parameters are its options."""

LONG = (
    *("cells", "arms", "suites", "robots", "evidence", "mcp", "frames", "serve", "differential", "starts", "gate"),
    "ik",
    "two-arms",
)
"""Studies that are not among all: what they find changes with the code alone, and they take long."""

OPTIONS: dict[str, tuple[Callable[[str], Any], str, str]] = {
    "part": (str, "PART", "the only part to take; all if not given"),
    "robot": (str, "NAME", "the only robot to look at; all if not given"),
    "states": (whole(1), "N", "states of each robot"),
    "edges": (whole(1), "N", "edges of each robot"),
    "plans": (whole(1), "N", "plans of each turn"),
    "queries": (whole(0, 10**6), "N", "queries of each set, or of a part"),
    "seeds": (whole(0, 1000), "M", "plans of each public problem"),
    "seed": (whole(0), "N", "of what is drawn"),
    "problems": (
        Path,
        "PATH",
        "a published problem set, for --robot; for arms and differential the folder of sets and robots",
    ),
    "against": (Path, "PYTHON", "of an environment with what is compared"),
    "keep": (Path, "FILE", "of what is done: the same command goes on after it"),
}
"""Options that studies may have: how each is read, its metavar and its help."""

INTERRUPTED = 130
"""The exit code of a program that was ended by Ctrl-C."""


def study(name: str) -> Any:
    """The module of a study."""
    return importlib.import_module(f"benchmarks.studies.{name.replace('-', '_')}")


def options_of(name: str) -> tuple[str, ...]:
    """The options that a study takes."""
    return tuple(key for key in inspect.signature(study(name).run).parameters if key in OPTIONS)


def _arguments(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    parser.add_argument("what", choices=["all", *STUDIES, *COMMANDS])
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write rows and promises to FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write a study into its part of a text")
    for key, (read, metavar, text) in OPTIONS.items():
        parser.add_argument(f"--{key}", type=read, metavar=metavar, help=text)
    asked = parser.parse_args(arguments)
    has = () if asked.what == "all" else options_of(asked.what)
    for key in OPTIONS:
        if getattr(asked, key) is not None and key not in has:
            told = f"it takes {', '.join(f'--{each}' for each in has)}" if has else "it takes none"
            parser.error(f"argument --{key}: {asked.what} has none; {told}")
    if asked.part is not None and asked.part not in study(asked.what).PARTS:
        parser.error(f"argument --part: {asked.what} has {', '.join(study(asked.what).PARTS)}")
    if asked.markdown is not None and asked.what == "all":
        parser.error("argument --markdown: it takes one study at a time")
    return asked


def listed() -> str:
    """The table of promises as Markdown: what each study shows, and its command with all options."""
    lines = ["| what it shows | command |", "| --- | --- |"]
    for name, text in STUDIES.items():
        options = "".join(f" [--{key} {OPTIONS[key][1]}]" for key in options_of(name))
        lines.append(f"| {text} | `python -m benchmarks {name}{options}` |")
    return "\n".join(lines) + "\n"


def main(given: Sequence[str]) -> int:
    """Exit code 0 if every promise was kept, else 1; 2 where the caller made a mistake, 130 when interrupted."""
    console = Console(width=None if sys.stdout.isatty() else 200)
    name = next(iter(given), "")
    try:
        if not name:
            console.print(table("Commands", ("", ""), [(key, text) for key, (_, text) in COMMANDS.items()]))
            console.print(
                table("Studies, also by all", ("", ""), STUDIES.items(), caption=f"Not by all: {', '.join(LONG)}")
            )
            return 0
        if name in COMMANDS:
            return int(importlib.import_module(f"benchmarks.{COMMANDS[name][0]}").main(given[1:], console))
        return _measured(_arguments(given), console)
    except (ps.InvalidRequest, ps.MissingDependency) as error:
        console.print(f"{name}: {error}", markup=False, highlight=False, soft_wrap=True)
        return 2
    except KeyboardInterrupt:
        console.print("interrupted")
        return INTERRUPTED


def _measured(arguments: argparse.Namespace, console: Console) -> int:
    """Exit code 0 if every promise was kept, else 1."""
    for path in filter(None, (arguments.json, arguments.markdown)):
        require_writable(path)
    reports = list[Report]()
    given = {key: getattr(arguments, key) for key in OPTIONS if getattr(arguments, key) is not None}
    every = [name for name in STUDIES if name not in LONG]
    for name in every if arguments.what == "all" else [arguments.what]:
        report: Report = study(name).run(**given)
        console.print(*report.tables, sep="\n\n")
        reports.append(report)
        if arguments.json is not None:  # after each: what was measured is not lost when a later one is interrupted
            write_json(reports, arguments.json)
        if arguments.markdown is not None:
            importlib.import_module("benchmarks.harness.markdown").write_part(report, arguments.markdown)
    return 0 if show(reports, console) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
