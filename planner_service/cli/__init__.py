"""The command ``planner-service``; everything it needs is imported when it runs."""

from __future__ import annotations

import io
import sys
import traceback

__all__ = ["main"]

INTERRUPTED = 130
"""128 + SIGINT, as in shells."""


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
        from planner_service.cli.exit_codes import OUR_BUG

        sys.exit(OUR_BUG)
