"""What a service does with roadmaps: grow them, tell them of a changed scene, ask them, in its checker's terms."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from planner_service.collision import CheckCounts, CollisionChecker
from planner_service.collision.edge_sampling import KNOWN_ENDS
from planner_service.collision.swept_bounds import Sweep
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import copied_in
from planner_service.roadmap import Built, Roadmap, Terms, Verdict
from planner_service.roadmap.planners import PRM, LazyPRM, PRMstar, Progress
from planner_service.roadmap.roadmap import RoadmapSearchResult
from planner_service.roadmap.verdicts import Knowledge, Lesson
from planner_service.robot.model import Robot
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem, SearchSpace

__all__ = ["GROWERS", "Grower", "RoadmapUpdate", "ask", "grow", "require_grower", "require_robot", "update"]

Grower = PRM | PRMstar | LazyPRM
GROWERS = (PRM, PRMstar, LazyPRM)

FREE, BLOCKED = int(Verdict.FREE), int(Verdict.BLOCKED)
BEFORE = (int(Verdict.FREE_BEFORE), int(Verdict.BLOCKED_BEFORE))


@dataclass(frozen=True, eq=False)
class RoadmapUpdate:
    """A roadmap that was told what its scene is now.

    Attributes:
        roadmap: All that was known before is known again.
        changed: Obstacles that came, went or moved, sorted; empty if more than obstacles differed, or nothing.
        kept: Edges that were free and are proven to be out of the way of what changed.
        judged: Edges judged again.
        fell: Edges that were free and are blocked now.
        rose: Edges that were blocked and are free now.
        counts: What this asked of the checker.
    """

    roadmap: Roadmap
    changed: tuple[str, ...]
    kept: int
    judged: int
    fell: int
    rose: int
    counts: CheckCounts

    def __post_init__(self) -> None:
        copied_in(self, "changed")

    def __str__(self) -> str:
        what = f"{', '.join(self.changed)} changed: " if self.changed else ""
        return (
            f"{what}{self.kept:,} edges kept without a check, {self.judged:,} judged, {self.fell:,} fell, "
            f"{self.rose:,} rose ({self.counts.states:,} states)"
        )


def require_grower(planner: object) -> None:
    """Refuse what grows no roadmap."""
    if not isinstance(planner, GROWERS):
        raise InvalidRequest("planner", planner, "PRM(), PRMstar() or LazyPRM()")


def require_robot(roadmap: Roadmap, robot: Robot) -> None:
    """Refuse a roadmap of other joints than a robot's, or beyond their limits."""
    names, limits = None if roadmap.terms is None else roadmap.terms.joint_names, robot.limits
    if names not in (None, robot.joint_names) or roadmap.net.n != robot.n:
        known = f"{roadmap.net.n} joints" if names is None else ", ".join(names)
        raise InvalidRequest("planner", f"a roadmap of {known}", f"one of {', '.join(robot.joint_names)}")
    low, high = roadmap.net.span
    if len(roadmap.milestones) and not ((low >= limits.lower) & (high <= limits.upper)).all():
        raise InvalidRequest("planner", "a roadmap with milestones beyond the joint limits", f"one of {robot.name}")


def grow(planner: Grower, checker: CollisionChecker, *, seed: int, progress: Progress | None = None) -> Roadmap:
    """A roadmap of the space in which a checker judges, with what growing it cost."""
    limits, before = checker.robot.limits, checker.counts
    space = SearchSpace(limits.lower, limits.upper, SearchOracle(checker), checker.ledger.poll, checker.reach)
    roadmap = planner.grow(space, seed=seed, progress=progress)
    settings = {item.name: getattr(planner, item.name) for item in fields(planner)}
    built = Built(planner.name, settings, int(seed), checker.counts - before)
    return replace(roadmap, terms=Terms.of(checker), built=built)


def ask(roadmap: Roadmap, checker: CollisionChecker, problem: SearchProblem) -> RoadmapSearchResult:
    """A path over a roadmap, which is first told of what changed; that is judged again where a path needs it."""
    here = _under(roadmap, checker)
    found = here.search(problem, carried=Sweep(checker, here.pending) if here.pending else None)
    if here is roadmap or roadmap.terms is None:
        return found
    changed = _changed(roadmap, here)
    if not changed:
        known = "" if here.verdicts.any() else ", judged under other terms: none is taken for known"
        return replace(found, note=found.note + known)
    fell = _both(here.verdicts, Verdict.FREE_BEFORE, found.roadmap.verdicts, Verdict.BLOCKED)
    again = _both(here.verdicts, Verdict.FREE_BEFORE, found.roadmap.verdicts, Verdict.FREE)
    told = f"{', '.join(changed)} changed: {again} edges found free again, {fell} fell"
    return replace(found, note=f"{found.note}; {told}")


def _under(roadmap: Roadmap, checker: CollisionChecker) -> Roadmap:
    """A roadmap in a checker's terms, within its robot's limits."""
    require_robot(roadmap, checker.robot)
    return roadmap.under(Terms.of(checker))


