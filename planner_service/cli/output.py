"""Writes tables and lines to standard output: as wide as the terminal, with colours only if it is one."""

from __future__ import annotations

import json
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from planner_service.presentation import tables
from planner_service.presentation.tables import WIDTH, Block, CostTable, printable

__all__ = ["Document", "console", "emit", "json_text", "labelled", "render", "show", "wrapped"]

LABEL_WIDTH = 14

Document = dict[str, Any] | Callable[[], dict[str, Any]]
"""A JSON document, or what makes it if it is wanted."""


def console() -> Console:
    """Standard output as it is now: as wide as the terminal, or as COLUMNS says, or 100 columns."""
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else WIDTH
    return Console(file=sys.stdout, width=width, highlight=False, markup=False, emoji=False)


def render(*blocks: Block) -> str:
    """Tables and lines, one below the other; titles and totals are bold on a terminal."""
    screen = console()
    with screen.capture() as capture:
        for block in blocks:
            text = Text(printable(block) if isinstance(block, str) else block.text(screen.width))
            if isinstance(block, CostTable):
                text.highlight_regex(r"\A.*|(?m:^ *total .*)", "bold")
            screen.print(text, soft_wrap=True)
    return capture.get()


def wrapped(lines: Iterable[str], indent: str = "  ") -> list[str]:
    """The lines wrapped to fit the terminal; the continuations of a line are indented."""
    return tables.wrapped(lines, min(console().width, WIDTH), indent)


def labelled(rows: Sequence[tuple[str, str]]) -> list[str]:
    """Texts with a label each, wrapped to fit the terminal."""
    width = max(min(console().width, WIDTH), LABEL_WIDTH + 10)
    indent = " " * (LABEL_WIDTH + 2)
    lines = []
    for label, text in rows:
        first = f"  {label:<{LABEL_WIDTH}}"
        lines += textwrap.wrap(text, width, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)
    return lines


def json_text(document: dict[str, Any]) -> str:
    """A JSON document as commands print it."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def show(document: Document, *blocks: Block, as_json: bool) -> None:
    """Print a JSON document, or what says the same to people."""
    if as_json:
        emit(json_text(document() if callable(document) else document))
    else:
        emit(render(*blocks))


def emit(text: str) -> None:
    """Write to standard output; if its reader is gone, write nowhere, so that the exit code stays right."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
