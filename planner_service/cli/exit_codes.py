"""How a command ends: its exit code, and what it prints last."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import typer

from planner_service.cli.output import Document, show, wrapped
from planner_service.errors import InvalidRequest, MissingDependency, NotProven
from planner_service.planning.result import Failure
from planner_service.presentation.tables import Block, printable

__all__ = ["BAD_INPUT", "NO_PLAN", "OUR_BUG", "ErrorLog", "bad_input_exits", "finish", "report_error"]

NO_PLAN, BAD_INPUT = 1, 2

OUR_BUG = 70
"""EX_SOFTWARE of sysexits.h: Python's own exit code, 1, would look like "no plan"."""

MAX_ERROR_LINES = 20
"""A file can have thousands of problems."""

MAX_LINES = 10
"""A task that finds no grasp has a note for each one it tried."""


@contextmanager
def bad_input_exits() -> Iterator[None]:
    """End the command with a message on standard error: code 2 for bad input, 1 for a file that is not proven."""
    try:
        yield
    except (InvalidRequest, MissingDependency) as error:
        first, *more = str(error).splitlines() or [type(error).__name__]
        hidden = len(more) - MAX_ERROR_LINES
        more[MAX_ERROR_LINES:] = [f"  ... and {hidden} more"] if hidden > 0 else []
        report_error(f"planner-service: {first}", *more)
        raise typer.Exit(NO_PLAN if isinstance(error, NotProven) else BAD_INPUT) from None


def report_error(*lines: str) -> None:
    """Write lines to standard error."""
    typer.echo("\n".join(map(printable, lines)), err=True)


class ErrorLog(logging.Handler):
    """Prints what is logged; looks standard error up at each line, as tests replace it."""

    def emit(self, record: logging.LogRecord) -> None:
        report_error(self.format(record))


def finish(
    document: Document,
    table: Block | None,
    lines: Sequence[str],
    failure: Failure | None,
    *,
    as_json: bool,
    last: Block | None = None,
) -> None:
    """Print a JSON document, or a table with lines below it and a last block, and exit with 1 if there is no plan."""
    hidden = len(lines) - MAX_LINES
    more = [f"note: {hidden} more notes; --json prints all"] if hidden > 0 else []
    blocks = [] if table is None else [table]
    ending = [] if last is None else ["", last]
    show(document, *blocks, *wrapped([*lines[:MAX_LINES], *more]), *ending, as_json=as_json)
    if failure is not None:
        report_error(f"no plan: {failure}")
        raise typer.Exit(NO_PLAN)
