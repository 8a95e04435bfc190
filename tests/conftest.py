"""What holds for all tests, and the worlds that many of them plan in."""

from __future__ import annotations

import gc
import signal

import pytest
from hypothesis import settings

from planner_service import PlannerService, Robot

settings.register_profile("tests", deadline=None)
settings.load_profile("tests")
"""A machine that does other things is no failure."""

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
"""A shell in the background has its programs ignore Ctrl-C, nohup SIGHUP: tests that send one would wait for ever."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that wait for browsers and clusters: at the end each would keep one process waiting."""
    waiting = {item.path for item in items if any(map(item.get_closest_marker, ("browser", "ray")))}
    items.sort(key=lambda item: item.path not in waiting)


def pytest_collection_finish() -> None:
    """Let garbage collections of the tests pass over what is there before the first: it takes most of their time."""
    gc.freeze()


def pytest_sessionfinish() -> None:
    """Collect all at the end: compiled modules report what is not."""
    gc.unfreeze()


@pytest.fixture(scope="session")
def discs() -> PlannerService:
    """The planar arm of the lesson among its discs."""
    return PlannerService("planar2", "discs")


@pytest.fixture(scope="session")
def bin_() -> PlannerService:
    """The WidowX AI over the bin."""
    return PlannerService("wxai", "bin")


@pytest.fixture(scope="session")
def wxai(bin_: PlannerService) -> Robot:
    """The WidowX AI."""
    return bin_.robot
