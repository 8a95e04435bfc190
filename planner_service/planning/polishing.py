"""Better paths than the first: by optimising one, and by further searches.

An optimiser that has converged need not be free of collisions, so its optimum is checked.

With ``PlanRequest.improve``, each round searches with a fresh seed for a path that is not much longer than the best,
and shortens what it finds; then the best parts of the shortest paths are joined, and what that gains is shortened
again. A round has so many states, and no clock has a say in it: the same request gives the same path on any machine.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.collision import CollisionChecker, Contact, Known
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.optimize import Figures, Optimise, Optimum
from planner_service.path.joint_path import JointPath, polyline_length
from planner_service.planning.accounting import PlanContext
from planner_service.planning.result import Failure, ImproveReport, PolishReport, Reason, Stage
from planner_service.presentation.measures import outside_text
from planner_service.robot.model import Robot
from planner_service.search.problem import ConstrainedOracle, Planner, SearchOracle, SearchProblem
from planner_service.smoothing.joining import JoinedPaths

__all__ = ["Rounds", "Touch", "judged", "lines", "nearer", "not_free", "optimum_path", "search_nearer"]

SPACING = 0.01
"""Radians of path between samples of a curve that is not free, to report where it is not."""

NO_WORSE = 1e-3
"""Metres of missing clearance, summed along it, that a curve may have more than another."""

SAME = 1e-6
"""Share by which costs may differ through rounding alone."""

BENT = 0.5
"""How far the middle of a line may be displaced at random, in each joint: this share of its length, at least this many
radians."""

ENOUGH = 0.02
"""No round begins if less than this share of the length can be gained."""

JOINED, JUDGED = 4, 24
"""Paths that are joined, and edges that may be judged for it in a round."""

TIMES_THE_FIRST, LEAST_STATES, MOST_STATES = 3, 3_000, 20_000
"""What such a search may check: as often as the first search the states of that, within these."""

LONGER = 1.3
"""Times the best length that the path of such a search may have before it is shortened. With 1.0, 1.3 and 1.6, 16
rounds come within 1.34, 1.08 and 1.10 times the best known of 8 joints, and 1.82, 1.24 and 1.31 of 14 (p95)."""

SHARE = 0.5
"""The part of the time and the states left that all rounds may take; the rest is for blends and the proof."""


@dataclass(frozen=True)
class Touch:
    """Where and why a curve is not free.

    Attributes:
        share: Where, as a share of its length.
        contacts: What touches there, deepest first.
        what: The same in words, or which joint is outside its limits.
    """

    share: float
    contacts: tuple[Contact, ...]
    what: str

    def __str__(self) -> str:
        return f"at {self.share:.0%} of the way: {self.what}"


def optimum_path(
    settings: Optimise, points: FloatArray, checker: CollisionChecker, padded: CollisionChecker
) -> tuple[Optimum, Touch | None]:
    """The optimum of a polyline (N, n), and where it is in collision; None if it is free with the padding.

    Args:
        checker: Without padding: measures the distances.
        padded: Checks the optimum between its ends, as it would any other path.
    """
    optimum = settings.improved(points, checker)
    path = optimum.path
    outside = _outside(path, checker.robot)
    if outside is None and not padded.path_is_free(path, known=Known.BOTH):
        return optimum, _where(path, checker, padded)
    return optimum, outside


def _outside(path: JointPath, robot: Robot) -> Touch | None:
    """Where a corner of a curve is outside the joint limits. The curve stays in the hull of its corners."""
    lower, upper = robot.limits.lower, robot.limits.upper
    rows, joints = np.nonzero((path.waypoints < lower) | (path.waypoints > upper))
    if not len(rows):
        return None
    row, joint = int(rows[0]), int(joints[0])
    value, low, high = (float(x) for x in (path.waypoints[row, joint], lower[joint], upper[joint]))
    what = f"{robot.joint_names[joint]} = {outside_text(value, low, high)}"
    return Touch(float(path.knots[row]) / path.length, (), what)


def _where(path: JointPath, checker: CollisionChecker, padded: CollisionChecker) -> Touch:
    s = path.length * np.linspace(0.0, 1.0, max(2, math.ceil(path.length / SPACING)))
    hits = np.flatnonzero(~padded.states_are_free(path(s)[1:-1]))
    at = float(s[1 + hits[0]]) if len(hits) else 0.0
    contacts = (checker.contacts(path(at)) or padded.contacts(path(at))) if len(hits) else ()
    what = ", ".join(map(str, contacts)) or "something between the samples"
    return Touch(at / path.length, contacts, what)


def judged(settings: Optimise, optimum: Optimum, touch: Touch | None) -> PolishReport:
    """The report on an optimum, which is kept only if it is free and no worse than the path it was made from."""
    note = ""
    if touch is not None:
        note = f"the optimum is not free, {touch}"
    elif _worse(optimum.before, optimum.after):
        note = "the optimum is worse than the path it was made from"
    before, after = optimum.before, optimum.after
    return PolishReport(settings.method.name, not note, before, after, optimum.iterations, optimum.gradients, note)


def _worse(before: Figures, after: Figures) -> bool:
    """Whether more clearance is missing, or as much is missing and the cost is higher."""
    gained = before.shortfall - after.shortfall
    return gained < -NO_WORSE or (gained <= NO_WORSE and after.cost > before.cost * (1.0 + SAME))


def lines(ends: tuple[FloatArray, FloatArray], settings: Optimise, seed: int, robot: Robot) -> Iterator[FloatArray]:
    """What an optimisation without a path begins with: the straight line, then lines that bend at a random point."""
    start, goal = ends
    yield np.array([start, goal])
    aside = max(BENT, BENT * joint_distance(start, goal))
    for k in range(1, settings.starts):
        drawn = np.random.default_rng([seed, 4, k]).uniform(-aside, aside, len(start))
        middle = (start + goal) / 2.0 + drawn
        yield np.array([start, np.minimum(np.maximum(middle, robot.limits.lower), robot.limits.upper), goal])


def not_free(tried: Sequence[tuple[Touch | None, str]]) -> Failure:
    """The failure when no optimum of a line is free: for each, the straight one first, where it is not, and why."""
    detail = f"the optimum of the straight line is not free, {tried[0][1]}"
    detail += f"; nor are those of {len(tried) - 1} other lines" if len(tried) > 1 else ""
    detail += "; converged is not collision-free, and a search may find a way"
    contacts = next((touch.contacts for touch, _ in tried if touch is not None), ())
    return Failure(Stage.SEARCH, Reason.OPTIMUM_IN_COLLISION, detail, contacts)


@dataclass(frozen=True, eq=False)
class Rounds:
    """What each round searches, and with what.

    Attributes:
        planner: Finds a path.
        problem: What was searched first; a round has its own seed, and joints no farther than a shorter path goes.
        oracle: Judges edges.
        states: That the first search checked.
        shortened: A path (N, n) cut short, its corners pulled in.
    """

    context: PlanContext
    planner: Planner
    problem: SearchProblem
    oracle: SearchOracle | ConstrainedOracle
    states: int
    shortened: Callable[[FloatArray, np.random.Generator], FloatArray]

    def improved(self, points: FloatArray) -> FloatArray:
        """The shortest path that all rounds find, or the one given; shape (N, n). The result will say what came of it.

        Args:
            points: The path of the first search, shortened; (N, n).
        """
        accounting, ledger = self.context.accounting, self.context.checker.ledger
        start, goals = self.problem.start.tolist(), self.problem.goals.tolist()
        paths = JoinedPaths(self.oracle, JOINED)
        paths.add(points)
        length = polyline_length(points)
        report = ImproveReport(0, length, length, min(joint_distance(start, goal) for goal in goals))
        left, room = ledger.time_left(), ledger.room()
        deadline = None if left is None else time.monotonic() + SHARE * left
        limited = ledger.limited(states=None if room is None else int(SHARE * room), deadline=deadline)
        with accounting.during(Stage.IMPROVE, improving="improved further") as entry, limited:
            entry.length = report.before
            while report.rounds < self.context.request.improve and report.gain > ENOUGH:
                report = replace(report, rounds=report.rounds + 1)
                self._round(report.rounds, paths)
                entry.length = polyline_length(paths.shortest)
                report = replace(report, after=entry.length)
            entry.note = report.words
        accounting.improvement = replace(report, after=polyline_length(paths.shortest))
        return paths.shortest

    def _round(self, number: int, paths: JoinedPaths) -> None:
        """Search once more, and take in what that, and joining it with the others, gives."""
        seed = self.context.request.seed
        length = polyline_length(paths.shortest)
        points = search_nearer(self.context, self.planner, self.problem, length, self.states, number)
        if points is None:
            return
        rng = np.random.default_rng([seed, 6, number])
        paths.add(self.shortened(points, rng))
        joined = paths.joined(JUDGED)
        if joined is not paths.shortest:
            paths.add(self.shortened(joined, rng))


def search_nearer(
    context: PlanContext, planner: Planner, problem: SearchProblem, length: float, states: int, number: int
) -> FloatArray | None:
    """A path (N, n) that another search finds where there may be a shorter one; None if it finds none in its states.

    Args:
        problem: What was searched first.
        length: Of the shortest path that is known.
        states: That the first search checked.
        number: Searches of different numbers draw different samples.
    """
    ledger = context.checker.ledger
    seed = int(np.random.SeedSequence([context.request.seed, 5, number]).generate_state(1)[0])
    problem = replace(problem, seed=seed, grown=None)
    if problem.projector is None:
        problem = nearer(problem, length)
    try:
        with ledger.limited(states=min(MOST_STATES, max(LEAST_STATES, TIMES_THE_FIRST * states))):
            return planner.search(problem).waypoints
    except CheckBudgetSpent:
        if ledger.room() == 0:
            raise
        return None


def nearer(problem: SearchProblem, length: float) -> SearchProblem:
    """The same problem for paths no longer than ``LONGER`` times ``length``, in the box around all that is on them.

    Such a path stays in an ellipsoid with its ends as foci (Gammell et al., IROS 2014). Goals that are farther away
    than ``length`` are left out.
    """
    lower, upper = [problem.start], [problem.start]
    goals = [goal for goal in problem.goals if joint_distance(problem.start, goal) < length]
    longest = LONGER * length
    for goal in goals:
        way = goal - problem.start
        square = float(way @ way)
        widths = 0.5 * np.sqrt(way * way + (longest * longest - square))  # the root is the length of the other axes
        middle = 0.5 * (problem.start + goal)
        lower += [middle - widths, goal]
        upper += [middle + widths, goal]
    bounds = np.maximum(problem.lower, np.min(lower, axis=0)), np.minimum(problem.upper, np.max(upper, axis=0))
    return replace(problem, goals=np.array(goals), lower=bounds[0], upper=bounds[1], longest=longest)
