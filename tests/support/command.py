"""The command line as tests run it."""

from __future__ import annotations

import gc
import json
import os
import signal
import threading
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from planner_service.cli.commands import app
from planner_service.planners import PRM, PRMstar
from planner_service.roadmap import Roadmap

__all__ = ["document", "interrupt_growing", "refused", "run"]


def run(*arguments: str | Path, columns: int = 100) -> Result:
    """What a command comes to; an error of ours comes out."""
    runner = CliRunner(env={"COLUMNS": str(columns), "TERM": "dumb"})
    return runner.invoke(app, list(map(str, arguments)), catch_exceptions=False)


def document(*arguments: str | Path, code: int = 0) -> Any:
    """What --json printed: one document and nothing else, without NaN."""
    result = run(*arguments, "--json")
    assert result.exit_code == code, result.output
    return json.loads(result.stdout, parse_constant=lambda name: pytest.fail(name))


def refused(*arguments: str | Path) -> str:
    """The few lines on standard error of a command that got bad input; standard output stays empty."""
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert len(result.stderr.splitlines()) <= 8
    return result.stderr


def interrupt_growing(monkeypatch: pytest.MonkeyPatch, planner: type[PRM | PRMstar]) -> None:
    """Ctrl-C comes while such a planner grows its roadmap."""
    grow = planner.grow

    def interrupted(*arguments: Any, **settings: Any) -> Roadmap:
        gc.collect()  # a Ctrl-C that falls into a finaliser of what earlier tests left behind is lost
        # well within the growing; once more if that one was lost all the same
        timers = [threading.Timer(delay, os.kill, (os.getpid(), signal.SIGINT)) for delay in (0.1, 0.6)]
        for timer in timers:
            timer.start()
        try:
            return grow(*arguments, **settings)
        finally:
            for timer in timers:
                timer.cancel()

    monkeypatch.setattr(planner, "grow", interrupted)
