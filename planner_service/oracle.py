"""The checker as a planner sees it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property

from planner_service.collision import CollisionChecker, Known
from planner_service.collision.checker import EdgeHit
from planner_service.geometry import FloatArray
from planner_service.roadmap.knowledge import SELF
from planner_service.search import Configuration

__all__ = ["SearchOracle"]

TELLING_MOTIONS = 20
"""Motions tried at an end, all in vain, before a user is told that it is boxed in."""


class SearchOracle:
    """The checker as a planner sees it: padded, and remembering which edges it found free.

    It also notes how motions at the ends of the problem fared, to tell a user which end is boxed in.
    """

    def __init__(
        self, checker: CollisionChecker, starts: Iterable[FloatArray] = (), goals: Iterable[FloatArray] = ()
    ) -> None:
        self._checker = checker
        self._edges: dict[tuple[Configuration, Configuration], bool] = {}
        """Those not found to collide, in either direction, and whether all their samples were judged."""
        self._starts: set[Configuration] = {tuple(start.tolist()) for start in starts}
        self._goals: set[Configuration] = {tuple(goal.tolist()) for goal in goals}
        self._ends = self._starts | self._goals
        self._motions = {"start": Counter[bool](), "goal": Counter[bool]()}

    @property
    def states(self) -> int:
        """States counted so far."""
        return self._checker.ledger.states

    @property
    def last_hit(self) -> EdgeHit | None:
        """The collision found last."""
        return self._checker.last_hit

    @property
    def blocker(self) -> str | None:
        """The obstacle that the last collision was with, ``SELF`` if it was with none; None before the first."""
        hit = self._checker.last_hit
        return None if hit is None else hit.b if hit.b in self._obstacles else SELF

    @cached_property
    def _obstacles(self) -> frozenset[str]:
        return frozenset(obstacle.name for obstacle in self._checker.scene.obstacles)

    def state_is_free(self, q: FloatArray | Configuration) -> bool:
        """Whether q (n,) is free with the padding of the search."""
        return self._checker.state_is_free(q)

    def edge_is_free(
        self, q1: FloatArray | Configuration, q2: FloatArray | Configuration, *, known: Known = Known.NEITHER
    ) -> bool:
        """Whether the edge is free with the padding of the search."""
        return self.edge_hit(q1, q2, known=known) is None

    def edge_hit(
        self, q1: FloatArray | Configuration, q2: FloatArray | Configuration, *, known: Known = Known.NEITHER
    ) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, None when it is free; a free edge is judged once."""
        a, b = _tuple(q1), _tuple(q2)
        key = (a, b) if a <= b else (b, a)
        judged = self._edges.get(key)
        if judged:
            return None
        if judged is None:
            hit = self._checker.edge_hit(a, b, known=known)
            self._note(a, b, free=hit is None)
        else:
            del self._edges[key]
            hit = self._checker.edge_rest(a, b)
        if hit is None:
            self._edges[key] = True
        return hit

    def edge_seems_free(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision; ``edge_is_free`` judges the others."""
        key = (q1, q2) if q1 <= q2 else (q2, q1)
        if key in self._edges:
            return True
        free = self._checker.edge_seems_free(q1, q2, known=known)
        if free:
            self._edges[key] = False
        if q1 in self._ends or q2 in self._ends:
            self._note(q1, q2, free=free)
        return free

    def _note(self, a: Configuration, b: Configuration, *, free: bool) -> None:
        """Remember how a motion fared, if it is one at an end."""
        for end, configurations in (("start", self._starts), ("goal", self._goals)):
            self._motions[end][free] += a in configurations or b in configurations

    def boxed_in(self) -> str:
        """Which end no motion could leave, as the end of a sentence; empty when both could be left."""
        return "".join(
            f"; none of the {tried[False]} motions tried at the {end} was free: it is boxed in"
            for end, tried in self._motions.items()
            if tried[False] >= TELLING_MOTIONS and not tried[True]
        )


def _tuple(q: FloatArray | Configuration) -> Configuration:
    return q if isinstance(q, tuple) else tuple(q.tolist())
