"""Paths that leave what is left of an old path for a goal: along its waypoints where that is free, else searched.

Such a path is the old curve, bit for bit, up to the blend in which it turns off. Where it may turn off depends on the
robot's speed: any turn can be driven where the robot could have stopped, closer only a slight one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planner_service.collision import CollisionChecker, Known
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.optimize import Optimise
from planner_service.path.corner_blend import STEEPEST
from planner_service.path.joint_path import JointPath, polyline_length
from planner_service.planning.accounting import NoPlan, PlanContext
from planner_service.planning.endpoints import GoalState
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.planning.search_stage import FIRST_TRIES, alternating, fresh_seed
from planner_service.replanning.splice import SwitchPoint
from planner_service.roadmap import Roadmap
from planner_service.search.planners import BalancedRRTConnect
from planner_service.search.problem import Configuration, SearchOracle, SearchProblem, TieredOracle
from planner_service.smoothing.smoothing import SeededDraws, blended, pulled_in, shortcut, without_short_pieces

__all__ = ["CandidatePath", "Detours", "Place"]

PLACES = (0.6, 1.05, 0.3, 0.1)
"""Where to turn off, as shares of the distance in which the robot can stop, in the order tried."""

BEYOND = (0.3, 0.8)
"""How far beyond the old end to turn, as shares of the distance from there to the goal: a robot that is braking for a
stop at the old end cannot stop sooner, nor turn sharply, but it can overshoot a little and then turn."""

PART = 0.9
"""Share of the widest blend that the robot can be slow enough for."""

NEAR = 1e-6
"""Radians. Anything that close to a waypoint is taken for it."""

COINCIDING = 1e-9
"""Radians between points that are taken for one."""

ROOM = 1e-3
"""Radians between two blends that leave enough room to turn off."""

MIN_BLEND = 1e-4
"""Radians: when a robot follows a moving goal, all its moves are short and all its corners slight."""

FINEST = 0.002
"""Metres between samples of edges with less padding: blends and edges that are free at these are mostly proven, too."""

LESS_PADDING = (1.0, 0.75, 0.5, 0.25, 0.125, 0.0)
"""Shares of the requested padding tried where the old path is closer to something."""

SEARCH_SHARE = 0.5
"""Part of the states that searching may use."""


Judge = SearchOracle | TieredOracle


class Place(NamedTuple):
    """Where to turn off.

    Attributes:
        s: On the old path.
        waypoint: The index that the corner there will have.
        q: Where that is, shape (n,).
        roomy: Whether the old path keeps the full padding up to there.
    """

    s: float
    waypoint: int
    q: FloatArray
    roomy: bool = False


@dataclass(frozen=True, eq=False)
class CandidatePath:
    """A path to a goal that begins as the old one does.

    Attributes:
        leaves: The waypoint up to which it follows the old one.
        s: Where that is on the old path.
        switch: Where another law takes over.
        searched: Whether a part of it had to be searched.
        roomy: Whether the old path keeps the full padding up to there.
        padding: Metres that samples keep on all of it.
    """

    path: JointPath
    leaves: int
    s: float
    switch: SwitchPoint
    searched: bool
    roomy: bool
    padding: float


class Detours:
    """Paths from a path under way to a goal.

    Args:
        path: What is left of the old path.
        ahead: Old waypoints beyond its end, (k, n), known from an earlier motion.
    """

    def __init__(self, context: PlanContext, path: JointPath, ahead: FloatArray) -> None:
        self._checker, self._request, self._accounting = context.checker, context.request, context.accounting
        self._path, self._ahead = path, ahead
        self._acceleration = self._checker.robot.limits.acceleration * self._request.acceleration_scale
        self._states = max(1, int(self._request.max_checks * SEARCH_SHARE))

    def places(self, switch: SwitchPoint, stop: float, goal: FloatArray, *, beyond: bool = True) -> Iterator[Place]:
        """Where to turn off for a goal.

        First where the old path keeps the full padding up to there, then where it is free at all, then straight
        ``beyond`` its end.

        Args:
            stop: Where a stop that begins at the switch point ends.
        """
        if not switch.rate > 0.0:
            yield self._place(switch.s, switch.s)
            return
        places: list[Place] = []
        for part in PLACES:
            place = self._place(min(switch.s + part * (stop - switch.s), self._path.length), switch.s)
            if all(abs(place.s - other.s) > ROOM for other in places):
                places.append(place)
        full = self._checker.variant(padding=self._request.padding)
        wide = [place for place in places if self._free_up_to(switch.s, place.s, full)]
        yield from (place._replace(roomy=True) for place in wide)
        rest = [place for place in places if not any(place is other for other in wide)]
        if rest:
            bare = self._checker.variant(motion_step=FINEST)
            yield from (place for place in rest if self._free_up_to(switch.s, place.s, bare))
        if beyond:
            yield from self._beyond(goal)

    def _beyond(self, goal: FloatArray) -> Iterator[Place]:
        """Places straight beyond the old end."""
        path, limits = self._path, self._checker.robot.limits
        end, direction = path.waypoints[-1], path(path.length, 1)
        away = joint_distance(end.tolist(), goal.tolist())
        for part in BEYOND:
            q = end + direction * (part * away)
            if part * away > ROOM and np.all((q >= limits.lower) & (q <= limits.upper)):
                yield Place(path.length + part * away, len(path.waypoints) - 1, q)

    def _place(self, s: float, since: float) -> Place:
        """The first place from s on that is on a straight piece, or a waypoint whose blend begins after ``since``."""
        path = self._path
        index = int(np.flatnonzero(path.knots >= s - NEAR)[0])
        begins, knot = float(path.knots[index] - path.blends[index]), float(path.knots[index])
        if index and begins < since - NEAR < knot:  # within this blend
            s, index = float(path.knots[index] + path.blends[index]), index + 1
            begins, knot = float(path.knots[index] - path.blends[index]), float(path.knots[index])
        if index and s < begins - NEAR:
            after = float(path.knots[index - 1] + path.blends[index - 1])
            if s > after:
                return Place(s, index, path(s))
            if begins - after > ROOM:
                return Place((after + begins) / 2.0, index, path((after + begins) / 2.0))
        return Place(knot, index, path.waypoints[index])

    def _free_up_to(self, s: float, end: float, checker: CollisionChecker) -> bool:
        """Whether the old polyline is free in between."""
        knots = [s, *(k for k in self._path.knots.tolist() if s + NEAR < k < end - NEAR), end]
        points = self._path(np.minimum(np.array(knots), self._path.length))
        with self._accounting.during(Stage.STRAIGHT_LINE):
            ends = [Known.NEITHER, *(Known.START for _ in points[1:])]
            edges = zip(pairwise(points), ends, strict=False)
            return all(checker.edge_is_free(a, b, known=known) for (a, b), known in edges)

    def candidate(self, switch: SwitchPoint, place: Place, goal: GoalState, turn: int = 0) -> CandidatePath | None:
        """A path that turns off at a place, its corners blended; None if the robot would touch something there.

        Args:
            turn: Another number, another search.

        Raises:
            NoPlan: None was found.
        """
        s, index, q, old = place.s, place.waypoint, place.q, self._path
        least = self._padding(q)
        if least is None:
            return None
        tight = self._checker.variant(padding=min(least, goal.padding))
        oracle = self._oracle(q, least, goal)
        chain = [q, *old.waypoints[old.knots > s + NEAR], *self._ahead]
        if len(chain) == 1 or chain[-1].tolist() != goal.q.tolist():
            chain = [*(chain[:-1] if len(chain) > 1 else chain), goal.q]
        points, searched = self._repaired(chain, oracle, turn)
        points = _apart(self._shortened(points, oracle))
        path = JointPath(
            np.concatenate([old.waypoints[:index], points]), np.append(old.blends[:index], np.zeros(len(points)))
        )
        with self._accounting.during(Stage.POLISH) as entry:
            sizes = np.full(len(path.waypoints), self._request.blend)
            sizes[:index] = 0.0
            reached = max(switch.s, float(path.knots[index - 1] + path.blends[index - 1])) if index else switch.s
            sizes[index] = min(sizes[index], max(0.0, s - reached))
            if index and switch.rate > 0.0 and len(points) > 1:
                sizes[index] = min(sizes[index], self._passable(path, index, switch))
            path = blended(path, SearchOracle(tight), sizes, least=MIN_BLEND)
            entry.length = path.length - s
        padding = min(self._request.padding, least, goal.padding) if place.roomy or not s > switch.s else 0.0
        return CandidatePath(path, index, s, switch, searched, place.roomy, padding)

    def _passable(self, path: JointPath, index: int, switch: SwitchPoint) -> float:
        """How wide the blend at a corner may be for the robot to be slow enough when it begins.

        The square of the speed at which a blend can be driven grows in proportion to its width, but a narrower blend
        leaves more distance to slow down. If that gains more, there is a widest blend.
        """
        u, v = path.on_pieces(path.pieces_at(path.knots[index - 1 : index + 1]), path.knots[index - 1 : index + 1], 1)
        with np.errstate(divide="ignore"):
            passing = float((self._acceleration / (STEEPEST * np.abs(v - u))).min())
            braking = float((self._acceleration / np.abs(u)).min())
        distance = float(path.knots[index]) - switch.s
        if passing >= 2.0 * braking:
            return math.inf
        return max(0.0, PART * (2.0 * braking * distance - switch.rate * switch.rate) / (2.0 * braking - passing))

    def _oracle(self, start: FloatArray, start_padding: float, goal: GoalState) -> Judge:
        """What judges a path between two ends, each with a padding of its own."""
        roomy = SearchOracle(self._checker.variant(padding=self._request.padding), [start], [goal.q])
        tight: dict[Configuration, SearchOracle] = {}
        for q, padding in ((start, start_padding), (goal.q, goal.padding)):
            if padding < self._request.padding:
                checker = self._checker.variant(padding=padding, motion_step=max(padding, FINEST))
                tight[tuple(q.tolist())] = SearchOracle(checker)
        return TieredOracle(roomy, tight) if tight else roomy

    def _padding(self, q: FloatArray) -> float | None:
        """The widest of a few paddings with which q is free; None if it is not free with any."""
        paddings = [self._request.padding * part for part in LESS_PADDING]
        with self._accounting.during(Stage.ENDPOINTS):
            free = (p for p in paddings if self._checker.variant(padding=p).state_is_free(q))
            return next(free, None)

    def _repaired(self, chain: Sequence[FloatArray], oracle: Judge, turn: int) -> tuple[FloatArray, bool]:
        """The chain with a search wherever it is blocked, and whether there was one."""
        out, at, last, searched = [chain[0]], 0, len(chain) - 1, False
        while at < last:
            with self._accounting.during(Stage.STRAIGHT_LINE):
                free = at + 1 == last or oracle.state_is_free(chain[at + 1])
                free = free and oracle.edge_is_free(chain[at], chain[at + 1], known=Known.BOTH)
                later = [] if free else [k for k in range(at + 1, last) if oracle.state_is_free(chain[k])]
            if free:
                at += 1
                out.append(chain[at])
                continue
            searched = True
            later.append(last)
            points = self._search(chain[at], np.array([chain[k] for k in later]), oracle, turn)
            out += list(points[1:])
            at = next(k for k in later if chain[k].tolist() == points[-1].tolist())
        return np.array(out), searched

    def _search(self, start: FloatArray, goals: FloatArray, oracle: Judge, turn: int) -> FloatArray:
        """A path from the start to one of the goals, with fresh seeds if one gives up.

        The default searches where the request's planner does not search, or is a roadmap: what a roadmap knows holds
        where all of the padding is kept.

        Raises:
            NoPlan: None was found.
        """
        request, limits, ledger = self._request, self._checker.robot.limits, self._checker.ledger
        planner = request.planner
        if isinstance(planner, Roadmap | Optimise):
            planner = BalancedRRTConnect()
        tries = FIRST_TRIES if request.retries is None else request.retries + 1
        if planner.patience is None:
            tries = 1
        share = max(1, self._states // tries, planner.patience or 0)
        with self._accounting.during(Stage.SEARCH) as entry:
            for attempt, searcher in zip(range(tries), alternating(planner), strict=False):
                entry.note = searcher.name + (f", try {attempt + 1}" if attempt else "")
                self._accounting.attempt(entry.note)
                seed = fresh_seed(request.seed, attempt + tries * turn)
                problem = SearchProblem(
                    start, goals, limits.lower, limits.upper, oracle, seed, ledger.poll, self._checker.reach
                )
                try:
                    with self._checker.limited(states=share):
                        points = searcher.search(problem).waypoints
                except CheckBudgetSpent:
                    if ledger.room() == 0:
                        raise
                    continue
                if points is not None:
                    return points
        detail = "no path was found from where the old one is left; whether there is one is unknown"
        raise NoPlan(Failure(Stage.SEARCH, Reason.PLANNING_FAILED, detail))

    def _shortened(self, points: FloatArray, oracle: Judge) -> FloatArray:
        if len(points) < 3:
            return points
        with self._accounting.during(Stage.SHORTCUT) as entry, suppress(CheckBudgetSpent):
            points = shortcut(points, oracle, SeededDraws(self._request.seed, 1))
            entry.length = polyline_length(points)
        with self._accounting.during(Stage.POLISH), suppress(CheckBudgetSpent):
            points = pulled_in(points, oracle)
            if self._request.blend > 0.0:
                points = without_short_pieces(points, oracle)
        return points


def _apart(points: FloatArray) -> FloatArray:
    """The points without those that nearly coincide with the one before; the last stays."""
    kept = [points[0]]
    for q in points[1:]:
        if joint_distance(kept[-1].tolist(), q.tolist()) <= COINCIDING:
            kept.pop()
        kept.append(q)
    return np.array(kept)
