"""Joins the best parts of several paths between the same ends into a shorter one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from planner_service.collision import Known
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import polyline_length
from planner_service.search.problem import Oracle

__all__ = ["JoinedPaths"]

Edge = tuple[bytes, bytes]


class JoinedPaths:
    """Free polylines from one start, and what is known of the straight edges between their waypoints.

    Paths are joined as by Raveh, Enosh and Halperin (IEEE T-RO 27(2), 2011), the edges judged lazily as by Bohlin and
    Kavraki (ICRA 2000).

    Args:
        kept: The shortest so many are joined.
    """

    def __init__(self, oracle: Oracle, kept: int) -> None:
        self._oracle, self._kept = oracle, kept
        self._paths: list[FloatArray] = []
        self._free: dict[Edge, bool] = {}

    @property
    def shortest(self) -> FloatArray:
        """The shortest of the paths, (N, n)."""
        return self._paths[0]

    def add(self, points: FloatArray) -> None:
        """Take in a path (N, n) whose pieces the caller knows to be free."""
        self._free.update(dict.fromkeys((_edge(a, b) for a, b in pairwise(points)), True))
        self._paths = sorted([*self._paths, points], key=polyline_length)[: self._kept]

    def joined(self, most: int) -> FloatArray:
        """The shortest way over waypoints of the paths, from the start to where any of them ends; (N, n).

        Edges between any two waypoints are part of it, and are judged where the shortest way needs them.

        Args:
            most: Edges to judge; if the way needs more, the answer is ``shortest``.
        """
        rows = {q.tobytes(): q for path in self._paths for q in path}
        nodes, numbers = np.array(list(rows.values())), {key: k for k, key in enumerate(rows)}
        start = numbers[self.shortest[0].tobytes()]
        goals = {numbers[path[-1].tobytes()] for path in self._paths}
        lengths: list[list[float]] = np.sqrt(((nodes[:, None] - nodes[None]) ** 2).sum(axis=2)).tolist()
        for (a, b), free in self._free.items():
            if not free and a in numbers and b in numbers:
                lengths[numbers[a]][numbers[b]] = lengths[numbers[b]][numbers[a]] = math.inf
        while True:
            way = _shortest_way(lengths, start, goals)
            unknown = [(i, j) for i, j in pairwise(way) if _edge(nodes[i], nodes[j]) not in self._free]
            if not unknown:
                return np.array(nodes[way])
            if most == 0:
                return self.shortest
            i, j = max(unknown, key=lambda edge: lengths[edge[0]][edge[1]])  # the longest is the likeliest to collide
            free = self._oracle.edge_is_free(nodes[i], nodes[j], known=Known.BOTH)
            self._free[_edge(nodes[i], nodes[j])] = free
            most -= 1
            if not free:
                lengths[i][j] = lengths[j][i] = math.inf


def _edge(a: FloatArray, b: FloatArray) -> Edge:
    """What two configurations are found by, in either order."""
    first, second = sorted((a.tobytes(), b.tobytes()))
    return first, second


def _shortest_way(lengths: Sequence[Sequence[float]], start: int, goals: set[int]) -> list[int]:
    """From the start to the nearest goal over edges of these lengths, by Dijkstra's algorithm; there is a way."""
    cost, before, left = [math.inf] * len(lengths), [start] * len(lengths), set(range(len(lengths)))
    cost[start], k = 0.0, start
    while k not in goals or cost[k] == math.inf:
        left.discard(k)
        for j in left:
            if cost[k] + lengths[k][j] < cost[j]:
                cost[j], before[j] = cost[k] + lengths[k][j], k
        k = min(left, key=lambda j: (cost[j], j))
    way = [k]
    while way[-1] != start:
        way.append(before[way[-1]])
    return way[::-1]
