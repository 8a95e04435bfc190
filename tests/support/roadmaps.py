"""What a roadmap claims, and whether a fresh checker agrees."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from planner_service import CollisionChecker, JointStep, PlannerService, Roadmap
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.native.loading import load_core
from planner_service.roadmap import Verdict
from planner_service.roadmap.graph import Graph, motion
from planner_service.roadmap.query import places_of
from tests.support.optional import present

__all__ = ["Place", "cell", "checker_of", "lies", "nearest_places", "points_along"]

FREE, BLOCKED = Verdict.FREE, Verdict.BLOCKED


@cache
def cell(scene: str = "bin") -> PlannerService:
    """An arm in a scene, with steps so coarse that roadmaps grow quickly."""
    return PlannerService("wxai", scene, edge_step=JointStep(0.05))


def checker_of(roadmap: Roadmap, service: PlannerService) -> CollisionChecker:
    """A checker of its own that judges on the roadmap's terms."""
    padding = present(roadmap.terms).padding
    return CollisionChecker(service.robot, service.scene, edge_step=service.checker.edge_step, padding=padding)


def _claims(roadmap: Roadmap, checker: CollisionChecker) -> Iterator[tuple[str, bool, bool]]:
    """What a roadmap says of its milestones and edges, and what a checker says."""
    for k, verdict in enumerate(roadmap.milestone_knowledge.verdicts.tolist()):
        if verdict in (FREE, BLOCKED):
            yield f"milestone {k}", verdict == FREE, checker.state_is_free(roadmap.milestones[k])
    for k, verdict in enumerate(roadmap.verdicts.tolist()):
        if verdict in (FREE, BLOCKED):
            a, b = roadmap.milestones[roadmap.edges[k]]
            yield f"edge {k}", verdict == FREE, checker.edge_is_free(a, b)


def lies(roadmap: Roadmap | None, service: PlannerService) -> list[tuple[str, bool]]:
    """Verdicts that a fresh checker does not share, and whether they are of the service's scene at all."""
    known = present(roadmap)
    if present(known.terms).scene_hash != service.scene.hash:
        return [("the scene", True)]
    told = _claims(known, checker_of(known, service))
    return [(what, claimed) for what, claimed, found in told if claimed != found]


class Place(NamedTuple):
    """Where a configuration may join a roadmap: how far away (m), an edge or -1, a milestone or -1, and where."""

    far: float
    edge: int
    milestone: int
    q: tuple[float, ...]


def nearest_places(graph: Graph, milestones: BoolArray, edges: BoolArray, q: FloatArray) -> Iterator[Place]:
    """The places nearest to q (n,), nearest first."""
    found = load_core().NearestPlaces(places_of(graph, milestones, edges), q.tolist())
    while (place := found.next()) is not None:
        yield Place._make(place)


def points_along(graph: Graph, edges: IntArray, spacing: float) -> tuple[FloatArray, IntArray]:
    """Evenly spaced points (p, n) along some edges, and the edge of each, (p,)."""
    ends = graph.edges[edges]
    a, b = graph.milestones[ends[:, 0]], graph.milestones[ends[:, 1]]
    parts = np.clip(motion(a, b, graph.reach) / spacing, 1, 1000).astype(np.int64)
    rows = [(a[k] + (b[k] - a[k]) * i / parts[k], edges[k]) for k in range(len(edges)) for i in range(1, parts[k])]
    points = np.array([q for q, _ in rows]).reshape(-1, graph.milestones.shape[1])
    return points, np.array([edge for _, edge in rows], dtype=np.int64)
