"""What an episode shows: a world drawn at random, and a task solved in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in
from planner_service.planning.request import PlanRequest
from planner_service.planning.task_result import TaskResult
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService

__all__ = ["EpisodeTask", "EpisodeWorld", "RandomDraws"]

STEP = 2.0**-53

EIGHTH_TURN = 0.198912367379658
"""tan(pi / 16), for rotations of up to 45 degrees."""


class RandomDraws:
    """The random numbers of an episode, from the data set's seed and the episode's index.

    The bits come from numpy's PCG64, whose stream is stable across releases; they are turned into numbers by plain
    arithmetic, which is the same on every processor.
    """

    def __init__(self, seed: int, index: int) -> None:
        self._bits = np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(index,)))

    def whole(self) -> int:
        """An integer in [0, 2^63)."""
        return int(self._bits.random_raw()) >> 1

    def between(self, low: float, high: float) -> float:
        """A number in [low, high)."""
        return low + (high - low) * ((int(self._bits.random_raw()) >> 11) * STEP)

    def happens(self, share: float) -> bool:
        """True with this probability."""
        return self.between(0.0, 1.0) < share

    def one_of(self, *values: float) -> float:
        """One of the values, all equally likely."""
        return values[int(self.between(0.0, len(values)))]

    def turned(self, x: float, y: float, z: float) -> Pose:
        """A pose rotated about the vertical by up to 45 degrees to either side, about uniformly.

        The quaternion is computed from t = tan(yaw / 4), which needs no sine; t is uniform, and yaw is to within 4 %.
        """
        t = self.between(-EIGHTH_TURN, EIGHTH_TURN)
        return Pose((x, y, z), ((1.0 - t * t) / (1.0 + t * t), 0.0, 0.0, 2.0 * t / (1.0 + t * t)))


@dataclass(frozen=True, eq=False)
class EpisodeWorld:
    """The world of one episode.

    Attributes:
        scene: Boxes, spheres, cylinders and capsules; nothing touches anything, nothing is attached.
        start: The robot's start, shape (n,).
        target: The obstacle to pick up.
        onto: The obstacle to place it on.
    """

    scene: Scene
    start: FloatArray
    target: str
    onto: str

    def __post_init__(self) -> None:
        copied_in(self, "start")


class EpisodeTask(Protocol):
    """A kind of episode: a small frozen dataclass in an importable module, as it is sent to the workers."""

    @property
    def name(self) -> str:
        """Its name on the command line."""

    @property
    def sentence(self) -> str:
        """The instruction for a policy."""

    @property
    def carrying(self) -> tuple[str, ...]:
        """The names of the motions during which the robot carries the target."""

    def draw(self, robot: Robot, draws: RandomDraws) -> EpisodeWorld:
        """A random world in which the task looks possible."""

    def solve(self, service: PlannerService, drawn: EpisodeWorld, request: PlanRequest) -> TaskResult:
        """The motions, or the failure that ended them; start, seed and limits come from the request."""
