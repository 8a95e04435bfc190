"""A plugin of pytest for the mutation study, which copies it beside the tests that it runs.

Without a mutant it records which tests reach which lines of a package, and how long each test takes. With one, it runs
the tests in the order of their limits, and ends the whole process when a test takes longer than its limit.

Properties look for no simpler example when they fail, and try the same examples each time.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import coverage
import pytest
from hypothesis import Phase, settings

settings.register_profile("mutants", phases=[Phase.explicit, Phase.generate], database=None, derandomize=True)
settings.load_profile("mutants")

FILE = Path(os.environ["MUTANT_JOB"])
JOB = json.loads(FILE.read_text("utf-8"))
LIMITS: dict[str, float] = JOB["limits"]
"""Seconds that each test may take; empty without a mutant."""

SECONDS: dict[str, float] = {}
COVERAGE = coverage.Coverage(data_file=FILE.with_name("coverage"), include=JOB["modules"], config_file=False)


def allow(test: str = "") -> None:
    """Set the clock for a test, or for what comes before and after all of them; it stops even compiled code."""
    signal.setitimer(signal.ITIMER_REAL, LIMITS.get(test, max(LIMITS.values(), default=0.0)))


def pytest_configure() -> None:
    """Start before anything of the package is imported."""
    allow()
    if not LIMITS:
        COVERAGE.start()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests in order; a mutant may have given some of them other names."""
    places = {test: place for place, test in enumerate(LIMITS)}
    items.sort(key=lambda item: places.get(item.nodeid, len(places)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Run a test with its fixtures."""
    allow(item.nodeid)
    if not LIMITS:
        COVERAGE.switch_context(item.nodeid)
    start = time.monotonic()
    result = yield
    SECONDS[item.nodeid] = time.monotonic() - start
    return result


def pytest_sessionfinish() -> None:
    """Write what was recorded."""
    allow()
    if not LIMITS:
        COVERAGE.stop()
        COVERAGE.save()
        FILE.with_name("seconds.json").write_text(json.dumps(SECONDS), "utf-8")
