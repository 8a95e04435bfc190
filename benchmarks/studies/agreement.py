"""Verdicts next to Coal's: the same configurations, each judged alone and in a batch, at random and close to contact.

Close to contact is where two checkers can differ: between a free and a colliding configuration the first contact is
found by bisection, and configurations are drawn around it, some a micrometre of motion away, some a millimetre.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table

from auditor.checker import IndependentChecker
from benchmarks.harness.audit import independent
from benchmarks.harness.report import Promise, Report, Row, table_of
from planner_service import Box, Capsule, CollisionChecker, Cylinder, Mesh, Obstacle, Pose, Robot, Scene, Sphere
from planner_service.errors import UnknownName
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import robot_names
from planner_service.robot_setup.loading import load_robot

__all__ = ["JITTERS", "WITHIN", "around_contacts", "first_contacts", "random_states", "run"]

SEED = 2026

JITTERS = (2e-6, 1e-5, 1e-4, 1e-3)
"""Metres that any point of the robot may be moved from where the first contact was found."""

EACH = 25
"""Configurations around each contact for every one of ``JITTERS``."""

HALVINGS = 45
"""Of a line between a free and a colliding configuration: its two ends are one but for rounding, then."""

AT_ONCE, AT_LEAST = 1_000, 100
"""Configurations judged in one go at most, and drawn in one at least: few may all be free."""

WITHIN = 1e-6
"""Metres from contact within which two checkers may disagree: FCL and Coal both stop there."""


def crowded_table(robot: Robot) -> Scene:
    """A table top with a box, a post, a ball, a rod and a stone (a mesh) on and above it, as large as the robot."""
    R = float(robot.reach().max())
    chance = random.Random(SEED)
    points = [[chance.gauss(0.0, 1.0) for _ in range(3)] for _ in range(40)]
    stone = [[0.12 * R * x / math.hypot(*p) for x in p] for p in points]
    turned = (math.cos(0.3), math.sin(0.3) / math.sqrt(2.0), 0.0, math.sin(0.3) / math.sqrt(2.0))
    return Scene(
        (
            Obstacle("table", Box((2.0 * R, 2.0 * R, 0.1 * R)), Pose((0.0, 0.0, -0.1 * R))),
            Obstacle("box", Box((0.2 * R, 0.15 * R, 0.4 * R)), Pose((0.45 * R, 0.3 * R, 0.15 * R), turned)),
            Obstacle("post", Cylinder(0.05 * R, 0.8 * R), Pose((0.3 * R, -0.45 * R, 0.35 * R))),
            Obstacle("ball", Sphere(0.12 * R), Pose((-0.45 * R, 0.2 * R, 0.3 * R))),
            Obstacle("rod", Capsule(0.03 * R, 0.7 * R), Pose((-0.2 * R, -0.5 * R, 0.5 * R), turned)),
            Obstacle("stone", Mesh(np.array(stone)), Pose((0.55 * R, -0.05 * R, 0.45 * R), turned)),
        ),
        name="crowded table",
    )


def random_states(robot: Robot, count: int, rng: np.random.Generator) -> FloatArray:
    """Configurations (count, n) anywhere within the joint limits."""
    lower, upper = robot.limits.lower, robot.limits.upper
    return np.asarray(lower + (upper - lower) * rng.random((count, robot.n)))


def around_contacts(
    checker: CollisionChecker,
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


def _contacts(checker: CollisionChecker, count: int, rng: np.random.Generator) -> FloatArray:
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


def first_contacts(checker: CollisionChecker, free: FloatArray, hit: FloatArray) -> FloatArray:
    """Configurations (m, n) at which straight ways from free ones to colliding ones first are in contact."""
    for _ in range(HALVINGS):
        middle = 0.5 * (free + hit)
        good = checker.states_are_free(middle)[:, None]
        free, hit = np.where(good, middle, free), np.where(good, hit, middle)
    return np.asarray(hit)


def compared(checker: CollisionChecker, second: IndependentChecker, Q: FloatArray) -> Row:
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


def _robot_rows(name: str, states: int) -> Iterator[Row]:
    robot = load_robot(name)
    scene = crowded_table(robot)
    checker = CollisionChecker(robot, scene)
    second = independent(name, scene)
    rng = np.random.default_rng(SEED)
    drawn = random_states(robot, states // 2, rng)
    near, sizes = around_contacts(checker, states - len(drawn), rng)
    kinds = {"random": drawn}
    low = 0.0
    for jitter in JITTERS:
        kinds[f"within {jitter * 1e6:g} um of contact"] = near[(sizes >= low) & (sizes < jitter)]
        low = jitter
    for kind, Q in kinds.items():
        if len(Q):
            yield {"robot": name, "kind": kind} | _in_parts(checker, second, Q)


def _in_parts(checker: CollisionChecker, second: IndependentChecker, Q: FloatArray) -> Row:
    parts = [compared(checker, second, Q[k : k + AT_ONCE]) for k in range(0, len(Q), AT_ONCE)]
    row: Row = {key: sum(part[key] for part in parts) for key in parts[0]}
    return row | {key: max(part[key] for part in parts) for key in ("apart", "deep")}


def run(robot: str | None = None, states: int = 100_000) -> Report:
    """Compare all robots that come with the package, or one.

    Raises:
        UnknownName: no robot of that name comes with the package.
    """
    if robot is not None and robot not in robot_names():
        raise UnknownName("robot", robot, robot_names())
    names = robot_names() if robot is None else (robot,)
    rows = tuple(row for name in names for row in _robot_rows(name, states))
    return Report("agreement", rows, (_table(rows),), tuple(_promise(name, rows) for name in names))


def _promise(name: str, rows: Sequence[Row]) -> Promise:
    here = [row for row in rows if row["robot"] == name]
    count, differ = sum(row["states"] for row in here), sum(row["disagreements"] for row in here)
    worst = max(max(row["apart"], row["deep"]) for row in here)
    text = f"{name}: no verdict of {count:,} differs from Coal's more than {WITHIN * 1e6:g} um from contact"
    measured = f"{differ} differ, at most {worst * 1e6:.2f} um from contact"
    return Promise(text, measured, worst <= WITHIN)


def _table(rows: Sequence[Row]) -> Table:
    lines = (
        {
            "robot": row["robot"],
            "states": row["kind"],
            "number": f"{row['states']:,}",
            "free": f"{row['free']:,}",
            "disagreements": row["disagreements"],
            "most apart um": f"{row['apart'] * 1e6:.3f}",
            "deepest um": f"{row['deep'] * 1e6:.3f}",
        }
        for row in rows
    )
    caption = (
        "Each state judged alone and among a thousand others. Around a contact: moved from it so that no point of the "
        "robot moves farther than stated, and farther than in the row above. Most apart, deepest: the nearest pair, "
        "where the two disagree; by support functions."
    )
    return table_of("Verdicts and Coal's, on a crowded table", lines, caption=caption)
