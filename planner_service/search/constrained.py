"""An oracle that also refuses edges that leave the constraints."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from planner_service.collision import Known
from planner_service.collision.checker import EdgeHit
from planner_service.native.loading import load_core
from planner_service.search.edge_cache import SearchOracle, State
from planner_service.search.problem import Configuration

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["ConstrainedOracle"]

T = TypeVar("T")


class ConstrainedOracle:
    """What ``SearchOracle`` says, but an edge is free only if it keeps the constraints, too.

    Attributes:
        inner: The same without constraints.
        projector: Says which edges keep them.
        core: As of ``SearchOracle``.
    """

    def __init__(self, oracle: SearchOracle, projector: _core.Projector) -> None:
        self.inner, self.projector = oracle, projector
        self.core: _core.ConstrainedOracle = load_core().ConstrainedOracle(oracle.core, projector)

    def counted(self, ask: Callable[[], T]) -> T:
        """As of ``SearchOracle``."""
        return self.inner.counted(ask)

    @property
    def states(self) -> int:
        """States that this thread has counted so far."""
        return self.inner.states

    def state_is_free(self, q: State) -> bool:
        """Whether q (n,) is free with the padding of the search."""
        return self.inner.state_is_free(q)

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge keeps the constraints and is free with the padding of the search."""
        return self.keeps(q1, q2) and self.inner.edge_is_free(q1, q2, known=known)

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge keeps the constraints and a first look at a few samples of it finds no collision."""
        return self.keeps(q1, q2) and self.inner.edge_is_free_coarse(q1, q2, known=known)

    def edge_hit(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, constraints aside; None if it does not."""
        return self.inner.edge_hit(q1, q2, known=known)

    def boxed_in(self) -> str:
        """As of ``SearchOracle``."""
        return self.inner.boxed_in()

    def blocker_of(self, pair: int) -> str:
        """As of ``SearchOracle``."""
        return self.inner.blocker_of(pair)

    def keeps(self, q1: State, q2: State) -> bool:
        """Whether the edge keeps the constraints."""
        return self.projector.keeps(_tuple(q1), _tuple(q2))


def _tuple(q: State) -> Configuration:
    return q if isinstance(q, tuple) else tuple(q.tolist())
