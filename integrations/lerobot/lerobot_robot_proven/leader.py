"""A leader without hardware, which swings about and now and then lunges at the table: to try a gate with."""

from __future__ import annotations

import math
from typing import Any

from lerobot.teleoperators.teleoperator import Teleoperator

from lerobot_robot_proven.config import STAGED, ScriptedLeaderConfig
from lerobot_robot_proven.joints import JOINTS, action_keys, prefixes_of

__all__ = ["ScriptedLeader"]

SWINGS = ((0.5, 0.23), (0.25, 0.31), (0.25, 0.27), (0.4, 0.37), (0.3, 0.29), (0.5, 0.41), (0.02, 0.2))
"""Of each joint, and of the finger: radians (or metres) to either side, and times a second."""

LUNGE, LASTS = 1.1, 1.0
"""Radians by which the shoulder goes forward at a lunge, and seconds that it takes."""


class ScriptedLeader(Teleoperator):  # type: ignore[misc]
    """Says the same at every run: it counts calls, and knows no clock."""

    config_class = ScriptedLeaderConfig
    name = "scripted_leader"

    def __init__(self, config: ScriptedLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self._calls: int | None = None

    @property
    def action_features(self) -> dict[str, type]:
        """As of the follower."""
        return dict.fromkeys(action_keys(prefixes_of(self.config.arms)), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether it was connected."""
        return self._calls is not None

    @property
    def is_calibrated(self) -> bool:
        """There is nothing to calibrate."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Begin."""
        self._calls = 0

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    def get_action(self) -> dict[str, float]:
        """The next pose."""
        seconds, self._calls = (self._calls or 0) / self.config.rate, (self._calls or 0) + 1
        since = seconds % self.config.lunge
        lunge = LUNGE * math.sin(math.pi * since / LASTS) if seconds >= self.config.lunge and since < LASTS else 0.0
        pose = [
            middle + far * math.sin(2.0 * math.pi * often * seconds + 1.0)
            for middle, (far, often) in zip(STAGED, SWINGS, strict=True)
        ]
        pose[1] += lunge
        pose[-1] += SWINGS[-1][0]  # the finger opens and closes
        arms = prefixes_of(self.config.arms)
        return {f"{prefix}{joint}.pos": value for prefix in arms for joint, value in zip(JOINTS, pose, strict=True)}

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """It feels nothing."""

    def disconnect(self) -> None:
        """End."""
        self._calls = None
