"""``compare``: two results files, or two planners within one, on the problems they share."""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import rows
from benchmarks.harness.report import p50, table
from benchmarks.harness.rows import Results, Row, states_of
from benchmarks.harness.statistics import Comparison, compared, exact_sign, holm, wilson
from benchmarks.pages.page import tables_of
from planner_service.errors import InvalidRequest, UnknownName

__all__ = ["MEASURES", "compare", "main"]

Contender = tuple[str, str]
"""Tool and planner."""

Measure = Callable[[Row], "float | None"]


def _bounds(row: Row) -> float | None:
    return sum(counts["distances"] for counts in row["checks"].values()) if row["checks"] else None


def _milliseconds(row: Row) -> float:
    return float(row["cpu_seconds"]) * 1e3


def _states(row: Row, stage: str | None = None) -> float | None:
    """States of a stage, None for a tool that tells no counts."""
    return states_of(row, stage) if row["checks"] else None


MEASURES: Mapping[str, tuple[Measure, int, bool]] = {
    "states": (_states, 0, True),
    "states in search": (lambda row: _states(row, "search"), 0, True),
    "states in shortcut": (lambda row: _states(row, "shortcut"), 0, True),
    "bounds": (_bounds, 0, True),
    "CPU ms": (_milliseconds, 1, True),
    "length rad": (lambda row: row["length"], 3, False),
    "motion s": (lambda row: row["duration"], 3, False),
}
"""How each is read off a row, its digits, and whether runs that failed count, with what they spent."""


def _by_contender(found: Iterable[Row]) -> dict[Contender, list[Row]]:
    out: dict[Contender, list[Row]] = defaultdict(list)
    for row in found:
        out[row["tool"], row["planner"]].append(row)
    return dict(out)


def _named(contender: Contender) -> str:
    tool, planner = contender
    return planner if tool in ("planner_service", planner) else f"{tool} {planner}"


# --- two contenders


def compare(title: str, first: Iterable[Row], second: Iterable[Row]) -> Table:
    """Ratios of the second's figures to the first's on the runs both have, and which of them are more than chance."""
    pairs = _paired(first, second)
    tests = [_tested(name, pairs) for name in MEASURES]
    found = holm([test for test in tests if test is not None])
    lines = [_solved_line(pairs), *(_line(each, pairs) for each in found)]
    columns = ("", "first p50", "second p50", "second / first", "pairs", "p", "p (Holm)", "")
    problems = len({problem for problem, _ in pairs})
    caption = (
        f"{problems} problems, {len(pairs)} runs of the same problem and seed. Median of the paired ratios with its "
        "bootstrapped 95% interval; Wilcoxon's signed-rank test on their logarithms, averaged by problem where there "
        "are at least six; Holm's correction over the rows. Not significant does not mean equal."
    )
    return table(title, columns, lines, caption=caption)


Pairs = dict[tuple[str, int], tuple[Row, Row]]


def _paired(first: Iterable[Row], second: Iterable[Row]) -> Pairs:
    """The rows of both by problem and seed."""
    ours = {(row["problem"], row["seed"]): row for row in first}
    theirs = {(row["problem"], row["seed"]): row for row in second}
    return {key: (ours[key], theirs[key]) for key in ours if key in theirs}


def _tested(name: str, pairs: Pairs) -> Comparison | None:
    measure, _, charged = MEASURES[name]
    values: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for (problem, _), (a, b) in pairs.items():
        x, y = (measure(row) if charged or (a["ok"] and b["ok"]) else None for row in (a, b))
        if x is not None and y is not None:
            values[problem].append((x, y))
    return compared(name, values)


def _line(each: Comparison, pairs: Pairs) -> list[str]:
    measure, digits, charged = MEASURES[each.measure]
    both = [(a, b) for a, b in pairs.values() if charged or (a["ok"] and b["ok"])]
    middles = [p50(float(measure(row[k]) or 0.0) for row in both) for k in (0, 1)]
    shown = [f"{value:,.{digits}f}" for value in middles]
    ps = (f"{each.p:.2g}", f"{each.adjusted:.2g}")
    return [each.measure, *shown, each.ratio.text(3), str(each.units), *ps, each.verdict]


