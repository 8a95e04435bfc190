"""What an episode is about: a world drawn at random, and the motions that are to be shown in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner_service.datasets.random_draws import Draws
from planner_service.geometry.shapes import FloatArray, copied_in
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from planner_service.tasks.result import TaskResult

__all__ = ["Drawn", "EpisodeTask"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """The world of one episode.

    Attributes:
        scene: Of boxes, spheres, cylinders and capsules, nothing in contact, nothing attached.
        start: Where the robot starts, shape (n,).
        target: The obstacle that is handled.
        onto: The obstacle that it is brought to.
    """

    scene: Scene
    start: FloatArray
    target: str
    onto: str

    def __post_init__(self) -> None:
        copied_in(self, "start")


class EpisodeTask(Protocol):
    """A kind of episodes: a small frozen dataclass that others can import, as it is sent to the workers."""

    @property
    def name(self) -> str:
        """What the command line calls it."""

    @property
    def sentence(self) -> str:
        """What a policy is told to do."""

    @property
    def carrying(self) -> tuple[str, ...]:
        """The names of the motions on which the target moves with the tool."""

    def draw(self, robot: Robot, draws: Draws) -> Drawn:
        """A world in which nothing speaks against the task at the outset."""

    def solve(self, service: PlannerService, drawn: Drawn, request: PlanRequest) -> TaskResult:
        """The motions, or the failure that ended them; the request has start, seed and limits."""
