"""How near the pairs of a scene come along a path, between two bounds: bisection with a second checker's distances.

On a stretch no pair comes nearer than at its middle by more than its points move from there. Distances are the
auditor's, by Pinocchio and Coal.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from auditor.checker import IndependentChecker
from planner_service.path.joint_path import JointPath

__all__ = ["nearest"]


def nearest(second: IndependentChecker, path: JointPath, share: float = 0.4) -> tuple[float, float]:
    """A lower and an upper bound of the smallest distance of any judged pair along the path, (-inf, 0) if one touches.

    Args:
        share: The lower bound is at least this part of the upper one.
    """
    least, places = math.inf, [(-math.inf, 0.0, path.length)]
    while True:
        lower, start, end = heapq.heappop(places)
        if lower >= share * least:
            return min(lower, least), least
        middle = 0.5 * (start + end)
        gap = min(second.gaps(path([middle])[0]).values(), default=math.inf)
        if gap <= 0.0:
            return -math.inf, 0.0
        least = min(least, gap)
        for low, high in ((start, middle), (middle, end)):
            heapq.heappush(places, (gap - _moved(second, path, low, high), low, high))


def _moved(second: IndependentChecker, path: JointPath, start: float, end: float) -> float:
    """How far any point moves from one end to any place of a stretch, seen from any other piece of the robot."""
    travel = np.diff(path.travel(np.array([start, end])), axis=0)[0]
    return float((second.reach * travel).sum())
