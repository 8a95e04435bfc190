"""The places where a configuration may join a roadmap: its milestones, and points along edges known to be free.

Places on the trunk are found by its trees, unless few of its edges are free; later additions are searched one by one.
The nearest places come first, whatever the earlier queries. All of this is compiled: native/roadmap/places.cpp.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planner_service.geometry.arrays import BoolArray
from planner_service.native.loading import load_core
from planner_service.roadmap.graph import Graph

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["places_of"]

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
