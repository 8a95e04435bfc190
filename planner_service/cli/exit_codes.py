"""How a command ends: what it prints last, and the code it leaves with."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer

from planner_service.cli.tables import UNATTENDED_WIDTH, console, emit, render
from planner_service.errors import InvalidRequest, MissingDependency, NotProven
from planner_service.planning.result import Failure

__all__ = ["BAD_INPUT", "NO_PLAN", "bad_input_exits", "finish", "json_text", "wrapped"]

NO_PLAN, BAD_INPUT = 1, 2

MESSAGE_LINES = 20
"""A file can have thousands of problems."""

MAX_LINES = 10
"""A task that finds no grasp has a note for each that it tried."""


@contextmanager
def bad_input_exits() -> Iterator[None]:
    """End the command with a message: code 2 for a mistake of its caller, 1 for a file that is not proven."""
    try:
        yield
    except (InvalidRequest, MissingDependency) as error:
        first, *more = str(error).splitlines()[: MESSAGE_LINES + 1] or [type(error).__name__]
        hidden = len(str(error).splitlines()) - 1 - len(more)
        more += [f"  ... and {hidden} more"] if hidden > 0 else []
        typer.echo("\n".join([f"planner-service: {first}", *more]), err=True)
        raise typer.Exit(NO_PLAN if isinstance(error, NotProven) else BAD_INPUT) from None


def finish(
    document: dict[str, Any], text: str, failure: Failure | None, lines: Sequence[str], *, as_json: bool
) -> None:
    """Print a document or a text and lines below it, and leave with the code that says whether there is a plan."""
    emit(json_text(document) if as_json else text)
    if not as_json and lines:
        more = [f"note: and {len(lines) - MAX_LINES} more, all in --json"] if len(lines) > MAX_LINES else []
        emit(render(*wrapped([*lines[:MAX_LINES], *more])))
    if failure is not None:
        typer.echo(f"no plan: {failure}", err=True)
        raise typer.Exit(NO_PLAN)


def wrapped(lines: Sequence[str], indent: str = "  ") -> list[str]:
    """Lines that fit the terminal, what is left of one indented in the next."""
    width = min(console().width, UNATTENDED_WIDTH)
    return [textwrap.fill(line, width, subsequent_indent=indent, break_on_hyphens=False) for line in lines]


def json_text(document: dict[str, Any]) -> str:
    """A document as commands print it."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
