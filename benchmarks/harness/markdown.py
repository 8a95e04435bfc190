"""Reports as the generated parts of a Markdown text."""

from __future__ import annotations

import html
from collections.abc import Iterable
from pathlib import Path

from rich.table import Table

from benchmarks.harness.report import Report
from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes
from planner_service.files.writing import write_whole

__all__ = ["write_part"]

MAX_TEXT = 5_000_000
"""Bytes of a Markdown file."""


def write_part(report: Report, where: Path) -> None:
    """Write tables and promises between ``<!-- generated: NAME -->`` and ``<!-- end of NAME -->`` of a text.

    A report that has parts is written part by part, each in its own place.

    Raises:
        InvalidFile: the text has no such part, or cannot be read.
    """
    if report.parts:
        for part in report.parts:
            write_part(part, where)
        return
    begin, end = f"<!-- generated: {report.name} -->", f"<!-- end of {report.name} -->"
    try:
        text = read_bytes(where, MAX_TEXT).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidFile(where, [f"not UTF-8 at byte {error.start}"]) from None
    if missing := [mark for mark in (begin, end) if mark not in text]:
        raise InvalidFile(where, [f"{missing[0]} is missing"])
    parts = [_table(table) for table in report.tables]
    promises = ((f"{'kept' if p.kept else 'MISSED'}: {p.text}: {p.measured}") for p in report.promises)
    parts.append("".join(f"- {_cell(text)}\n" for text in promises))
    head, _, rest = text.partition(begin)
    content = "\n".join(filter(None, parts))
    write_whole(where, f"{head}{begin}\n\n{content}\n{end}{rest.partition(end)[2]}")


def _table(table: Table) -> str:
    columns = [[column.header, *column.cells] for column in table.columns]
    head, *rows = zip(*columns, strict=True)
    caption = f"\n{html.escape(str(table.caption), quote=False)}\n" if table.caption else ""
    ruler = ["---"] + ["---:"] * (len(columns) - 1)
    return "".join(map(_line, (map(_cell, head), ruler, *(map(_cell, row) for row in rows)))) + caption


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


def _cell(content: object) -> str:
    text = html.escape(str(content), quote=False).replace("\n", " ")
    return text.replace("|", "\\|").replace("[", "\\[")  # [2, 3] [4, 5] would be a link
