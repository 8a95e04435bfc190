"""A recording is replayed up to the first target that a gate would have refused."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.gate import Kind
from planner_service.gate.replay import replayed
from planner_service.geometry.arrays import FloatArray
from planner_service.scene.scene import Scene
from tests.unit.gate.test_action_gate import TRACKING, gate_of, ramp

SHARE = 1.0 / (30.0 * TRACKING.goal_time)


def _followed(targets: FloatArray) -> FloatArray:
    """Where an exact driver is as each target comes."""
    places = [targets[0] - np.array([0.001, 0.0])]
    for target in targets[:-1]:
        places.append(places[-1] + SHARE * (target - places[-1]))
    return np.array(places)


def test_a_recording_in_free_space_passes_whole() -> None:
    targets = ramp(60)
    done = replayed(gate_of(Scene()), _followed(targets), targets)
    assert (done.passed, done.refused) == (60, None)


def test_a_recording_ends_at_its_first_refused_target() -> None:
    targets = ramp(60)
    targets[40:] += 1.0
    done = replayed(gate_of(Scene()), _followed(targets), targets)
    assert done.refused is not None
    assert (done.passed, done.refused.index, done.refused.kind) == (40, 40, Kind.SPEED)
    assert done.refused.time == pytest.approx(40.0 / 30.0)


def test_measurements_and_targets_come_in_pairs() -> None:
    targets = ramp(5)
    with pytest.raises(InvalidRequest, match="one row for each target"):
        replayed(gate_of(Scene()), targets[:4], targets)
