"""``report``: results files as one HTML page that needs nothing else, or as the tables of a Markdown text."""

from __future__ import annotations

import argparse
import html
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import rows
from benchmarks.harness.report import Promise, Report
from benchmarks.pages import page_tables as tables
from benchmarks.pages.page_builds import builds
from benchmarks.pages.page_numbers import Sheet, sheets_of
from benchmarks.pages.pictures import pictures_of
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import read_bytes
from planner_service.files.writing import require_writable, write_whole

__all__ = ["filled", "main", "page_of", "write_measure"]

MAX_TEXT = 5_000_000
"""Bytes of a Markdown file."""

POLICY = "default-src 'none'; style-src 'unsafe-inline'"
"""Nothing is fetched from anywhere, and nothing is run."""


def page_of(sheets: Sequence[Sheet]) -> str:
    """The page."""
    style = (Path(__file__).parent / "page.css").read_text("utf-8")
    title = f"Planners compared: {', '.join(sheet.suite for sheet in sheets)}"
    links = "".join(f'<a href="#{_anchor(sheet)}">{html.escape(sheet.suite)}</a>' for sheet in sheets)
    told = "".join(f"<p>{html.escape(text)}</p>\n" for text in tables.explained(sheets))
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{html.escape(title)}</title>\n'
        f"<style>\n{style}</style>\n</head>\n<body>\n<h1>{html.escape(title)}</h1>\n"
        f"<nav>{links if len(sheets) > 1 else ''}</nav>\n{told}"
        f"{''.join(part for sheet in sheets for part in _section(sheet))}</body>\n</html>\n"
    )


def _anchor(sheet: Sheet) -> str:
    return "suite-" + re.sub(r"[^\w-]", "-", sheet.suite)


def _section(sheet: Sheet) -> Iterator[str]:
    yield f'<section id="{_anchor(sheet)}">\n<h2>{html.escape(sheet.suite)}</h2>\n<dl>\n'
    for name, value in tables.environments(sheet):
        yield f"<dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd>\n"
    yield "</dl>\n"
    told = tables.statements(sheet)
    if told:
        yield "<h3>In plain words</h3>\n<ul class=told>\n"
        yield "".join(_item(sentence) for sentence in told)
        yield "</ul>\n"
    yield tables.overall(sheet).html()
    if len(sheet.kinds) > 1:
        yield tables.by_kind(sheet).html()
    apart = builds(sheet)
    if apart is not None:
        yield apart.html()
    yield "<div class=pictures>\n"
    for _, caption, picture in pictures_of(sheet):
        yield f"<figure>{picture}\n<figcaption>{html.escape(caption)}</figcaption></figure>\n"
    yield "</div>\n"
    for table in (tables.failures(sheet), tables.rejects(sheet)):
        if table is not None:
            count = f"{table.title} ({len(table.rows)} lines)"
            shown = table.html().partition("</h3>\n")[2]
            opened = " open" if len(table.rows) <= 12 else ""
            yield f"<details class=texts{opened}><summary>{html.escape(count)}</summary>\n{shown}</details>\n"
    yield "</section>\n"


def _item(sentence: tables.Sentence) -> str:
    if not sentence.theirs:
        return f"<li>{html.escape(sentence.text)}</li>\n"
    first, point, rest = map(html.escape, sentence.text.partition(": "))
    return f"<li class=theirs><strong>{first}</strong>{point}{rest}</li>\n"


# --- Markdown


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


def _markdown(sheet: Sheet) -> str:
    parts = ["".join(f"- {name}: {_code(name, value)}\n" for name, value in tables.environments(sheet))]
    parts.append("".join(f"- {html.escape(sentence.text, quote=False)}\n" for sentence in tables.statements(sheet)))
    parts.append(tables.overall(sheet).markdown())
    if len(sheet.kinds) > 1:
        parts.append(tables.by_kind(sheet).markdown())
    parts += [table.markdown() for table in (builds(sheet), tables.failures_in_short(sheet)) if table is not None]
    return "\n".join(part for part in parts if part)


def _code(name: str, value: str) -> str:
    return f"`{value}`" if name in ("command", "commit") else html.escape(value, quote=False)


# --- the command


def main(arguments: Sequence[str], console: Console) -> int:
    """Exit code 0 when what was asked for is written."""
    asked = _asked(arguments)
    sheets = sheets_of([rows.read(path) for path in asked.results])
    if not sheets:
        raise InvalidRequest("results", list(map(str, asked.results)), "files with at least one row in all")
    for path in filter(None, (asked.output, asked.markdown)):
        require_writable(path)
    if asked.markdown is not None:
        write_whole(asked.markdown, filled(_text(asked.markdown), sheets, asked.markdown))
    if asked.output is not None:
        write_whole(asked.output, page_of(sheets))
    for path in filter(None, (asked.output, asked.markdown)):
        count = sum(len(group.rows) for sheet in sheets for group in sheet.groups)
        console.print(f"{path}: {count:,} rows of {', '.join(sheet.suite for sheet in sheets)}", markup=False)
    return 0


def _text(path: Path) -> str:
    data = read_bytes(path, MAX_TEXT)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8: byte {data[error.start]:#04x} at {error.start}"]) from None


def _asked(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks report")
    parser.add_argument("results", nargs="+", type=Path, metavar="FILE.jsonl")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.html")
    parser.add_argument("--markdown", type=Path, metavar="FILE.md", help="renew the generated parts of a text")
    asked = parser.parse_args(arguments)
    if asked.output is None and asked.markdown is None:
        parser.error("nothing to write: -o FILE.html or --markdown FILE.md")
    return asked
