"""The collision checker as a planner uses it: padded, with free edges remembered."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

from planner_service.collision import CollisionChecker, Known
from planner_service.collision.checker import EdgeHit
from planner_service.geometry.arrays import FloatArray
from planner_service.native.loading import load_core
from planner_service.search.problem import SELF, Configuration

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["SearchOracle", "TieredOracle"]

MIN_MOTIONS_BOXED_IN = 20
"""Motions tried at a start or goal, none of them free, before it is reported as boxed in."""

T = TypeVar("T")
State = FloatArray | Configuration
NEAR_END = 0.2
"""Radians from a start or goal within which an edge needs no more clearance than that state."""


class Counted(Protocol):
    """Returns what a function returns that asks compiled code: what that judges is counted, and limits hold."""

    def __call__(self, ask: Callable[[], T]) -> T: ...


class SearchOracle:
    """The checker with the padding of the search and a memory of free edges.

    It also counts free and colliding motions at the starts and goals, to report which of them is boxed in.

    Attributes:
        core: The same compiled, which answers. Whoever asks it does so within ``counted``.
        counted: Returns what a function returns that asks ``core``.
    """

    def __init__(
        self, checker: CollisionChecker, starts: Iterable[FloatArray] = (), goals: Iterable[FloatArray] = ()
    ) -> None:
        self._checker = checker
        self.core = checker.oracle([_tuple(q) for q in starts], [_tuple(q) for q in goals])
        self.counted: Counted = cast(Counted, partial(checker.counted, self.core))

    @property
    def states(self) -> int:
        """States that this thread has counted so far."""
        return self._checker.ledger.own.states

    @property
    def last_hit(self) -> EdgeHit | None:
        """The last collision found."""
        return self._checker.last_hit

    @property
    def blocker(self) -> str | None:
        """The obstacle of the last collision, ``SELF`` if it was a self-collision; None before the first."""
        hit = self._checker.last_hit
        return None if hit is None else self._obstacle(hit.b)

    def blocker_of(self, pair: int) -> str:
        """The same of a pair that ``core`` found to collide, by its number."""
        return self._obstacle(self._checker.parts.names[pair][1])

    def _obstacle(self, name: str) -> str:
        return name if name in self._obstacles else SELF

    @cached_property
    def _obstacles(self) -> frozenset[str]:
        return frozenset(obstacle.name for obstacle in self._checker.scene.obstacles)

    def state_is_free(self, q: State) -> bool:
        """Whether q (n,) is free with the padding of the search."""
        return self._checker.state_is_free(q)

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge is free with the padding of the search; a free edge is checked only once."""
        return self.counted(partial(self.core.edge_is_free, _tuple(q1), _tuple(q2), known._value_))

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision; ``edge_is_free`` judges the others."""
        return self.counted(partial(self.core.edge_is_free_coarse, q1, q2, known._value_))

    def edge_hit(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, None if free; a free edge is checked only once."""
        return None if self.edge_is_free(q1, q2, known=known) else self.last_hit

    def boxed_in(self) -> str:
        """Which ends no motion could leave, as the end of a sentence; empty if both could be left."""
        tried = zip(("start", "goal"), self.core.motions, strict=True)
        return "".join(
            f"; none of the {colliding} motions tried at the {end} was free: it is boxed in"
            for end, (free, colliding) in tried
            if colliding >= MIN_MOTIONS_BOXED_IN and not free
        )


class TieredOracle:
    """An oracle with less padding near starts and goals that are closer to something than the padding of the rest.

    Args:
        roomy: Checks all other states, and edges beyond 0.2 rad from such a start or goal.
        tight: For each such start or goal the oracle of that state and of edges within 0.2 rad.

    Attributes:
        core: As of ``SearchOracle``.
    """

    def __init__(self, roomy: SearchOracle, tight: Mapping[Configuration, SearchOracle]) -> None:
        self._roomy, self._tight = roomy, dict(tight)  # kept alive for ``core``
        self.core: _core.TieredOracle = load_core().TieredOracle(
            roomy.core, [(q, oracle.core) for q, oracle in tight.items()], NEAR_END
        )

    def counted(self, ask: Callable[[], T]) -> T:
        """What ``ask`` returns, which asks ``core``: what that judges is counted, and limits hold."""
        return self._roomy.counted(ask)

    @property
    def states(self) -> int:
        """States counted so far."""
        return self._roomy.states

    def blocker_of(self, pair: int) -> str:
        """As of ``SearchOracle``."""
        return self._roomy.blocker_of(pair)

    def state_is_free(self, q: State) -> bool:
        """Whether q (n,) is free with the padding that holds there."""
        return self.counted(partial(self.core.state_is_free, _tuple(q)))

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge is free with the padding that holds along it."""
        return self.counted(partial(self.core.edge_is_free, _tuple(q1), _tuple(q2), known._value_))

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision."""
        return self.counted(partial(self.core.edge_is_free_coarse, q1, q2, known._value_))


def _tuple(q: State) -> Configuration:
    return q if isinstance(q, tuple) else tuple(q.tolist())
