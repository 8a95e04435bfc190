"""The step that lets actions of any robot pass, or gives one that brakes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from lerobot.processor import TransitionKey
from lerobot_robot_proven import ProvenActionStep
from vendor_arm import Clock

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray

PERIOD = 1.0 / 30.0
JOINTS = {f"{name}.pos": name for name in ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")}
JOINTS |= {f"wrist_{k}.pos": f"wrist_{k}_joint" for k in (1, 2, 3)}
UP = np.array([0.0, -1.5, 1.0, 0.0, 0.0, 0.0])


def step_of(**options: Any) -> ProvenActionStep:
    return ProvenActionStep(**{"robot": "ur5", "scene": "table", "joints": JOINTS, "error": 0.005, **options})


def passed(step: ProvenActionStep, measured: FloatArray, wanted: FloatArray, **more: float) -> dict[str, float]:
    """What LeRobot's pipeline gets for an action."""
    keys = list(JOINTS)
    observation = dict(zip(keys, measured.tolist(), strict=True))
    action = {**dict(zip(keys, wanted.tolist(), strict=True)), **more}
    done = step({TransitionKey.OBSERVATION: observation, TransitionKey.ACTION: action})
    sent: dict[str, float] = done[TransitionKey.ACTION]
    return sent


def values(action: dict[str, float]) -> FloatArray:
    return np.array([action[key] for key in JOINTS])


@pytest.mark.usefixtures("clock")
def test_an_action_that_is_free_passes_and_what_is_no_joint_stays() -> None:
    step, wanted = step_of(), UP + 0.001
    sent = passed(step, UP, wanted, gripper=50.0)
    assert np.allclose(values(sent), wanted)
    assert sent["gripper"] == 50.0
    assert step.last is not None
    assert step.last.verdict.ok


def test_actions_into_the_table_are_braked_before(clock: Clock) -> None:
    step, q, wanted = step_of(), UP, UP
    checker = step.gate.service.checker
    for _ in range(150):
        wanted = wanted + np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
        sent = values(passed(step, q, wanted))
        assert checker.state_is_free(sent)
        q = q + (sent - q) * PERIOD / 0.1
        clock.sleep(PERIOD)
    assert not checker.state_is_free(np.clip(wanted, *checker.robot.bounds))
    assert step.gate.counts.refused


@pytest.mark.usefixtures("clock")
def test_degrees_are_taken_and_given_as_degrees() -> None:
    step, wanted = step_of(degrees=True), np.degrees(UP + 0.001)
    assert np.allclose(values(passed(step, np.degrees(UP), wanted)), wanted)
    assert step.last is not None
    assert np.allclose(step.last.q, UP + 0.001)


@pytest.mark.usefixtures("clock")
def test_a_robot_that_does_not_follow_ends_the_session() -> None:
    step = step_of()
    passed(step, UP, UP)
    with pytest.raises(ConnectionError, match="shoulder_lift_joint is"):
        passed(step, UP + np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0]), UP)
    step.reset()
    assert np.allclose(values(passed(step, UP, UP + 0.001)), UP + 0.001)


@pytest.mark.usefixtures("clock")
def test_an_equal_step_is_made_of_its_configuration() -> None:
    step = step_of(degrees=True, error=0.01)
    assert ProvenActionStep(**step.get_config()).get_config() == step.get_config()
    features = {"action": {"shoulder_pan_joint.pos": float}}
    assert step.transform_features(features) == features


@pytest.mark.usefixtures("clock")
def test_an_observation_without_a_joint_is_refused() -> None:
    step = step_of()
    with pytest.raises(InvalidRequest, match="wrist_3"):
        step({TransitionKey.OBSERVATION: dict.fromkeys(list(JOINTS)[:-1], 0.0), TransitionKey.ACTION: {}})


def test_joints_in_another_order_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="in this order"):
        step_of(joints=dict(reversed(JOINTS.items())))
