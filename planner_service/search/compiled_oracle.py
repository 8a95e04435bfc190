"""Oracles as the compiled core asks them: those that are compiled themselves, and any other behind its methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

from planner_service.collision.edge_sampling import KNOWN_ENDS
from planner_service.native.loading import load_core
from planner_service.search.problem import CoarseOracle, Configuration, Oracle, of_tuples

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["CompiledOracle", "compiled"]

T = TypeVar("T")


class CompiledOracle(Protocol):
    """What compiled searching and smoothing ask."""

    @property
    def core(self) -> _core.Oracle:
        """What answers."""

    def counted(self, ask: Callable[[], T]) -> T:
        """What ``ask`` returns, which asks ``core``: what that judges is counted, and limits hold."""

    def blocker_of(self, pair: int) -> str | None:
        """The obstacle of a pair that ``core`` found to collide, by its number; None if that is not known."""


def compiled(oracle: Oracle | CoarseOracle, poll: Callable[[], None] = lambda: None) -> CompiledOracle:
    """The oracle itself if it is compiled, else one that asks its methods.

    Args:
        poll: Called often by the latter; what it raises ends the search.
    """
    return cast(CompiledOracle, oracle) if hasattr(oracle, "core") else _Asked(oracle, poll)


class _Asked:
    """An oracle behind its methods, for one call; the numbers of its pairs are those of the collisions that were told.

    After the call nothing leads to the oracle any more: through the core no cycle of references is ever found.
    """

    def __init__(self, oracle: Oracle | CoarseOracle, poll: Callable[[], None]) -> None:
        held, self._blockers = [of_tuples(cast(Oracle, oracle))], list[str | None]()
        told, blockers, self._held = [oracle], self._blockers, held
        self._told = told

        def edge(a: Configuration, b: Configuration, known: int) -> bool:
            return bool(held[0].edge_is_free(a, b, known=KNOWN_ENDS[known]))

        def coarse(a: Configuration, b: Configuration, known: int) -> bool:
            return bool(held[0].edge_is_free_coarse(a, b, known=KNOWN_ENDS[known]))

        def last() -> tuple[float, int]:
            hit = getattr(told[0], "last_hit", None)
            blockers.append(getattr(told[0], "blocker", None))
            return 0.5 if hit is None else hit.fraction, len(blockers) - 1

        glance = coarse if hasattr(oracle, "edge_is_free_coarse") else None
        self.core: _core.AskedOracle = load_core().AskedOracle(
            lambda q: bool(held[0].state_is_free(q)), edge, glance, last, poll
        )

    def counted(self, ask: Callable[[], T]) -> T:
        """What ``ask`` returns; the oracle counts by itself."""
        try:
            return ask()
        finally:
            self._held.clear()
            self._told.clear()

    def blocker_of(self, pair: int) -> str | None:
        """As of ``CompiledOracle``."""
        return self._blockers[pair]
