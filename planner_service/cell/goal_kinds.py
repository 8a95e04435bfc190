"""Goals that depend on other arms: a tool at a pose in another tool's frame, and arms that only get out of the way.

::

    leads, follows = PlanRequest(start, goal), PlanRequest(stands, stands)
    across = AtTool("left", Pose((0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    cell.plan({"left": leads, "right": follows}, goals={"right": across})
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import checked_name, instance
from planner_service.planning.request import PlanRequest

__all__ = ["Anywhere", "AtTool", "checked_goals", "off"]


@dataclass(frozen=True)
class AtTool:
    """The tool of an arm at a pose in the tool frame of another arm, when both are through.

    Attributes:
        arm: The other arm.
        pose: The pose there.

    Raises:
        InvalidRequest: They are no name and no Pose.
    """

    arm: str
    pose: Pose

    def __post_init__(self) -> None:
        checked_name("arm", self.arm, "the name of another arm, ")
        instance("pose", self.pose, Pose, "a Pose of the tool in the other arm's tool frame")


@dataclass(frozen=True)
class Anywhere:
    """An arm that may end anywhere: it stays where its request starts, unless others need that place."""


def checked_goals(
    goals: object, requests: Mapping[str, PlanRequest], arms: Sequence[str]
) -> dict[str, AtTool | Anywhere]:
    """Goals by the names of arms, those that lead before those that follow.

    Raises:
        UnknownName: No such arm.
        InvalidRequest: No goals, of an arm without a request, or arms that wait for each other's.
    """
    given = instance("goals", goals, Mapping, "a AtTool or Anywhere by the names of arms")
    for name, goal in given.items():
        field = f"goals[{name!r}]"
        if name not in arms:
            raise UnknownName("arm", name, arms)
        if name not in requests:
            raise InvalidRequest(field, goal, "a goal of an arm that has a request")
        instance(field, goal, (AtTool, Anywhere), "a AtTool or Anywhere")
        if isinstance(goal, AtTool):
            if goal.arm not in arms:
                raise UnknownName("arm", goal.arm, arms)
            if goal.arm == name or isinstance(given.get(goal.arm), Anywhere):
                raise InvalidRequest(field, goal.arm, "another arm, whose goal is not anywhere")
    ordered: dict[str, AtTool | Anywhere] = {}
    while len(ordered) < len(given):
        ready = [
            name
            for name, goal in given.items()
            if name not in ordered and (isinstance(goal, Anywhere) or goal.arm not in given or goal.arm in ordered)
        ]
        if not ready:
            raise InvalidRequest("goals", sorted(given.keys() - ordered.keys()), "arms that do not follow each other")
        ordered |= {name: given[name] for name in ready}
    if requests and all(isinstance(ordered.get(name), Anywhere) for name in requests):
        raise InvalidRequest("goals", sorted(ordered), "one arm at least that is to go somewhere")
    return ordered


def off(goal: AtTool, own: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Metres and radians by which a tool (4, 4) is not where it is to be from another one's (4, 4)."""
    wanted = other @ goal.pose.matrix
    turn = wanted[:3, :3].T @ own[:3, :3]
    sine = 0.5 * np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.linalg.norm(own[:3, 3] - wanted[:3, 3])), math.atan2(float(sine), 0.5 * (np.trace(turn) - 1.0))
