"""Followers: the vendor's features, and nothing that is sent touches anything."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_proven import (
    ProvenBiWidowXAIFollower,
    ProvenBiWidowXAIFollowerConfig,
    ProvenWidowXAIFollower,
    ProvenWidowXAIFollowerConfig,
)
from lerobot_robot_proven.config import STAGED
from vendor_arm import Arm, Clock

from planner_service import PlannerService
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray

LEFT, RIGHT = "192.168.1.4", "192.168.1.5"
KEYS = [*(f"joint_{k}.pos" for k in range(6)), "left_carriage_joint.pos"]
PERIOD = 1.0 / 30.0
WAIST, SHOULDER = np.eye(6)[:2]

One = Callable[..., ProvenWidowXAIFollower]


@pytest.fixture
def one(arms: dict[str, Arm], tmp_path: Path) -> One:
    def make(scene: str = "table", **options: Any) -> ProvenWidowXAIFollower:
        config: dict[str, Any] = {"ip_address": LEFT, "calibration_dir": tmp_path, **options}
        return ProvenWidowXAIFollower(ProvenWidowXAIFollowerConfig(scene=scene, **config))

    return make


@pytest.fixture
def two(arms: dict[str, Arm], tmp_path: Path) -> ProvenBiWidowXAIFollower:
    config = ProvenBiWidowXAIFollowerConfig(
        scene="table", left_arm_ip_address=LEFT, right_arm_ip_address=RIGHT, calibration_dir=tmp_path
    )
    return ProvenBiWidowXAIFollower(config)


def action_of(q: FloatArray, finger: float = 0.0) -> dict[str, float]:
    return dict(zip(KEYS, [*q.tolist(), finger], strict=True))


def touching(arms: list[Arm], robot: str, scene: str = "table") -> int:
    """At how many of the places where arms have been, all together, anything touches, however open the gripper is."""
    services = [PlannerService(PlannerService(robot, scene).robot.with_gripper(width), scene) for width in (0.0, 0.08)]
    places = np.concatenate([np.array(arm.been) for arm in arms], axis=1)
    awake = places[np.abs(places).max(axis=1) > 0.1]  # asleep an arm rests on itself
    assert len(awake) > 20
    return sum(not service.checker.state_is_free(q) for service in services for q in awake)


def test_the_features_are_the_vendors(one: One, two: ProvenBiWidowXAIFollower) -> None:
    assert list(one().action_features) == list(one().observation_features) == KEYS
    both = [f"{side}{key}" for side in ("left_", "right_") for key in KEYS]
    assert list(two.action_features) == list(two.observation_features) == both
    assert set(one().action_features.values()) == {float}


def test_more_is_observed_where_it_is_asked_for(one: One) -> None:
    robot = one(include_velocity=True, include_effort=True, include_external_effort=True)
    kinds = [key.rpartition(".")[2] for key in robot.observation_features]
    assert kinds == ["pos"] * 7 + ["vel"] * 7 + ["eff"] * 7 + ["ext_eff"] * 7
    robot.connect()
    observation = robot.get_observation()
    assert list(observation) == list(robot.observation_features)
    assert observation["joint_1.vel"] == observation["joint_1.pos"] + 1.0
    assert observation["joint_1.ext_eff"] == observation["joint_1.pos"] + 3.0


def test_connecting_goes_from_sleep_to_the_staged_pose_and_touches_nothing(one: One, arms: dict[str, Arm]) -> None:
    robot = one()
    robot.connect()
    assert robot.is_connected
    assert np.allclose(arms[LEFT].positions(), STAGED[:-1])
    assert arms[LEFT].finger == 0.0
    assert touching([arms[LEFT]], "wxai") == 0


def test_connecting_goes_round_what_is_in_the_way(one: One, arms: dict[str, Arm]) -> None:
    """Straight from here to the staged pose the arm would hit the post."""
    arms[LEFT].q = np.array([1.2, 1.6, 0.9, 0.2, 0.0, 0.0])
    straight = np.linspace(arms[LEFT].q, STAGED[:-1], 50)
    checker = PlannerService("wxai", "bin").checker
    assert not all(checker.state_is_free(q) for q in straight)
    assert checker.state_is_free(straight[0])
    robot = one("bin")  # which disconnects when nobody has it any more
    robot.connect()
    assert np.allclose(arms[LEFT].positions(), STAGED[:-1])
    assert touching([arms[LEFT]], "wxai", "bin") == 0


def test_where_there_is_no_plan_nothing_moves_and_the_arm_is_let_go_of(one: One, arms: dict[str, Arm]) -> None:
    robot = one(staged_positions=[0.0, 2.5, 0.2, 0.0, 0.0, 0.0, 0.0])
    assert not robot.service.checker.state_is_free([0.0, 2.5, 0.2, 0.0, 0.0, 0.0])
    with pytest.raises(InvalidRequest, match="one with a plan"):
        robot.connect()
    assert arms[LEFT].been == []
    assert arms[LEFT].closed
    assert not robot.is_connected


def test_an_action_that_passes_is_sent_and_returned_as_it_is(one: One, arms: dict[str, Arm]) -> None:
    robot = one()
    robot.connect()
    wanted = action_of(np.array(STAGED[:-1]) + 0.003, 0.03)
    assert robot.send_action(wanted) == wanted
    assert np.allclose(arms[LEFT].been[-1], list(wanted.values())[:-1])
    assert arms[LEFT].finger == 0.03


def test_actions_into_the_table_are_braked_before_and_what_was_sent_is_returned(
    one: One, arms: dict[str, Arm], clock: Clock
) -> None:
    robot = one()
    robot.connect()
    down = np.array(STAGED[:-1])
    sent: dict[str, float] = {}
    for _ in range(60):
        down = down + 0.03 * SHOULDER
        sent = robot.send_action(action_of(down, 0.04))
        clock.sleep(PERIOD)
    assert not robot.service.checker.state_is_free(down)
    assert sent["joint_1.pos"] < down[1] - 0.5
    assert robot.gate.counts.refused
    assert touching([arms[LEFT]], "wxai") == 0


def test_the_first_far_action_is_reached_on_a_plan(one: One, arms: dict[str, Arm], clock: Clock) -> None:
    robot = one("bin")
    robot.connect()
    wanted = np.array([1.2, 1.6, 0.9, 0.2, 0.0, 0.0])
    for _ in range(200):
        robot.send_action(action_of(wanted))
        clock.sleep(PERIOD)
    assert np.allclose(arms[LEFT].positions(), wanted, atol=1e-3)
    assert touching([arms[LEFT]], "wxai", "bin") == 0


def test_disconnecting_goes_to_sleep_from_wherever_the_arm_is(one: One, arms: dict[str, Arm], clock: Clock) -> None:
    robot = one()
    robot.connect()
    for k in range(30):
        robot.send_action(action_of(np.array(STAGED[:-1]) + 0.0005 * k * k * WAIST))
        clock.sleep(PERIOD)
    robot.disconnect()
    assert np.allclose(arms[LEFT].positions(), 0.0)
    assert arms[LEFT].closed
    assert touching([arms[LEFT]], "wxai") == 0


def test_an_arm_that_does_not_follow_ends_the_session_and_is_left_where_it_is(one: One, arms: dict[str, Arm]) -> None:
    robot = one()
    robot.connect()
    arms[LEFT].off = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ConnectionError, match="joint_1 is"):
        robot.send_action(action_of(np.array(STAGED[:-1])))
    many = len(arms[LEFT].been)
    robot.disconnect()
    assert len(arms[LEFT].been) == many
    assert arms[LEFT].closed
    assert not robot.is_connected


def test_two_arms_move_together_and_never_touch_each_other(
    two: ProvenBiWidowXAIFollower, arms: dict[str, Arm], clock: Clock
) -> None:
    """Both lean over to the other's side."""
    two.connect()
    left, right = np.array(STAGED), np.array(STAGED)
    for _ in range(60):
        left[0] -= 0.025
        right[0] += 0.025
        wanted = {f"left_{key}": value for key, value in zip(KEYS, left.tolist(), strict=True)}
        wanted |= {f"right_{key}": value for key, value in zip(KEYS, right.tolist(), strict=True)}
        assert list(two.send_action(wanted)) == list(wanted)
        clock.sleep(PERIOD)
    assert not two.service.checker.state_is_free(np.concatenate([left[:-1], right[:-1]]))
    two.disconnect()
    both = [arms[LEFT], arms[RIGHT]]
    assert len(both[0].been) == len(both[1].been)
    assert touching(both, "wxai_dual") == 0
    assert all(arm.closed for arm in both)


def test_an_arm_needs_an_address_unless_it_is_simulated(one: One) -> None:
    with pytest.raises(InvalidRequest, match="ip_address"):
        one(ip_address=None)
    with pytest.raises(InvalidRequest, match="none for simulated arms"):
        one(simulated=True)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"allow": ["finger_left"]}, "allow"),
        ({"staged_positions": [0.0]}, "staged_positions"),
        ({"model": "panda"}, "model"),
        ({"loop_rate": 5}, "goal_time"),
    ],
)
def test_options_that_cannot_be_are_refused(one: One, options: dict[str, Any], match: str) -> None:
    with pytest.raises(InvalidRequest, match=match):
        one(**options)


def test_what_is_not_connected_cannot_be_used(one: One) -> None:
    robot = one()
    for use in (robot.get_observation, robot.disconnect, robot.reset, lambda: robot.send_action({})):
        with pytest.raises(DeviceNotConnectedError):
            use()
    robot.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()
