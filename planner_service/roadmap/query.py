"""One query of a roadmap: a short path over edges not known to be blocked, checked only when a path uses them.

Lazy collision checking (Bohlin & Kavraki, ICRA 2000; Dellin & Srinivasa, ICAPS 2016): search, check the path, leave
out what is blocked, search again. Most edges of a roadmap are never on such a path. In a roadmap that is already
checked, the cost of a query is joining the start and the goals to it. So they may join anywhere along an edge known to
be free, and the places to which the robot moves least come first, whatever the earlier queries. Places on the trunk are
found by its trees, unless few of its edges are free; later additions are searched one by one. All of this is compiled:
native/roadmap/query.cpp and places.cpp.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.native.loading import load_core
from planner_service.roadmap.graph import Graph
from planner_service.roadmap.verdicts import Knowledge, Lesson, Verdict
from planner_service.search.problem import SearchProblem, compiled

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["Carried", "Query", "places_of"]


MAX_FREE_SHARE = 0.25
"""Share of free edges in the trunk up to which searching them one by one is faster than the tree of all edges."""


def places_of(graph: Graph, milestones: BoolArray, edges: BoolArray) -> _core.Places:
    """The places that may be used.

    Args:
        milestones: Which milestones may be used, (N,).
        edges: Which edges may be used, (E,).
    """
    places: _core.Places = load_core().Places(graph.compiled, milestones, edges, _are_few(graph, edges))
    return places


def _are_few(graph: Graph, edges: BoolArray) -> bool:
    """Whether few edges of the trunk are free."""
    free = edges[: len(graph.trunk.edges)]
    return bool(np.count_nonzero(free) <= MAX_FREE_SHARE * len(free))


BLOCKED = int(Verdict.BLOCKED)

Lessons = tuple[dict[int, Lesson], dict[int, Lesson]]


class Carried(Protocol):
    """Knows which edges a change of the scene left free."""

    def still_free(self, A: FloatArray, B: FloatArray) -> BoolArray:
        """Which edges from A (m, n) to B (m, n), free before, are proven to be free still, (m,)."""


class Query:
    """A query of a graph with what is known of its milestones and edges."""

    def __init__(self, graph: Graph, milestones: Knowledge, edges: Knowledge, problem: SearchProblem) -> None:
        self._graph, self._oracle = graph, compiled(problem.oracle, problem.poll)
        places = places_of(graph, milestones.possible, edges.free)
        verdicts, ends = (milestones.verdicts, edges.verdicts), (problem.start.tolist(), problem.goals.tolist())
        self._query = load_core().RoadmapQuery(graph.compiled, places, *verdicts, *ends, self._oracle.core)

    @property
    def learned(self) -> Lessons:
        """The new verdicts on milestones and on edges, by their numbers."""
        milestones, edges = map(self._lessons, self._query.learned)
        return milestones, edges

    def _lessons(self, found: Iterable[tuple[int, int, int]]) -> dict[int, Lesson]:
        return {
            number: (Verdict(verdict), self._oracle.blocker_of(pair) if verdict == BLOCKED else None)
            for number, verdict, pair in found
        }

    def route(self, carried: Carried | None = None) -> tuple[Sequence[Sequence[float]], int] | None:
        """The path and the goal it reaches; None if the roadmap has none."""
        still_free = None if carried is None else partial(_still_free, self._graph, carried)
        found: tuple[Sequence[Sequence[float]], int] | None = self._oracle.counted(
            lambda: self._query.route(still_free)
        )
        return found


def _still_free(graph: Graph, carried: Carried, milestones: list[int], edges: list[int]) -> list[bool]:
    """Which of some milestones, and then of some edges, all free before, are proven to be free still."""
    rows = [(milestone, milestone) for milestone in milestones] + graph.edges[edges].tolist()
    points = graph.milestones[np.array(rows)]
    still: list[bool] = carried.still_free(points[:, 0], points[:, 1]).tolist()
    return still
