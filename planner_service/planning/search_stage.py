"""Searching for a path, with retries, and shortening it: what happens when no straight line is free.

What a search leaves after many states may be hard, or it began badly. So each try of our own search gets twice what the
one before it had, and between them another planner, which fails elsewhere, gets a third of that.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count, islice, repeat

import numpy as np

from planner_service.certify import Certificate
from planner_service.collision import Cancelled, CollisionChecker, Known
from planner_service.collision.budget import CheckBudgetSpent, TimeBoxSpent
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.optimize import Optimise
from planner_service.path.joint_path import JointPath, polyline_length
from planner_service.planning.accounting import NoPlan, PlanContext, StageEntry
from planner_service.planning.collision_recovery import near
from planner_service.planning.endpoints import Ends, padded_ends
from planner_service.planning.kept_padding import free_but_for
from planner_service.planning.polishing import Rounds, search_nearer
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Reason, Stage
from planner_service.planning.roadmap_work import GROWERS, ask, grow
from planner_service.roadmap import Roadmap, Terms
from planner_service.search.planners import BalancedRRTConnect, RRTConnect
from planner_service.search.problem import ConstrainedOracle, Planner, SearchOracle, SearchProblem
from planner_service.smoothing.smoothing import (
    Draws,
    SeededDraws,
    pulled_in,
    shortcut,
    shortcut_on_constraints,
    without_short_pieces,
)

__all__ = [
    "FIRST_TRIES",
    "Candidates",
    "NoProgress",
    "SearchRound",
    "Tries",
    "alternating",
    "fresh_seed",
    "fresh_tries",
    "oracle_of",
    "remember",
    "retry_paddings",
    "roomier",
    "search",
    "search_again",
]

RETRY_PADDING, MIN_RETRY_PADDING = 0.003, 0.0005
"""Metres of padding with which another path is searched when one cannot be certified, one after the other if less was
requested. Edges are then sampled as closely: between two samples nothing comes nearer than half the padding."""

ROOMIER_STATES = 40_000
"""States that a search may check for a path with more padding than a line that is free keeps: the first two tries."""

MAX_WAYS = 16
"""Free lines away from an end that are tried for one on which only what is close comes closer than the padding."""

FIRST_TRIES, FIRST_STATES = 2, 40_000
"""Tries before they become longer, and the states of both; all of the states where there are fewer."""

LONG, LONG_OF_MANY, FEW_JOINTS = 1.6, 3.0, 7
"""Times the straight line that a path must be longer than for another search: of few joints, so many at most, and of
many. These are a third of the public paths of 6 to 14 joints; docs/guides/optimisation.md has the trade."""


@dataclass(frozen=True)
class SearchRound:
    """How a path is searched for.

    Attributes:
        number: 0 for the first; in the later ones a path was found before that could not be proven.
        padding: Metres that the path keeps from everything, except near ends that are closer.
        motion_step: Metres that nothing moves farther than between two samples of an edge; None to sample edges as the
            checker does.
    """

    number: int
    padding: float
    motion_step: float | None = None

    def checker(self, context: PlanContext, padding: float) -> CollisionChecker:
        """The checker with the padding, and with the samples of this round."""
        return context.checker.variant(padding=padding, motion_step=self.motion_step)

    def fits(self, roadmap: Roadmap, padding: float, request: PlanRequest) -> bool:
        """Whether edges judged in this round are what a roadmap knows: same padding, same samples."""
        return self.number == 0 and padding == (request.padding if roadmap.terms is None else roadmap.terms.padding)


@dataclass(frozen=True)
class Tries:
    """Which tries a search makes.

    Attributes:
        first: The number of the first; those before it found nothing.
        pause: The number of the try before which ``NoProgress`` is raised; None for no pause.
        states: States that those before the first have checked.
    """

    first: int = 0
    pause: int | None = None
    states: int = 0


class NoProgress(Exception):
    """Some tries found nothing; it is time for something else."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Polylines from the start to a goal, to be polished and proven in turn.

    Attributes:
        polylines: Shape (N, n) each.
        round: How they were searched.
        padding: Metres that they keep from everything, except near ends that are closer.
        searched: The same without what leads to ends that are closer; none for a straight line.
        oracle: What judged them.
    """

    polylines: tuple[FloatArray, ...]
    round: SearchRound
    padding: float
    searched: tuple[FloatArray, ...]
    oracle: SearchOracle | ConstrainedOracle


def oracle_of(
    context: PlanContext, checker: CollisionChecker, start: FloatArray, goals: Sequence[FloatArray]
) -> SearchOracle | ConstrainedOracle:
    """What a search from the start to the goals asks."""
    oracle = SearchOracle(checker, [start], goals)
    return oracle if context.accounting.projector is None else ConstrainedOracle(oracle, context.accounting.projector)


def retry_paddings(request: PlanRequest) -> tuple[float, ...]:
    """The paddings with which another path is searched, one after the other, when one cannot be proven."""
    return tuple(dict.fromkeys(max(padding, request.padding) for padding in (RETRY_PADDING, MIN_RETRY_PADDING)))


def roomier(context: PlanContext, ends: Ends, narrow: Candidates) -> Candidates:
    """What a short search finds with all of the padding but near the ends; without it, a line that keeps less.

    A line that is shorter than the ways from its ends to where there is room stays as it is.
    """
    accounting, ledger = context.accounting, context.checker.ledger
    left = ledger.time_left()
    deadline = None if left is None else time.monotonic() + left / 2.0
    try:
        with context.checker.ledger.limited(states=ROOMIER_STATES, deadline=deadline):
            leads = None
            if context.accounting.constraints is None:
                with accounting.during(Stage.SEARCH):
                    leads = _leads(context, ends, SearchRound(0, context.request.padding))
            if leads is not None and not _in_vain(ends, leads, narrow):
                return _searched(context, ends, SearchRound(0, context.request.padding), leads)
    except (CheckBudgetSpent, TimeBoxSpent) as stopped:
        if ledger.room() == 0:
            raise
        accounting.stopped_by(stopped)
    except NoPlan as no_plan:
        if no_plan.failure.reason is not Reason.PLANNING_FAILED:
            raise
    return narrow


def search(
    context: PlanContext, ends: Ends, searching: SearchRound | None = None, tries: Tries | None = None
) -> Candidates:
    """A path with the full padding, and after it the same before its corners were pulled in, should that be easier to
    prove. An end that is closer to something is left on a short line first.

    Raises:
        NoPlan: There is none.
        NoProgress: The tries come to a pause.
    """
    searching = SearchRound(0, context.request.padding) if searching is None else searching
    accounting = context.accounting
    leads = None
    if ends.padding != searching.padding and context.accounting.constraints is None:
        with accounting.during(Stage.SEARCH):
            leads = _leads(context, ends, searching)
    return _searched(context, ends, searching, leads, tries)


def _searched(
    context: PlanContext,
    ends: Ends,
    searching: SearchRound,
    leads: list[FloatArray] | None,
    tries: Tries | None = None,
) -> Candidates:
    """The same between given ``leads``; without them, with what all of the ends keep."""
    accounting = context.accounting
    start, *goals = leads or (ends.start, *(goal.q for goal in ends.goals))
    accounting.padding = ends.padding if leads is None else searching.padding
    oracle = oracle_of(context, searching.checker(context, accounting.padding), start, goals)
    problem, before = _problem(context, searching, start, goals, oracle), accounting.tally.states
    points = _search(context, searching, problem, oracle, Tries() if tries is None else tries)
    states = accounting.tally.states - before
    searched = _shortened(context, problem, oracle, states, points)
    if context.request.improve:
        searched = _improved(context, problem, oracle, states, searched)
    arrived = {tuple(q.tolist()): goal.q for goal, q in reversed([*zip(ends.goals, goals, strict=True)])}
    polylines = tuple(
        _without_repeats([ends.start, *points, arrived[tuple(points[-1].tolist())]]) for points in searched
    )
    return Candidates(polylines, searching, accounting.padding, searched, oracle)


def search_again(context: PlanContext, ends: Ends, searching: SearchRound, refused: Certificate) -> Candidates | None:
    """Another path, whose edges are sampled so closely that their padding proves them; None if none was found."""
    accounting = context.accounting
    accounting.retry(f"searched again with {searching.padding * 1000:g} mm of padding: {refused.refusal}")
    try:
        return search(context, padded_ends(context, ends, searching.padding), searching)
    except CheckBudgetSpent as spent:
        accounting.notes.append(f"no other path: {spent}")
    except NoPlan as no_plan:
        if no_plan.failure.reason is not Reason.PLANNING_FAILED:
            raise
        accounting.notes.append("no other path was found")
    return None


def remember(context: PlanContext, candidates: Candidates, turn: int) -> None:
    """Add the path that was searched and proven to the roadmap, if that is one that remembers paths."""
    roadmap, searching = context.accounting.roadmap, candidates.round
    if roadmap is None or not roadmap.remember or turn >= len(candidates.searched):
        return
    if not searching.fits(roadmap, candidates.padding, context.request):
        return
    points = candidates.searched[turn]
    roadmap = roadmap.under(Terms.of(searching.checker(context, candidates.padding)))
    pieces = roadmap.unknown_pieces(points)  # those of a longer edge, which was judged at other samples
    judged = not pieces
    if pieces:
        with context.accounting.during(Stage.ROADMAP, improving="remembered"):
            judged = all(candidates.oracle.edge_is_free(a, b) for a, b in pieces)
    if judged:
        context.accounting.roadmap = roadmap.with_path(points)


def _leads(context: PlanContext, ends: Ends, searching: SearchRound) -> list[FloatArray] | None:
    """Configurations near the ends, the start first, that keep the full padding and are a free line away from them.

    None if an end has none.
    """
    roomy = searching.checker(context, searching.padding)
    rng = np.random.default_rng([context.request.seed, 3])
    leads: list[FloatArray] = []
    for q, padding in [(ends.start, ends.start_padding), *((goal.q, goal.padding) for goal in ends.goals)]:
        if padding == searching.padding:
            leads.append(q)
            continue
        tight = SearchOracle(searching.checker(context, padding), [q], ())
        roomy_places = (p for p in near(q, roomy.robot.limits, rng) if roomy.state_is_free(p))
        close = roomy.touching(q)
        ways = (p for p in roomy_places if tight.edge_is_free(q, p, known=Known.BOTH))
        lead: FloatArray | None = None
        for p in islice(ways, MAX_WAYS):
            if _leaves(q, p, close, roomy):
                lead = p
                break
            lead = p if lead is None else lead
        if lead is None:
            return None
        leads.append(lead)
    return leads


def _leaves(q: FloatArray, p: FloatArray, close: frozenset[tuple[str, str]], roomy: CollisionChecker) -> bool:
    """Whether an end is left on a line on which only what is close to it comes closer than the padding."""
    line = JointPath(np.array([q, p]))
    return free_but_for(close, line, (0.0, line.length), roomy)


def _in_vain(ends: Ends, leads: list[FloatArray], narrow: Candidates) -> bool:
    """Whether a line is no longer than the ways from its ends to where there is room."""
    points = narrow.polylines[0]
    goal = next(k for k, goal in enumerate(ends.goals, start=1) if goal.q.tolist() == points[-1].tolist())
    aside = joint_distance(ends.start, leads[0]) + joint_distance(points[-1], leads[goal])
    return polyline_length(points) <= aside


@dataclass(frozen=True, eq=False)
class _Search:
    """A search that runs: what is searched, in which round and with which padding, and what its stage reports."""

    context: PlanContext
    round: SearchRound
    problem: SearchProblem
    padding: float
    entry: StageEntry
    tries: Tries


def _problem(
    context: PlanContext,
    searching: SearchRound,
    start: FloatArray,
    goals: Sequence[FloatArray],
    oracle: SearchOracle | ConstrainedOracle,
) -> SearchProblem:
    """What is searched from the start to one of the goals."""
    checker, tracer = context.checker, context.accounting.tracer
    lower, upper = checker.robot.limits.lower, checker.robot.limits.upper
    if context.accounting.constraints is not None:  # an end may be beyond a range by rounding
        lower = np.min([context.accounting.constraints.lower, start, *goals], axis=0)
        upper = np.max([context.accounting.constraints.upper, start, *goals], axis=0)
    return SearchProblem(
        start=start,
        goals=np.array(goals),
        lower=lower,
        upper=upper,
        oracle=oracle.inner if isinstance(oracle, ConstrainedOracle) else oracle,
        seed=fresh_seed(context.request.seed, FIRST_TRIES * searching.number),
        poll=checker.ledger.poll,
        reach=checker.reach,
        grown=None if tracer is None else tracer.grown,
        projector=context.accounting.projector,
    )


def _search(
    context: PlanContext,
    searching: SearchRound,
    problem: SearchProblem,
    oracle: SearchOracle | ConstrainedOracle,
    tries: Tries,
) -> FloatArray:
    """A path from the start to one of the goals, as the planner of the request finds it.

    Raises:
        NoPlan: It finds none.
        NoProgress: The tries come to a pause.
    """
    accounting, tracer = context.accounting, context.accounting.tracer
    planner = _planner(context, searching)
    with accounting.during(Stage.SEARCH) as entry:
        running = _Search(context, searching, problem, accounting.padding, entry, tries)
        try:
            if isinstance(planner, Roadmap):
                points = _over_roadmap(running, planner)
            else:
                points = _with_retries(running, planner)
        finally:
            alone = isinstance(planner, Roadmap) and not planner.fallback  # its motions are long: they tell nothing
            accounting.end_trouble = "" if alone else oracle.boxed_in()
        if points is None:
            raise NoPlan(accounting.gave_up())
        entry.length = polyline_length(points)
        if tracer is not None:
            tracer.searched(points)
        return points


def _planner(context: PlanContext, searching: SearchRound) -> Planner:
    """The planner of the request; for a PRM the roadmap that it grows, on its own budget of states."""
    planner = context.request.planner
    if isinstance(planner, Optimise):
        raise BrokenInvariant("an optimisation was asked to search")
    if not isinstance(planner, GROWERS):
        return planner
    with context.accounting.during(Stage.ROADMAP) as entry, context.checker.ledger.apart():
        checker = searching.checker(context, searching.padding)
        roadmap = replace(grow(planner, checker, seed=context.request.seed), fallback=False)
        entry.note = f"{planner.name}: {len(roadmap.milestones)} milestones, {len(roadmap.edges)} edges"
        if searching.number == 0:
            context.accounting.roadmap = roadmap
        return roadmap


def _with_retries(running: _Search, planner: Planner) -> FloatArray | None:
    """The path of the first try that finds one; None after some that ended by themselves without one.

    Raises:
        NoProgress: They come to a pause.
    """
    context, entry = running.context, running.entry
    checker, request, accounting = context.checker, context.request, context.accounting
    most, given_up = request.search_states, 0
    tries: Iterable[int] = (most,)
    if planner.patience is not None:
        tries = fresh_tries(most, request.retries, planner.patience)
    searchers = alternating(planner) if context.accounting.constraints is None else repeat(planner)
    spent: CheckBudgetSpent | None = None
    before = accounting.tally.states
    for attempt, (states, searcher) in enumerate(zip(tries, searchers, strict=False)):
        if attempt < running.tries.first:
            continue
        if attempt == running.tries.pause:
            raise NoProgress
        entry.note = searcher.name + (f", try {attempt + 1}" if attempt else "")
        accounting.attempt(entry.note)
        seed = fresh_seed(request.seed, attempt + FIRST_TRIES * running.round.number)
        left = max(0, most - running.tries.states - (accounting.tally.states - before))
        try:
            problem = running.problem if seed == running.problem.seed else replace(running.problem, seed=seed)
            with checker.ledger.limited(states=min(states, left)):
                result = searcher.search(problem)
        except CheckBudgetSpent as stopped:
            if left <= states or checker.ledger.room() == 0:
                raise
            spent = stopped
            continue
        if result.waypoints is not None:
            accounting.deterministic &= not isinstance(result.stopped, TimeBoxSpent | Cancelled)
            return result.waypoints
        spent, given_up = None, given_up + 1
        if request.retries is None and given_up == FIRST_TRIES:
            break
    if spent is not None:
        raise spent
    return None


def _over_roadmap(running: _Search, roadmap: Roadmap) -> FloatArray | None:
    """The path over a roadmap; without one, a search's, unless ``fallback`` is off."""
    points, entry = None, running.entry
    if (
        running.round.number == 0 and not running.tries.first
    ) or not roadmap.fallback:  # a roadmap knows nothing of edges sampled more closely
        points = _query(running, roadmap)
    if points is None and roadmap.fallback:
        note = f"{entry.note}; no path there: " if entry.note else ""
        try:
            points = _with_retries(running, BalancedRRTConnect())
        finally:
            entry.note = note + entry.note
    return points


