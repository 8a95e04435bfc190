"""Arms in place of the vendor's. Where LeRobot is not installed, a stand-in with the same interface takes its place."""

from __future__ import annotations

import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
if find_spec("lerobot") is None:
    sys.path.insert(0, str(HERE / "stand_in"))

from lerobot_robot_proven import follower, processor  # noqa: E402
from vendor_arm import ASLEEP, Arm, Clock  # noqa: E402

from planner_service.execute import GatedArm  # noqa: E402
from planner_service.execute import arm as arm_module  # noqa: E402
from planner_service.execute import stream as execution  # noqa: E402


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in (execution, arm_module, processor):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(follower, "GatedArm", partial(GatedArm, clock=clock.perf_counter, wait=clock.sleep))
    return clock


@pytest.fixture
def arms(clock: Clock, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Arm]:
    """Arms that are asleep, by address."""
    arms = {name: Arm(name, clock, ASLEEP) for name in ("192.168.1.4", "192.168.1.5")}
    monkeypatch.setattr(follower, "TrossenDriver", lambda address: arms[address])
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    return arms
