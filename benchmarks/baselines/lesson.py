"""The textbook program that the service is measured against: bidirectional trees of short steps, then vertex shortcuts.

``Toy`` is the lesson's two-joint example, draw for draw: the same random numbers in the same order
and the same sequence of checks, so that its counts can be compared with the published ones.
``Lesson`` is the same algorithm on a robot of n joints, judged and counted by the product's
checker. Every edge is walked from one end to the other at 0.02 rad, both ends included, and nothing
is remembered: that is what makes it dear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import FloatArray, joint_distance, read_only
from planner_service.search.problem import SearchProblem, SearchResult

__all__ = ["STEP", "Lesson", "Toy", "ToyRun", "VertexShortcut", "samples", "stop_and_go_seconds"]

STEP = 0.15
RESOLUTION = 0.02
ROUNDS = 2000
CUTS = 300

EdgeTest = Callable[[FloatArray, FloatArray], bool]


def samples(a: FloatArray, b: FloatArray) -> list[FloatArray]:
    """Configurations from a to b, both included, at most 0.02 rad (L2) apart."""
    parts = max(1, math.ceil(joint_distance(a.tolist(), b.tolist()) / RESOLUTION))
    return [a + (b - a) * (k / parts) for k in range(parts + 1)]


class _Tree:
    """Configurations and their parents; the nearest one is found by looking at all."""

    def __init__(self, root: FloatArray) -> None:
        self._points: FloatArray = np.empty((64, len(root)))
        self._points[0] = root
        self._parents = [-1]

    def __getitem__(self, index: int) -> FloatArray:
        return np.array(self._points[index])

    def nearest(self, q: FloatArray) -> int:
        difference = self._points[: len(self._parents)] - q
        squares = np.zeros(len(difference))
        for column in difference.T:
            squares = squares + column * column
        return int(np.argmin(np.sqrt(squares)))

    def add(self, q: FloatArray, parent: int) -> int:
        index = len(self._parents)
        if index == len(self._points):
            self._points = np.concatenate([self._points, np.empty_like(self._points)])
        self._points[index] = q
        self._parents.append(parent)
        return index

    def branch(self, index: int) -> list[FloatArray]:
        """From the root to ``index``."""
        found = []
        while index >= 0:
            found.append(self[index])
            index = self._parents[index]
        return found[::-1]


def _step(tree: _Tree, target: FloatArray, edge_is_free: EdgeTest) -> tuple[int | None, bool]:
    """One step of the tree towards ``target``: the new node if the edge is free, and whether it is the target."""
    index = tree.nearest(target)
    near = tree[index]
    distance = joint_distance(near.tolist(), target.tolist())
    arrives = distance <= STEP
    q = target if arrives else near + (target - near) * (STEP / distance)
    if not edge_is_free(near, q):
        return None, False
    return tree.add(q, index), arrives


def _walk(tree: _Tree, target: FloatArray, edge_is_free: EdgeTest) -> int | None:
    """Steps towards ``target`` until it is reached, or None when one is blocked."""
    while True:
        index, arrived = _step(tree, target, edge_is_free)
        if index is None or arrived:
            return index


def grow(
    start: FloatArray, goal: FloatArray, sample: Callable[[], FloatArray], edge_is_free: EdgeTest
) -> list[FloatArray] | None:
    """Two trees in turn, one stepping to a sample and the other walking to where it came; None after 2000 rounds."""
    growing, other, forward = _Tree(start), _Tree(goal), True
    for _ in range(ROUNDS):
        index, _ = _step(growing, sample(), edge_is_free)
        if index is not None:
            met = _walk(other, growing[index], edge_is_free)
            if met is not None:
                first, second = growing.branch(index), other.branch(met)
                if not forward:
                    first, second = second, first
                return first + second[-2::-1]
        growing, other, forward = other, growing, not forward
    return None


def cut_vertices(path: Sequence[FloatArray], rng: np.random.Generator, edge_is_free: EdgeTest) -> list[FloatArray]:
    """300 times: two random vertices, and what lies between them left out if the edge between them is free."""
    kept = list(path)
    for _ in range(CUTS):
        if len(kept) < 3:
            break
        i, j = sorted(rng.choice(len(kept), size=2, replace=False).tolist())
        if j - i >= 2 and edge_is_free(kept[i], kept[j]):
            del kept[i + 1 : j]
    return kept


def length_of(path: FloatArray | Sequence[FloatArray]) -> float:
    """L2 joint length of a polyline."""
    points = np.asarray(path, dtype=np.float64).tolist()
    return sum((joint_distance(a, b) for a, b in pairwise(points)), 0.0)


def stop_and_go_seconds(path: Sequence[FloatArray], velocity: float = 1.57, acceleration: float = 5.0) -> float:
    """Motion time that stops at every waypoint, each piece a trapezoid or triangle of its slowest joint."""
    total = 0.0
    for a, b in pairwise(path):
        travel = max(abs(d) for d in (b - a).tolist())
        if travel >= velocity * velocity / acceleration:
            total += travel / velocity + velocity / acceleration
        else:
            total += 2.0 * math.sqrt(travel / acceleration)
    return total


# --- two joints and a disc


@dataclass(frozen=True, eq=False)
class ToyRun:
    """One run of the toy: checks by stage, and the paths before and after shortcutting."""

    growth: int
    shortcut: int
    raw: list[FloatArray]
    short: list[FloatArray]

    @property
    def checks(self) -> int:
        """All of them."""
        return self.growth + self.shortcut


class Toy:
    """A square of two joints with one disc in it, and a query across the disc."""

    START, GOAL = read_only([-2.5, 2.0]), read_only([2.2, -2.2])
    CENTRE, RADIUS = (0.6, -0.4), 0.9

    def __init__(self) -> None:
        self.checks = 0

    def collides(self, q: Sequence[float]) -> bool:
        """Whether q (2,) is inside the disc; counted."""
        self.checks += 1
        return joint_distance(self.CENTRE, q) < self.RADIUS

    def edge_is_free(self, a: FloatArray, b: FloatArray) -> bool:
        """Whether all samples from a to b are outside the disc, asked one after the other."""
        return not any(self.collides(q.tolist()) for q in samples(a, b))

    @classmethod
    def run(cls, seed: int) -> ToyRun:
        """Grow and shorten with one random source."""
        toy, rng = cls(), np.random.default_rng(seed)
        raw = grow(cls.START, cls.GOAL, lambda: rng.uniform(-math.pi, math.pi, size=2), toy.edge_is_free)
        if raw is None:
            raise RuntimeError(f"seed {seed}: no path in {ROUNDS} rounds")
        growth = toy.checks
        short = cut_vertices(raw, rng, toy.edge_is_free)
        return ToyRun(growth, toy.checks - growth, raw, short)


# --- n joints


@dataclass(frozen=True)
class Lesson:
    """The lesson's tree growth as a planner: steps of 0.15 rad, edges judged state by state from end to end."""

    name: ClassVar[str] = "lesson"

    def search(self, problem: SearchProblem) -> SearchResult:
        """The path as it was grown, not shortened; towards the first goal, since the lesson knows only one."""
        rng, oracle = np.random.default_rng(problem.seed), problem.oracle
        lower, upper = problem.lower, problem.upper

        def edge_is_free(a: FloatArray, b: FloatArray) -> bool:
            problem.poll()
            return all(oracle.state_is_free(q) for q in samples(a, b))

        path = grow(problem.start, problem.goals[0], lambda: rng.uniform(lower, upper), edge_is_free)
        if path is None:
            return SearchResult(None, note=f"no path in {ROUNDS} rounds")
        return SearchResult(np.array(path), goal_index=0)


class VertexShortcut:
    """The lesson's shortcutting, counted in full but computed once.

    Nine tenths of its edges are ones it has walked before. They are counted again, state by state,
    as the lesson's program would; only the answers come from memory, to spare the benchmark the wait.
    """

    def __init__(self, checker: CollisionChecker) -> None:
        self._checker = checker
        self._answers: dict[tuple[tuple[float, ...], tuple[float, ...]], tuple[bool, int]] = {}

    def shorten(self, path: ArrayLike, seed: int) -> FloatArray:
        """``path`` (N, n) after 300 random vertex cuts."""
        rows = list(np.array(path, dtype=np.float64))
        return np.array(cut_vertices(rows, np.random.default_rng([seed, 1]), self._edge_is_free))

    def _edge_is_free(self, a: FloatArray, b: FloatArray) -> bool:
        key = (tuple(a.tolist()), tuple(b.tolist()))
        if key in self._answers:
            free, states = self._answers[key]
            self._checker.ledger.record_states(states)
            return free
        before = self._checker.counts.states
        free = all(self._checker.state_is_free(q) for q in samples(a, b))
        self._answers[key] = free, self._checker.counts.states - before
        return free
