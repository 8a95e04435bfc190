"""The tables and sentences of a report, as cells that become Markdown."""

from __future__ import annotations

import html
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.harness.rows import Row
from benchmarks.harness.statistics import Estimate
from benchmarks.pages.page_numbers import OURS, Group, Pace, Sheet, paces, planning_seconds, seconds, states

__all__ = ["Cell", "Sheaf", "by_kind", "environments", "failures_in_short", "overall", "statements"]

NOTHING = "–"


@dataclass(frozen=True)
class Cell:
    """A text, what stands smaller under it, and whether it is bad news."""

    text: str
    under: str = ""
    bad: bool = False

    def markdown(self) -> str:
        """As a cell; what stands under the text comes after it."""
        text = " ".join(filter(None, (self.text, self.under)))
        text = html.escape(text, quote=False).replace("\n", " ")
        text = text.replace("|", "\\|").replace("[", "\\[")  # [2, 3] [4, 5] would be a link
        return f"**{text}**" if self.bad else text


Line = Mapping[Cell | str, Cell | str]
"""The cells of a row by their heads."""


@dataclass(frozen=True)
class Sheaf:
    """A table: its heads and rows, the first column being names."""

    title: str
    heads: tuple[Cell, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""

    @classmethod
    def of(cls, title: str, lines: Iterable[Line], caption: str = "") -> Sheaf | None:
        """A table of lines that all have the same heads; None of none."""
        found = [{_cell(head): _cell(cell) for head, cell in line.items()} for line in lines]
        return cls(title, tuple(found[0]), tuple(tuple(line.values()) for line in found), caption) if found else None

    def markdown(self) -> str:
        """As a table with its caption under it."""
        lines = [[cell.markdown() for cell in self.heads], ["---"] + ["---:"] * (len(self.heads) - 1)]
        lines += [[cell.markdown() for cell in row] for row in self.rows]
        caption = f"\n{html.escape(self.caption, quote=False)}\n" if self.caption else ""
        return "".join(f"| {' | '.join(line)} |\n" for line in lines) + caption


def _cell(content: Cell | str) -> Cell:
    return Cell(content) if isinstance(content, str) else content


def environments(sheet: Sheet) -> list[tuple[str, str]]:
    """Where the rows of a suite were made, as names and values; several values where files differ."""
    found: dict[str, dict[str, None]] = {}
    for header in sheet.headers:
        environment = header["environment"]
        told = {
            "machine": f"{environment['cpu']}, {environment['cores']} cores, {environment['platform']}",
            "Python": environment["python"],
            "commit": environment.get("commit") or "unknown",
            "instruction set": environment.get("instruction_set") or "unknown",
            "packages": _versions(environment["versions"]),
            "command": f"python -m benchmarks {shlex.join(map(str, header.get('command', ())))}",
        }
        for name, value in told.items():
            found.setdefault(name, {})[value] = None
    for group in sheet.groups:
        if group.versions:
            found.setdefault(f"packages of {group.tool}", {})[_versions(group.versions)] = None
    return [(name, value) for name, values in found.items() for value in values]


def _versions(found: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {version}" for name, version in found.items())


def overall(sheet: Sheet) -> Sheaf:
    """A row for each contender."""
    heads = (
        *(Cell(sheet.suite, "95 % intervals in brackets"), Cell("solved", "Wilson"), Cell("refused", "by the auditor")),
        *(Cell("states", "p50 / p95"), Cell("ms", "p50 / p95"), Cell("ms, path alone", "p50")),
        *(Cell("rad", "raw → final, p50"), Cell("motion s", "p50"), Cell("clearance mm", "p50, least")),
    )
    caption = (
        "States and ms: failures with what they spent; path alone: without proof and timing; the rest: rows with a "
        "path. Refused: by the independent checker, of the path or the timed motion. Clearance: proven lower bound of "
    )
    measured = "ours; of a peer's path the smallest that the independent checker measured."
    caption += measured if sheet.several_tools else "the whole curve."
    return Sheaf("All problems", heads, tuple(_overall_row(group) for group in sheet.groups), caption)


def _overall_row(group: Group) -> tuple[Cell, ...]:
    if group.absent:
        return (Cell(group.name), Cell("not run", bad=True), *[Cell(NOTHING)] * 7)
    refused, worst = group.rejects, max((row["audit"]["depth"] or 0.0 for row in group.rejects), default=0.0)
    share = group.solved
    under = f"[{100 * share.low:.0f}, {100 * share.high:.0f}] %"
    depth = f"≤ {_millimetres(worst)} mm deep" if worst else ""
    return (
        Cell(group.name),
        Cell(f"{len(group.done)}/{len(group.rows)}", under),
        Cell(f"{len(refused)}/{group.audited}", depth, bad=bool(refused)),
        _spread(group, states) if group.counts else Cell("not told"),
        _spread(group, lambda row: 1e3 * seconds(row)),
        _middle(group, _path_ms),
        Cell(f"{_median(group, 'raw_length')} → {_median(group, 'length')}"),
        Cell(_median(group, "duration")),
        Cell(_median(group, "clearance", 1e3), _least(group)),
    )


def _spread(group: Group, measure: Any) -> Cell:
    middle, high = (group.quantile(measure, share, charged=True) for share in (0.5, 0.95))
    if middle is None or high is None:
        return Cell(NOTHING)
    return Cell(f"{_short(middle.value)} / {_short(high.value)}", f"{_range(middle)}\n{_range(high)}")


def _path_ms(row: Row) -> float | None:
    spent = planning_seconds(row)
    return None if spent is None else 1e3 * spent


def _middle(group: Group, measure: Any) -> Cell:
    middle = group.quantile(measure, 0.5, charged=True)
    return Cell(NOTHING) if middle is None else Cell(_short(middle.value), _range(middle))


def _median(group: Group, key: str, scale: float = 1.0) -> str:
    values = sorted(group.values(lambda row: row[key]))
    return f"{values[len(values) // 2] * scale:.2f}" if values else NOTHING


def _least(group: Group) -> str:
    values = group.values(lambda row: row["clearance"])
    return f"{1e3 * min(values):.2f}" if values else ""


def _range(estimate: Estimate) -> str:
    return f"[{_short(estimate.low)}, {_short(estimate.high)}]"


def _short(value: float) -> str:
    """Three digits, or a whole number."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _millimetres(metres: float) -> str:
    return f"{1e3 * metres:.3g}"


def by_kind(sheet: Sheet) -> Sheaf:
    """For each kind of problem and contender: how many are solved, and the median time."""

    def cell(here: Group) -> Cell:
        middle = here.quantile(lambda row: 1e3 * seconds(row), 0.5, charged=True)
        told = NOTHING if middle is None else f"{_short(middle.value)} ms"
        return Cell(f"{len(here.done)}/{len(here.rows)}", told, bad=len(here.done) < len(here.rows))

    heads = (Cell("", "solved, ms p50"), *map(Cell, sheet.kinds))
    rows = tuple((Cell(each.name), *(cell(each.of_kind(kind)) for kind in sheet.kinds)) for each in sheet.present)
    return Sheaf("By kind of problem", heads, rows, "Processor time of the whole call, failures with what they spent.")


def statements(sheet: Sheet) -> list[str]:
    """What peers do better and worse than our first planner, in plain words."""
    groups = {group.name: group for group in sheet.groups}
    found: list[str | None] = [_statement(pace, groups) for pace in paces(sheet)]
    found += [_better(sheet, *each) for each in _QUALITIES]
    return [sentence for sentence in found if sentence is not None]


def _statement(pace: Pace, groups: Mapping[str, Group]) -> str:
    ours, peer = groups[pace.ours], groups[pace.peer]
    found = {
        "faster": f"{pace.peer} is faster than {pace.ours}",
        "slower": f"{pace.peer} is slower than {pace.ours}",
        "not shown": f"Between {pace.peer} and {pace.ours} no difference is shown",
    }[pace.verdict]
    found += f": it takes {_times(pace.ratio)} our processor time"
    found += f" (median of the {pace.units} {pace.unit} both solved; less on {pace.faster} of them)."
    if pace.planning is not None:
        found += f" For the path alone, without proof and timing, it takes {_times(pace.planning)} ours."
    found += f" The independent checker refuses {len(peer.rejects)} of its {peer.audited} results,"
    found += f" and {len(ours.rejects)} of {ours.audited} of ours."
    return found


def _times(estimate: Estimate) -> str:
    return f"{estimate.value:.3g} times [{estimate.low:.3g}, {estimate.high:.3g}]"


_QUALITIES = (("length", "rad", "Shorter paths"), ("duration", "s", "Shorter motions"))


def _better(sheet: Sheet, key: str, unit: str, text: str) -> str | None:
    """The peers whose median of something is less than ours, on problems both solved."""
    ours = next((group for group in sheet.present if group.tool == OURS), None)
    if ours is None or not sheet.several_tools:
        return None
    found = []
    for peer in (group for group in sheet.present if group.tool != OURS):
        both = {row["problem"] for row in ours.done} & {row["problem"] for row in peer.done}
        sides = [[row[key] for row in group.done if row["problem"] in both] for group in (ours, peer)]
        if all(sides) and not any(None in side for side in sides):
            a, b = (float(np.median(side)) for side in sides)
            if b < a:
                found.append(f"{peer.name} ({b:.2f} {unit} to our {a:.2f} {unit}, {_number(len(both), 'problem')})")
    return f"{text} than ours, by the median: {'; '.join(found)}." if found else None


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _lost(sheet: Sheet, *keys: str) -> dict[tuple[str, ...], list[Row]]:
    """The rows without a path, by whose they are and by some of their values."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for group in sheet.groups:
        for row in group.rows:
            if not row["ok"]:
                found.setdefault((group.name, *(str(row[key]) for key in keys)), []).append(row)
    return found


def _where(row: Row) -> str:
    return f"{row['problem']} seed {row['seed']}"


def failures_in_short(sheet: Sheet) -> Sheaf | None:
    """How many rows of whom have no path for which reason, with one example each."""
    lines: list[Line] = []
    for (who, why), lost in _lost(sheet, "failure").items():
        such = f"{_where(lost[0])}: {lost[0]['detail']}"
        lines.append({"without a path": who, "rows": str(len(lost)), "why": why, "such as": such})
    return Sheaf.of("Without a path", lines)