def _solved_line(pairs: Pairs) -> list[str]:
    counts = [sum(rows_[k]["ok"] for rows_ in pairs.values()) for k in (0, 1)]
    only = [sum(rows_[k]["ok"] and not rows_[1 - k]["ok"] for rows_ in pairs.values()) for k in (0, 1)]
    p = exact_sign(*only)
    verdict = ("second less" if only[1] < only[0] else "second more") if p < 0.05 else "not significant"
    shown = [wilson(count, len(pairs)).text(0, 100.0) + " %" for count in counts]
    return ["solved", *shown, f"only one: {only[0]} : {only[1]}", str(len(pairs)), f"{p:.2g}", "", verdict]


# --- the command


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0; what differs is for the reader to judge."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks compare", description=__doc__)
    parser.add_argument("first", type=Path, metavar="A")
    parser.add_argument("second", type=Path, metavar="B", nargs="?", help="planners within A if not given")
    parser.add_argument("--planner", action="append", default=[], metavar="NAME", help="the planner, or two within A")
    asked = parser.parse_args(arguments)
    first = rows.read_some(asked.first)
    second = first if asked.second is None else rows.read_some(asked.second)
    console.print(*tables_of(first), sep="\n\n")
    if second is not first:
        console.print(*tables_of(second), sep="\n\n")
        _tell_places(first, second, console)
    for title, a, b in _matches(first, second, asked.planner):
        if not _paired(a, b):
            message = f"{title}: they have no run of the same problem and seed in common"
            raise InvalidRequest("B", title, "rows of the same problems and seeds", message=message)
        console.print(compare(title, a, b), "", sep="\n")
    return 0


def _tell_places(first: Results, second: Results, console: Console) -> None:
    """Say it where two files were made in different places, so that their times are not of the code alone."""
    then, now = (results.header["environment"] for results in (first, second))
    changed = [f"{key} {then[key]} and {now[key]}" for key in ("cpu", "cores", "python") if then[key] != now[key]]
    if changed:
        console.print(f"made in different places, times are not comparable: {'; '.join(changed)}", soft_wrap=True)


def _matches(
    first: Results, second: Results, planners: Sequence[str]
) -> Iterable[tuple[str, Sequence[Row], Sequence[Row]]]:
    """Who is compared with whom.

    Raises:
        UnknownName: a planner that a file does not have.
        InvalidRequest: the files have no planner in common.
    """
    ours, theirs = ({_named(c): found for c, found in _by_contender(r.rows).items()} for r in (first, second))
    for name in planners:
        if name not in ours and name not in theirs:
            raise UnknownName("planner", name, {*ours, *theirs})
    if first is second:
        one, *others = planners or ours
        if not others and len(ours) == 1:
            message = f"all rows are of {one}: there is nothing to compare it with; give a second file"
            raise InvalidRequest("B", None, "a second file", message=message)
        if not others:
            raise InvalidRequest("--planner", one, f"another one of {', '.join(ours)} beside it, or a second file")
        return [(f"{one}, then {other}", ours[one], ours[other]) for other in others]
    if len(planners) > 2:
        raise InvalidRequest("--planner", list(planners), "at most two, one of each file")
    if len(planners) == 2:
        a, b = planners
        return [(f"{a}, then {b}", _of(ours, a, "first"), _of(theirs, b, "second"))]
    both = [name for name in ours if name in theirs and (not planners or name in planners)]
    if not both:
        named = f"{planners[0]} is not in both files" if planners else "the files have no planner in common"
        message = f"{named}: {', '.join(ours)} and {', '.join(theirs)}; name two, that of the first file first"
        raise InvalidRequest("--planner", list(planners), "--planner A --planner B", message=message)
    return [(name, ours[name], theirs[name]) for name in both]


def _of(found: Mapping[str, Sequence[Row]], planner: str, which: str) -> Sequence[Row]:
    if planner not in found:
        raise UnknownName(f"planner of the {which} file", planner, found)
    return found[planner]
