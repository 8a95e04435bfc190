"""Whether the compiled kernel and the reference say the same: verdicts, counts and what touches.

Random states; states and edges as a planner asks for them, near states that are free; and states next to contact, found
by bisection between a free and a colliding one.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.studies.differential import STEP, case
from planner_service.collision import CollisionChecker, JointStep
from planner_service.collision.checker import BackendName
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["CASES", "Agreement", "case", "checkers", "compare", "edges_of", "states_of"]

CASES = ("wxai bin", "wxai shelf", "wxai clutter", "wxai cloud", "panda shelf", "ur5 bin", "planar2 pins")

NEAR = 2e-3
"""Radians about a contact, drawn down to a millionth of it: joints reach about a metre, so this is about 2 mm."""

LONGEST = 0.8
"""Radians of an edge."""

HALVINGS = 30


@dataclass
class Agreement:
    """What was compared, and every difference in words."""

    states: int = 0
    edges: int = 0
    colliding: int = 0
    differences: list[str] = field(default_factory=list)


def checkers(
    robot: Robot, scene: Scene, *, padding: float = 0.0, allowed: Sequence[tuple[str, str]] = ()
) -> tuple[CollisionChecker, CollisionChecker]:
    """One that uses the kernel, and its judge: FCL pair by pair."""
    step = JointStep(STEP)
    backends: tuple[BackendName, BackendName] = ("native", "fcl")
    first, second = (
        CollisionChecker(robot, scene, edge_step=step, padding=padding, allowed=allowed, backend=b) for b in backends
    )
    return first, second


def states_of(checker: CollisionChecker, count: int, seed: int) -> Iterator[FloatArray]:
    """Configurations: a third at random, a third next to free ones, a third next to contact."""
    chance = random.Random(seed)
    robot = checker.robot
    free = _anywhere(robot, chance)
    for k in range(count):
        q = _anywhere(robot, chance)
        if k % 3 == 1:
            q = _near(robot, free, chance, LONGEST)
        elif k % 3 == 2:
            q = _near(robot, _contact(checker, free, q), chance, NEAR * 10.0 ** chance.uniform(-6.0, 0.0))
        elif checker.state_is_free(q):
            free = q
        yield q


def edges_of(checker: CollisionChecker, count: int, seed: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Edges at most ``LONGEST`` long that mostly begin where it is free, as a planner's do."""
    chance = random.Random(seed)
    for k in range(count):
        q = _anywhere(checker.robot, chance)
        for _ in range(20 if k % 4 else 0):
            if checker.state_is_free(q):
                break
            q = _anywhere(checker.robot, chance)
        yield q, _near(checker.robot, q, chance, LONGEST)


def _anywhere(robot: Robot, chance: random.Random) -> FloatArray:
    lower, upper = robot.limits.lower.tolist(), robot.limits.upper.tolist()
    return np.array([chance.uniform(low, high) for low, high in zip(lower, upper, strict=True)])


def _near(robot: Robot, q: FloatArray, chance: random.Random, distance: float) -> FloatArray:
    step = [chance.gauss(0.0, 1.0) for _ in range(robot.n)]
    scale = distance * chance.random() / math.sqrt(math.fsum(x * x for x in step))
    return np.asarray(np.clip(q + scale * np.array(step), robot.limits.lower, robot.limits.upper))


def _contact(checker: CollisionChecker, a: FloatArray, b: FloatArray) -> FloatArray:
    """A point of the line from a to b next to which the verdict changes, if it does."""
    known = checker.state_is_free(a)
    for _ in range(HALVINGS):
        middle = 0.5 * (a + b)
        if checker.state_is_free(middle) == known:
            a = middle
        else:
            b = middle
    return np.asarray(a)


def compare(pair: Sequence[CollisionChecker], states: int, edges: int, seed: int = 0) -> Agreement:
    """Ask two checkers the same; where to go is found by the first, whose counts of that are not compared."""
    first, found = pair[0], Agreement()
    for q in states_of(first, states, seed):
        before = [checker.counts for checker in pair]
        said = [checker._first_collision(q[None]) for checker in pair]
        spent = [checker.counts - counts for checker, counts in zip(pair, before, strict=True)]
        found.states += 1
        found.colliding += said[1] is not None
        if said[0] != said[1] or spent[0] != spent[1]:
            found.differences.append(f"state {q.tolist()}: {said[0]} {spent[0]} != {said[1]} {spent[1]}")
    for a, b in edges_of(first, edges, seed):
        before = [checker.counts for checker in pair]
        hits = [checker.edge_hit(a, b) for checker in pair]
        spent = [checker.counts - counts for checker, counts in zip(pair, before, strict=True)]
        found.edges += 1
        found.colliding += hits[1] is not None
        if hits[0] != hits[1] or spent[0] != spent[1]:
            found.differences.append(f"edge {a.tolist()} {b.tolist()}: {hits[0]} {spent[0]} != {hits[1]} {spent[1]}")
    return found
