"""What a service does with roadmaps: grow them, query them, and check again what a changed scene may have touched."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from planner_service.collision import CheckCounts, CollisionChecker
from planner_service.collision.edge_sampling import KNOWN_ENDS
from planner_service.collision.swept_bounds import Sweep
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import copied_in
from planner_service.roadmap import Built, Roadmap, Terms, Verdict
from planner_service.roadmap.planners import PRM, LazyPRM, PRMstar, Progress
from planner_service.roadmap.roadmap import RoadmapSearchResult
from planner_service.roadmap.verdicts import Knowledge, Lesson
from planner_service.robot.model import Robot
from planner_service.search.problem import SearchOracle, SearchProblem, SearchSpace

__all__ = ["GROWERS", "Grower", "RoadmapUpdate", "ask", "grow", "require_grower", "require_robot", "update"]

Grower = PRM | PRMstar | LazyPRM
GROWERS = (PRM, PRMstar, LazyPRM)

FREE, BLOCKED = int(Verdict.FREE), int(Verdict.BLOCKED)
BEFORE = (int(Verdict.FREE_BEFORE), int(Verdict.BLOCKED_BEFORE))


@dataclass(frozen=True, eq=False)
class RoadmapUpdate:
    """A roadmap brought up to date with its scene.

    Attributes:
        roadmap: All that was known in the old scene is known in the new one.
        changed: Obstacles that came, went or moved, sorted; empty if more than obstacles differed, or nothing.
        kept: Edges that were free and provably nowhere near what changed.
        judged: Edges checked again.
        fell: Edges that were free and are blocked now.
        rose: Edges that were blocked and are free now.
        counts: What this cost.
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
    """Raise for a planner that does not grow a roadmap."""
    if not isinstance(planner, GROWERS):
        raise InvalidRequest("planner", planner, "PRM(), PRMstar() or LazyPRM()")


def require_robot(roadmap: Roadmap, robot: Robot) -> None:
    """Raise for a roadmap whose joints are not those of a robot, or that goes beyond their limits."""
    names, limits = None if roadmap.terms is None else roadmap.terms.joint_names, robot.limits
    if names not in (None, robot.joint_names) or roadmap.graph.n != robot.n:
        known = f"{roadmap.graph.n} joints" if names is None else ", ".join(names)
        raise InvalidRequest("planner", f"a roadmap of {known}", f"one of {', '.join(robot.joint_names)}")
    low, high = roadmap.graph.span
    if len(roadmap.milestones) and not ((low >= limits.lower) & (high <= limits.upper)).all():
        raise InvalidRequest("planner", "a roadmap with milestones beyond the joint limits", f"one of {robot.name}")


def grow(planner: Grower, checker: CollisionChecker, *, seed: int, progress: Progress | None = None) -> Roadmap:
    """A roadmap of the free space as a checker sees it, with what growing it cost."""
    limits, tally = checker.robot.limits, checker.ledger.own
    before = tally.counts
    space = SearchSpace(limits.lower, limits.upper, SearchOracle(checker), checker.ledger.poll, checker.reach)
    roadmap = planner.grow(space, seed=seed, progress=progress)
    settings = {item.name: getattr(planner, item.name) for item in fields(planner)}
    built = Built(planner.name, settings, int(seed), tally.counts - before)
    return replace(roadmap, terms=Terms.of(checker), built=built)


def ask(roadmap: Roadmap, checker: CollisionChecker, problem: SearchProblem) -> RoadmapSearchResult:
    """A path over a roadmap. What a change of the scene may have touched is checked again where the path needs it."""
    current = _under(roadmap, checker)
    answer = current.search(problem, carried=Sweep(checker, current.pending) if current.pending else None)
    if current is roadmap or roadmap.terms is None:
        return answer
    changed = _changed(roadmap, current)
    if not changed:
        known = "" if current.verdicts.any() else ", judged under other terms: none is taken for known"
        return replace(answer, note=answer.note + known)
    fell = _both(current.verdicts, Verdict.FREE_BEFORE, answer.roadmap.verdicts, Verdict.BLOCKED)
    again = _both(current.verdicts, Verdict.FREE_BEFORE, answer.roadmap.verdicts, Verdict.FREE)
    note = f"{', '.join(changed)} changed: {again} edges found free again, {fell} fell"
    return replace(answer, note=f"{answer.note}; {note}")