def _query(running: _Search, roadmap: Roadmap) -> FloatArray | None:
    """A path over a roadmap; None if it has none, or has spent half of the states and may leave the rest."""
    context, entry = running.context, running.entry
    most = context.request.search_states
    states = most // 2 if roadmap.fallback else most
    context.accounting.attempt(roadmap.name)
    checker = running.round.checker(context, running.padding)
    with context.checker.ledger.limited(states=states):
        answer = ask(roadmap, checker, running.problem)
    entry.note = f"{roadmap.name}: {answer.note}"
    if running.round.fits(roadmap, running.padding, context.request):
        context.accounting.roadmap = answer.roadmap
    if answer.stopped is not None:
        if not roadmap.fallback or not isinstance(answer.stopped, CheckBudgetSpent):
            raise answer.stopped
        entry.note = f"{roadmap.name}: given up after {states:,} states"
    return answer.waypoints


def _shortened(
    context: PlanContext,
    problem: SearchProblem,
    oracle: SearchOracle | ConstrainedOracle,
    states: int,
    points: FloatArray,
) -> tuple[FloatArray, ...]:
    """The path cut short, or a shorter one that another search finds, its corners pulled in, and without those that
    leave no room for a blend; then as cut.
    """
    request, accounting, length = context.request, context.accounting, polyline_length(points)
    with accounting.during(Stage.SHORTCUT, improving="shortened") as entry:  # which may end it
        entry.length, rng = length, SeededDraws(request.seed, 1)
        points = _cut(points, oracle, rng)
        entry.length = length = polyline_length(points)
        planner = request.planner
        if isinstance(planner, BalancedRRTConnect) and problem.projector is None and _is_long(points, length):
            entry.note = f"searched again, {length:.2f} rad being long"
            other = search_nearer(context, planner, problem, length, states, 0)
            if other is not None:
                points = min(points, _cut(other, oracle, rng), key=polyline_length)
                entry.length = length = polyline_length(points)
    if accounting.tracer is not None:
        accounting.tracer.cut(points)
    if len(points) > 2:
        with accounting.during(Stage.POLISH, improving="tidied") as entry:
            entry.length = length
            pulled = _tidied(points, oracle, request.blend)
            entry.length = polyline_length(pulled)
            if pulled.tolist() != points.tolist():
                return pulled, points
    return (points,)


