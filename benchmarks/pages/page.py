"""``report``: results files as the tables of a Markdown text."""

from __future__ import annotations

import argparse
import html
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import rows
from benchmarks.harness.report import Promise, Report, table
from benchmarks.pages import page_tables as tables
from benchmarks.pages.page_builds import builds
from benchmarks.pages.page_numbers import Sheet, sheets_of
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import read_bytes
from planner_service.files.writing import require_writable, write_whole

__all__ = ["filled", "main", "tables_of", "write_measure"]

MAX_TEXT = 5_000_000
"""Bytes of a Markdown file."""


def filled(text: str, sheets: Sequence[Sheet], where: Path) -> str:
    """A Markdown text with its generated parts made anew: one for each suite of the results.

    A part begins with a line ``<!-- generated: SUITE -->`` and ends with ``<!-- end of SUITE -->``.

    Raises:
        InvalidFile: a suite of the results has no part in the text, or a part no end.
    """
    return _filled(text, {sheet.suite: _markdown(sheet) for sheet in sheets}, where)


def _filled(text: str, parts: Mapping[str, str], where: Path) -> str:
    problems = []
    for name, content in parts.items():
        begin, end = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
        head, found, rest = text.partition(begin)
        _, ended, tail = rest.partition(end)
        if not (found and ended):
            problems.append(f"{begin if not found else end} is missing")
            continue
        text = f"{head}{begin}\n\n{content}\n{end}{tail}"
    if problems:
        raise InvalidFile(where, problems)
    return text


def write_measure(report: Report, where: Path) -> None:
    """Write the tables and promises of a measure into its part of a Markdown text.

    Raises:
        InvalidFile: the text has no such part, or cannot be read.
    """
    parts = [_sheaf(table).markdown() for table in report.tables]
    parts.append("".join(f"- {_promised(promise)}\n" for promise in report.promises))
    write_whole(where, _filled(_text(where), {report.name: "\n".join(parts)}, where))


def _sheaf(table: Table) -> tables.Sheaf:
    cells = zip(*(column.cells for column in table.columns), strict=True)
    heads = tuple(tables.Cell(str(column.header)) for column in table.columns)
    rows = tuple(tuple(tables.Cell(str(cell)) for cell in row) for row in cells)
    return tables.Sheaf(str(table.title), heads, rows, str(table.caption or ""))


def _promised(promise: Promise) -> str:
    return tables.Cell(f"{'kept' if promise.kept else 'MISSED'}: {promise.text}: {promise.measured}").markdown()


def tables_of(found: rows.Results) -> list[Table]:
    """The tables of results for a console."""
    return [_printed(sheaf) for sheet in sheets_of([found]) for sheaf in _sheaves(sheet)]


def _sheaves(sheet: Sheet) -> list[tables.Sheaf]:
    found = [tables.overall(sheet), tables.by_kind(sheet) if len(sheet.kinds) > 1 else None, builds(sheet)]
    return [sheaf for sheaf in (*found, tables.failures_in_short(sheet)) if sheaf is not None]


def _printed(sheaf: tables.Sheaf) -> Table:
    heads = [" ".join(filter(None, (cell.text, cell.under))) for cell in sheaf.heads]
    lines = ([" ".join(filter(None, (cell.text, cell.under))) for cell in row] for row in sheaf.rows)
    return table(sheaf.title, heads, lines, caption=sheaf.caption)


def _markdown(sheet: Sheet) -> str:
    parts = ["".join(f"- {name}: {_code(name, value)}\n" for name, value in tables.environments(sheet))]
    parts.append("".join(f"- {html.escape(sentence, quote=False)}\n" for sentence in tables.statements(sheet)))
    parts += [sheaf.markdown() for sheaf in _sheaves(sheet)]
    return "\n".join(part for part in parts if part)


def _code(name: str, value: str) -> str:
    return f"`{value}`" if name in ("command", "commit") else html.escape(value, quote=False)


# --- the command


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0 when what was asked for is written."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks report")
    parser.add_argument("results", nargs="+", type=Path, metavar="FILE.jsonl")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("-o", "--output", type=Path, metavar="FILE.md", help="a new text")
    where.add_argument("--markdown", type=Path, metavar="FILE.md", help="renew the generated parts of a text")
    asked = parser.parse_args(arguments)
    sheets = sheets_of([rows.read(path) for path in asked.results])
    if not sheets:
        raise InvalidRequest("results", list(map(str, asked.results)), "files with at least one row in all")
    path = asked.markdown or asked.output
    require_writable(path)
    blank = "".join(f"## {s.suite}\n\n<!-- generated: {s.suite} -->\n<!-- end of {s.suite} -->\n\n" for s in sheets)
    write_whole(path, filled(blank if asked.markdown is None else _text(path), sheets, path))
    count = sum(len(group.rows) for sheet in sheets for group in sheet.groups)
    console.print(f"{path}: {count:,} rows of {', '.join(sheet.suite for sheet in sheets)}", markup=False)
    return 0


def _text(path: Path) -> str:
    data = read_bytes(path, MAX_TEXT)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8: byte {data[error.start]:#04x} at {error.start}"]) from None
