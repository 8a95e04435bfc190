"""One plan, stage by stage: what ``PlannerService.plan`` runs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planner_service.certify import Certificate, Certifier, ExemptInterval
from planner_service.collision import CancelToken, CollisionChecker, Known
from planner_service.collision.budget import Cancelled, CheckBudgetSpent, TimeBoxSpent
from planner_service.collision.proximity import require_kernel
from planner_service.concurrency.fair_lock import Turns
from planner_service.concurrency.polling import Prepared, waited
from planner_service.errors import BrokenInvariant
from planner_service.geometry.shapes import FloatArray
from planner_service.optimize import Optimise, Optimum
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planners import RRTConnect
from planner_service.planning.accounting import Entry, Limits, NoPlan, StageBook, not_certified
from planner_service.planning.collision_recovery import near
from planner_service.planning.endpoints import Endpoints, Ends
from planner_service.planning.polishing import Touch, judged, lines, not_free, optimum_path
from planner_service.planning.request import Pace, PlanRequest
from planner_service.planning.result import MotionReport, PlanResult, Reason, Stage
from planner_service.planning.roadmap_work import GROWERS, ask, grow, require_robot
from planner_service.planning.timing_stage import timed
from planner_service.planning.tries import FIRST_TRIES, fresh_tries
from planner_service.roadmap import Roadmap, Terms
from planner_service.robot.model import ExemptRetreat
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import Planner, SearchProblem, joint_distance
from planner_service.search.trace import Tracer
from planner_service.smoothing.smoothing import blended, pulled_in, shortcut, without_short_pieces

__all__ = ["Run", "fresh_seed"]

SEARCH_SHARE = 0.8
"""Part of ``max_checks`` that one search may use; the rest is kept for shortcutting and blending."""

POLISH_SHARE = 0.7
"""Part of the time that is left which optimising may take; the rest is kept for the path as it was."""

ROOMIER, LEAST = 0.003, 0.0005
"""Metres of padding with which another path is searched when one cannot be certified, one after the other if less was
asked. Edges are then sampled as closely: between two samples nothing comes nearer than half the padding."""


@dataclass(frozen=True, eq=False)
class _Route:
    """A polyline from start to goal; corners at ``kept`` waypoints, where fixed ways out end, stay as they are."""

    path: JointPath
    goal_index: int
    kept: tuple[int, ...]
    exempt: tuple[ExemptInterval, ...]


class Run:
    """One call of ``plan``; with a ``tracer``, that takes down how its search goes."""

    def __init__(
        self,
        checker: CollisionChecker,
        certifier: Prepared[Certifier],
        request: PlanRequest,
        cancel: CancelToken | None,
    ) -> None:
        self.tracer: Tracer | None = None
        self._checker = checker
        self._certifier = certifier
        self._request = request
        self._search_states = max(1, int(request.max_checks * SEARCH_SHARE))
        self._book = StageBook(checker, Limits(request.max_checks, self._search_states, request.time_limit, cancel))
        self._endpoints = Endpoints(checker, request, self._book)
        self._padding = request.padding
        self._motion_step: float | None = None
        self._rounds = 0
        self._searched_paths: list[FloatArray] = []
        self._found_by = SearchOracle(checker)
        if request.optimise is not None:
            require_kernel("polish" if request.polish is not None else "planner", request.optimise)
        if isinstance(request.planner, Roadmap):
            require_robot(request.planner, checker.robot)
            self._book.roadmap = request.planner

    def result(self, turns: Turns) -> PlanResult:
        """Run the stages when the turn has come."""
        try:
            return self._book.within_limits(turns, self._stages)
        except NoPlan as no_plan:
            return self._book.result(failure=no_plan.failure, certificate=no_plan.certificate)

    def _stages(self) -> PlanResult:
        book = self._book
        if book.roadmap is not None:
            waited(book.roadmap.prepare)
        with book.during(Stage.ENDPOINTS):
            ends = self._endpoints.find()
        book.padding = ends.padding
        if ends.arrived_at is not None:
            return self._nowhere_to_go(ends, ends.arrived_at)
        points = self._straight_line(ends)
        if points is None and isinstance(self._request.planner, Optimise) and self._request.optimise is not None:
            return self._from_lines(ends, self._request.optimise)
        found = self._searched(ends) if points is None else [points]
        refused: Certificate | None = None
        roomier = dict.fromkeys(max(padding, self._request.padding) for padding in (ROOMIER, LEAST))
        for padding in (None, *roomier):
            if padding is not None and refused is not None:
                found = self._searched_again(ends, padding, refused)
            optimal = self._optimised(found, ends)
            if optimal is not None:
                return optimal
            for turn, points in enumerate(found):
                if turn and refused is not None:
                    book.notes.append(f"corners put back where they were: {refused.refusal}")
                route = self._route(points, ends)
                path, certificate = book.certified(self._certifier.get(), self._polished(route), route.exempt)
                if certificate.refusal is None:
                    self._remember(turn)
                    return self._closed(path, certificate, route.goal_index)
                refused = certificate
                if certificate.refusal.spent:
                    raise NoPlan(not_certified(refused), refused)
        if refused is None:
            raise BrokenInvariant("a path was neither proven nor refused")
        raise NoPlan(not_certified(refused), refused)

    def _remember(self, turn: int) -> None:
        """Let the roadmap gain the path that was searched and proven, if it is one that remembers."""
        roadmap, checker = self._book.roadmap, self._judge(self._book.padding)
        if roadmap is None or not roadmap.remember or not self._holds(roadmap) or turn >= len(self._searched_paths):
            return
        here, points = roadmap.under(Terms.of(checker)), self._searched_paths[turn]
        parts = here.unknown_pieces(points)  # those of a longer edge, which was judged at other samples
        judged = True
        if parts:
            judged = False
            with self._book.during(Stage.ROADMAP) as entry, self._optional(entry, "remembered"):
                judged = all(self._found_by.edge_is_free(a, b) for a, b in parts)
        if judged:
            self._book.roadmap = here.with_path(points)

    def _holds(self, roadmap: Roadmap) -> bool:
        """Whether what this round finds out is of what a roadmap is about: the padding it keeps, the step there is."""
        padding = self._request.padding if roadmap.terms is None else roadmap.terms.padding
        return self._rounds == 0 and self._book.padding == padding

    def _optimised(self, found: Sequence[FloatArray], ends: Ends) -> PlanResult | None:
        """The plan along the optimum of the path that was found, if that was asked for, and is free and proven."""
        settings, book = self._request.optimise, self._book
        if settings is None or not found or len(found[0]) < 2:
            return None
        optimum: Optimum | None = None
        left = self._checker.ledger.time_left()
        deadline = None if left is None else time.monotonic() + POLISH_SHARE * left
        limited = self._checker.limited(deadline=deadline)
        with book.during(Stage.POLISH) as entry, self._optional(entry, "optimised"), limited:
            optimum, touch = optimum_path(settings, found[0], self._checker, self._judge(ends.padding))
            if not optimum.iterations:
                return None
            book.polish = judged(settings, optimum, touch)
            entry.length, entry.note = _length(found[0]), book.polish.note
            if book.polish.kept:
                entry.length, entry.note = optimum.path.length, f"{settings.method.name}, {optimum.iterations} steps"
        if optimum is None or book.polish is None:
            book.notes.append(entry.note)
            return None
        if book.polish.kept:
            try:
                return self._proven(optimum, ends)
            except NoPlan as no_plan:
                why = no_plan.certificate and no_plan.certificate.refusal
                note = f"the optimum is not proven: {why}" if why else f"no motion along the optimum: {no_plan}"
                book.polish = replace(book.polish, kept=False, note=note)
        book.notes.append(f"not optimised: {book.polish.note}")
        return None

    def _from_lines(self, ends: Ends, settings: Optimise) -> PlanResult:
        """The plan along the first optimum of a line that is free and proven."""
        book, robot, tried = self._book, self._checker.robot, list[tuple[Touch | None, str]]()
        routes = [list(lines((ends.start, goal.q), settings, self._request.seed, robot)) for goal in ends.goals]
        for points in (route for turn in zip(*routes, strict=True) for route in turn):
            book.attempts += 1
            with book.during(Stage.SEARCH) as entry:
                optimum, touch = optimum_path(settings, points, self._checker, self._judge(ends.padding))
                report = judged(settings, optimum, touch)
                book.polish = replace(report, kept=True, note="") if touch is None else report
                entry.note = f"{settings.method.name}, {optimum.iterations} steps, start {book.attempts}"
                entry.length = optimum.path.length
            try:
                if touch is None:
                    return self._proven(optimum, ends)
                tried.append((touch, str(touch)))
            except NoPlan as no_plan:
                tried.append((None, str((no_plan.certificate and no_plan.certificate.refusal) or no_plan)))
            book.polish = replace(book.polish, kept=False, note=tried[-1][1])
        raise NoPlan(not_free(tried))

    def _proven(self, optimum: Optimum, ends: Ends) -> PlanResult:
        """The plan along an optimum as it was judged: no blend is made narrower, and none a stop.

        Raises:
            NoPlan: it is not proven, or the timing law has no solution.
        """
        course = optimum.path
        route = self._route(course.waypoints, ends)
        blends = np.zeros(len(route.path.waypoints))
        first = 1 if ends.departure is not None else 0
        blends[first : first + len(course.blends)] = course.blends
        path = route.path.with_blends(blends)
        certificate = self._book.certificate(self._certifier.get(), path, route.exempt)
        if not certificate.certified:
            raise NoPlan(not_certified(certificate), certificate)
        moving = self._timed(path)
        self._remember(0)
        if ends.padding < self._book.padding:
            self._book.notes.append(f"the optimum was judged with {ends.padding * 1000:g} mm all along")
            self._book.padding = ends.padding
        return self._book.result(path, moving, goal_index=route.goal_index, certificate=certificate)

    def _closed(self, path: JointPath, certificate: Certificate, goal_index: int) -> PlanResult:
        """The proven path in time; with stops instead of blends in the rare case that this is faster."""
        moving = self._timed(path)
        if moving[1].duration > moving[1].stop_duration:
            with suppress(NoPlan), self._optional(Entry(), "compared with stops"):  # what is in hand is a plan, too
                sharp, proof = self._book.certified(self._certifier.get(), path.with_blends(None), certificate.exempt)
                stopping = self._timed(sharp)
                if proof.certified and stopping[1].duration < moving[1].duration:
                    path, certificate, moving = sharp, proof, stopping
                    self._book.notes.append("stops at the corners are faster here than blends: none was kept")
        return self._book.result(path, moving, goal_index=goal_index, certificate=certificate)

    def _nowhere_to_go(self, ends: Ends, goal_index: int) -> PlanResult:
        self._book.notes.append("start and goal are the same configuration: nothing to do")
        path = JointPath(np.array([ends.begin]))
        exempt = [] if ends.departure is None else [self._exempt(0.0, 0.0, ends.departure)]
        certificate = self._book.certificate(self._certifier.get(), path, exempt)
        if not certificate.certified:
            raise NoPlan(not_certified(certificate), certificate)
        return self._book.result(path, self._timed(path), goal_index=goal_index, certificate=certificate)

    def _timed(self, path: JointPath) -> tuple[Trajectory, MotionReport]:
        return timed(path, Pace.of(self._request), self._checker.robot, self._book)

    def _oracle(self, padding: float, start: FloatArray, goals: Iterable[FloatArray]) -> SearchOracle:
        return SearchOracle(self._judge(padding), [start], goals)

    def _judge(self, padding: float) -> CollisionChecker:
        return self._checker.variant(padding=padding, motion_step=self._motion_step)

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

    def _searched(self, ends: Ends) -> list[FloatArray]:
        """A path searched with the full padding, and what it was before its corners were pulled in, should that be
        easier to prove; an end that is closer to something is left on a short line first.
        """
        book, padding = self._book, self._padding
        with book.during(Stage.SEARCH):
            leads = None if ends.padding == padding else self._leads(ends)
        start, goals = leads or (ends.start, tuple(goal.q for goal in ends.goals))
        if leads is not None:
            book.notes.append(f"an end is closer than {padding * 1000:g} mm to something: only near it less is kept")
        book.padding = ends.padding if leads is None else padding
        oracle = self._found_by = self._oracle(book.padding, start, goals)
        found = self._searched_paths = self._shortened(self._search(start, goals, oracle), oracle)
        goal = next(g.q for g, q in zip(ends.goals, goals, strict=True) if q.tolist() == found[0][-1].tolist())
        return [_without_repeats([ends.start, *points, goal]) for points in found]

    def _searched_again(self, ends: Ends, padding: float, refused: Certificate) -> list[FloatArray]:
        """Another path, whose edges are sampled so closely that their padding proves them, if one is found."""
        self._book.notes.append(f"searched again with {padding * 1000:g} mm of padding: {refused.refusal}")
        self._padding = self._motion_step = padding
        self._rounds += 1
        try:
            with self._book.during(Stage.ENDPOINTS):
                ends = self._endpoints.padded(ends, padding)
            return self._searched(ends)
        except CheckBudgetSpent as spent:
            self._book.notes.append(f"no other path: {spent}")
        except NoPlan as no_plan:
            if no_plan.failure.reason is not Reason.PLANNING_FAILED:
                raise
            self._book.notes.append("no other path was found")
        return []

    def _leads(self, ends: Ends) -> tuple[FloatArray, tuple[FloatArray, ...]] | None:
        """Configurations near the ends that keep the full padding, a free line away; None if an end has none."""
        roomy = self._judge(self._padding)
        rng = np.random.default_rng([self._request.seed, 3])
        found: list[FloatArray] = []
        for q, padding in [(ends.start, ends.start_padding), *((goal.q, goal.padding) for goal in ends.goals)]:
            if padding == self._padding:
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
        if isinstance(self._request.planner, Optimise):
            raise BrokenInvariant("an optimisation was asked to search")
        planner = self._grown(self._request.planner)
        limits = self._checker.robot.limits
        problem = SearchProblem(
            start=start,
            goals=np.array(goals),
            lower=limits.lower,
            upper=limits.upper,
            oracle=oracle,
            poll=self._checker.ledger.poll,
            reach=self._checker.reach,
            grown=None if self.tracer is None else self.tracer.grown,
        )
        with self._book.during(Stage.SEARCH) as entry:
            try:
                points = self._found(planner, problem, entry)
            finally:
                alone = isinstance(planner, Roadmap) and not planner.fallback  # its motions are long: they tell nothing
                self._book.end_trouble = "" if alone else oracle.boxed_in()
            if points is None:
                raise NoPlan(self._book.gave_up())
            entry.length = _length(points)
            if self.tracer is not None:
                self.tracer.searched(points)
            return points

    def _tries(self, planner: Planner, problem: SearchProblem, entry: Entry) -> FloatArray | None:
        """Search until a try finds a path; None after some that ended by themselves without one."""
        ledger, retries, given_up = self._checker.ledger, self._request.retries, 0
        tries: Iterable[int] = (self._search_states,)
        if planner.patience is not None:
            tries = fresh_tries(self._search_states, retries, planner.patience)
        spent: CheckBudgetSpent | None = None
        with self._checker.limited(states=self._search_states):
            for attempt, states in enumerate(tries):
                self._book.attempts += 1
                entry.note = planner.name + (f", try {attempt + 1}" if attempt else "")
                seed = fresh_seed(self._request.seed, attempt + FIRST_TRIES * self._rounds)
                try:
                    with self._checker.limited(states=states):
                        found = planner.search(replace(problem, seed=seed))
                except CheckBudgetSpent as stopped:
                    if ledger.room() == 0:
                        raise
                    spent = stopped
                    continue
                if found.waypoints is not None:
                    self._book.deterministic &= not isinstance(found.stopped, TimeBoxSpent | Cancelled)
                    return found.waypoints
                spent, given_up = None, given_up + 1
                if retries is None and given_up == FIRST_TRIES:
                    break
        if spent is not None:
            raise spent
        return None

    def _grown(self, planner: Planner) -> Planner:
        """The planner itself; for a PRM the roadmap it grows, on its own budget of states."""
        if not isinstance(planner, GROWERS):
            return planner
        with self._book.during(Stage.ROADMAP) as entry, self._checker.ledger.apart():
            roadmap = replace(grow(planner, self._judge(self._padding), seed=self._request.seed), fallback=False)
            entry.note = f"{planner.name}: {len(roadmap.milestones)} milestones, {len(roadmap.edges)} edges"
            if self._rounds == 0:
                self._book.roadmap = roadmap
            return roadmap

    def _found(self, planner: Planner, problem: SearchProblem, entry: Entry) -> FloatArray | None:
        """The path a planner finds; where a roadmap has none, RRTConnect's, unless it is to do without."""
        if not isinstance(planner, Roadmap):
            return self._tries(planner, problem, entry)
        points = None
        if self._rounds == 0 or not planner.fallback:  # a roadmap knows nothing of edges sampled more closely
            points = self._over(planner, problem, entry)
        if points is None and planner.fallback:
            note = f"{entry.note}; no path there: " if entry.note else ""
            try:
                points = self._tries(RRTConnect(), problem, entry)
            finally:
                entry.note = note + entry.note
        return points

    def _over(self, roadmap: Roadmap, problem: SearchProblem, entry: Entry) -> FloatArray | None:
        """A path over a roadmap; None if it has none, or has spent half of the states and may leave the rest."""
        self._book.attempts += 1
        checker = self._judge(self._book.padding)
        room = self._search_states // 2 if roadmap.fallback else self._search_states
        with self._checker.limited(states=room):
            found = ask(roadmap, checker, problem)
        entry.note = f"{roadmap.name}: {found.note}"
        if self._holds(roadmap):
            self._book.roadmap = found.roadmap
        if found.stopped is not None:
            if not roadmap.fallback or not isinstance(found.stopped, CheckBudgetSpent):
                raise found.stopped
            entry.note = f"{roadmap.name}: given up after {room:,} states"
        return found.waypoints

    def _shortened(self, points: FloatArray, oracle: SearchOracle) -> list[FloatArray]:
        """The path cut short, its corners pulled in, and without those that leave no room for a blend; then as cut."""
        with self._book.during(Stage.SHORTCUT) as entry, self._optional(entry, "shortened"):
            entry.length = _length(points)
            points = shortcut(points, oracle, np.random.default_rng([self._request.seed, 1]))
            entry.length = _length(points)
        if self.tracer is not None:
            self.tracer.cut(points)
        found = [points]
        if len(points) > 2:
            with self._book.during(Stage.POLISH) as entry, self._optional(entry, "tidied"):
                entry.length = _length(points)
                pulled = pulled_in(points, oracle)
                if self._request.blend > 0.0:
                    pulled = without_short_pieces(pulled, oracle)
                entry.length = _length(pulled)
                if pulled.tolist() != points.tolist():
                    found.insert(0, pulled)
        return found

    @contextmanager
    def _optional(self, entry: Entry, what: str) -> Iterator[None]:
        """A path is in hand: a limit only ends its improvement."""
        try:
            yield
        except (CheckBudgetSpent, TimeBoxSpent) as stopped:
            self._book.deterministic &= isinstance(stopped, CheckBudgetSpent)
            entry.note = f"not {what}: {stopped}"

    def _route(self, points: FloatArray, ends: Ends) -> _Route:
        """The whole way, with the fixed ways out of a pose and into one."""
        goal = next(goal for goal in ends.goals if goal.q.tolist() == points[-1].tolist())
        robot, pieces, kept = self._checker.robot, [points], []
        exempt: list[ExemptInterval] = []
        if ends.departure is not None:
            pieces.insert(0, robot.pose(ends.departure.pose)[None])
            kept.append(1)
        if goal.arrival is not None:
            pieces.append(robot.pose(goal.arrival.pose)[None])
        path = JointPath(np.concatenate(pieces))
        if ends.departure is not None:
            exempt.append(self._exempt(0.0, float(path.knots[1]), ends.departure))
        if goal.arrival is not None:
            kept.append(len(path.waypoints) - 2)
            exempt.append(self._exempt(float(path.knots[-2]), path.length, goal.arrival))
        return _Route(path, goal.index, tuple(kept), tuple(exempt))

    def _exempt(self, s_start: float, s_end: float, retreat: ExemptRetreat) -> ExemptInterval:
        pairs = self._checker.parts.labels.links(retreat.pairs)
        return ExemptInterval(s_start, s_end, pairs, retreat.reason)

    def _polished(self, route: _Route) -> JointPath:
        """The route with its corners blended as widely as is free with the padding of the search."""
        path, size = route.path, self._request.blend
        if size == 0.0 or not set(path.corners) - set(route.kept):
            return path
        with self._book.during(Stage.POLISH) as entry, self._optional(entry, "blended"):
            entry.length = path.length
            sizes = np.full(len(path.waypoints), size)
            sizes[list(route.kept)] = 0.0
            path = blended(path, self._judge(self._book.padding).blend_is_free, sizes)
            corners, stops = len(route.path.corners), len(path.corners)
            entry.note = f"{corners - stops} of {corners} corners blended"
        return path


def _without_repeats(points: Sequence[FloatArray]) -> FloatArray:
    return np.array([q for k, q in enumerate(points) if k == 0 or q.tolist() != points[k - 1].tolist()])


def fresh_seed(seed: int, attempt: int) -> int:
    """The seed of a try: the request's own for the first, an unrelated one for each retry."""
    if attempt == 0:
        return seed
    return int(np.random.SeedSequence([seed, attempt]).generate_state(1)[0])


def _length(points: FloatArray) -> float:
    return math.fsum(joint_distance(a, b) for a, b in pairwise(points.tolist()))
