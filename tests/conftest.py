"""What holds for all tests, and the worlds that many of them plan in."""

from __future__ import annotations

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