def _changed(roadmap: Roadmap, here: Roadmap) -> tuple[str, ...]:
    """The obstacles that came, went or moved since all of a roadmap was judged; none where more than these differ."""
    changed = frozenset(here.pending)
    if roadmap.terms is not None and here.terms is not None and roadmap.terms.same_but_for_obstacles(here.terms):
        changed = changed.union(*roadmap.terms.changed(here.terms))
    return tuple(sorted(changed))


def update(roadmap: Roadmap, checker: CollisionChecker) -> RoadmapUpdate:
    """A roadmap of which everything that was known, and may have changed, is known again."""
    before = checker.counts
    here = _under(roadmap, checker)
    work = _Revision(here, checker)
    work.milestones(_open(roadmap.milestone_knowledge, here.milestone_knowledge))
    edges = work.edges(_open(roadmap.edge_knowledge, here.edge_knowledge))
    done = replace(here.with_lessons(*work.lessons), pending=())
    was, now = roadmap.verdicts, done.verdicts
    was_free = np.isin(was, (Verdict.FREE, Verdict.FREE_BEFORE))
    was_blocked = np.isin(was, (Verdict.BLOCKED, Verdict.BLOCKED_BEFORE))
    return RoadmapUpdate(
        done,
        _changed(roadmap, here),
        work.kept,
        edges - work.kept,
        int(np.count_nonzero(was_free & (now == BLOCKED))),
        int(np.count_nonzero(was_blocked & (now == FREE))),
        checker.counts - before,
    )


def _both(before: np.ndarray, was: Verdict, after: np.ndarray, now: Verdict) -> int:  # type: ignore[type-arg]
    return int(np.count_nonzero((before == was) & (after == now)))


def _open(was: Knowledge, now: Knowledge) -> list[int]:
    """What was judged once and is in doubt now."""
    found = (was.verdicts != Verdict.UNKNOWN) & (now.verdicts != FREE) & (now.verdicts != BLOCKED)
    return [int(k) for k in np.flatnonzero(found)]


class _Revision:
    """Judging again what is in doubt: what is proven untouched first, then the rest one by one."""

    def __init__(self, roadmap: Roadmap, checker: CollisionChecker) -> None:
        self._roadmap, self._oracle = roadmap, SearchOracle(checker)
        self._sweep = Sweep(checker, roadmap.pending) if roadmap.pending else None
        self._node = bytearray(roadmap.milestone_knowledge.verdicts.tobytes())
        self.lessons: tuple[dict[int, Lesson], dict[int, Lesson]] = ({}, {})
        self.kept = 0

    def milestones(self, doubtful: list[int]) -> None:
        """Judge milestones."""
        points = self._roadmap.milestones
        for node, kept in self._swept(doubtful, self._roadmap.milestone_knowledge, points, points):
            free = kept or self._oracle.state_is_free(points[node])
            verdict = Verdict.FREE if free else Verdict.BLOCKED
            self._node[node] = verdict
            self.lessons[0][node] = verdict, None if free else self._oracle.blocker

    def edges(self, doubtful: list[int]) -> int:
        """Judge edges but those with an end that is blocked; how many these are."""
        ends, points = self._roadmap.edges, self._roadmap.milestones
        whole = [edge for edge in doubtful if BLOCKED not in (self._node[ends[edge, 0]], self._node[ends[edge, 1]])]
        for edge in sorted(set(doubtful) - set(whole)):
            blocked = next(node for node in ends[edge].tolist() if self._node[node] == BLOCKED)
            self.lessons[1][edge] = self._blocked_milestone(blocked)
        a, b = points[ends[:, 0]], points[ends[:, 1]]
        for edge, kept in self._swept(whole, self._roadmap.edge_knowledge, a, b):
            known = (self._node[ends[edge, 0]] == FREE) + 2 * (self._node[ends[edge, 1]] == FREE)
            free = kept or self._oracle.edge_is_free(a[edge], b[edge], known=KNOWN_ENDS[known])
            self.lessons[1][edge] = (Verdict.FREE, None) if free else (Verdict.BLOCKED, self._oracle.blocker)
            self.kept += kept
        return len(whole)

    def _blocked_milestone(self, node: int) -> Lesson:
        if node in self.lessons[0]:
            return self.lessons[0][node]
        knowledge = self._roadmap.milestone_knowledge
        name = int(knowledge.blockers[node])
        return Verdict.BLOCKED, None if name < 0 else knowledge.names[name]

    def _swept(self, some: list[int], known: Knowledge, A: np.ndarray, B: np.ndarray) -> list[tuple[int, bool]]:  # type: ignore[type-arg]
        """Each of some, and whether it was free before and is proven untouched."""
        kept = dict.fromkeys(some, False)
        before = [k for k in some if known.verdicts[k] == Verdict.FREE_BEFORE]
        if self._sweep is not None and before:
            kept.update(zip(before, self._sweep.still_free(A[before], B[before]).tolist(), strict=True))
        return list(kept.items())
