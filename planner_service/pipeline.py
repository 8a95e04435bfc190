"""One plan, stage by stage: what ``PlannerService.plan`` runs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planner_service.collision import CancelToken, CollisionChecker, Known
from planner_service.collision.checker import EdgeHit
from planner_service.collision.ledger import Cancelled, CheckBudgetSpent, TimeBoxSpent
from planner_service.endpoints import Endpoints, Ends
from planner_service.geometry import FloatArray
from planner_service.outcome import ExemptInterval, Failure, PlanResult, Reason, Stage
from planner_service.path import JointPath, Trajectory
from planner_service.planners import PRM, PRMstar
from planner_service.remedies import near
from planner_service.request import PlanRequest
from planner_service.robot import JointLimits
from planner_service.search import Planner, SearchProblem, SearchSpace, joint_distance
from planner_service.smoothing import shortcut
from planner_service.stagebook import Limits, NoPlan, StageBook
from planner_service.timing import Timing, TimingFailed
from planner_service.turns import Turns

__all__ = ["Run", "scaled", "timed"]

SEARCH_SHARE = 0.8
"""Part of ``max_checks`` that searching may use; the rest is kept for shortcutting and the last check."""

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
        a, b = tuple(q1.tolist()), tuple(q2.tolist())
        hit = self._checker.edge_hit(q1, q2, known=known)
        if hit is None:
            self._free_edges.add((a, b) if a <= b else (b, a))
        for end, configurations in (("start", self._starts), ("goal", self._goals)):
            if a in configurations or b in configurations:
                self._motions[end][hit is None] += 1
        return hit

    def proved(self, q1: FloatArray, q2: FloatArray) -> bool:
        """Whether this very edge was found free before, in either direction."""
        a, b = tuple(q1.tolist()), tuple(q2.tolist())
        return ((a, b) if a <= b else (b, a)) in self._free_edges

    def boxed_in(self) -> str:
        """Which end no motion could leave, as the end of a sentence; empty when both could be left."""
        return "".join(
            f"; none of the {tried[False]} motions tried at the {end} was free: it is boxed in"
            for end, tried in self._motions.items()
            if tried[False] >= TELLING_MOTIONS and not tried[True]
        )


class Run:
    """One call of ``plan``."""

    def __init__(self, checker: CollisionChecker, request: PlanRequest, cancel: CancelToken | None) -> None:
        self._checker = checker
        self._request = request
        self._search_states = max(1, int(request.max_checks * SEARCH_SHARE))
        self._book = StageBook(checker, Limits(request.max_checks, self._search_states, request.time_limit, cancel))
        self._endpoints = Endpoints(checker, request, self._book)
        self._oracles: list[SearchOracle] = []

    def result(self, turns: Turns) -> PlanResult:
        """Run the stages when the turn has come."""
        try:
            with self._book.within_limits(turns, padding=self._request.padding):
                return self._stages()
        except NoPlan as no_plan:
            return self._book.result(failure=no_plan.failure)

    def _stages(self) -> PlanResult:
        book = self._book
        with book.during(Stage.ENDPOINTS):
            ends = self._endpoints.find()
        book.padding = ends.padding
        if ends.arrived_at is not None:
            return self._nowhere_to_go(ends, ends.arrived_at)
        points = self._straight_line(ends)
        if points is None:
            points = self._searched(ends)
        path, goal_index, exempt = self._certified(points, ends)
        return book.result(path, self._timed(path), goal_index=goal_index, exempt=exempt)

    def _nowhere_to_go(self, ends: Ends, goal_index: int) -> PlanResult:
        self._book.notes.append("start and goal are the same configuration: nothing to do")
        path = JointPath(np.array([ends.begin]))
        return self._book.result(path, self._timed(path), goal_index=goal_index)

    def _timed(self, path: JointPath) -> Trajectory:
        request = self._request
        limits = scaled(self._checker.robot.limits, request.velocity_scale, request.acceleration_scale)
        return timed(path, request.timing, limits, self._book)

    def _oracle(self, padding: float, start: FloatArray, goals: Iterable[FloatArray]) -> SearchOracle:
        self._oracles.append(SearchOracle(self._checker.variant(padding=padding), [start], goals))
        return self._oracles[-1]

    def _straight_line(self, ends: Ends) -> FloatArray | None:
        oracle = self._oracle(ends.padding, ends.start, [goal.q for goal in ends.goals])
        with self._book.during(Stage.STRAIGHT_LINE) as entry:
            for goal in ends.goals:
                if goal.q.tolist() == ends.start.tolist():  # two ends of one retreat
                    return np.array([ends.start])
                hit = oracle.edge_hit(ends.start, goal.q, known=Known.BOTH)
                if hit is None:
                    entry.note, entry.length = "free", joint_distance(ends.start, goal.q)
                    return np.array([ends.start, goal.q])
                entry.note = entry.note or f"blocked at {hit.fraction:.0%}: {hit.a} x {hit.b}"
        return None

    def _searched(self, ends: Ends) -> FloatArray:
        """A path searched with the full padding; an end that is closer to something is left on a short line first."""
        book, request = self._book, self._request
        with book.during(Stage.SEARCH):
            leads = None if ends.padding == request.padding else self._leads(ends)
        start, goals = leads or (ends.start, tuple(goal.q for goal in ends.goals))
        if leads is not None:
            book.notes.append(
                f"an end is closer than {request.padding * 1000:g} mm to something: only near it less is kept"
            )
            book.padding = request.padding
        oracle = self._oracle(book.padding, start, goals)
        found = self._shortcut(self._search(start, goals, oracle), oracle)
        goal = next(g.q for g, q in zip(ends.goals, goals, strict=True) if q.tolist() == found[-1].tolist())
        points = [ends.start, *found, goal]
        return np.array([q for k, q in enumerate(points) if k == 0 or q.tolist() != points[k - 1].tolist()])

    def _leads(self, ends: Ends) -> tuple[FloatArray, tuple[FloatArray, ...]] | None:
        """Configurations near the ends that keep the full padding, a free line away; None if an end has none."""
        roomy = self._checker.variant(padding=self._request.padding)
        rng = np.random.default_rng([self._request.seed, 3])
        found: list[FloatArray] = []
        for q, padding in [(ends.start, ends.start_padding), *((goal.q, goal.padding) for goal in ends.goals)]:
            if padding == self._request.padding:
                found.append(q)
                continue
            tight = self._oracle(padding, q, ())
            close = (p for p in near(q, roomy.robot.limits, rng) if roomy.state_is_free(p))
            lead: FloatArray | None = next((p for p in close if tight.edge_is_free(q, p, known=Known.BOTH)), None)
            if lead is None:
                return None
            found.append(lead)
        return found[0], tuple(found[1:])

    def _search(self, start: FloatArray, goals: tuple[FloatArray, ...], oracle: SearchOracle) -> FloatArray:
        planner = self._grown(self._request.planner, oracle)
        limits = self._checker.robot.limits
        problem = SearchProblem(
            start=start,
            goals=np.array(goals),
            lower=limits.lower,
            upper=limits.upper,
            oracle=oracle,
            poll=self._checker.ledger.poll,
        )
        with self._book.during(Stage.SEARCH) as entry:
            try:
                points = self._tries(planner, problem)
            finally:
                self._book.end_trouble = oracle.boxed_in()
                entry.note = planner.name + (f", try {self._book.attempts}" if self._book.attempts > 1 else "")
            if points is None:
                raise NoPlan(self._book.gave_up())
            entry.length = _length(points)
            return points

    def _tries(self, planner: Planner, problem: SearchProblem) -> FloatArray | None:
        """Search until a try finds a path: each with a fresh seed and an equal share of the states.

        A search has a long tail, which a fresh start cuts off; one that would end well is over long before.
        """
        tries = 1 if planner.patience is None else self._request.retries + 1
        share = max(1, self._search_states // tries, planner.patience or 0)
        ledger = self._checker.ledger
        with self._checker.limited(states=self._search_states):
            for attempt in range(tries):
                self._book.attempts = attempt + 1
                seed = fresh_seed(self._request.seed, attempt)
                try:
                    with self._checker.limited(states=share):
                        found = planner.search(replace(problem, seed=seed))
                except CheckBudgetSpent:
                    if attempt + 1 == tries or ledger.room() == 0:
                        raise
                    continue
                if found.waypoints is not None:
                    self._book.deterministic &= not isinstance(found.stopped, TimeBoxSpent | Cancelled)
                    return found.waypoints
        return None

    def _grown(self, planner: Planner, oracle: SearchOracle) -> Planner:
        """The planner itself; for a PRM the roadmap it grows, on its own budget and outside the time box."""
        if not isinstance(planner, PRM | PRMstar):
            return planner
        ledger, limits = self._checker.ledger, self._checker.robot.limits
        with self._book.during(Stage.ROADMAP) as entry, ledger.apart(states=None):
            space = SearchSpace(limits.lower, limits.upper, oracle, ledger.poll)
            roadmap = planner.grow(space, seed=self._request.seed)
            entry.note = f"{planner.name}: {len(roadmap.milestones)} milestones, {len(roadmap.edges)} edges"
            return roadmap

    def _shortcut(self, points: FloatArray, oracle: SearchOracle) -> FloatArray:
        with self._book.during(Stage.SHORTCUT) as entry:
            try:
                points = shortcut(points, oracle, np.random.default_rng([self._request.seed, 1]))
            except (CheckBudgetSpent, TimeBoxSpent) as stopped:  # a path is in hand: a limit only ends its shortening
                self._book.deterministic &= isinstance(stopped, CheckBudgetSpent)
                entry.note = f"not shortened: {stopped}"
            entry.length = _length(points)
            return points

    def _certified(self, points: FloatArray, ends: Ends) -> tuple[JointPath, int, tuple[ExemptInterval, ...]]:
        """The whole path, each of its pieces judged, in this call, as exactly this piece."""
        with self._book.during(Stage.CERTIFY) as entry:
            for q1, q2 in pairwise(points):
                proved = any(oracle.proved(q1, q2) for oracle in self._oracles)
                if not proved and not self._checker.edge_is_free(q1, q2):
                    raise NoPlan(Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, "a piece of the final path collides"))
            goal = next(goal for goal in ends.goals if goal.q.tolist() == points[-1].tolist())
            robot, pieces, exempt = self._checker.robot, [points], []
            if ends.departure is not None:
                pieces.insert(0, robot.pose(ends.departure.pose)[None])
            if goal.arrival is not None:
                pieces.append(robot.pose(goal.arrival.pose)[None])
            path = JointPath(np.concatenate(pieces))
            if ends.departure is not None:
                s = joint_distance(robot.pose(ends.departure.pose), ends.departure.to)
                exempt.append(ExemptInterval(0.0, s, ends.departure.pairs, ends.departure.reason))
            if goal.arrival is not None:
                s = path.length - joint_distance(robot.pose(goal.arrival.pose), goal.arrival.to)
                exempt.append(ExemptInterval(s, path.length, goal.arrival.pairs, goal.arrival.reason))
            entry.length = path.length
            return path, goal.index, tuple(exempt)


def timed(path: JointPath, timing: Timing, limits: JointLimits, book: StageBook) -> Trajectory:
    """The path in time, as the TIMING stage.

    Raises:
        NoPlan: the timing law found no solution.
    """
    with book.during(Stage.TIMING) as entry:
        try:
            trajectory = timing.time_path(path, limits)
        except TimingFailed as failed:
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, str(failed))) from failed
        entry.note, entry.length = f"{timing.name}, {trajectory.duration:.2f} s", path.length
        return trajectory


def scaled(limits: JointLimits, velocity: float, acceleration: float) -> JointLimits:
    """Limits of which only parts in (0, 1] may be used; jerk shrinks with acceleration."""
    return replace(
        limits,
        velocity=limits.velocity * velocity,
        acceleration=limits.acceleration * acceleration,
        jerk=limits.jerk * acceleration,
    )


def fresh_seed(seed: int, attempt: int) -> int:
    """The seed of a try: the request's own for the first, an unrelated one for each retry."""
    if attempt == 0:
        return seed
    return int(np.random.SeedSequence([seed, attempt]).generate_state(1)[0])


def _length(points: FloatArray) -> float:
    return math.fsum(joint_distance(a, b) for a, b in pairwise(points.tolist()))
