"""Robots, a leader and a processor step for LeRobot whose motions are proven collision-free before they are sent.

LeRobot imports this package by its name, which registers what ``--robot.type`` and ``--teleop.type`` then know.
"""

from lerobot_robot_proven.config import (
    ProvenBiWidowXAIFollowerConfig,
    ProvenWidowXAIFollowerConfig,
    ScriptedLeaderConfig,
)
from lerobot_robot_proven.follower import ProvenBiWidowXAIFollower, ProvenWidowXAIFollower
from lerobot_robot_proven.leader import ScriptedLeader
from lerobot_robot_proven.processor import ProvenActionStep

__all__ = [
    "ProvenActionStep",
    "ProvenBiWidowXAIFollower",
    "ProvenBiWidowXAIFollowerConfig",
    "ProvenWidowXAIFollower",
    "ProvenWidowXAIFollowerConfig",
    "ScriptedLeader",
    "ScriptedLeaderConfig",
]
