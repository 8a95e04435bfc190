"""What an episode shows: a random world, and a task solved in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner_service.datasets.random_draws import RandomDraws
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import copied_in
from planner_service.planning.request import PlanRequest
from planner_service.planning.task_result import TaskResult
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService

__all__ = ["EpisodeTask", "EpisodeWorld"]


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
