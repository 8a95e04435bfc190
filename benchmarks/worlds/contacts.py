"""Configurations at random and close to contact, and verdicts on them next to Coal's.

Close to contact is where two checkers can differ: between a free and a colliding configuration the first contact is
found by bisection, and configurations are drawn around it, some a micrometre of motion away, some a millimetre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker
from benchmarks.harness.report import Row
from planner_service.geometry.arrays import FloatArray

__all__ = ["JITTERS", "WITHIN", "around_contacts", "compared", "first_contacts", "random_states"]

JITTERS = (2e-6, 1e-5, 1e-4, 1e-3)
"""Metres that any point of the robot may be moved from where the first contact was found."""

EACH = 25
"""Configurations around each contact for every one of ``JITTERS``."""

HALVINGS = 45
"""Of a line between a free and a colliding configuration: its two ends are one but for rounding, then."""

AT_LEAST = 100
"""Configurations drawn in one go at least: few may all be free."""

WITHIN = 1e-6
"""Metres from contact within which two checkers may disagree: FCL and Coal both stop there."""


def random_states(robot: ps.Robot, count: int, rng: np.random.Generator) -> FloatArray:
    """Configurations (count, n) anywhere within the joint limits."""
    lower, upper = robot.limits.lower, robot.limits.upper
    return np.asarray(lower + (upper - lower) * rng.random((count, robot.n)))


def around_contacts(
    checker: ps.CollisionChecker,
    count: int,
    rng: np.random.Generator,
    jitters: Sequence[float] = JITTERS,
    each: int = EACH,
) -> tuple[FloatArray, FloatArray]:
    """Configurations (count, n) around first contacts, and how far any point was moved from there at most (count,)."""
    robot, jittered = checker.robot, np.repeat(jitters, each)
    each = len(jittered)
    contacts = _contacts(checker, math.ceil(count / each), rng)
    sizes = np.tile(jittered, len(contacts))[:count] * rng.random(count)
    ways = rng.normal(size=(count, robot.n))
    ways *= (sizes / (np.abs(ways) * robot.reach()).sum(axis=1))[:, None]
    Q = np.repeat(contacts, each, axis=0)[:count] + ways
    return np.clip(Q, robot.limits.lower, robot.limits.upper), sizes


def _contacts(checker: ps.CollisionChecker, count: int, rng: np.random.Generator) -> FloatArray:
    """Configurations (count, n) at which a straight way from a free one to a colliding one first was in contact."""
    free: FloatArray = np.empty((0, checker.robot.n))
    hit: FloatArray = np.empty((0, checker.robot.n))
    while min(len(free), len(hit)) < count:
        Q = random_states(checker.robot, max(2 * count, AT_LEAST), rng)
        good = checker.states_are_free(Q)
        if not len(free) and not len(hit) and (good.all() or not good.any()):
            raise AssertionError(f"{checker.robot.name}: of {len(Q)} configurations all are free, or none")
        free, hit = np.concatenate([free, Q[good]]), np.concatenate([hit, Q[~good]])
    return first_contacts(checker, free[:count], hit[:count])


def first_contacts(checker: ps.CollisionChecker, free: FloatArray, hit: FloatArray) -> FloatArray:
    """Configurations (m, n) at which straight ways from free ones to colliding ones first are in contact."""
    for _ in range(HALVINGS):
        middle = 0.5 * (free + hit)
        good = checker.states_are_free(middle)[:, None]
        free, hit = np.where(good, middle, free), np.where(good, hit, middle)
    return np.asarray(hit)


def compared(checker: ps.CollisionChecker, second: IndependentChecker, Q: FloatArray) -> Row:
    """How many verdicts differ, and how far apart or how deep the nearest pair is in the worst of these."""
    alone = np.array([checker.state_is_free(q) for q in Q])
    together = checker.states_are_free(Q)
    theirs = np.array([second.free(q) for q in Q])
    differ = [Q[k] for k in np.flatnonzero((alone != theirs) | (together != theirs)).tolist()]
    gaps = [gap if math.isfinite(gap := second.exact_gap(q)) else min(second.gaps(q).values()) for q in differ]
    return {
        "states": len(Q),
        "free": int(theirs.sum()),
        "disagreements": len(differ),
        "apart": max((gap for gap in gaps if gap > 0.0), default=0.0),
        "deep": max((-gap for gap in gaps if gap < 0.0), default=0.0),
    }
