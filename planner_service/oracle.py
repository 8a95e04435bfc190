"""The checker as a planner sees it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from planner_service.collision import CollisionChecker, Known
from planner_service.collision.checker import EdgeHit
from planner_service.geometry import FloatArray

__all__ = ["SearchOracle"]

TELLING_MOTIONS = 20
"""Motions tried at an end, all in vain, before a user is told that it is boxed in."""

Configuration = tuple[float, ...]


class SearchOracle:
    """The checker as a planner sees it: padded, and remembering which edges it found free.

    It also notes how motions at the ends of the problem fared, to tell a user which end is boxed in.
    """

    def __init__(
        self, checker: CollisionChecker, starts: Iterable[FloatArray] = (), goals: Iterable[FloatArray] = ()
    ) -> None:
        self._checker = checker
        self._free_edges: set[tuple[Configuration, Configuration]] = set()
        self._glanced: set[tuple[Configuration, Configuration]] = set()
        self._starts: set[Configuration] = {tuple(start.tolist()) for start in starts}
        self._goals: set[Configuration] = {tuple(goal.tolist()) for goal in goals}
        self._motions = {"start": Counter[bool](), "goal": Counter[bool]()}

    @property
    def states(self) -> int:
        """States counted so far."""
        return self._checker.counts.states

    def state_is_free(self, q: FloatArray) -> bool:
        """Whether q (n,) is free with the padding of the search."""
        return self._checker.state_is_free(q)

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge is free with the padding of the search."""
        return self.edge_hit(q1, q2, known=known) is None

    def edge_hit(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, None when it is free; a free edge is judged once."""
        if self.proved(q1, q2):
            return None
        key = _key(q1, q2)
        if key in self._glanced:
            self._glanced.discard(key)
            hit = self._checker.edge_rest(q1, q2)
        else:
            hit = self._checker.edge_hit(q1, q2, known=known)
            self._note(key, free=hit is None)
        if hit is None:
            self._free_edges.add(key)
        return hit

    def edge_seems_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision; ``edge_is_free`` judges the others."""
        key = _key(q1, q2)
        if key in self._free_edges or key in self._glanced:
            return True
        free = self._checker.edge_glance(q1, q2, known=known) is None
        if free:
            self._glanced.add(key)
        self._note(key, free=free)
        return free

    def _note(self, key: tuple[Configuration, Configuration], *, free: bool) -> None:
        for end, configurations in (("start", self._starts), ("goal", self._goals)):
            if configurations.intersection(key):
                self._motions[end][free] += 1

    def proved(self, q1: FloatArray, q2: FloatArray) -> bool:
        """Whether this very edge was found free before, in either direction."""
        return _key(q1, q2) in self._free_edges

    def boxed_in(self) -> str:
        """Which end no motion could leave, as the end of a sentence; empty when both could be left."""
        return "".join(
            f"; none of the {tried[False]} motions tried at the {end} was free: it is boxed in"
            for end, tried in self._motions.items()
            if tried[False] >= TELLING_MOTIONS and not tried[True]
        )


def _key(q1: FloatArray, q2: FloatArray) -> tuple[Configuration, Configuration]:
    """An edge and its reverse alike."""
    a, b = tuple(q1.tolist()), tuple(q2.tolist())
    return (a, b) if a <= b else (b, a)
