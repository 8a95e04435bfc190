"""The vendor's driver as a ``Driver``, with a library that writes down what it is asked."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from planner_service.execute import TrossenDriver


@pytest.fixture
def vendor(monkeypatch: pytest.MonkeyPatch) -> Any:
    """What the vendor's library is asked of the arm."""
    library = MagicMock()
    monkeypatch.setitem(sys.modules, "trossen_arm", library)
    return library.TrossenArmDriver.return_value


def test_going_to_a_target_does_not_wait_and_leaves_the_gripper_alone(vendor: Any) -> None:
    TrossenDriver("192.168.1.2").go([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], 0.1)
    (q, seconds, waits), _ = vendor.set_arm_positions.call_args
    assert np.array_equal(q, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert (seconds, waits) == (0.1, False)
    assert not vendor.set_all_positions.called


def test_readings_are_of_one_instant(vendor: Any) -> None:
    joints = SimpleNamespace(
        positions=[0.0] * 7,
        velocities=[1.0] * 7,
        efforts=[2.0] * 7,
        external_efforts=[3.0] * 7,
        temperatures=[40.0] * 7,
    )
    vendor.get_robot_output.return_value.joint.all = joints
    readings = TrossenDriver("192.168.1.2").readings()
    assert {name: values.tolist() for name, values in readings.items()} == {
        "positions": [0.0] * 7,
        "velocities": [1.0] * 7,
        "efforts": [2.0] * 7,
        "external_efforts": [3.0] * 7,
    }
    assert vendor.get_robot_output.call_count == 1
