"""How a search went, to look at: what it grew, and the paths on the way to the plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, frozen, set_fields
from planner_service.geometry.validation import MAX_ITEMS, copied_in, numbers

__all__ = ["SearchGraph", "Trace", "Tracer"]


@dataclass(frozen=True, eq=False)
class SearchGraph:
    """What a search grew: a tree, two trees that met, or a roadmap.

    Attributes:
        milestones: Shape (N, n).
        edges: Which milestones are joined, each edge once, shape (E, 2).
    """

    milestones: FloatArray
    edges: IntArray

    def __post_init__(self) -> None:
        expected = "rows of two milestones each, shape (E, 2)"
        given = numbers("edges", self.edges, expected)
        if given.size and (given.ndim != 2 or given.shape[1] != 2 or not (np.abs(given) < MAX_ITEMS).all()):
            raise InvalidRequest("edges", self.edges, expected)
        milestones = numbers("milestones", self.milestones, "rows of joint values")
        set_fields(self, milestones=milestones, edges=frozen(given.reshape(-1, 2).astype(np.intp)))


@dataclass(frozen=True, eq=False)
class Trace:
    """What ``PlannerService.plan(..., trace=True)`` keeps beside the plan.

    Attributes:
        graph: What the last search grew, or without a path the one that grew most; None if nothing was searched, or a
            roadmap was (``PlanResult.roadmap``).
        searched: The path that was found, shape (N, n); None without one.
        shortcut: The same path after shortcutting, shape (N, n); the plan's path is this one, polished.
    """

    graph: SearchGraph | None = None
    searched: FloatArray | None = None
    shortcut: FloatArray | None = None

    def __post_init__(self) -> None:
        copied_in(self, "searched", "shortcut")


class Tracer:
    """Records how a search goes while a plan is made.

    Attributes:
        trace: What happened so far.
    """

    def __init__(self) -> None:
        self.trace = Trace()
        self._last: SearchGraph | None = None

    def grown(self, milestones: FloatArray, edges: list[tuple[int, int]]) -> None:
        """A search ended and has grown this; its path, if any, follows."""
        self._last = SearchGraph(milestones, np.array(edges, dtype=np.intp))
        most = self.trace.graph
        self.trace = Trace(most if most is not None and len(most.edges) > len(edges) else self._last)

    def searched(self, points: FloatArray) -> None:
        """The search found a path (N, n)."""
        self.trace = Trace(self._last, points)

    def cut(self, points: FloatArray) -> None:
        """The path was shortened to (N, n)."""
        self.trace = replace(self.trace, shortcut=points)
