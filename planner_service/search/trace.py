"""How a search went, for a look at it: what it grew, and the paths on the way to the plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, frozen, read_only, set_fields
from planner_service.geometry.validation import MAX_ITEMS, copied_in, numbers

__all__ = ["SearchGraph", "Trace", "Tracer"]

Pairs = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class SearchGraph:
    """What a search grew: a tree, two trees that met, or a roadmap.

    Attributes:
        milestones: Shape (N, n).
        edges: Which milestones are joined, each edge once, shape (E, 2).
    """

    milestones: FloatArray
    edges: Pairs

    def __post_init__(self) -> None:
        expected = "rows of two milestones each, shape (E, 2)"
        given = numbers("edges", self.edges, expected)
        if given.size and (given.ndim != 2 or given.shape[1] != 2 or not (np.abs(given) < MAX_ITEMS).all()):
            raise InvalidRequest("edges", self.edges, expected)
        milestones = numbers("milestones", self.milestones, "rows of joint values")
        set_fields(self, milestones=milestones, edges=frozen(given.reshape(-1, 2).astype(np.intp)))


@dataclass(frozen=True, eq=False)
class Trace:
    """What ``PlannerService.plan(..., trace=True)`` keeps beside the plan; of a search begun anew, the last.

    Attributes:
        graph: What the search grew; None where nothing was searched, or a roadmap was (``PlanResult.roadmap``).
        searched: The path as it was found, shape (N, n); None without one.
        shortcut: The path once it was cut short, shape (N, n); the plan's is this one, polished.
    """

    graph: SearchGraph | None = None
    searched: FloatArray | None = None
    shortcut: FloatArray | None = None

    def __post_init__(self) -> None:
        copied_in(self, "searched", "shortcut")


class Tracer:
    """Takes a trace down while a plan is made."""

    def __init__(self) -> None:
        self._graph: SearchGraph | None = None
        self._searched: FloatArray | None = None
        self._shortcut: FloatArray | None = None

    def grown(self, milestones: FloatArray, edges: list[tuple[int, int]]) -> None:
        """A search ended; what it found, and what came of that, is still to come."""
        self._graph = SearchGraph(milestones, np.array(edges, dtype=np.intp))
        self._searched = self._shortcut = None

    def searched(self, points: FloatArray) -> None:
        """A search ended with a path (N, n)."""
        self._searched, self._shortcut = read_only(points), None

    def cut(self, points: FloatArray) -> None:
        """That path was cut short to (N, n)."""
        self._shortcut = read_only(points)

    @property
    def trace(self) -> Trace:
        """What was taken down so far."""
        return Trace(self._graph, self._searched, self._shortcut)
