"""The geometry of a roadmap: its milestones and the edges between them, whatever their verdicts.

A graph only grows: its milestones and edges keep their numbers. Those grown at once form its ``Trunk``, for which
lookup tables are built once; paths added later are looked through one by one. Graphs made from each other share their
trunk. A graph's answers depend on its milestones and edges and on how many belong to its trunk, not on earlier queries.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, frozen, joint_distance, read_only
from planner_service.geometry.validation import numbers
from planner_service.native.loading import load_core

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["Graph", "Neighbour", "Trunk", "checked_edges", "motion"]


Neighbour = tuple[int, float, int]
"""The milestone at the other end of an edge, the edge's length, and its number."""

SPACING = 0.1
"""Metres of motion between points on an edge. Half of it brings the nearest point no nearer, with six joints."""

MAX_EDGE_POINTS = 120_000
"""The most points on the edges of a trunk: from about ten thousand milestones on, these alone lie as close."""

MAX_POINTS_PER_EDGE = 1_000
"""The most points on one edge. A robot's edges are a few metres long; those in a file may have any length."""


class Trunk:
    """The milestones and edges that were grown at once, with lookup tables that are built when first needed."""

    def __init__(self, milestones: FloatArray, edges: IntArray, reach: FloatArray) -> None:
        self.milestones, self.edges, self.reach = milestones, edges, reach
        self._lists: dict[int, list[Neighbour]] = {}  # lists are faster than arrays

    @cached_property
    def _rows(self) -> tuple[list[int], IntArray, FloatArray, IntArray]:
        """The edges sorted by milestone: where its rows start; other end, length and number of each edge."""
        count = len(self.edges)
        one, two = self.edges[:, 0], self.edges[:, 1]
        at, other = np.concatenate([one, two]), np.concatenate([two, one])
        order = np.lexsort((other, at))
        starts = np.searchsorted(at[order], np.arange(len(self.milestones) + 1)).tolist()
        number = np.concatenate([np.arange(count), np.arange(count)])[order]
        return starts, other[order], lengths_of(self.milestones, self.edges)[number], number

    def around(self, milestone: int) -> list[Neighbour]:
        """The neighbours of a milestone; do not change the list."""
        neighbours = self._lists.get(milestone)
        if neighbours is None:
            starts, other, lengths, number = self._rows
            rows = slice(starts[milestone], starts[milestone + 1])
            neighbours = list(zip(other[rows].tolist(), lengths[rows].tolist(), number[rows].tolist(), strict=True))
            self._lists[milestone] = neighbours
        return neighbours

    def __getstate__(self) -> dict[str, Any]:
        """Sent to another process without what is compiled, which is made anew there."""
        return {name: value for name, value in vars(self).items() if not name.startswith("compiled")}

    @cached_property
    def compiled(self) -> _core.RoadmapTrunk:
        """The same for the compiled query."""
        starts, *rows = self._rows
        components = np.array(self.components, dtype=np.int64)
        trunk: _core.RoadmapTrunk = load_core().RoadmapTrunk(
            *(self.milestones, self.edges, self.reach, self.spacing),
            *(np.array(starts), *map(np.ascontiguousarray, rows), components),
        )
        return trunk

    @cached_property
    def components(self) -> list[int]:
        """The connected component of each milestone, over edges of any verdict."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        count = len(self.milestones)
        ends = (self.edges[:, 0], self.edges[:, 1])
        graph = coo_array((np.ones(len(self.edges), dtype=np.int8), ends), shape=(count, count))
        labels: list[int] = connected_components(graph, directed=False)[1].tolist() if count else []
        return labels

    @cached_property
    def spacing(self) -> float:
        """Metres of motion between the points on an edge."""
        a, b = self.milestones[self.edges[:, 0]], self.milestones[self.edges[:, 1]]
        return max(SPACING, math.fsum(motion(a, b, self.reach).tolist()) / MAX_EDGE_POINTS)


class Graph:
    """A trunk and the paths added to it.

    Attributes:
        trunk: The first milestones and edges.
        milestones: Shape (N, n), read-only.
        edges: Shape (E, 2), read-only: the two milestones of each edge, the smaller index first, each edge once.
        reach: The most that any point of the robot moves per unit of each joint (m), shape (n,). The cost of checking
            an edge grows with the sum of ``reach * |dq|``.
    """

    def __init__(self, trunk: Trunk, milestones: FloatArray, edges: IntArray) -> None:
        self.trunk, self.milestones, self.edges, self.reach = trunk, milestones, edges, trunk.reach
        self._added: dict[int, tuple[Neighbour, ...]] = {}
        self._merged: dict[int, int] = {}  # components that added edges joined to others
        self._note(range(len(trunk.edges), len(edges)))

    @classmethod
    def of(
        cls, milestones: FloatArray, edges: IntArray, reach: FloatArray, grown: tuple[int, int] | None = None
    ) -> Graph:
        """The graph of some milestones and edges.

        Args:
            grown: How many of each belong to the trunk; all if not given.

        Raises:
            InvalidRequest: There are fewer, or an edge of the trunk leads out of it.
        """
        count, many = (len(milestones), len(edges)) if grown is None else grown
        if not (0 <= count <= len(milestones) and 0 <= many <= len(edges)) or (edges[:many] >= count).any():
            raise InvalidRequest("grown", [count, many], "how many milestones and edges were grown at once")
        return cls(Trunk(milestones[:count], edges[:many], reach), milestones, edges)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.milestones.shape[1])

    @property
    def grown(self) -> tuple[int, int]:
        """How many milestones and edges belong to the trunk."""
        return len(self.trunk.milestones), len(self.trunk.edges)

    @cached_property
    def span(self) -> tuple[FloatArray, FloatArray]:
        """The smallest and the largest value of each joint among the milestones, (n,) each."""
        rows = self.milestones if len(self.milestones) else np.zeros((1, self.n))
        return rows.min(axis=0), rows.max(axis=0)

    @cached_property
    def lengths(self) -> FloatArray:
        """L2 joint length of every edge, (E,): the bits of ``joint_distance``."""
        return lengths_of(self.milestones, self.edges)

    def around(self, milestone: int) -> list[Neighbour]:
        """The neighbours of a milestone; do not change the list."""
        grown = self.trunk.around(milestone) if milestone < len(self.trunk.milestones) else []
        return [*grown, *self._added[milestone]] if milestone in self._added else grown

    def __getstate__(self) -> dict[str, Any]:
        """Sent to another process without what is compiled, which is made anew there."""
        return {name: value for name, value in vars(self).items() if not name.startswith("compiled")}

    @cached_property
    def compiled(self) -> _core.RoadmapGraph:
        """The same for the compiled query."""
        graph: _core.RoadmapGraph = load_core().RoadmapGraph(
            self.trunk.compiled, self.milestones, self.edges, self.reach, SPACING, self._added, self._merged
        )
        return graph

    def component(self, milestone: int) -> int:
        """The number of a milestone's connected component, over edges of any verdict."""
        count = len(self.trunk.milestones)
        known = self.trunk.components[milestone] if milestone < count else milestone + count
        while known in self._merged:
            known = self._merged[known]
        return known

    def with_path(self, points: FloatArray) -> tuple[Graph, list[int], list[int]]:
        """Add the waypoints (k, n) of a path as milestones, unless they are already, and its pieces as edges.

        Returns:
            The new graph, the milestone of each waypoint, and the edge of each piece.
        """
        count, new = len(self.milestones), []
        path: list[int] = []
        for q in points.tolist():
            equal = np.flatnonzero((self.milestones == np.array(q)).all(axis=1))
            if len(equal) == 0 and q not in new:
                new.append(q)
            path.append(int(equal[0]) if len(equal) else count + new.index(q))
        steps = [(min(a, b), max(a, b)) for a, b in pairwise(path) if a != b]
        number: dict[tuple[int, int], int] = {}
        for a, b in steps:
            known = next((row[2] for row in self.around(a) if row[0] == b), None) if b < count else None
            if known is not None:
                number[a, b] = known
        joined = list(dict.fromkeys(step for step in steps if step not in number))
        number.update({step: len(self.edges) + k for k, step in enumerate(joined)})
        milestones = read_only(np.concatenate([self.milestones, np.array(new, dtype=np.float64).reshape(-1, self.n)]))
        edges = frozen(np.concatenate([self.edges, np.array(joined, dtype=np.int64).reshape(-1, 2)]))
        return self._longer(milestones, edges), path, [number[step] for step in steps]

    def _longer(self, milestones: FloatArray, edges: IntArray) -> Graph:
        """This graph with more milestones and edges."""
        graph = Graph(self.trunk, milestones, edges[: len(self.trunk.edges)])
        graph._added, graph._merged, graph.edges = dict(self._added), dict(self._merged), edges
        graph._note(range(len(self.edges), len(edges)))
        return graph

    def _note(self, numbers: range) -> None:
        """Enter added edges, given by their numbers."""
        for number in numbers:
            a, b = self.edges[number].tolist()
            length = joint_distance(self.milestones[a].tolist(), self.milestones[b].tolist())
            self._added[a] = (*self._added.get(a, ()), (b, length, number))
            self._added[b] = (*self._added.get(b, ()), (a, length, number))
            one, two = self.component(a), self.component(b)
            if one != two:
                self._merged[two] = one


