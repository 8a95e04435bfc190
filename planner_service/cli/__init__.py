"""The command ``planner-service``; everything it needs is imported when it runs."""

from __future__ import annotations

import io
import sys
import traceback

__all__ = ["OUR_BUG", "main"]

INTERRUPTED = 130
"""128 + SIGINT, as in shells."""

OUR_BUG = 70
"""EX_SOFTWARE of sysexits.h: Python's own exit code, 1, would look like "no plan"."""


def main() -> None:
    """Run the command line; exit with 0 planned, 1 no plan, 2 bad input, 130 interrupted, 70 internal error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names may have characters that the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    try:
        from planner_service.cli.commands import app

        app(prog_name="planner-service")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception:
        traceback.print_exc()
        sys.exit(OUR_BUG)
