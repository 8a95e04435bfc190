"""A roadmap as a value: milestones and edges, what is known of them, and for what that holds."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType, NoneType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.collision import CheckCounts
from planner_service.collision.budget import SearchStopped
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.validation import copied_in, instance, items, numbers
from planner_service.provided import Provided
from planner_service.roadmap.graph import Graph, checked_edges
from planner_service.roadmap.query import Carried, Query
from planner_service.roadmap.verdicts import Knowledge, Lesson, Terms, Verdict
from planner_service.search.problem import SearchProblem, SearchResult

__all__ = ["Built", "Roadmap", "RoadmapSearchResult"]

save_roadmap: Provided[[Roadmap, str | os.PathLike[str]], None] = Provided()
load_roadmap: Provided[[str | os.PathLike[str]], Roadmap] = Provided()

FCL_NOISE = 1e-5
"""Metres of padding, ten times the difference that rounding makes to what FCL finds apart."""


@dataclass(frozen=True)
class Built:
    """How a roadmap was grown.

    Attributes:
        planner: Name of the planner.
        settings: Its settings by name.
        seed: The seed it was given.
        counts: The checks that growing it took.
    """

    planner: str
    settings: Mapping[str, int]
    seed: int
    counts: CheckCounts

    def __post_init__(self) -> None:
        copied_in(self, "settings")


@dataclass(frozen=True, eq=False, repr=False)
class Roadmap:
    """Milestones, edges and the verdicts on them; as ``PlanRequest.planner`` it finds paths with few checks.

    A roadmap is a value that queries do not change. What a query learned is in ``result.roadmap``, another roadmap with
    another hash.

    Attributes:
        graph: The milestones and edges.
        milestone_knowledge: The verdicts on the milestones.
        edge_knowledge: The verdicts on the edges.
        terms: The robot, scene and settings for which the verdicts hold; None for those of the space it was grown in.
        pending: Obstacles against which FREE_BEFORE milestones and edges have not been checked.
        built: How it was grown; None if it was made from parts.
        fallback: Whether ``plan`` searches without it if the roadmap does not connect start and goal.
        remember: Whether ``plan`` adds the path it found to ``result.roadmap``, as milestones and edges.
    """

    graph: Graph
    milestone_knowledge: Knowledge
    edge_knowledge: Knowledge
    terms: Terms | None = None
    pending: tuple[str, ...] = ()
    built: Built | None = None
    fallback: bool = True
    remember: bool = False
    name: ClassVar[str] = "roadmap"
    patience: ClassVar[int | None] = None

    @classmethod
    def of(cls, milestones: ArrayLike, edges: ArrayLike = (), *, reach: ArrayLike | None = None) -> Roadmap:
        """A roadmap of unchecked milestones and edges.

        Args:
            milestones: Shape (N, n); a memory of paths starts with none, shape (0, n).
            edges: Shape (E, 2): the indices of the two milestones of each edge.
            reach: Cost of moving each joint, (n,), as ``Robot.reach``; the same for all if not given.

        Raises:
            InvalidRequest: A milestone is not finite, an edge joins a milestone that does not exist, or a reach is
                negative.
        """
        points = numbers("milestones", milestones, "finite joint values, one row per milestone")
        if points.ndim != 2 or not np.isfinite(points).all() or points.shape[1] == 0:
            raise InvalidRequest("milestones", points.shape, "finite joint values, one row per milestone")
        weights = np.ones(points.shape[1]) if reach is None else numbers("reach", reach, "positive numbers")
        if weights.shape != points.shape[1:] or not (np.isfinite(weights) & (weights >= 0.0)).all():
            raise InvalidRequest("reach", weights.tolist(), f"{points.shape[1]} numbers of at least 0")
        graph = Graph.of(points, checked_edges(edges, len(points)), read_only(weights))
        return cls(graph, Knowledge.none(len(points)), Knowledge.none(len(graph.edges)))

    @classmethod
    def judged(
        cls,
        milestones: ArrayLike,
        free: Sequence[tuple[int, int]],
        blocked: Mapping[tuple[int, int], str | None] = MappingProxyType({}),
        *,
        reach: ArrayLike | None = None,
    ) -> Roadmap:
        """A roadmap of free milestones (N, n) and checked edges.

        Args:
            free: The free edges.
            blocked: The blocked edges, each with the obstacle in the way, ``SELF``, or None if that is not known.
            reach: See ``of``.

        Raises:
            InvalidRequest: as ``of``.
        """
        instance("blocked", blocked, Mapping, "a mapping from edges to obstacles, SELF or None")
        judged: list[Any] = [*items("free", free, object, "edges"), *blocked]
        roadmap = cls.of(milestones, judged, reach=reach)
        obstacles = {(min(edge), max(edge)): blocker for edge, blocker in blocked.items()}
        verdicts: dict[int, Lesson] = {}
        for k, (a, b) in enumerate(roadmap.edges.tolist()):
            is_blocked = (a, b) in obstacles
            verdicts[k] = (Verdict.BLOCKED, obstacles[a, b]) if is_blocked else (Verdict.FREE, None)
        return roadmap.with_lessons(dict.fromkeys(range(len(roadmap.milestones)), (Verdict.FREE, None)), verdicts)

    def __post_init__(self) -> None:
        instance("graph", self.graph, Graph, "a Graph")
        for name in ("milestone_knowledge", "edge_knowledge"):
            instance(name, getattr(self, name), Knowledge, "Knowledge")
        instance("terms", self.terms, (Terms, NoneType), "Terms, or None")
        instance("built", self.built, (Built, NoneType), "Built, or None")
        copied_in(self, "pending")

    def __repr__(self) -> str:
        where = "" if self.terms is None else f" of {self.terms.robot} in {self.terms.scene}"
        return f"<Roadmap{where}: {len(self.milestones)} milestones, {len(self.edges)} edges>"

    @property
    def milestones(self) -> FloatArray:
        """Shape (N, n)."""
        return self.graph.milestones

    @property
    def edges(self) -> NDArray[np.int64]:
        """Shape (E, 2): indices of the two milestones of each edge, the smaller first."""
        return self.graph.edges

    @property
    def lengths(self) -> FloatArray:
        """L2 joint length of every edge, shape (E,)."""
        return self.graph.lengths

    @property
    def verdicts(self) -> NDArray[np.int8]:
        """The ``Verdict`` on each edge, shape (E,)."""
        return self.edge_knowledge.verdicts

    def search(self, problem: SearchProblem, *, carried: Carried | None = None) -> RoadmapSearchResult:
        """Search a short path over the roadmap from the start to any of the goals; the seed is ignored.

        Edges are checked only when a path needs them, those that join the start and goals always. A blocked one is
        left out, and the search repeated. The result's roadmap has what was learned, even if a limit of the checker
        ended the search, which is then in ``stopped``.

        Args:
            carried: Decides which FREE_BEFORE edges are free still; without it they are checked like others.
        """
        if problem.lower.size != self.graph.n:
            expected = f"a roadmap of {problem.lower.size} joints"
            raise InvalidRequest("planner", f"a roadmap of {self.graph.n} joints", expected)
        query = Query(self.graph, self.milestone_knowledge, self.edge_knowledge, problem)
        route, stopped = None, None
        try:
            route = query.route(carried)
        except SearchStopped as error:
            stopped = error.with_traceback(None)
        points, goal = (None, None) if route is None else (np.array(route[0]), route[1])
        note = f"{len(self.milestones)} milestones, {len(self.edges)} edges"
        return RoadmapSearchResult(points, goal, note, stopped, roadmap=self.with_lessons(*query.learned))

    @property
    def prepared(self) -> bool:
        """Whether ``prepare`` has little left to do."""
        return "compiled" in vars(self.graph.trunk)

    def prepare(self) -> None:
        """Build the lookup tables of queries, for all roadmaps made from this one; 100,000 milestones take 0.3 s."""
        _ = self.graph.compiled

    def with_lessons(self, milestones: Mapping[int, Lesson], edges: Mapping[int, Lesson]) -> Roadmap:
        """This roadmap with new verdicts on some of its milestones and edges, by their numbers."""
        if not milestones and not edges:
            return self
        return replace(
            self,
            milestone_knowledge=self.milestone_knowledge.with_lessons(milestones),
            edge_knowledge=self.edge_knowledge.with_lessons(edges),
        )

    def with_path(self, points: ArrayLike) -> Roadmap:
        """This roadmap with the waypoints of a free path (k, n) as milestones and its pieces as edges.

        Raises:
            InvalidRequest: The path is not two or more waypoints of n finite joint values.
        """
        rows = numbers("points", points, f"waypoints of {self.graph.n} joints")
        if rows.ndim != 2 or rows.shape[1] != self.graph.n or len(rows) < 2 or not np.isfinite(rows).all():
            raise InvalidRequest("points", rows.shape, f"two waypoints or more, shape (k, {self.graph.n})")
        graph, nodes, pieces = self.graph.with_path(rows)
        free: Lesson = (Verdict.FREE, None)
        return replace(self, graph=graph).with_lessons(dict.fromkeys(nodes, free), dict.fromkeys(pieces, free))

    def unknown_pieces(self, points: ArrayLike) -> list[tuple[FloatArray, FloatArray]]:
        """The pieces of a path (k, n) that are not edges known to be free, as pairs of waypoints."""
        rows = read_only(points)
        _, nodes, _ = self.graph.with_path(rows)
        count, free = len(self.milestones), self.verdicts == Verdict.FREE
        unknown = []
        for (a, b), piece in zip(pairwise(nodes), pairwise(rows), strict=True):
            known = a == b or (max(a, b) < count and any(row[0] == b and free[row[2]] for row in self.graph.around(a)))
            if not known:
                unknown.append(piece)
        return unknown

    def under(self, terms: Terms) -> Roadmap:
        """This roadmap under other terms, without the verdicts that may have changed.

        If only obstacles came, went or moved, what was free becomes FREE_BEFORE, and what one of them blocked
        BLOCKED_BEFORE. If anything else differs, all verdicts become UNKNOWN.
        """
        before = self.terms
        if before is not None and before.same(terms):
            return self
        nearer = before is not None and terms.padding < before.padding - FCL_NOISE
        pending, knowledge = self.pending, (self.milestone_knowledge, self.edge_knowledge)
        if before is not None and nearer and replace(before, padding=terms.padding).same(terms):
            milestones, edges = (known.nearer() for known in knowledge)
        elif before is None or not before.same_but_for_obstacles(terms):
            pending, (milestones, edges) = (), (known.elsewhere() for known in knowledge)
        else:
            come, gone = before.changed(terms)
            pending = tuple(sorted((come | set(self.pending)) & {name for name, _ in terms.obstacles}))
            milestones, edges = (known.after(come, gone, pending) for known in knowledge)
        return replace(self, milestone_knowledge=milestones, edge_knowledge=edges, terms=terms, pending=pending)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of everything that the answer to a query depends on, verdicts included; equal in every process."""
        content = hashlib.sha256(json.dumps(self.head, sort_keys=True).encode())
        for array in self.arrays.values():
            content.update(repr((array.shape, array.dtype.str)).encode())
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()

    @property
    def head(self) -> dict[str, Any]:
        """Everything but the arrays, as plain JSON values."""
        return {
            "terms": None if self.terms is None else asdict(self.terms),
            "pending": list(self.pending),
            "built": None if self.built is None else asdict(self.built) | {"counts": self.built.counts.named},
            "fallback": self.fallback,
            "remember": self.remember,
            "grown": list(self.graph.grown),
            "milestone_names": list(self.milestone_knowledge.names),
            "edge_names": list(self.edge_knowledge.names),
        }

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by their names in a file."""
        return {
            "milestones": self.milestones,
            "edges": self.edges,
            "reach": self.graph.reach,
            "milestone_verdicts": self.milestone_knowledge.verdicts,
            "milestone_blockers": self.milestone_knowledge.blockers,
            "edge_verdicts": self.edge_knowledge.verdicts,
            "edge_blockers": self.edge_knowledge.blockers,
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to an npz file, whole or not at all; ``load`` returns one with the same hash.

        Raises:
            InvalidFile: It cannot be written.
        """
        save_roadmap(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Roadmap:
        """The roadmap in a file that ``save`` wrote.

        Raises:
            InvalidFile: It is not such a file, it is truncated or was changed, or another version of the package wrote
                it.
        """
        return load_roadmap(path)


@dataclass(frozen=True, eq=False)
class RoadmapSearchResult(SearchResult):
    """The path that a search of a roadmap found, if any, and what it learned.

    Attributes:
        roadmap: The roadmap with the verdicts of the search.
    """

    roadmap: Roadmap = field(kw_only=True)
