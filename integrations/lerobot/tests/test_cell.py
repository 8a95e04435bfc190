"""The arms as the planner knows them."""

from __future__ import annotations

import numpy as np
import pytest
from lerobot_robot_proven.cell import roomy

from planner_service import load_robot
from planner_service.errors import InvalidRequest

ROUNDING = 1e-9
"""Metres."""


@pytest.mark.parametrize(("name", "prefixes"), [("wxai", ("",)), ("wxai_dual", ("left_", "right_"))])
def test_the_fingers_of_every_arm_have_room_for_any_width(name: str, prefixes: tuple[str, ...]) -> None:
    robot = load_robot(name)
    rooms = [item for item in roomy(robot, prefixes).shapes if "finger" in item.link]
    one = load_robot("wxai").gripper
    assert one is not None
    assert len(rooms) == len(prefixes) * len(one.closed)
    directions = np.random.default_rng(0).normal(size=(200, 3))
    for width in np.linspace(0.0, 0.08, 9).tolist():
        for k, room in enumerate(rooms):
            finger = one.shapes(width)[k % len(one.closed)]
            assert room.link.endswith(finger.link)
            at = finger.shape.support(directions @ finger.pose.rotation) @ finger.pose.rotation.T + finger.pose.position
            assert float(room.shape.distance((at - room.pose.position) @ room.pose.rotation).max()) <= ROUNDING


def test_another_robot_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="model"):
        roomy(load_robot("panda"), ("",))
    with pytest.raises(InvalidRequest, match="model"):
        roomy(load_robot("wxai"), ("left_", "right_"))
