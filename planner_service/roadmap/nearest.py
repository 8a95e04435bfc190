"""Where a configuration may be joined to a roadmap: at its milestones, and along edges known to be free.

What came after the trunk is looked through place by place; what there is of the trunk is looked up in its trees, unless
few of its edges are free. The nearest places come first, whatever was asked before.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry.shapes import FloatArray
from planner_service.roadmap.graph import Net, Spots, motion

__all__ = ["Place", "nearest_places"]

IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]

LOOKED_UP = (24, 128, 1024)
"""Nearest places of the trunk looked up at first, and then if these are too few: many may lie on the same edge."""

FEW = 0.25
"""Share of the trunk's edges up to which looking through the free ones alone is better than looking up among all."""


class Place(NamedTuple):
    """A configuration of a roadmap.

    Attributes:
        far: Metres that some point of the robot moves on the way there at most.
        edge: Which edge it lies on; -1 if it is a milestone.
        milestone: Which milestone it is; -1 if it is none.
        q: The configuration.
    """

    far: float
    edge: int
    milestone: int
    q: tuple[float, ...]


def nearest_places(net: Net, milestones: Flags, edges: Flags, q: FloatArray) -> Iterator[Place]:
    """Places from near to far from q (n,), on each edge the nearest alone; not all of them, but the nearest thousand.

    Args:
        milestones: Which may be offered, (N,).
        edges: Which may, (E,).
    """
    told: set[tuple[int, int]] = set()
    for count in LOOKED_UP:
        (ours, to_ours), (theirs, to_theirs) = _milestones(net, q, count), _on_edges(net, edges, q, count)
        ours, theirs = ours[milestones[ours]], _allowed(theirs, edges)
        points = np.concatenate([net.milestones[ours], theirs.q])
        far = motion(points, q, net.reach)
        edge = np.concatenate([np.full(len(ours), -1), theirs.edge])
        milestone = np.concatenate([ours, np.full(len(theirs.edge), -1)])
        order = np.lexsort((milestone, edge, far))
        order = order[far[order] <= min(to_ours, to_theirs)]
        _, first = np.unique(np.where(edge < 0, -1 - milestone, edge)[order], return_index=True)
        order = order[np.sort(first)]
        columns = (array[order].tolist() for array in (far, edge, milestone))
        for place in map(Place, *columns, map(tuple, points[order].tolist())):
            if place[1:3] not in told:
                told.add(place[1:3])
                yield place
        if min(to_ours, to_theirs) == np.inf:
            return


class _Some(NamedTuple):
    q: FloatArray
    edge: IntArray


def _allowed(spots: _Some, edges: Flags) -> _Some:
    there = edges[spots.edge]
    return _Some(spots.q[there], spots.edge[there])


def _milestones(net: Net, q: FloatArray, count: int) -> tuple[IntArray, float]:
    """The nearest milestones, unordered, and how far from q there may be others."""
    grown = len(net.trunk.milestones)
    added = np.arange(grown, len(net.milestones))
    if grown <= count:
        return np.arange(len(net.milestones)), np.inf
    far, rows = net.trunk.milestone_tree.query(q * net.reach, k=count, p=1)
    return np.concatenate([np.atleast_1d(rows).astype(np.int64), added]), float(np.max(far))


def _on_edges(net: Net, edges: Flags, q: FloatArray, count: int) -> tuple[_Some, float]:
    """The nearest places on edges, unordered, and how far from q there may be others."""
    added, trunk = net.added_spots, net.trunk
    free = np.flatnonzero(edges[: len(trunk.edges)])
    beyond = np.inf
    if len(free) <= FEW * len(trunk.edges):
        spots = Spots(trunk, free, trunk.spacing)
        near = _Some(spots.q, spots.edge)
    elif len(trunk.spots.edge) <= count:
        near = _Some(trunk.spots.q, trunk.spots.edge)
    else:
        far, rows = trunk.spot_tree.query(q * net.reach, k=count, p=1)
        near, beyond = _Some(trunk.spots.q[rows], trunk.spots.edge[rows]), float(np.max(far))
    return _Some(np.concatenate([near.q, added.q]), np.concatenate([near.edge, added.edge])), beyond
