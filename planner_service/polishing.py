"""An optimum, and the honest checker's verdict on it: converged is not collision-free."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner_service.collision import CollisionChecker, Contact, Known
from planner_service.geometry import FloatArray
from planner_service.optimize import Figures, Optimise, Optimum
from planner_service.outcome import PolishReport
from planner_service.path import JointPath
from planner_service.search import joint_distance

__all__ = ["Touch", "judged", "lines", "optimum_path"]

SPACING = 0.01
"""Radians of path between places at which a curve that is known to collide is looked at, to tell where."""

NO_WORSE = 1e-3
"""Metres of distance lacking, summed over a curve, that make no curve worse than another."""

BENT = 0.5
"""How far the middle of a line may be drawn aside, in each joint: as a share of its length, but at least this (rad)."""


@dataclass(frozen=True)
class Touch:
    """Where a curve collides: the share of its length, and what touches there, deepest first (it may be rounding)."""

    share: float
    contacts: tuple[Contact, ...]

    def __str__(self) -> str:
        pairs = ", ".join(map(str, self.contacts)) or "nothing that a closer look confirms"
        return f"at {self.share:.0%} of the way: {pairs}"


def optimum_path(
    settings: Optimise, points: FloatArray, checker: CollisionChecker, padded: CollisionChecker
) -> tuple[Optimum, Touch | None]:
    """What optimising a polyline (N, n) gives, and where the result collides; None if it is free with the padding.

    Args:
        checker: Without padding: distances are those of the pieces themselves.
        padded: Judges the result, between its ends, as any other path.
    """
    optimum = settings.improved(points, checker)
    path = optimum.path
    return optimum, None if padded.path_is_free(path, known=Known.BOTH) else _where(path, checker, padded)


def _where(path: JointPath, checker: CollisionChecker, padded: CollisionChecker) -> Touch:
    s = path.length * np.linspace(0.0, 1.0, max(2, math.ceil(path.length / SPACING)))
    hits = np.flatnonzero(~padded.states_are_free(path(s)[1:-1]))
    at = float(s[1 + hits[0]]) if len(hits) else 0.0
    contacts = (checker.contacts(path(at)) or padded.contacts(path(at))) if len(hits) else ()
    return Touch(at / path.length, contacts)


def judged(settings: Optimise, optimum: Optimum, touch: Touch | None) -> PolishReport:
    """The report on an optimum, to be kept only if it is free and not worse than what it was made from."""
    note = ""
    if touch is not None:
        note = f"the optimum is in collision {touch}"
    elif _worse(optimum.before, optimum.after):
        note = "the optimum is worse than what it was made from"
    return PolishReport(
        settings.method.name,
        not note,
        optimum.before,
        optimum.after,
        optimum.iterations,
        optimum.gradients,
        note,
    )


def _worse(before: Figures, after: Figures) -> bool:
    """Whether more distance is lacking; or no less, and the cost is higher."""
    gained = before.shortfall - after.shortfall
    return gained < -NO_WORSE or (gained <= NO_WORSE and after.cost > before.cost)


def lines(start: FloatArray, goal: FloatArray, settings: Optimise, seed: int) -> Iterator[FloatArray]:
    """What an optimisation without a path begins with: the straight line, then some through a place drawn beside it."""
    yield np.array([start, goal])
    aside = max(BENT, BENT * joint_distance(start, goal))
    for k in range(1, settings.starts):
        rng = np.random.default_rng([seed, 4, k])
        yield np.array([start, (start + goal) / 2.0 + aside * rng.uniform(-1.0, 1.0, len(start)), goal])
