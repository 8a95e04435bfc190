"""Tool poses of the WidowX AI of which every configuration collides with a block: its closed form gives all of them.

``python -m benchmarks.worlds.blocked_poses`` draws and stores them.
"""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from planner_service import Box, CollisionChecker, Obstacle, Pose, Scene
from planner_service.kinematics.inverse import inverse_is_complete, inverse_kinematics
from planner_service.robot_setup.loading import load_robot

__all__ = ["COUNT", "FILE", "ROBOT", "BlockedPose", "draw", "load", "text_of"]

FILE = Path(__file__).parents[1] / "queries" / "blocked_poses.json"

ROBOT, COUNT, SEED, DECIMALS = "wxai", 100, 2026, 6
EDGE = (0.1, 0.3)
"""Metres, of the block around the tool."""


@dataclass(frozen=True)
class BlockedPose:
    """No configuration of ``pose`` is free: a cube of so many metres is there; ``solutions`` of them are in limits."""

    pose: Pose
    edge: float
    solutions: int

    @property
    def scene(self) -> Scene:
        return Scene((Obstacle("block", Box((self.edge, self.edge, self.edge)), self.pose),))


def draw() -> Iterator[BlockedPose]:
    """Such poses, without end."""
    robot, chance = load_robot(ROBOT), random.Random(f"{SEED} blocked poses")
    limits = list(zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True))
    while True:
        exact = Pose.from_matrix(robot.tool_pose([chance.uniform(*limit) for limit in limits]))
        x, y, z = (round(value, DECIMALS) for value in exact.position)
        pose = Pose((x, y, z), exact.quaternion)
        solutions = inverse_kinematics(robot, pose)
        found = BlockedPose(pose, round(chance.uniform(*EDGE), DECIMALS), len(solutions))
        checker = CollisionChecker(robot, found.scene)
        free = any(checker.state_is_free(q) for q in solutions)
        if len(solutions) and not free and checker.state_is_free(robot.home) and inverse_is_complete(robot, pose):
            yield found


def text_of(poses: Sequence[BlockedPose]) -> str:
    """The content of the stored file: one pose a line."""
    rows = [[*one.pose.position, *one.pose.quaternion, one.edge, one.solutions] for one in poses]
    body = ",\n    ".join(map(json.dumps, rows))
    return f'{{\n  "seed": {SEED},\n  "poses": [\n    {body}\n  ]\n}}\n'


def load() -> tuple[BlockedPose, ...]:
    """The stored poses."""
    rows = json.loads(FILE.read_text("utf-8"))["poses"]
    return tuple(BlockedPose(Pose(row[:3], row[3:7]), row[7], row[8]) for row in rows)


if __name__ == "__main__":
    FILE.write_text(text_of(list(itertools.islice(draw(), COUNT))), "utf-8")
