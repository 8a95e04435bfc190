"""The command ``planner-service``; its parts are imported when it runs, and only then."""

from __future__ import annotations

import io
import sys
import traceback

__all__ = ["OUR_BUG", "main"]

INTERRUPTED = 130
"""128 + SIGINT, as shells have it."""

OUR_BUG = 70
"""EX_SOFTWARE of sysexits.h: an error of ours must not look like "no plan", which Python's own 1 would."""


def main() -> None:
    """Run the command line and exit with its code: 0 planned, 1 no plan, 2 bad input, 130 interrupted, 70 our bug."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the terminal cannot show is no reason to stop
            stream.reconfigure(errors="backslashreplace")
    try:
        from planner_service.cli.commands import app

        app(prog_name="planner-service")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except Exception:
        traceback.print_exc()
        sys.exit(OUR_BUG)
