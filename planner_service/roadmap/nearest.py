"""The places where a configuration may join a roadmap: its milestones, and points along edges known to be free.

Places on the trunk are found by its trees, unless few of its edges are free; later additions are searched one by one.
The nearest places come first, whatever the earlier queries.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.native.loading import load_core
from planner_service.roadmap.graph import EdgePoints, Graph, motion

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["Place", "compiled_places", "nearest_places"]

LOOKED_UP = (24, 128, 1024)
"""Nearest places of the trunk to look up first, and then if these are too few: many may lie on the same edge."""

MAX_FREE_SHARE = 0.25
"""Share of free edges in the trunk up to which searching them one by one is faster than the tree of all edges."""

JUST_WITHIN = 1.0 - 1e-9
"""Share of the distance to the farthest found within which all are: beyond, rounding tells which of equal ones are."""


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
    places = compiled_places(graph, milestones, edges)
    if places is None:
        yield from _reference(graph, milestones, edges, q)
        return
    core: Any = load_core()
    found: _core.NearestPlaces = core.NearestPlaces(places, q.tolist())
    while (place := found.next()) is not None:
        yield Place._make(place)


def compiled_places(graph: Graph, milestones: BoolArray, edges: BoolArray) -> _core.Places | None:
    """The places that may be used, for ``_core.NearestPlaces``; None where it was not built."""
    core = load_core()
    if core is None:
        return None
    places: _core.Places = core.Places(graph.compiled, milestones, edges, _are_few(graph, edges))
    return places


def _reference(graph: Graph, milestones: BoolArray, edges: BoolArray, q: FloatArray) -> Iterator[Place]:
    """``nearest_places`` in Python, in rounds."""
    yielded: set[tuple[int, int]] = set()
    for count in LOOKED_UP:
        places, complete = _round(graph, milestones, edges, q, count)
        for place in places:
            if place[1:3] not in yielded:
                yielded.add(place[1:3])
                yield place
        if complete:
            return


def _round(
    graph: Graph, milestones: BoolArray, edges: BoolArray, q: FloatArray, count: int
) -> tuple[Iterable[Place], bool]:
    """The places found among the ``count`` nearest of the trunk, in their order, and whether there are no others."""
    (ours, to_ours), (theirs, to_theirs) = _milestones(graph, q, count), _on_edges(graph, edges, q, count)
    ours, theirs = ours[milestones[ours]], theirs.take(edges[theirs.edge])
    points = np.concatenate([graph.milestones[ours], theirs.q])
    far = motion(points, q, graph.reach)
    edge = np.concatenate([np.full(len(ours), -1), theirs.edge])
    milestone = np.concatenate([ours, np.full(len(theirs.edge), -1)])
    order = np.lexsort((milestone, edge, far))
    order = order[far[order] < min(to_ours, to_theirs)]
    _, first = np.unique(np.where(edge < 0, -1 - milestone, edge)[order], return_index=True)
    order = order[np.sort(first)]
    columns = (array[order].tolist() for array in (far, edge, milestone))
    rows = zip(*columns, map(tuple, points[order].tolist()), strict=True)
    return map(Place._make, rows), min(to_ours, to_theirs) == np.inf


def _milestones(graph: Graph, q: FloatArray, count: int) -> tuple[IntArray, float]:
    """The nearest milestones, unordered, and a distance from q within which there are no others."""
    grown = len(graph.trunk.milestones)
    added = np.arange(grown, len(graph.milestones))
    if grown <= count:
        return np.arange(len(graph.milestones)), np.inf
    far, rows = graph.trunk.milestone_tree.query(q * graph.reach, k=count, p=1)
    return np.concatenate([rows.astype(np.int64), added]), float(np.max(far)) * JUST_WITHIN


def _on_edges(graph: Graph, edges: BoolArray, q: FloatArray, count: int) -> tuple[EdgePoints, float]:
    """The nearest points on edges, unordered, and a distance from q within which there are no others."""
    added, trunk, near, beyond = graph.added_points, graph.trunk, _few_free(graph, edges), np.inf
    if near is None:
        near = trunk.edge_points
        if len(near.edge) > count:
            far, rows = trunk.edge_point_tree.query(q * graph.reach, k=count, p=1)
            near, beyond = near.take(np.sort(rows)), float(np.max(far)) * JUST_WITHIN
    return EdgePoints(np.concatenate([near.q, added.q]), np.concatenate([near.edge, added.edge])), beyond


def _few_free(graph: Graph, edges: BoolArray) -> EdgePoints | None:
    """The points on the free edges of the trunk if these are few."""
    trunk = graph.trunk
    if not _are_few(graph, edges):
        return None
    return EdgePoints.along(trunk, np.flatnonzero(edges[: len(trunk.edges)]), trunk.spacing)


def _are_few(graph: Graph, edges: BoolArray) -> bool:
    """Whether few edges of the trunk are free."""
    free = edges[: len(graph.trunk.edges)]
    return bool(np.count_nonzero(free) <= MAX_FREE_SHARE * len(free))
