"""Tables as text of a given width, as HTML, and as Markdown."""

from __future__ import annotations

import io
import re
import textwrap
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

__all__ = [
    "WIDTH",
    "Block",
    "CostTable",
    "Row",
    "Table",
    "markdown_escaped",
    "printable",
    "render_html",
    "render_text",
    "wrapped",
]

WIDTH = 100
"""Columns of printed objects, and of commands whose output is no terminal."""

NARROW = 88
"""In fewer columns, each row of a cost table takes a line for its words and one for its numbers."""

NAME_WIDTH = 19
COUNTS, PROJECTIONS = ("states", "edges", "distances"), "projections"
"""Columns of counts; that of projections is there only if there are any."""

NUMBER_WIDTHS = (7, 7, 11, 8)
NARROW_WIDTHS = (7, 6, 10, 12, 8)
"""With projections; so the name of the default planner stays on one line."""

LENGTH_WIDTH, DURATION_WIDTH = 10, 9

MARKDOWN_SIGNS = re.compile(r"[!-/:-@\[-`{-~]")
"""ASCII punctuation: Markdown may read it as a sign, but never after a backslash."""


@dataclass(frozen=True)
class Row:
    """A line of a cost table.

    Attributes:
        note: What happened, in words.
        seconds: Wall time; None if it was not measured.
        length: Of the path, in the table's unit.
        duration: Of the motion, in seconds.
        depth: Levels of indentation.
    """

    name: str
    note: str
    states: int
    edges: int
    distances: int
    seconds: float | None
    length: float | None = None
    duration: float | None = None
    depth: int = 1
    projections: int = 0

    def counts_text(self, names: Iterable[str]) -> tuple[str, ...]:
        """The counts of these names."""
        return tuple(f"{getattr(self, name):,}" for name in names)

    @property
    def milliseconds_text(self) -> str:
        """The wall time; empty if it was not measured."""
        return "" if self.seconds is None else f"{self.seconds * 1000:,.1f}"

    def length_text(self, unit: str) -> str:
        """The length with its unit; empty if there is none."""
        return "" if self.length is None else f"{self.length:.2f} {unit}"

    @property
    def duration_text(self) -> str:
        """The duration; empty if there is none."""
        return "" if self.duration is None else f"{self.duration:.2f} s"


def printable(text: str) -> str:
    """The text with control characters written as escapes: a name from a file must not steer the terminal."""
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def markdown_escaped(text: str) -> str:
    """The text with every sign of Markdown and HTML escaped."""
    return MARKDOWN_SIGNS.sub(r"\\\g<0>", text)


@dataclass(frozen=True)
class CostTable:
    """Rows of a cost table below a title.

    Attributes:
        unit: Unit of path lengths.
    """

    title: str
    rows: Sequence[Row]
    unit: str = ""

    def text(self, width: int = WIDTH) -> str:
        """The rows in columns; in a narrow terminal two lines per row."""
        layout = _wide if width >= NARROW else _narrow
        return "\n".join(layout(printable(self.title), self.rows, min(width, WIDTH), self.unit))

    def html(self) -> str:
        """The rows as an HTML table with the title as its caption."""
        counts = _counts(self.rows)
        cells = [
            (
                "\N{EM SPACE}" * (row.depth - 1) + row.name,
                row.note,
                row.length_text(self.unit),
                row.duration_text,
                *row.counts_text(counts),
                row.milliseconds_text,
            )
            for row in self.rows
        ]
        numeric = ("length", "duration", *counts, "ms")
        return _html_table(self.title, ("", " ", *numeric), cells, numeric)

    def markdown(self) -> str:
        """Names, counts and milliseconds as a Markdown table; the last row, the total, is bold."""
        counts = _counts(self.rows)
        lines = [f"| | {' | '.join(counts)} | ms |", f"|:--|{'--:|' * (len(counts) + 1)}"]
        names = [markdown_escaped(row.name) for row in self.rows]
        names[-1] = f"**{names[-1]}**"
        for name, row in zip(names, self.rows, strict=True):
            lines.append(f"| {name} | {' | '.join(row.counts_text(counts))} | {row.milliseconds_text} |")
        return "\n".join(lines)