def _is_long(points: FloatArray, length: float) -> bool:
    """Whether a path from the start to a goal is so much longer than the straight line that another search may pay."""
    straight = polyline_length(points[[0, -1]])
    return length > (LONG if len(points[0]) <= FEW_JOINTS else LONG_OF_MANY) * straight


def _improved(
    context: PlanContext,
    problem: SearchProblem,
    oracle: SearchOracle | ConstrainedOracle,
    states: int,
    searched: tuple[FloatArray, ...],
) -> tuple[FloatArray, ...]:
    """The path that further searches make of the first that was searched; then those that were."""
    planner, blend = context.request.planner, context.request.blend
    if isinstance(planner, (Roadmap, *GROWERS, Optimise)):  # the same again would find the same
        planner = BalancedRRTConnect()

    def shortened(points: FloatArray, rng: np.random.Generator) -> FloatArray:
        cut = _cut(points, oracle, rng)
        return _tidied(cut, oracle, blend) if len(cut) > 2 else cut

    best = Rounds(context, planner, problem, oracle, states, shortened).improved(searched[0])
    return searched if best is searched[0] else (best, *searched)


def _cut(points: FloatArray, oracle: SearchOracle | ConstrainedOracle, rng: Draws) -> FloatArray:
    """A path with pieces replaced by straight edges that are free, and keep the constraints."""
    if isinstance(oracle, ConstrainedOracle):
        return shortcut_on_constraints(points, oracle, rng)
    return shortcut(points, oracle, rng)


