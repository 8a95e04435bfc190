"""The places where a configuration may join a roadmap: its milestones, and points along edges known to be free.

Places on the trunk are found by its trees, unless few of its edges are free; later additions are searched one by one.
The nearest places come first, whatever the earlier queries.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.roadmap.graph import EdgePoints, Graph, motion

__all__ = ["Place", "nearest_places"]

LOOKED_UP = (24, 128, 1024)
"""Nearest places of the trunk to look up first, and then if these are too few: many may lie on the same edge."""

MAX_FREE_SHARE = 0.25
"""Share of free edges in the trunk up to which searching them one by one is faster than the tree of all edges."""


class Place(NamedTuple):
    """A configuration on a roadmap.

    Attributes:
        far: The most that any point of the robot moves on the way to it (m).
        edge: The edge on which it lies; -1 for a milestone.
        milestone: Its milestone; -1 for a point on an edge.
        q: The configuration.
    """

    far: float
    edge: int
    milestone: int
    q: tuple[float, ...]


def nearest_places(graph: Graph, milestones: BoolArray, edges: BoolArray, q: FloatArray) -> Iterator[Place]:
    """The places nearest to q (n,), about a thousand, nearest first and one for each edge.

    Args:
        milestones: Which milestones may be used, (N,).
        edges: Which edges may be used, (E,).
    """
    yielded: set[tuple[int, int]] = set()
    for count in LOOKED_UP:
        (ours, to_ours), (theirs, to_theirs) = _milestones(graph, q, count), _on_edges(graph, edges, q, count)
        ours, theirs = ours[milestones[ours]], theirs.take(edges[theirs.edge])
        points = np.concatenate([graph.milestones[ours], theirs.q])
        far = motion(points, q, graph.reach)
        edge = np.concatenate([np.full(len(ours), -1), theirs.edge])
        milestone = np.concatenate([ours, np.full(len(theirs.edge), -1)])
        order = np.lexsort((milestone, edge, far))
        order = order[far[order] <= min(to_ours, to_theirs)]
        _, first = np.unique(np.where(edge < 0, -1 - milestone, edge)[order], return_index=True)
        order = order[np.sort(first)]
        columns = (array[order].tolist() for array in (far, edge, milestone))
        for place in map(Place, *columns, map(tuple, points[order].tolist())):
            if place[1:3] not in yielded:
                yielded.add(place[1:3])
                yield place
        if min(to_ours, to_theirs) == np.inf:
            return


def _milestones(graph: Graph, q: FloatArray, count: int) -> tuple[IntArray, float]:
    """The nearest milestones, unordered, and a distance from q within which there are no others."""
    grown = len(graph.trunk.milestones)
    added = np.arange(grown, len(graph.milestones))
    if grown <= count:
        return np.arange(len(graph.milestones)), np.inf
    far, rows = graph.trunk.milestone_tree.query(q * graph.reach, k=count, p=1)
    return np.concatenate([np.atleast_1d(rows).astype(np.int64), added]), float(np.max(far))


def _on_edges(graph: Graph, edges: BoolArray, q: FloatArray, count: int) -> tuple[EdgePoints, float]:
    """The nearest points on edges, unordered, and a distance from q within which there are no others."""
    added, trunk = graph.added_points, graph.trunk
    free = np.flatnonzero(edges[: len(trunk.edges)])
    beyond = np.inf
    if len(free) <= MAX_FREE_SHARE * len(trunk.edges):
        near = EdgePoints.along(trunk, free, trunk.spacing)
    elif len(trunk.edge_points.edge) <= count:
        near = trunk.edge_points
    else:
        far, rows = trunk.edge_point_tree.query(q * graph.reach, k=count, p=1)
        near, beyond = trunk.edge_points.take(rows), float(np.max(far))
    return EdgePoints(np.concatenate([near.q, added.q]), np.concatenate([near.edge, added.edge])), beyond
