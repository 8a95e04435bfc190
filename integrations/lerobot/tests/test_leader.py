"""A leader without hardware."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from lerobot_robot_proven import ScriptedLeader, ScriptedLeaderConfig
from lerobot_robot_proven.config import STAGED

from planner_service import PlannerService


def actions(folder: Path, count: int, arms: int = 1) -> list[dict[str, float]]:
    leader = ScriptedLeader(ScriptedLeaderConfig(calibration_dir=folder, arms=arms))
    assert not leader.is_connected
    leader.connect()
    assert leader.is_connected
    said = [leader.get_action() for _ in range(count)]
    assert list(said[0]) == list(leader.action_features)
    leader.disconnect()
    assert not leader.is_connected
    return said


def test_it_says_the_same_at_every_run_and_to_each_of_two_arms(tmp_path: Path) -> None:
    once = actions(tmp_path, 300)
    assert actions(tmp_path, 300) == once
    both = actions(tmp_path, 300, arms=2)
    for alone, each in zip(once, both, strict=True):
        for side in ("left_", "right_"):
            assert {key.removeprefix(side): value for key, value in each.items() if key.startswith(side)} == alone


def test_it_begins_elsewhere_than_the_arm_and_lunges_into_the_table(tmp_path: Path) -> None:
    q = np.array([list(action.values())[:-1] for action in actions(tmp_path, 300)])
    assert np.abs(q[0] - STAGED[:-1]).max() > 0.2
    assert q[120:].max(axis=0)[1] > q[:120].max(axis=0)[1] + 0.5
    checker = PlannerService("wxai", "table").checker
    free = [checker.state_is_free(np.clip(each, *checker.robot.bounds)) for each in q]
    assert all(free[:120])
    assert not all(free[120:])