@dataclass(frozen=True)
class Table:
    """Cells in columns.

    Attributes:
        heads: The name of each column.
        rows: As many cells each.
        numeric: The heads of columns of numbers, which are aligned to the right.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Collection[str] = ()

    def text(self, width: int = WIDTH) -> str:
        """The cells in columns, long ones wrapped."""
        from rich.console import Console
        from rich.table import Table as Columns
        from rich.text import Text

        columns = Columns(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for head in self.heads:
            columns.add_column(Text(head), justify="right" if head in self.numeric else "left", overflow="fold")
        for row in self.rows:
            columns.add_row(*(Text(printable(cell)) for cell in row))
        file = io.StringIO()
        Console(file=file, width=width, force_terminal=False, force_jupyter=False, color_system=None).print(columns)
        return "\n".join(line.rstrip() for line in file.getvalue().splitlines())

    def html(self) -> str:
        """The cells as an HTML table."""
        return _html_table("", self.heads, self.rows, self.numeric)


Block = CostTable | Table | str
"""A table, or a line of text."""


def render_text(blocks: Iterable[Block]) -> str:
    """Tables and wrapped lines one below the other; control characters are written as escapes."""
    texts = (wrapped([block]) if isinstance(block, str) else [block.text()] for block in blocks)
    return "\n".join(line for lines in texts for line in lines)


def wrapped(lines: Iterable[str], width: int = WIDTH, indent: str = "  ") -> list[str]:
    """Lines of at most so many columns; the continuations of a line are indented."""
    wrapper = textwrap.TextWrapper(width, subsequent_indent=indent, break_on_hyphens=False)
    return [piece for line in lines for piece in wrapper.wrap(printable(line)) or [""]]


def render_html(blocks: Iterable[Block]) -> str:
    """The same as HTML, with every text escaped."""
    return "\n".join(f"<p>{_html(block)}</p>" if isinstance(block, str) else block.html() for block in blocks if block)


def _counts(rows: Sequence[Row]) -> tuple[str, ...]:
    """The counts that have a column."""
    return (*COUNTS, PROJECTIONS) if any(row.projections for row in rows) else COUNTS


def _wide(title: str, rows: Sequence[Row], width: int, unit: str) -> list[str]:
    counts = _counts(rows)
    numbers = [(*row.counts_text(counts), row.milliseconds_text) for row in rows]
    widths = NARROW_WIDTHS if PROJECTIONS in counts else NUMBER_WIDTHS
    sizes = [
        max(least, *(len(cell) + 1 for cell in column))
        for least, column in zip(widths, zip(*numbers, strict=True), strict=True)
    ]

    def aligned(cells: Sequence[str]) -> str:
        return "".join(f"{cell:>{size}}" for cell, size in zip(cells, sizes, strict=True))

    room = width - sum(sizes)
    first, *more = textwrap.wrap(title, max(room - 1, 12)) or [""]
    lines = [f"{first:<{room}}{aligned((*counts, 'ms'))}", *(f"  {line}" for line in more)]
    for row, cells in zip(rows, numbers, strict=True):
        length = row.length_text(unit)
        motion = f"{length:>{LENGTH_WIDTH}}{row.duration_text:>{DURATION_WIDTH}}" if length else row.duration_text
        name = f"{'  ' * row.depth}{printable(row.name)}"
        first, *more = textwrap.wrap(printable(row.note), max(room - NAME_WIDTH - len(motion), 12)) or [""]
        left = f"{name:<{NAME_WIDTH - 1}} {first}"
        lines.append(left + motion.rjust(room - len(left)) + aligned(cells))
        lines += [" " * NAME_WIDTH + line for line in more]
    return lines


def _narrow(title: str, rows: Sequence[Row], width: int, unit: str) -> list[str]:
    lines, names = textwrap.wrap(title, width), _counts(rows)
    for row in rows:
        indent = "  " * row.depth
        words = printable(f"{row.name}: {row.note}" if row.note else row.name)
        lines += textwrap.wrap(words, width, initial_indent=indent, subsequent_indent=indent)
        counts = [f"{count} {name}" for count, name in zip(row.counts_text(names), names, strict=True)]
        milliseconds = row.milliseconds_text and f"{row.milliseconds_text} ms"
        numbers = ", ".join(filter(None, (row.length_text(unit), row.duration_text, *counts, milliseconds)))
        indent += "    "
        lines += textwrap.wrap(numbers, width, initial_indent=indent, subsequent_indent=indent)
    return lines


def _html_table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], numeric: Collection[str]) -> str:
    styles = [f' style="text-align: {"right" if head in numeric else "left"}"' for head in heads]

    def line(tag: str, cells: Sequence[str]) -> str:
        return "".join(f"<{tag}{style}>{_html(cell)}</{tag}>" for style, cell in zip(styles, cells, strict=True))

    title = f'<caption style="text-align: left">{_html(caption)}</caption>' if caption else ""
    lines = [f"<tr>{line('th', heads)}</tr>", *(f"<tr>{line('td', row)}</tr>" for row in rows)]
    return "\n".join([f"<table>{title}", *lines, "</table>"])


def _html(text: str) -> str:
    import html  # a plan is seldom shown as HTML

    return html.escape(printable(text))
