"""How far a search came that found no path: where what it grew from both ends is nearest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.robot.model import Robot
from planner_service.search.trace import SearchGraph

__all__ = ["Reached", "how_far"]

AROUND = 100
"""Configurations on each side whose clearance is computed: those nearest to the other side."""


@dataclass(frozen=True, eq=False)
class Reached:
    """What a search reached from the start, and from the goals.

    Attributes:
        nearest: A configuration reached from the start and one reached from a goal, the nearest two, (2, n).
        gap: Their joint distance (L2), in radians (metres for joints that slide).
        tool_gap: How far the tool is from one to the other, in metres.
        clearance: Proven lower bound of the smallest gap, in metres, of the reached configurations that are nearest to
            the other side; infinite if there is nothing to hit.
        milestones: How many configurations were reached from the start, and from the goals.
    """

    nearest: FloatArray
    gap: float
    tool_gap: float
    clearance: float
    milestones: tuple[int, int]

    def __str__(self) -> str:
        counts = "{:,} and {:,}".format(*self.milestones)
        room = (
            "" if np.isinf(self.clearance) else f"; there at least {max(self.clearance, 0.0) * 1e3:.1f} mm were clear"
        )
        return (
            f"the search came from start to goal within {self.gap:.2f} rad, the tool within"
            f" {self.tool_gap * 1e3:.0f} mm ({counts} configurations reached){room}"
        )


def how_far(
    robot: Robot,
    graph: SearchGraph,
    start: FloatArray,
    goals: Sequence[FloatArray],
    clearances: Callable[[FloatArray], FloatArray],
) -> Reached | None:
    """How far a search came from the start; None if it grew nothing from there, or nothing else is known.

    Args:
        goals: Those that are configurations; they count as reached from the goals even if nothing grew there.
        clearances: Lower bounds of the smallest gap of configurations (m, n).
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    size = len(graph.milestones)
    if not size:
        return None
    a, b = graph.edges.T
    _, of = connected_components(csr_array((np.ones(len(a)), (a, b)), shape=(size, size)), directed=False)
    from_start = np.abs(graph.milestones - start).max(axis=1) == 0.0
    if not from_start.any():
        return None
    grown = of == of[from_start.argmax()]
    first, rest = graph.milestones[grown], graph.milestones[~grown]
    second = np.unique(np.concatenate([rest, np.reshape(list(goals), (-1, robot.n))]), axis=0)
    if not len(second):
        return None
    distances, mate = KDTree(second).query(first)
    back, _ = KDTree(first).query(second)
    k = int(distances.argmin())
    nearest = np.stack([first[k], second[mate[k]]])
    poses = [robot.tool_pose(q)[:3, 3] for q in nearest]
    beside = np.concatenate([first[np.argsort(distances)[:AROUND]], second[np.argsort(back)[:AROUND]]])
    return Reached(
        read_only(nearest),
        float(distances[k]),
        float(np.linalg.norm(poses[0] - poses[1])),
        float(clearances(beside).min()),
        (len(first), len(second)),
    )
