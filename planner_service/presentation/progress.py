"""How far a long job is, told on standard error: a bar in a terminal, a line now and then in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from planner_service.errors import InvalidRequest

__all__ = ["INTERVAL", "bar"]

INTERVAL = 10.0
"""Seconds between two lines; a job that takes less has none."""


@contextmanager
def bar(what: str, shown: bool | None) -> Iterator[Callable[[int, int], None] | None]:
    """Tells how much is done of how much: by a bar, or by lines where there is no terminal; None if not ``shown``.

    Args:
        shown: If None, when standard error is a terminal.
    """
    if shown is not None and not isinstance(shown, bool | np.bool_):
        raise InvalidRequest("progress", shown, "True or False")
    if not (sys.stderr.isatty() if shown is None else shown):
        yield None
        return
    if not sys.stderr.isatty():
        yield _lines(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as drawn:
        task = drawn.add_task(what, total=None)
        yield lambda done, total: drawn.update(task, completed=min(done, total), total=total)


def _lines(what: str) -> Callable[[int, int], None]:
    """Writes how far it is, how long that took, and how long the rest will take, once in ten seconds."""
    began = last = time.monotonic()
    first: int | None = None

    def tell(done: int, total: int) -> None:
        nonlocal last, first
        now = time.monotonic()
        first = done if first is None else first  # what an earlier run had done says nothing about the pace
        if now - last < INTERVAL:
            return
        last, took = now, now - began
        left = f", about {took * (total - done) / (done - first):.0f} s left" if total > done > first else ""
        print(f"{what}: {min(done, total):,} of {total:,} in {took:.0f} s{left}", file=sys.stderr, flush=True)

    return tell
