"""Optimising a path, and checking the optimum: an optimiser that has converged need not be free of collisions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.collision import CollisionChecker, Contact, Known
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.optimize import Figures, Optimise, Optimum
from planner_service.path.joint_path import JointPath
from planner_service.planning.result import Failure, PolishReport, Reason, Stage
from planner_service.presentation.measures import outside_text
from planner_service.robot.model import Robot

__all__ = ["Touch", "judged", "lines", "not_free", "optimum_path"]

SPACING = 0.01
"""Radians of path between samples of a curve that is not free, to report where it is not."""

NO_WORSE = 1e-3
"""Metres of missing clearance, summed along it, that a curve may have more than another."""

SAME = 1e-6
"""Share by which costs may differ through rounding alone."""

BENT = 0.5
"""How far the middle of a line may be displaced at random, in each joint: this share of its length, at least this many
radians."""


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
