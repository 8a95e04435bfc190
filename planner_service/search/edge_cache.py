"""The collision checker as a planner uses it: padded, with free edges remembered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

from planner_service.collision import CollisionChecker, Known
from planner_service.collision.checker import EdgeHit
from planner_service.collision.edge_sampling import KNOWN_ENDS
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.native.loading import load_core
from planner_service.search.problem import SELF, Configuration

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["SearchOracle", "TieredOracle"]

MIN_MOTIONS_BOXED_IN = 20
"""Motions tried at a start or goal, none of them free, before it is reported as boxed in."""

T = TypeVar("T")
State = FloatArray | Configuration
Part = tuple["SearchOracle", Configuration, Configuration, Known]
"""A part of an edge with what judges it, and which of its ends are known to be free."""

NEAR_END = 0.2
"""Radians from a start or goal within which an edge needs no more clearance than that state."""


class Counted(Protocol):
    """Returns what a function returns that asks compiled code: what that judges is counted, and limits hold."""

    def __call__(self, ask: Callable[[], T]) -> T: ...


class SearchOracle:
    """The checker with the padding of the search and a memory of free edges.

    It also counts free and colliding motions at the starts and goals, to report which of them is boxed in.

    Attributes:
        core: The same compiled, which answers wherever there is one; None without the kernel, or with a user's own edge
            step. Whoever asks it does so within ``counted``.
        counted: Returns what a function returns that asks ``core``.
    """

    def __init__(
        self, checker: CollisionChecker, starts: Iterable[FloatArray] = (), goals: Iterable[FloatArray] = ()
    ) -> None:
        self._checker = checker
        ends = [_tuple(q) for q in starts], [_tuple(q) for q in goals]
        self.core = checker.compiled_oracle(*ends)
        self._judge = _Reference(checker, *ends) if self.core is None else self.core
        self.counted: Counted = _uncounted if self.core is None else cast(Counted, partial(checker.counted, self.core))

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
        return self._asked(self._judge.edge_is_free, _tuple(q1), _tuple(q2), known)

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision; ``edge_is_free`` judges the others."""
        return self._asked(self._judge.edge_is_free_coarse, q1, q2, known)

    def edge_hit(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> EdgeHit | None:
        """Where the edge collides with the padding of the search, None if free; a free edge is checked only once."""
        return None if self.edge_is_free(q1, q2, known=known) else self.last_hit

    def _asked(
        self,
        judge: Callable[[Configuration, Configuration, int], bool],
        a: Configuration,
        b: Configuration,
        known: Known,
    ) -> bool:
        return self.counted(partial(judge, a, b, known._value_))

    def boxed_in(self) -> str:
        """Which ends no motion could leave, as the end of a sentence; empty if both could be left."""
        tried = zip(("start", "goal"), self._judge.motions, strict=True)
        return "".join(
            f"; none of the {colliding} motions tried at the {end} was free: it is boxed in"
            for end, (free, colliding) in tried
            if colliding >= MIN_MOTIONS_BOXED_IN and not free
        )


def _uncounted(ask: Callable[[], T]) -> T:
    return ask()


class _Reference:
    """What ``SearchOracle`` does where nothing is compiled; native/search/edge_oracle.cpp is the same."""

    def __init__(self, checker: CollisionChecker, starts: list[Configuration], goals: list[Configuration]) -> None:
        self._checker = checker
        self._edges: dict[tuple[Configuration, Configuration], bool] = {}
        """Edges not found to collide, in either direction, and whether all their samples were checked."""
        self._ends = frozenset(starts), frozenset(goals)
        self._tried = Counter[bool](), Counter[bool]()

    @property
    def motions(self) -> tuple[tuple[int, int], ...]:
        """Free and colliding motions tried at starts, then at goals."""
        return tuple((tried[True], tried[False]) for tried in self._tried)

    def edge_is_free(self, a: Configuration, b: Configuration, known: int) -> bool:
        key = (a, b) if a <= b else (b, a)
        judged = self._edges.get(key)
        if judged is None:
            free = self._checker.edge_is_free(a, b, known=KNOWN_ENDS[known])
            self._note(a, b, free=free)
        elif judged:
            return True
        else:
            del self._edges[key]
            free = self._checker.finish_edge(a, b) is None
        if free:
            self._edges[key] = True
        return free

    def edge_is_free_coarse(self, a: Configuration, b: Configuration, known: int) -> bool:
        key = (a, b) if a <= b else (b, a)
        if key in self._edges:
            return True
        free = self._checker.edge_is_free_coarse(a, b, known=KNOWN_ENDS[known])
        if free:
            self._edges[key] = False
        self._note(a, b, free=free)
        return free

    def _note(self, a: Configuration, b: Configuration, *, free: bool) -> None:
        """Count a motion if it starts or ends at a start or goal."""
        for ends, tried in zip(self._ends, self._tried, strict=True):
            tried[free] += a in ends or b in ends


class TieredOracle:
    """An oracle with less padding near starts and goals that are closer to something than the padding of the rest.

    Args:
        roomy: Checks all other states, and edges beyond 0.2 rad from such a start or goal.
        tight: For each such start or goal the oracle of that state and of edges within 0.2 rad.

    Attributes:
        core: As of ``SearchOracle``.
    """

    def __init__(self, roomy: SearchOracle, tight: Mapping[Configuration, SearchOracle]) -> None:
        self._roomy, self._tight = roomy, dict(tight)
        core, cores = load_core(), [(q, oracle.core) for q, oracle in tight.items() if oracle.core is not None]
        self.core: _core.TieredOracle | None = None
        if core is not None and roomy.core is not None and len(cores) == len(tight):
            self.core = core.TieredOracle(roomy.core, cores, NEAR_END)

    def counted(self, ask: Callable[[], T]) -> T:
        """What ``ask`` returns, which asks ``core``: what that judges is counted, and limits hold."""
        return self._roomy.counted(ask)

    @property
    def states(self) -> int:
        """States counted so far."""
        return self._roomy.states

    def state_is_free(self, q: State) -> bool:
        """Whether q (n,) is free with the padding that holds there."""
        return self._tight.get(_tuple(q), self._roomy).state_is_free(q)

    def edge_is_free(self, q1: State, q2: State, *, known: Known = Known.NEITHER) -> bool:
        """Whether the edge is free with the padding that holds along it."""
        parts = self._parts(_tuple(q1), _tuple(q2), known)
        return all(oracle.edge_is_free(a, b, known=ends) for oracle, a, b, ends in parts)

    def edge_is_free_coarse(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool:
        """Whether a first look at a few samples of the edge finds no collision."""
        return all(oracle.edge_is_free_coarse(a, b, known=ends) for oracle, a, b, ends in self._parts(q1, q2, known))

    def _parts(self, q1: Configuration, q2: Configuration, known: Known) -> list[Part]:
        """The parts of an edge, each with its oracle and the ends known to be free."""
        first, second = self._tight.get(q1), self._tight.get(q2)
        length = joint_distance(q1, q2)
        if length == 0.0 or (first is None and second is None):
            return [(first or second or self._roomy, q1, q2, known)]
        share = min(NEAR_END / length, 1.0 if first is None or second is None else 0.5)
        points, judges = [q1, q2], [self._roomy]
        if first is not None:
            points.insert(1, _between(q1, q2, share))
            judges.insert(0, first)
        if second is not None:
            points.insert(-1, _between(q1, q2, 1.0 - share))
            judges.append(second)
        parts: list[Part] = []
        for judge, a, b in zip(judges, points[:-1], points[1:], strict=True):
            if a != b:
                at_end = known & Known.END if b == q2 else Known.NEITHER
                parts.append((judge, a, b, at_end if parts else at_end | known & Known.START))
        return parts


def _between(a: Configuration, b: Configuration, share: float) -> Configuration:
    return tuple(x + (y - x) * share for x, y in zip(a, b, strict=True))


def _tuple(q: State) -> Configuration:
    return q if isinstance(q, tuple) else tuple(q.tolist())