def _tidied(points: FloatArray, oracle: SearchOracle | ConstrainedOracle, blend: float) -> FloatArray:
    """A path with its corners pulled in, and without those that leave no room for a blend."""
    pulled = pulled_in(points, oracle)
    return without_short_pieces(pulled, oracle) if blend > 0.0 else pulled


def alternating(planner: Planner) -> Iterator[Planner]:
    """The planner of each try: between those of our own search OMPL's RRTConnect, which fails elsewhere."""
    while True:
        yield planner
        if isinstance(planner, BalancedRRTConnect):
            yield RRTConnect()


def fresh_tries(states: int, retries: int | None, patience: int) -> Iterator[int]:
    """How many states each try may check, one after the other, without an end if ``retries`` is None.

    Args:
        states: What all of them may check.
        retries: ``PlanRequest.retries``; if given, all tries have equal parts, else every second one has
            a third of the one before it.
        patience: States that each try is to have at least.
    """
    if retries is not None:
        yield from repeat(max(1, states // (retries + 1), patience), retries + 1)
        return
    short = min(FIRST_STATES, states) // 4
    for turn in count():
        yield max(1, (short << turn) * 3, patience)
        yield max(1, short << turn, patience)


def fresh_seed(seed: int, attempt: int) -> int:
    """The seed of a try: the request's own for the first, an unrelated one for each retry."""
    if attempt == 0:
        return seed
    return int(np.random.SeedSequence([seed, attempt]).generate_state(1)[0])


def _without_repeats(points: Sequence[FloatArray]) -> FloatArray:
    rows = [q.tolist() for q in points]
    return np.array([q for k, q in enumerate(rows) if k == 0 or q != rows[k - 1]])
