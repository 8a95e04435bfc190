"""How far a long job is, drawn on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from planner_service.errors import InvalidRequest

__all__ = ["bar"]


@contextmanager
def bar(what: str, shown: bool | None) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar, set by how much is done of how much; None if it is not to be ``shown``.

    Args:
        shown: If None, when standard error is a terminal.
    """
    if shown is not None and not isinstance(shown, bool | np.bool_):
        raise InvalidRequest("progress", shown, "True or False")
    if not (sys.stderr.isatty() if shown is None else shown):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True, force_terminal=True), transient=True) as drawn:
        task = drawn.add_task(what, total=None)
        yield lambda done, total: drawn.update(task, completed=min(done, total), total=total)
