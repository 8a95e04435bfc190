"""A world of discs in the plane of the first two joints, with closed-form answers: the planners' double."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from planner_service.collision.edge_sampling import JointStep, Known, interior
from planner_service.geometry.arrays import FloatArray
from planner_service.search.problem import SearchProblem

Configuration = tuple[float, ...]
Disc = tuple[float, float, float]

WALL: tuple[Disc, ...] = ((0.0, 0.0, 0.9), (0.0, 1.8, 0.8), (0.0, -1.6, 0.4))
"""Two gaps between left and right; centre x, y and radius."""

SEALED: tuple[Disc, ...] = tuple((0.0, -3.0 + 0.5 * k, 0.5) for k in range(13))
"""No gap."""


class Stop(Exception):
    """A limit of the test's own."""


class DiscWorld:
    """An oracle that records all it is asked; ``limit`` states, then it raises ``error``."""

    def __init__(
        self,
        discs: Sequence[Disc] = WALL,
        *,
        step: float = 0.05,
        limit: int | None = None,
        error: Callable[[], Exception] = Stop,
    ) -> None:
        self._discs, self._step, self._limit, self._error = discs, JointStep(step), limit, error
        self.judged: list[Configuration] = []
        self.edges: list[tuple[Configuration, Configuration]] = []
        self.free_edges: set[frozenset[Configuration]] = set()

    @property
    def states(self) -> int:
        return len(self.judged)

    def state_is_free(self, q: FloatArray) -> bool:
        if self._limit is not None and self.states >= self._limit:
            raise self._error()
        self.judged.append(tuple(q.tolist()))
        return all((q[0] - x) ** 2 + (q[1] - y) ** 2 > r * r for x, y, r in self._discs)

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        a, b = q1.tolist(), q2.tolist()
        self.edges.append((tuple(a), tuple(b)))
        parts = self._step.segments((q2 - q1).tolist(), [1.0] * q1.size)
        samples = [*interior(a, b, parts)]
        ends = [q for q, end in ((q1, Known.START), (q2, Known.END)) if end not in known]
        free = all(self.state_is_free(q) for q in [*ends, *samples])
        if free:
            self.free_edges.add(frozenset((tuple(a), tuple(b))))
        return free

    def found_free(self, waypoints: FloatArray) -> bool:
        """Whether each piece is an edge that was asked about, and was free, or a part of one."""
        rows = [tuple(q) for q in waypoints.tolist()]
        return all(
            frozenset(piece) in self.free_edges or any(_lies_on(piece, edge) for edge in self.free_edges)
            for piece in pairwise(rows)
        )


def _lies_on(piece: tuple[Configuration, Configuration], edge: frozenset[Configuration]) -> bool:
    if len(edge) < 2:
        return False
    a, b = edge
    return all(math.dist(a, q) + math.dist(q, b) < math.dist(a, b) + 1e-12 for q in piece)


def across(
    world: DiscWorld,
    *,
    n: int = 2,
    seed: int = 0,
    goals: Sequence[tuple[float, float]] = ((2.0, 0.1),),
    poll: Callable[[], None] = lambda: None,
) -> SearchProblem:
    """From the left of the wall to goals on its right, in n joints of which the last n - 2 do not matter."""
    rest = [0.0] * (n - 2)
    return SearchProblem(
        start=np.array([-2.0, -0.2, *rest]),
        goals=np.array([[*goal, *rest] for goal in goals]),
        lower=np.full(n, -3.0),
        upper=np.full(n, 3.0),
        oracle=world,
        seed=seed,
        poll=poll,
    )


def length(waypoints: FloatArray) -> float:
    """Sum of the L2 lengths of the pieces."""
    return float(np.sqrt(((waypoints[1:] - waypoints[:-1]) ** 2).sum(axis=1)).sum())


class GlancingWorld(DiscWorld):
    """One that takes tuples, too; a first look judges the ends alone: almost any edge seems free."""

    glances = 0

    def state_is_free(self, q: FloatArray | Configuration) -> bool:
        return super().state_is_free(np.asarray(q))

    def edge_is_free(
        self, q1: FloatArray | Configuration, q2: FloatArray | Configuration, *, known: Known = Known.NEITHER
    ) -> bool:
        return super().edge_is_free(np.asarray(q1), np.asarray(q2), known=known)

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        self.glances += 1
        return all(self.state_is_free(q) for q, end in ((q1, Known.START), (q2, Known.END)) if end not in known)
