"""Shorter paths with effort that is left: ``PlanRequest.improve``.

Each round searches with a fresh seed, where a path can be shorter at all, and shortens what it finds; then the best
parts of the shortest paths are joined, and what that gains is shortened again. A round has so many states, and no clock
has a say in it: the same request gives the same path on any machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from planner_service.collision.budget import CheckBudgetSpent
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.path.joint_path import polyline_length
from planner_service.planning.accounting import PlanContext
from planner_service.planning.result import ImproveReport, Stage
from planner_service.search.problem import ConstrainedOracle, Planner, SearchOracle, SearchProblem
from planner_service.smoothing.joining import JoinedPaths

__all__ = ["Rounds", "nearer"]

ENOUGH = 0.02
"""No round begins if less than this share of the length can be gained."""

JOINED, JUDGED = 4, 24
"""Paths that are joined, and edges that may be judged for it in a round."""

TIMES_THE_FIRST, LEAST_STATES = 3, 3_000
"""What the search of a round may check: as often as the first search the states of that, at least so many."""

SHARE = 0.5
"""The part of the time and the states left that all rounds may take; the rest is for blends and the proof."""


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
        points = self._searched(int(np.random.SeedSequence([seed, 5, number]).generate_state(1)[0]), paths.shortest)
        if points is None:
            return
        rng = np.random.default_rng([seed, 6, number])
        paths.add(self.shortened(points, rng))
        joined = paths.joined(JUDGED)
        if joined is not paths.shortest:
            paths.add(self.shortened(joined, rng))

    def _searched(self, seed: int, best: FloatArray) -> FloatArray | None:
        """A path that is found where one shorter than the best can be; None if there was none within the states."""
        ledger = self.context.checker.ledger
        problem = replace(self.problem, seed=seed, grown=None)
        if self.problem.projector is None:
            problem = nearer(problem, polyline_length(best))
        try:
            with ledger.limited(states=max(LEAST_STATES, TIMES_THE_FIRST * self.states)):
                return self.planner.search(problem).waypoints
        except CheckBudgetSpent:
            if ledger.room() == 0:
                raise
            return None


def nearer(problem: SearchProblem, length: float) -> SearchProblem:
    """The same problem, in the box around all that is on a path shorter than ``length`` (Gammell et al., IROS 2014).

    Such a path stays in an ellipsoid with its ends as foci. Goals that are farther away are left out.
    """
    lower, upper = [problem.start], [problem.start]
    goals = [goal for goal in problem.goals if joint_distance(problem.start, goal) < length]
    for goal in goals:
        way = goal - problem.start
        square = float(way @ way)
        widths = 0.5 * np.sqrt(way * way + (length * length - square))  # of an ellipsoid with axes length and that root
        middle = 0.5 * (problem.start + goal)
        lower += [middle - widths, goal]
        upper += [middle + widths, goal]
    bounds = np.maximum(problem.lower, np.min(lower, axis=0)), np.minimum(problem.upper, np.max(upper, axis=0))
    return replace(problem, goals=np.array(goals), lower=bounds[0], upper=bounds[1])