def motion(a: FloatArray, b: FloatArray, reach: FloatArray) -> FloatArray:
    """The most that any point of a robot moves (m) from configurations a (m, n) to b, (m, n) or (n,); shape (m,)."""
    total = np.zeros(len(a))
    for joint, metres in enumerate(reach.tolist()):
        total = total + metres * np.abs(b[..., joint] - a[:, joint])
    return np.asarray(total)


def lengths_of(milestones: FloatArray, edges: IntArray) -> FloatArray:
    """L2 joint length of every edge, (E,), read-only."""
    total = np.zeros(len(edges))
    for column in milestones.T:
        difference = column[edges[:, 1]] - column[edges[:, 0]]
        total = total + difference * difference
    return read_only(np.sqrt(total))


def checked_edges(edges: ArrayLike, count: int) -> IntArray:
    """A user's edges among ``count`` milestones, sorted, the smaller index first and each edge once; read-only.

    Raises:
        InvalidRequest: A row is not two different milestones of these.
    """
    expected = "rows of two milestones each, shape (E, 2)"
    given = numbers("edges", edges, expected)
    if given.size and (given.ndim != 2 or given.shape[1] != 2 or not np.array_equal(given, np.floor(given))):
        raise InvalidRequest("edges", edges, expected)
    pairs = given.reshape(-1, 2)
    wrong = ~((pairs >= 0) & (pairs < count)).all(axis=1) | (pairs[:, 0] == pairs[:, 1])
    if wrong.any():
        row = pairs[int(np.flatnonzero(wrong)[0])].tolist()
        raise InvalidRequest("edges", row, f"two different milestones of {count}")
    ends = np.sort(pairs.astype(np.int64), axis=1)
    each = np.unique(ends[:, 0] * count + ends[:, 1])  # as rows, but sorted ten times as fast
    return frozen(np.stack(np.divmod(each, max(count, 1)), axis=1))
