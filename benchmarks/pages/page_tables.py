"""The tables and sentences of the page, as cells that become HTML or Markdown."""

from __future__ import annotations

import html
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.harness.rows import Row
from benchmarks.harness.statistics import Estimate
from benchmarks.pages.page_numbers import OURS, Group, Pace, Sheet, paces, planning_seconds, rejected, seconds, states

__all__ = ["Cell", "Sentence", "Sheaf", "by_kind", "environments", "explained", "failures", "failures_in_short"]
__all__ += ["overall", "rejects", "statements"]

NOTHING = "–"


@dataclass(frozen=True)
class Cell:
    """A text, what stands smaller under it, and whether it is bad news."""

    text: str
    under: str = ""
    bad: bool = False

    def html(self, tag: str = "td") -> str:
        """As an element of a row."""
        under = f"<small>{html.escape(self.under)}</small>" if self.under else ""
        return f"<{tag}{' class=bad' if self.bad else ''}>{html.escape(self.text)}{under}</{tag}>"

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

    def html(self) -> str:
        """As a figure that can be scrolled sideways."""
        head = "".join(cell.html("th") for cell in self.heads)
        rows = "".join(f"<tr>{row[0].html('th')}{''.join(map(Cell.html, row[1:]))}</tr>\n" for row in self.rows)
        caption = f"<p class=caption>{html.escape(self.caption)}</p>" if self.caption else ""
        table = f"<div class=wide><table><thead><tr>{head}</tr></thead><tbody>\n{rows}</tbody></table></div>"
        return f"<h3>{html.escape(self.title)}</h3>\n{table}\n{caption}\n"

    def markdown(self) -> str:
        """As a table with its caption under it."""
        lines = [[cell.markdown() for cell in self.heads], ["---"] + ["---:"] * (len(self.heads) - 1)]
        lines += [[cell.markdown() for cell in row] for row in self.rows]
        caption = f"\n{html.escape(self.caption, quote=False)}\n" if self.caption else ""
        return "".join(f"| {' | '.join(line)} |\n" for line in lines) + caption


def _cell(content: Cell | str) -> Cell:
    return Cell(content) if isinstance(content, str) else content


@dataclass(frozen=True)
class Sentence:
    """A statement, and whether it is about something a peer does better."""

    text: str
    theirs: bool = False


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


def statements(sheet: Sheet) -> list[Sentence]:
    """What peers do better and worse than our first planner, in plain words."""
    groups = {group.name: group for group in sheet.groups}
    found: list[Sentence | None] = [_statement(pace, groups) for pace in paces(sheet)]
    found += [_better(sheet, *each) for each in _QUALITIES]
    return [sentence for sentence in found if sentence is not None]


def _statement(pace: Pace, groups: Mapping[str, Group]) -> Sentence:
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
    return Sentence(found, theirs=pace.verdict == "faster" or (pace.planning is not None and pace.planning.high < 1.0))


def _times(estimate: Estimate) -> str:
    return f"{estimate.value:.3g} times [{estimate.low:.3g}, {estimate.high:.3g}]"


_QUALITIES = (("length", "rad", "Shorter paths"), ("duration", "s", "Shorter motions"))


def _better(sheet: Sheet, key: str, unit: str, text: str) -> Sentence | None:
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
    return Sentence(f"{text} than ours, by the median: {'; '.join(found)}.", theirs=True) if found else None


def _number(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def failures(sheet: Sheet) -> Sheaf | None:
    """Every row without a path, with its reason; alike ones of one contender together."""
    lines: list[Line] = []
    for (who, why, detail), lost in _lost(sheet, "failure", "detail").items():
        where = Cell(_listed(list(map(_where, lost))), f"{len(lost)} in all" if len(lost) > 1 else "")
        lines.append({"who": who, "why": why, "detail": detail, "where": where})
    return Sheaf.of("Without a path", lines)


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


def rejects(sheet: Sheet) -> Sheaf | None:
    """What the independent checker refuses: whose, who touches whom, how deep."""
    lines: list[Line] = []
    for group in sheet.groups:
        for row in sorted(group.rejects, key=lambda row: -(row["audit"]["depth"] or 0.0)):
            audit = row["audit"]
            pair = " × ".join(audit["pair"] or ())
            depth = NOTHING if audit["depth"] is None else f"{1e3 * audit['depth']:.2f}"
            refused = [name for name, each in row.get("audits", {}).items() if rejected({"audit": each})]
            line: dict[Cell | str, Cell | str] = {"whose": group.name, "where": _where(row)}
            line |= {"what": " and ".join(refused) or "path or motion", "who touches whom": pair}
            lines.append(line | {"mm deep": Cell(depth, bad=True), "step, rad": f"{audit['step']}"})
    return Sheaf.of("Refused by the independent checker", lines)


def _listed(where: Sequence[str], most: int = 70) -> str:
    return ", ".join(where[:most]) + (f" and {len(where) - most} more" if len(where) > most else "")


def explained(sheets: Sequence[Sheet]) -> Iterator[str]:
    """What the words of the tables mean."""
    steps = sorted({row["audit"]["step"] for s in sheets for g in s.groups for row in g.rows if row["audit"]["step"]})
    told = " and ".join(f"{step:g}" for step in steps)
    yield (
        "The independent checker is Coal, through code that shares nothing with the planner. It judges every result "
        f"joint by joint at steps of {told} rad: polylines straight in joint space, timed motions as they are executed."
        if steps
        else "No result was put before the independent checker."
    )
    yield (
        "Milliseconds are processor time of one call, its world being built already; those of a stage are its share of "
        "the call's wall clock. Our counts are exact, and equal on any machine."
    )