def _under(roadmap: Roadmap, checker: CollisionChecker) -> Roadmap:
    """A roadmap with what it knows of the world in which a checker judges.

    Raises:
        InvalidRequest: Its joints are not those of the robot.
    """
    require_robot(roadmap, checker.robot)
    return roadmap.under(Terms.of(checker))


def _changed(roadmap: Roadmap, current: Roadmap) -> tuple[str, ...]:
    """The obstacles that came, went or moved since all of a roadmap was checked; none if more than obstacles differ."""
    changed = frozenset(current.pending)
    if roadmap.terms is not None and current.terms is not None and roadmap.terms.same_but_for_obstacles(current.terms):
        changed = changed.union(*roadmap.terms.changed(current.terms))
    return tuple(sorted(changed))


def update(roadmap: Roadmap, checker: CollisionChecker) -> RoadmapUpdate:
    """A roadmap brought up to date: everything it knew that may have changed is checked again."""
    tally = checker.ledger.own
    before = tally.counts
    current = _under(roadmap, checker)
    work = _Revision(current, checker)
    work.milestones(_open(roadmap.milestone_knowledge, current.milestone_knowledge))
    edges = work.edges(_open(roadmap.edge_knowledge, current.edge_knowledge))
    done = replace(current.with_lessons(*work.lessons), pending=())
    was, now = roadmap.verdicts, done.verdicts
    was_free = np.isin(was, (Verdict.FREE, Verdict.FREE_BEFORE))
    was_blocked = np.isin(was, (Verdict.BLOCKED, Verdict.BLOCKED_BEFORE))
    return RoadmapUpdate(
        done,
        _changed(roadmap, current),
        work.kept,
        edges - work.kept,
        int(np.count_nonzero(was_free & (now == BLOCKED))),
        int(np.count_nonzero(was_blocked & (now == FREE))),
        tally.counts - before,
    )


def _both(before: NDArray[np.int8], was: Verdict, after: NDArray[np.int8], now: Verdict) -> int:
    return int(np.count_nonzero((before == was) & (after == now)))


def _open(was: Knowledge, now: Knowledge) -> list[int]:
    """What was known once and is in doubt now."""
    doubtful = (was.verdicts != Verdict.UNKNOWN) & (now.verdicts != FREE) & (now.verdicts != BLOCKED)
    return [int(k) for k in np.flatnonzero(doubtful)]


class _Revision:
    """Checking what is in doubt: first all that is provably untouched, then the rest one by one."""

    def __init__(self, roadmap: Roadmap, checker: CollisionChecker) -> None:
        self._roadmap, self._oracle = roadmap, SearchOracle(checker)
        self._sweep = Sweep(checker, roadmap.pending) if roadmap.pending else None
        self._node = bytearray(roadmap.milestone_knowledge.verdicts.tobytes())
        self.lessons: tuple[dict[int, Lesson], dict[int, Lesson]] = ({}, {})
        self.kept = 0

    def milestones(self, doubtful: list[int]) -> None:
        """Check milestones."""
        points = self._roadmap.milestones
        for node, kept in self._swept(doubtful, self._roadmap.milestone_knowledge, points, points):
            free = kept or self._oracle.state_is_free(points[node])
            verdict = Verdict.FREE if free else Verdict.BLOCKED
            self._node[node] = verdict
            self.lessons[0][node] = verdict, None if free else self._oracle.blocker

    def edges(self, doubtful: list[int]) -> int:
        """Check the edges whose ends are not blocked; return how many those are."""
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

    def _swept(self, doubtful: list[int], known: Knowledge, A: FloatArray, B: FloatArray) -> list[tuple[int, bool]]:
        """Each of them, and whether it was free before and is provably untouched."""
        kept = dict.fromkeys(doubtful, False)
        before = [k for k in doubtful if known.verdicts[k] == Verdict.FREE_BEFORE]
        if self._sweep is not None and before:
            kept.update(zip(before, self._sweep.still_free(A[before], B[before]).tolist(), strict=True))
        return list(kept.items())
