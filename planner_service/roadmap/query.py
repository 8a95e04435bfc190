"""One query of a roadmap: a short path over edges not known to be blocked, checked only when a path uses them.

Lazy collision checking (Bohlin & Kavraki, ICRA 2000; Dellin & Srinivasa, ICAPS 2016): search, check the path, leave
out what is blocked, search again. Most edges of a roadmap are never on such a path. In a roadmap that is already
checked, the cost of a query is joining the start and the goals to it. So they may join anywhere along an edge known to
be free, and the places to which the robot moves least come first.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner_service.collision.contact import EdgeHit
from planner_service.collision.edge_sampling import KNOWN_ENDS
from planner_service.geometry.arrays import BoolArray, FloatArray, joint_distance
from planner_service.native.loading import load_core
from planner_service.roadmap.graph import Graph, Neighbour
from planner_service.roadmap.nearest import Place, compiled_places, nearest_places
from planner_service.roadmap.verdicts import Knowledge, Lesson, Verdict
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import (
    CoarseOracle,
    Configuration,
    SearchProblem,
    distances,
    of_tuples,
)

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["Carried", "Query", "query_of"]

JOINS_AT_ONCE = 4
"""Places to which an end is joined at a time, and as many more if these lead nowhere; each blocked one is replaced."""

MAX_JOINS = 48
"""The most places tried at an end."""

DETOUR = 4.0
"""Radians of path that count as much as a metre of a joining edge: joining costs checks, the roadmap has been paid."""

GREED, UNKNOWN_AS = 3.0, 2.0
"""How many times as long as the shortest a path may be, and how many times its length an edge counts that is not known
to be free. Paths are shortened anyway; these are found ten times as fast and cost fewer checks (Phillips et al., 2012).
"""

NODES_PER_POLL = 256
"""Nodes expanded between two polls."""

MAX_NODES = 50_000
"""Nodes that all searches of a query may expand before it gives up, about half a second: a roadmap that is mostly
unknown or blocked is searched again and again."""

NO_NEIGHBOURS: list[Neighbour] = []

FREE, BLOCKED = int(Verdict.FREE), int(Verdict.BLOCKED)

Lessons = tuple[dict[int, Lesson], dict[int, Lesson]]

SHADOW, HITS = 0.06, 12
"""A joining edge that passes within so many metres of motion of one of the last so many collisions is tried late."""


class Carried(Protocol):
    """Knows which edges a change of the scene left free."""

    def still_free(self, A: FloatArray, B: FloatArray) -> BoolArray:
        """Which edges from A (m, n) to B (m, n), free before, are proven to be free still, (m,)."""


@dataclass(eq=False)
class _End:
    """A start or a goal, and its joining edges."""

    node: int
    q: Configuration
    waiting: Iterator[Place]
    open: list[int] = field(default_factory=list)
    tried: int = 0
    shadowed: list[Place] = field(default_factory=list)
    hits: deque[Configuration] = field(default_factory=lambda: deque(maxlen=HITS))


class Query(Protocol):
    """One query."""

    @property
    def learned(self) -> Lessons:
        """The new verdicts on milestones and on edges, by their numbers."""

    def route(self, carried: Carried | None = None) -> tuple[Sequence[Sequence[float]], int] | None:
        """The path and the goal it reaches; None if the roadmap has none."""


def query_of(graph: Graph, milestones: Knowledge, edges: Knowledge, problem: SearchProblem) -> Query:
    """A query of a graph with what is known of its milestones and edges."""
    core, oracle = load_core(), problem.oracle
    if core is None or not isinstance(oracle, SearchOracle) or oracle.core is None:
        return _Reference(graph, milestones, edges, problem)
    places = compiled_places(graph, milestones.possible, edges.free)
    verdicts, ends = (milestones.verdicts, edges.verdicts), (problem.start.tolist(), problem.goals.tolist())
    return _Compiled(graph, oracle, core.RoadmapQuery(graph.compiled, places, *verdicts, *ends, oracle.core))


class _Compiled:
    """A query that native/roadmap/query.cpp answers."""

    def __init__(self, graph: Graph, oracle: SearchOracle, query: _core.RoadmapQuery) -> None:
        self._graph, self._oracle, self._query = graph, oracle, query

    @property
    def learned(self) -> Lessons:
        milestones, edges = map(self._lessons, self._query.learned)
        return milestones, edges

    def _lessons(self, found: Iterable[tuple[int, int, int]]) -> dict[int, Lesson]:
        return {
            number: (Verdict(verdict), self._oracle.blocker_of(pair) if verdict == BLOCKED else None)
            for number, verdict, pair in found
        }

    def route(self, carried: Carried | None = None) -> tuple[Sequence[Sequence[float]], int] | None:
        still_free = None if carried is None else partial(_still_free, self._graph, carried)
        return self._oracle.counted(lambda: self._query.route(still_free))


class _Reference:
    """The same in Python, for any oracle, step by step.

    Its nodes are the milestones, then the start, the goals, and the places on edges where these join.
    """

    def __init__(self, graph: Graph, milestones: Knowledge, edges: Knowledge, problem: SearchProblem) -> None:
        self._graph, self._problem = graph, problem
        self._offered = milestones.possible, edges.free
        self._oracle: CoarseOracle = of_tuples(problem.oracle)
        self._glances = hasattr(problem.oracle, "edge_is_free_coarse")
        self._count, self._edges = len(graph.milestones), len(graph.edges)
        self._reach: list[float] = graph.reach.tolist()
        self._node = bytearray(milestones.verdicts.tobytes())
        self._piece = bytearray(edges.verdicts.tobytes())
        self._at_once, self._effort = 0, MAX_NODES
        self._extra: list[Configuration] = []
        self._joins: dict[int, list[Neighbour]] = {}
        self._ends_of: dict[int, tuple[int, int]] = {}  # the nodes of a joining edge
        self._shaded: set[int] = set()  # joining edges that pass near a collision of another
        self._on: dict[int, list[int]] = {}  # the nodes on an edge
        self.learned: Lessons = ({}, {})
        goals = problem.goals
        self._bound: list[float] = (
            np.array([distances(graph.milestones, goal) for goal in goals]).min(axis=0).tolist() if self._count else []
        )
        self._goals = [tuple(goal) for goal in goals.tolist()]
        self._ends = [self._new_end(tuple(problem.start.tolist())), *map(self._new_end, self._goals)]
        self._start = self._ends[0].node

    def route(self, carried: Carried | None = None) -> tuple[list[Configuration], int] | None:
        """The path and the goal it reaches; None if the roadmap has none."""
        while True:
            self._problem.poll()
            path = self._shortest() if self._may_meet() else None
            if path is None:
                if self._effort <= 0 or not self._widen():
                    return None
            elif self._is_free(path, carried):
                # places inside an edge, where the path neither joins nor leaves it, were never checked
                passed = {a for (*_, one), (a, _, two) in pairwise(path) if one == two}
                nodes = [self._start, *(node for _, node, _ in path)]
                points = [self._at(node) for node in nodes if node not in passed]
                fresh = [q for k, q in enumerate(points) if k == 0 or q != points[k - 1]]
                return fresh, nodes[-1] - self._start - 1

    def _at(self, node: int) -> Configuration:
        if node >= self._count:
            return self._extra[node - self._count]
        return tuple(self._graph.milestones[node].tolist())

    def _new_node(self, q: Configuration, verdict: Verdict) -> int:
        self._extra.append(q)
        self._node.append(verdict)
        self._bound.append(min(joint_distance(q, goal) for goal in self._goals))
        return self._count + len(self._extra) - 1

    def _new_end(self, q: Configuration) -> _End:
        waiting = nearest_places(self._graph, *self._offered, np.array(q))
        return _End(self._new_node(q, Verdict.FREE), q, waiting)

    def _may_meet(self) -> bool:
        """Whether the start and a goal are joined to one component; else the search would look everywhere in vain."""
        first, *others = (set(self._components(end)) for end in self._ends)
        return any(first & other for other in others)

    def _components(self, end: _End) -> Iterator[int]:
        for piece in end.open:
            node = self._ends_of[piece][1]
            at = (
                node if node < self._count else self._joins[node][0][0]
            )  # a place's first neighbours are the ends of its edge
            yield self._graph.component(at)

    def _widen(self) -> bool:
        """Join the ends to more places; False if there are none."""
        joined = len(self._ends_of)
        self._at_once += JOINS_AT_ONCE
        for end in self._ends:
            self._join(end)
        return len(self._ends_of) > joined

    def _join(self, end: _End) -> None:
        """Join an end to as many places as allowed at a time, those in the shadow of a collision last."""
        while len(end.open) < self._at_once and end.tried < MAX_JOINS:
            self._problem.poll()
            place = next(end.waiting, None)
            if place is None:
                if not end.shadowed:
                    return
                place = end.shadowed.pop(0)
            elif end.hits and self._in_shadow(end, place.q, end.hits):
                end.shadowed.append(place)
                continue
            self._join_to(end, place)

    def _join_to(self, end: _End, place: Place) -> None:
        end.tried += 1
        node = place.milestone if place.edge < 0 else self._place_node(place)
        piece = len(self._piece)
        self._piece.append(Verdict.FREE if place.q == end.q else Verdict.UNKNOWN)
        self._ends_of[piece] = (end.node, node)
        end.open.append(piece)
        self._link(end.node, node, joint_distance(end.q, place.q) + DETOUR * place.far, piece)

    def _place_node(self, place: Place) -> int:
        """A new node on an edge, joined along it to the edge's milestones and to other such nodes."""
        node, edge = self._new_node(place.q, Verdict.UNKNOWN), place.edge
        a, b = self._graph.edges[edge].tolist()
        for other in (a, b, *self._on.get(edge, ())):
            self._link(node, other, joint_distance(place.q, self._at(other)), edge)
        self._on.setdefault(edge, []).append(node)
        return node

    def _link(self, a: int, b: int, length: float, piece: int) -> None:
        self._joins.setdefault(a, []).append((b, length, piece))
        self._joins.setdefault(b, []).append((a, length, piece))

    def _in_shadow(self, end: _End, q: Configuration, hits: Iterable[Configuration]) -> bool:
        """Whether the edge from an end to q passes near collisions of other ones, given relative to that end."""
        along = self._moved(end, q)
        square = 0.0
        for x in along:
            square += x * x
        for hit in hits:
            dot = away = 0.0
            for x, y in zip(along, hit, strict=True):
                dot += x * y
            share = min(max(dot / square, 0.0), 1.0) if square > 0.0 else 0.0
            for x, y in zip(along, hit, strict=True):
                away += abs(y - share * x)
            if away < SHADOW:
                return True
        return False

    def _moved(self, end: _End, q: Configuration) -> Configuration:
        """The motion from an end to q, each joint in metres."""
        return tuple(r * (y - x) for r, x, y in zip(self._reach, end.q, q, strict=True))

    def _shortest(self) -> list[tuple[int, int, int]] | None:
        """Weighted A* (Pohl, 1970) over edges not known to be blocked: (from, to, piece) of each step.

        Of equal costs the smaller node wins.
        """
        start, bound, nodes, pieces, joins = self._start, self._bound, self._node, self._piece, self._joins
        count, around = self._count, self._graph.around
        last_end, best = start + len(self._goals), math.inf
        cost, parent = {start: 0.0}, {start: (start, -1)}
        front = [(GREED * bound[start], start, 0.0)]
        while front:
            _, node, spent = heapq.heappop(front)
            if spent > cost[node]:
                continue  # a shorter path to this node was found since
            if start < node <= last_end:
                return _traced(parent, node)
            self._effort -= 1
            if self._effort <= 0:
                return None
            if self._effort % NODES_PER_POLL == 0:
                self._problem.poll()
            near = around(node) if node < count else NO_NEIGHBOURS
            for other, length, piece in near + joins[node] if node in joins else near:
                total = spent + (length if pieces[piece] == FREE else UNKNOWN_AS * length)
                known = cost.get(other)
                if known is not None and known <= total:
                    continue
                least = total + GREED * bound[other]
                if total + bound[other] >= best or pieces[piece] == BLOCKED or nodes[other] == BLOCKED:
                    continue
                if start < other <= last_end:
                    best = total
                cost[other], parent[other] = total, (node, piece)
                heapq.heappush(front, (least, other, total))
        return None

    def _is_free(self, path: Sequence[tuple[int, int, int]], carried: Carried | None) -> bool:
        """Check what is unknown on a path: its milestones, then every piece coarsely, then the rest of each piece."""
        if carried is not None:
            self._carry(path, carried)
        if not all(self._milestone_is_free(node) for step in path for node in step[:2] if node < self._count):
            return False
        pieces = sorted({piece for *_, piece in path}, reverse=True)  # those that join the ends first
        pieces = [piece for piece in pieces if self._piece[piece] != Verdict.FREE]
        for judge in (self._seems_free, self._piece_is_free):
            for piece in pieces:
                if not judge(piece):
                    if piece >= self._edges:
                        self._join_anywhere(self._ends[self._ends_of[piece][0] - self._start])
                    return False
        return True

    def _carry(self, path: Sequence[tuple[int, int, int]], carried: Carried) -> None:
        """Keep what was free before and is proven untouched since."""
        nodes = sorted({n for step in path for n in step[:2] if self._node[n] == Verdict.FREE_BEFORE})
        pieces = sorted({piece for *_, piece in path if self._piece[piece] == Verdict.FREE_BEFORE})
        if not nodes and not pieces:
            return
        still = _still_free(self._graph, carried, nodes, pieces)
        for node, free in zip(nodes, still, strict=False):
            if free:
                self._learn_node(node, Verdict.FREE)
        for piece, free in zip(pieces, still[len(nodes) :], strict=True):
            if free:
                self._learn_piece(piece, Verdict.FREE)

    def _milestone_is_free(self, node: int) -> bool:
        if self._node[node] != Verdict.FREE:
            free = self._oracle.state_is_free(self._at(node))
            self._learn_node(node, Verdict.FREE if free else Verdict.BLOCKED)
        return self._node[node] == Verdict.FREE

    def _piece_ends(self, piece: int) -> tuple[Configuration, Configuration, int]:
        """The ends of a piece (for part of an edge those of the whole edge), and which of them are known to be free."""
        a, b = self._ends_of[piece] if piece >= self._edges else self._graph.edges[piece].tolist()
        known = (self._node[a] == Verdict.FREE) + 2 * (self._node[b] == Verdict.FREE)
        return self._at(a), self._at(b), known

    def _seems_free(self, piece: int) -> bool:
        if not self._glances:
            return self._piece_is_free(piece)
        a, b, known = self._piece_ends(piece)
        free = self._oracle.edge_is_free_coarse(a, b, known=KNOWN_ENDS[known])
        if not free:
            self._learn_piece(piece, Verdict.BLOCKED)
        return free

    def _piece_is_free(self, piece: int) -> bool:
        if self._piece[piece] != Verdict.FREE:
            a, b, known = self._piece_ends(piece)
            free = self._oracle.edge_is_free(a, b, known=KNOWN_ENDS[known])
            self._learn_piece(piece, Verdict.FREE if free else Verdict.BLOCKED)
        return self._piece[piece] == Verdict.FREE

    def _blocker(self) -> str | None:
        """The obstacle of the last collision."""
        return getattr(self._oracle, "blocker", None)

    def _learn_node(self, node: int, verdict: Verdict) -> None:
        self._node[node] = verdict
        if node < self._count:
            self.learned[0][node] = verdict, self._blocker() if verdict == Verdict.BLOCKED else None

    def _learn_piece(self, piece: int, verdict: Verdict) -> None:
        self._piece[piece] = verdict
        if piece >= self._edges:
            self._learn_joint(piece, verdict)
            return
        self.learned[1][piece] = verdict, self._blocker() if verdict == Verdict.BLOCKED else None
        if verdict == Verdict.FREE:
            for node in self._graph.edges[piece].tolist():
                if self._node[node] != Verdict.FREE:
                    self._learn_node(node, Verdict.FREE)

    def _learn_joint(self, piece: int, verdict: Verdict) -> None:
        """Enter the verdict on a joining edge; a blocked one is replaced by another."""
        end_node, node = self._ends_of[piece]
        if verdict == Verdict.FREE:
            self._paid(end_node, node, piece)
            if self._node[node] != Verdict.FREE:
                self._learn_node(node, Verdict.FREE)
            return
        end = self._ends[end_node - self._start]
        end.open.remove(piece)
        hit: EdgeHit | None = getattr(self._oracle, "last_hit", None)
        if hit is not None:
            moved = self._moved(end, self._at(node))
            end.hits.append(tuple(hit.fraction * x for x in moved))
            near = (
                piece for piece in end.open if self._in_shadow(end, self._at(self._ends_of[piece][1]), [end.hits[-1]])
            )
            self._shaded.update(near)
        self._join(end)

    def _paid(self, end: int, node: int, piece: int) -> None:
        """Let a joining edge that was checked cost no more than its length."""
        length = joint_distance(self._at(end), self._at(node))
        for at, other in ((end, node), (node, end)):
            self._joins[at] = [(other, length, piece) if row[2] == piece else row for row in self._joins[at]]

    def _join_anywhere(self, end: _End) -> None:
        """Check joining edges of an end, the most promising first, until one is free; before, no search succeeds."""
        while end.open and not any(self._piece[piece] == Verdict.FREE for piece in end.open):
            best = min(end.open, key=lambda piece: (*self._promise(end, piece), piece))
            if self._seems_free(best) and self._piece_is_free(best):
                return

    def _promise(self, end: _End, piece: int) -> tuple[bool, float]:
        """The sort key of a joining edge: whether a collision is near, then the length of a path over it."""
        node = self._ends_of[piece][1]
        length = next(row[1] for row in self._joins[end.node] if row[2] == piece)
        return piece in self._shaded, length + self._bound[node]


def _still_free(graph: Graph, carried: Carried, milestones: list[int], edges: list[int]) -> list[bool]:
    """Which of some milestones, and then of some edges, all free before, are proven to be free still."""
    rows = [(milestone, milestone) for milestone in milestones] + graph.edges[edges].tolist()
    points = graph.milestones[np.array(rows)]
    still: list[bool] = carried.still_free(points[:, 0], points[:, 1]).tolist()
    return still


def _traced(parent: dict[int, tuple[int, int]], node: int) -> list[tuple[int, int, int]]:
    steps = []
    while parent[node][1] >= 0:
        before, piece = parent[node]
        steps.append((before, node, piece))
        node = before
    return steps[::-1]
