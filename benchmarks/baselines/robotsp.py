"""RoboTSP's way to an order: first the order, by distances of the tool, then the branches.

The algorithm (Suarez-Ruiz, Lembono & Pham, arXiv 1709.09343, III): a tour of the targets in task space by 2-opt on
Euclidean distances, then the shortest path through the layered graph of their configurations, then plans of its
edges. Edges of the graph cost here what the motion takes at least, which is nearer to what is wanted than their
distances of joints. A leg without a plan is taken out of the graph, and the shortest path is looked for anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

import planner_service as ps
from planner_service.geometry.arrays import FloatArray
from planner_service.tasks.ordering.legs import LegTable, Stops
from planner_service.tasks.ordering.tours import IMPOSSIBLE, best_branches
from planner_service.tasks.ordering.visits import Branch

__all__ = ["robotsp_seconds", "task_space_order"]


def task_space_order(arrive: FloatArray, leave: FloatArray, start: FloatArray) -> list[int]:
    """A closed tour from ``start`` (3,), which enters targets at ``arrive`` (N, 3) and leaves them at ``leave``, by
    2-opt."""
    into, out = np.vstack([start, arrive]), np.vstack([start, leave])
    away = np.linalg.norm(out[:, None] - into[None], axis=2)
    order, left = [0], set(range(1, len(into)))
    while left:
        order.append(min(left, key=lambda k: (float(away[order[-1], k]), k)))
        left.remove(order[-1])
    shorter = True
    while shorter:
        shorter = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                turned = [*order[:i], *order[i : j + 1][::-1], *order[j + 1 :]]
                piece = slice(max(i - 1, 0), min(j + 2, len(order)))
                if _length(away, turned, piece) < _length(away, order, piece) - 1e-12:
                    order, shorter = turned, True
    return [k - 1 for k in order[1:]]


def _length(away: FloatArray, order: Sequence[int], piece: slice) -> float:
    """Of a piece of a closed tour."""
    some = order[piece] if piece.stop < len(order) else [*order[piece], order[0]]
    return float(sum(away[a, b] for a, b in pairwise(some)))


def robotsp_seconds(service: ps.PlannerService, jobs: Sequence[Stops], request: ps.PlanRequest) -> tuple[float, int]:
    """Seconds of all motions in RoboTSP's order, infinite if a leg has no plan, and how many legs were planned.

    Args:
        jobs: The branches of each target, or of a pick and of its place.
    """
    start = Branch(np.asarray(request.start))
    where = [[_tool(service, stop[0].q) for stop in job] for job in jobs]
    arrive, leave = (np.array([places[end] for places in where]) for end in (0, -1))
    order = [1 + k for k in task_space_order(arrive, leave, _tool(service, start.q))]
    before = np.zeros((len(jobs) + 1, len(jobs) + 1), dtype=bool)
    table = LegTable(service, request, (((start,),), *jobs), start, before)
    while True:
        least = [
            np.where(one.known & (one.seconds >= IMPOSSIBLE), IMPOSSIBLE, one.least) for one in table.tables
        ]  # fmt: skip
        tour = best_branches(table.costs(least), order)
        if tour.cost >= IMPOSSIBLE:
            return float("inf"), len(table.planned)
        path = table.path(tour, least)
        unknown = table.unknown(path)
        table.plan(unknown, None, None)
        if all(table.planned[place].seconds < IMPOSSIBLE for place in path):
            chosen = [table.ends(place)[1] for place in path]
            return sum(table.planned[p].seconds for p in path) + sum(b.seconds for b in chosen), len(table.planned)


def _tool(service: ps.PlannerService, q: FloatArray) -> FloatArray:
    """Where the tool is, (3,)."""
    return np.array([row[3] for row in service.robot.tool_rows(q.tolist())])
