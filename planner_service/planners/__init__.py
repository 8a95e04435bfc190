"""The planners, each a small frozen dataclass of settings: ``PlanRequest(..., planner=BalancedRRTConnect(range=0.5))``.

Write your own by giving a class a ``name``, a ``patience`` and ``search(problem)``: see ``Planner``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from planner_service.errors import UnknownName
from planner_service.roadmap.planners import PRM, LazyPRM, PRMstar
from planner_service.roadmap.roadmap import Roadmap
from planner_service.search.ompl_planners import (
    AORRTC,
    BFMT,
    BKPIECE1,
    FMT,
    KPIECE1,
    LBKPIECE1,
    BITstar,
    InformedRRTstar,
    RRTstar,
    SORRTstar,
)
from planner_service.search.planners import RRT, BalancedRRTConnect, RRTConnect
from planner_service.search.problem import Oracle, Planner, SearchProblem, SearchResult, SearchSpace, Space

__all__ = [
    "AORRTC",
    "BFMT",
    "BKPIECE1",
    "FMT",
    "KPIECE1",
    "LBKPIECE1",
    "PLANNERS",
    "PRM",
    "RRT",
    "BITstar",
    "BalancedRRTConnect",
    "InformedRRTstar",
    "LazyPRM",
    "Oracle",
    "PRMstar",
    "Planner",
    "RRTConnect",
    "RRTstar",
    "Roadmap",
    "SORRTstar",
    "SearchProblem",
    "SearchResult",
    "SearchSpace",
    "Space",
    "planner_by_name",
]

_TREES = (BalancedRRTConnect, RRTConnect, RRT, RRTstar, InformedRRTstar, SORRTstar, BITstar, AORRTC, FMT, BFMT)
_OTHERS = (KPIECE1, BKPIECE1, LBKPIECE1, PRM, PRMstar, LazyPRM)
PLANNERS: Mapping[str, type[Any]] = MappingProxyType({planner.name: planner for planner in (*_TREES, *_OTHERS)})
"""Every planner that can be made from its name alone, by that name."""


def planner_by_name(name: str) -> Planner:
    """The planner of that name (any case) with its default settings.

    Raises:
        UnknownName: there is none; the message offers the nearest.
    """
    kind = PLANNERS.get(name.lower()) if isinstance(name, str) else None
    if kind is None:
        raise UnknownName("planner", name, PLANNERS)
    planner: Planner = kind()
    return planner
