"""An arm and a clock for each test."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.cli import run
from planner_service.execute import arm as arm_module
from planner_service.execute import stream as execution
from tests.support.arms import FakeArm, FakeTime, robot


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    """No test waits, and none depends on how busy the machine is."""
    clock = FakeTime()
    monkeypatch.setattr(execution, "time", clock)
    monkeypatch.setattr(arm_module, "time", clock)
    return clock


@pytest.fixture
def arm() -> FakeArm:
    return FakeArm(np.array(robot().home))


@pytest.fixture
def real(arm: FakeArm, monkeypatch: pytest.MonkeyPatch) -> FakeArm:
    """An arm that is no simulation, which the command line connects to."""
    arm.simulated = False
    monkeypatch.setattr(run, "TrossenDriver", lambda address: arm)
    return arm


@pytest.fixture
def unconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line must not connect to any arm."""
    monkeypatch.setattr(run, "TrossenDriver", lambda address: pytest.fail("connected"))
