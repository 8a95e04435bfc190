"""A PRM roadmap as a value: milestones, the edges found free between them, and how to ask it for a path."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.collision.edges import Known
from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray, numbers, read_only
from planner_service.search import Oracle, SearchProblem, SearchResult, distances, joint_distance

__all__ = ["Roadmap"]


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Milestones and edges that were free where it was grown; a planner for many queries there.

    Attributes:
        milestones: Shape (N, n).
        edges: Shape (E, 2): indices of the milestones each edge joins, sorted, each edge once with
            the smaller index first.
        neighbours: Nearest milestones tried at each end of a query.
        lengths: L2 joint length of every edge, shape (E,).

    Raises:
        InvalidRequest: a milestone is not finite, or an edge joins what is not there.
    """

    milestones: FloatArray
    edges: NDArray[np.intp]
    neighbours: int = 10
    lengths: FloatArray = field(init=False)
    name: ClassVar[str] = "roadmap"
    patience: ClassVar[int | None] = None

    def __init__(self, milestones: ArrayLike, edges: ArrayLike, *, neighbours: int = 10) -> None:
        points = numbers("milestones", milestones, "finite joint values, one row per milestone")
        if points.ndim != 2 or not np.isfinite(points).all():
            raise InvalidRequest("milestones", points.shape, "finite joint values, one row per milestone")
        if isinstance(neighbours, bool) or not isinstance(neighbours, int) or neighbours < 1:
            raise InvalidRequest("neighbours", neighbours, "a whole number of at least 1")
        pairs = _pairs(edges, len(points))
        lengths = [joint_distance(points[a].tolist(), points[b].tolist()) for a, b in pairs.tolist()]
        object.__setattr__(self, "milestones", points)
        object.__setattr__(self, "edges", pairs)
        object.__setattr__(self, "neighbours", neighbours)
        object.__setattr__(self, "lengths", read_only(lengths))

    def query(self, start: ArrayLike, goals: ArrayLike, oracle: Oracle, *, trusted: bool = False) -> FloatArray | None:
        """The shortest path in the roadmap from start (n,) to any of goals (k, n), shape (N, n); None if there is none.

        Edges are judged only once a shortest path needs them: those that join the ends to the
        roadmap always, the roadmap's own unless ``trusted``. An edge found blocked is left out,
        and the search repeated. The edge from the start straight to a goal is not tried.

        Args:
            trusted: The roadmap's edges were judged by this very oracle.

        Raises:
            InvalidRequest: an end is not n finite numbers.
        """
        n = self.milestones.shape[1]
        first = numbers("start", start, f"{n} finite numbers")
        last = np.atleast_2d(numbers("goals", goals, f"rows of {n} finite numbers"))
        for what, rows in (("start", first[None]), ("goals", last)):
            if rows.ndim != 2 or rows.shape[1] != n or not len(rows) or not np.isfinite(rows).all():
                raise InvalidRequest(what, rows, f"{n} finite numbers per configuration")
        route = _Query(self, first, last, oracle, trusted).route()
        return None if route is None else route[0]

    def search(self, problem: SearchProblem, *, trusted: bool = False) -> SearchResult:
        """``query`` as a planner; the seed plays no part."""
        if problem.lower.size != self.milestones.shape[1]:
            raise InvalidRequest(
                "planner",
                f"a roadmap of {self.milestones.shape[1]} joints",
                f"a roadmap of {problem.lower.size} joints",
            )
        query = _Query(self, problem.start, problem.goals, problem.oracle, trusted)
        route = query.route(problem)
        waypoints, goal = (None, None) if route is None else route
        count = len(self.milestones)
        return SearchResult(
            waypoints,
            goal,
            note=f"{count} milestones, {len(self.edges)} edges",
        )

    @cached_property
    def adjacency(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """For every milestone its neighbours by edges with the edges' lengths, in ascending order."""
        near: list[list[tuple[int, float]]] = [[] for _ in self.milestones]
        for (a, b), length in zip(self.edges.tolist(), self.lengths.tolist(), strict=True):
            near[a].append((b, length))
            near[b].append((a, length))
        return tuple(tuple(sorted(row)) for row in near)


class _Query:
    """One search of a roadmap: nodes are its milestones, then the start, then the goals."""

    def __init__(self, roadmap: Roadmap, start: FloatArray, goals: FloatArray, oracle: Oracle, trusted: bool) -> None:
        self._roadmap, self._oracle = roadmap, oracle
        self._count = len(roadmap.milestones)
        self._start = self._count
        self._points = np.concatenate([roadmap.milestones.reshape(self._count, start.size), start[None], goals])
        ends = range(self._start, len(self._points))
        self._bound = np.array([distances(self._points, goal) for goal in goals]).min(axis=0).tolist()
        self._links: dict[int, list[tuple[int, float]]] = {}
        for end in ends:
            away = distances(roadmap.milestones.reshape(self._count, start.size), self._points[end])
            for milestone in np.argsort(away, kind="stable")[: roadmap.neighbours].tolist():
                self._links.setdefault(end, []).append((milestone, float(away[milestone])))
                self._links.setdefault(milestone, []).append((end, float(away[milestone])))
        self._free = set(ends)
        self._verdicts: dict[tuple[int, int], bool] = {}
        self._trusted = trusted
        if trusted:
            self._free.update(range(self._count))

    def route(self, problem: SearchProblem | None = None) -> tuple[FloatArray, int] | None:
        """The shortest path whose edges are all free, and which goal it reaches."""
        while (path := self._shortest()) is not None:
            if problem is not None:
                problem.poll()
            if all(self._is_free(a, b) for a, b in pairwise(path)):
                points = self._points[path]
                # An end may coincide with a milestone.
                fresh = [True, *(points[1:] != points[:-1]).any(axis=1).tolist()]
                return read_only(points[fresh]), path[-1] - self._start - 1
        return None

    def _around(self, node: int) -> Iterator[tuple[int, float]]:
        if node < self._count:
            yield from self._roadmap.adjacency[node]
        yield from self._links.get(node, ())

    def _shortest(self) -> list[int] | None:
        """A* over edges not found blocked; of equally good nodes the one with the smaller index goes first."""
        cost, parent = {self._start: 0.0}, {self._start: self._start}
        front = [(self._bound[self._start], self._start, 0.0)]
        while front:
            _, node, spent = heapq.heappop(front)
            if spent > cost[node]:
                continue  # a shorter way here was found since
            if node > self._start:
                return _traced(parent, node)
            for other, length in self._around(node):
                total = spent + length
                if self._verdicts.get(_key(node, other), True) and (other not in cost or total < cost[other]):
                    cost[other], parent[other] = total, node
                    heapq.heappush(front, (total + self._bound[other], other, total))
        return None

    def _is_free(self, a: int, b: int) -> bool:
        key = _key(a, b)
        if self._trusted and key[1] < self._count:
            return True
        if key not in self._verdicts:
            known = (Known.START if a in self._free else Known.NEITHER) | (
                Known.END if b in self._free else Known.NEITHER
            )
            self._verdicts[key] = bool(self._oracle.edge_is_free(self._points[a], self._points[b], known=known))
            if self._verdicts[key]:
                self._free.update(key)
        return self._verdicts[key]


def _key(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)


def _traced(parent: dict[int, int], node: int) -> list[int]:
    path = [node]
    while parent[path[-1]] != path[-1]:
        path.append(parent[path[-1]])
    return path[::-1]


def _pairs(edges: ArrayLike, count: int) -> NDArray[np.intp]:
    """``edges`` sorted, each once with its smaller index first, shape (E, 2), read-only."""
    expected = "rows of two milestones each, shape (E, 2)"
    given = numbers("edges", edges, expected)
    if given.size and (given.ndim != 2 or given.shape[1] != 2 or not np.array_equal(given, np.floor(given))):
        raise InvalidRequest("edges", edges, expected)
    with np.errstate(invalid="ignore"):  # an infinity becomes an index that is out of range
        rows = given.astype(np.intp).reshape(-1, 2)
    for a, b in rows.tolist():
        if not (0 <= a < count and 0 <= b < count and a != b):
            raise InvalidRequest("edges", (a, b), f"two different milestones of {count}")
    unique = sorted({_key(a, b) for a, b in rows.tolist()})
    pairs = np.array(unique, dtype=np.intp).reshape(-1, 2)
    pairs.flags.writeable = False
    return pairs
