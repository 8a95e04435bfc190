"""The oracle of a search in Python: edges are remembered, and judged by the checker one by one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from planner_service import CollisionChecker
from planner_service.collision.edge_sampling import Known
from planner_service.geometry.arrays import FloatArray

__all__ = ["ReferenceOracle"]

Configuration = tuple[float, ...]
State = FloatArray | Configuration


class ReferenceOracle:
    """The same answers and counts as ``SearchOracle``."""

    def __init__(
        self, checker: CollisionChecker, starts: Iterable[FloatArray] = (), goals: Iterable[FloatArray] = ()
    ) -> None:
        self._checker = checker
        self._edges: dict[tuple[Configuration, Configuration], bool] = {}
        """Edges not found to collide, in either direction, and whether all their samples were checked."""
        self._ends = [frozenset(tuple(np.asarray(q).tolist()) for q in ends) for ends in (starts, goals)]
        self._tried = Counter[bool](), Counter[bool]()

    @property
    def states(self) -> int:
        """States that this thread has counted so far."""
        return self._checker.ledger.own.states

    @property
    def motions(self) -> tuple[tuple[int, int], ...]:
        """Free and colliding motions tried at starts, then at goals."""
        return tuple((tried[True], tried[False]) for tried in self._tried)

    def state_is_free(self, q: State) -> bool:
        return self._checker.state_is_free(q)

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        a, b = (tuple(np.asarray(q).tolist()) for q in (q1, q2))
        key = (a, b) if a <= b else (b, a)
        judged = self._edges.get(key)
        if judged is None:
            free = self._checker.edge_is_free(a, b, known=known)
            self._note(a, b, free=free)
        elif judged:
            return True
        else:
            del self._edges[key]
            free = self._checker.finish_edge(a, b) is None
        if free:
            self._edges[key] = True
        return free

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        key = (q1, q2) if q1 <= q2 else (q2, q1)
        if key in self._edges:
            return True
        free = self._checker.edge_is_free_coarse(q1, q2, known=known)
        if free:
            self._edges[key] = False
        self._note(q1, q2, free=free)
        return free

    def _note(self, a: Configuration, b: Configuration, *, free: bool) -> None:
        """Count a motion if it starts or ends at a start or goal."""
        for ends, tried in zip(self._ends, self._tried, strict=True):
            tried[free] += a in ends or b in ends
