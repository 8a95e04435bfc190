"""RRT-Connect with balanced trees, in Python: the same questions, trees and bits as native/search/balanced.cpp."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner_service.collision.edge_sampling import Known
from planner_service.native._core import Projector
from planner_service.search.planners import metric
from planner_service.search.problem import Configuration, SearchProblem, of_tuples
from tests.reference.projector import LEAST_STRIDE

__all__ = ["ReferenceSearch"]

RADIUS = 0.2
"""How near samples must be to a blocked node, as a share of the longest distance in the space."""

MOST_MOVING = 7.0
"""Joints of more that a step moves, on average."""

MAX_LEFT_OUT = 30
"""Samples left out in a row for being too far away, after which the next is used wherever it is."""

MAX_REFUTED = 8
"""Paths with an edge that was not free after all, after which edges are no longer judged coarsely first."""

Grown = tuple[Sequence[Sequence[float]], list[tuple[int, int]]]
"""Milestones, and the pairs of them that are joined."""

_FAR_AWAY = 1e100
"""Where nodes that were cut off are: farther than any other."""

MAX_IDLE = 2000
"""Steps in a row of which constraints left nothing, after which the search gives up."""

_WORD = 2**64 - 1


class ReferenceSearch:
    """The same as native/search/balanced.cpp, for any oracle, step by step."""

    def __init__(self, problem: SearchProblem, longest: float, seed: int) -> None:
        self._oracle = of_tuples(problem.oracle)
        self._coarse = hasattr(problem.oracle, "edge_is_free_coarse")
        self._poll, self._longest = problem.poll, longest
        self._lower, self._upper = problem.lower.tolist(), problem.upper.tolist()
        self._weights = metric(problem)
        self._radius = RADIUS * self._distance(self._lower, self._upper)
        self._moving = MOST_MOVING / len(self._lower)
        self._bound, self._bounded = problem.longest, problem.longest < math.inf
        self._generator = _Generator(seed)
        self._start, self._goal = _Tree(self._weights), _Tree(self._weights)
        self._ends: dict[_Tree, Sequence[Configuration]] = {}
        self._refuted = self._left_out = self._idle = 0
        self._projector, self._stride = problem.projector, longest

    def run(self, start: Configuration, goals: Sequence[Configuration]) -> list[Configuration]:
        """A path; empty if constraints, or the bound of its length, left nothing to judge for long."""
        self._ends = {self._start: [start], self._goal: goals}
        self._start.add(start, -1, confirmed=True)
        for goal in goals:
            self._goal.add(goal, -1, confirmed=True)
        while self._idle < MAX_IDLE:
            self._poll()
            from_start = len(self._start.nodes) <= len(self._goal.nodes)
            tree, other = (self._start, self._goal) if from_start else (self._goal, self._start)
            node = self._extended(tree)
            met = -1 if node < 0 else self._connected(other, tree.nodes[node], tree.costs[node])
            if met < 0:
                continue
            at_start, at_goal = (node, met) if from_start else (met, node)
            if self._confirmed(self._start, at_start) and self._confirmed(self._goal, at_goal):
                return [*reversed(self._start.branch(at_start)), *self._goal.branch(at_goal)[1:]]
            self._refuted += 1
            if self._refuted == MAX_REFUTED:
                self._coarse = False
                for each in (self._start, self._goal):
                    for k in range(len(each.nodes)):
                        _ = each.cut_off[k] or self._confirm(each, k)
        return []

    def grown(self) -> Grown:
        """The milestones of both trees, and which of them are joined."""
        milestones: list[Configuration] = []
        edges: list[tuple[int, int]] = []
        for tree in (self._start, self._goal):
            numbers: dict[int, int] = {}
            for node in (k for k, off in enumerate(tree.cut_off) if not off):
                numbers[node] = len(milestones)
                milestones.append(tree.nodes[node])
                if tree.parents[node] >= 0:
                    edges.append((numbers[tree.parents[node]], numbers[node]))
        return milestones, edges

    def _extended(self, tree: _Tree) -> int:
        """The node by which a tree grew towards a random configuration; -1 if it did not grow."""
        if self._bounded:
            drawn, most = self._drawn_within(tree)
            nearest, distance = tree.nearest(drawn, most)
            self._idle += 1
            if nearest < 0:
                return -1
        else:
            drawn = tuple(
                low + (high - low) * self._generator.uniform()
                for low, high in zip(self._lower, self._upper, strict=True)
            )
            nearest, distance = tree.nearest(drawn)
        if self._moving < 1.0:
            drawn = self._some_held(drawn, tree.nodes[nearest])
            distance = self._distance(tree.nodes[nearest], drawn)
            if self._bounded and tree.way(nearest, drawn) + self._rest(tree, drawn) > self._bound:
                return -1
        if tree.blocked[nearest] and distance > self._radius and self._left_out < MAX_LEFT_OUT:
            self._left_out += 1
            return -1
        self._left_out = 0
        node = nearest
        if self._projector is not None:
            node = self._walked(self._projector, tree, nearest, drawn, self._longest, target_is_node=False)
        else:
            if self._bounded:
                self._idle = 0
            fresh = self._step(tree.nodes[nearest], drawn, distance, self._longest)
            if self._step_is_free(tree.nodes[nearest], fresh, Known.START):
                node = tree.add(fresh, nearest, confirmed=not self._coarse)
        if node != nearest:
            return node
        tree.blocked[nearest] = True
        return -1

    def _drawn_within(self, tree: _Tree) -> tuple[Configuration, float]:
        """Where a path that is short enough may go, and how long its way from the root of a tree to there may be."""
        goals = self._ends[self._goal]
        goal = goals[int(self._generator.uniform() * len(goals))]
        drawn = self._drawn_between(self._ends[self._start][0], goal)
        least = self._rest(self._goal if tree is self._start else self._start, drawn)
        return drawn, least + (self._bound - self._rest(tree, drawn) - least) * self._generator.uniform()

    def _drawn_between(self, a: Configuration, b: Configuration) -> Configuration:
        """From the ellipsoid of all that is on a way from a to b within the bound, within the limits."""
        between = _length(a, b)
        along, across = 0.5 * self._bound, 0.5 * math.sqrt(max(0.0, self._bound * self._bound - between * between))
        ball, square, radius, share = list[float](), 0.0, 0.0, 0.0
        for _ in a:
            x = -6.0
            for _ in range(12):
                x += self._generator.uniform()
            square += x * x
            radius = max(radius, self._generator.uniform())
            ball.append(x)
        scale = radius / math.sqrt(square) if square > 0.0 else 0.0
        axis = [(y - x) / between if between > 0.0 else 0.0 for x, y in zip(a, b, strict=True)]
        for x, y in zip(ball, axis, strict=True):
            share += x * y
        return tuple(
            min(max(0.5 * (p + q) + scale * (across * x + (along - across) * (share * y)), low), high)
            for p, q, x, y, low, high in zip(a, b, ball, axis, self._lower, self._upper, strict=True)
        )

    def _rest(self, tree: _Tree, q: Configuration) -> float:
        """The least length of a way from a configuration of a tree to where the other one is rooted."""
        return min(_length(q, end) for end in self._ends[self._goal if tree is self._start else self._start])

    def _some_held(self, drawn: Configuration, q: Configuration) -> Configuration:
        """What was drawn, with the values of q in some joints, each by the same chance; none if it were all."""
        moves = [self._generator.uniform() < self._moving for _ in drawn]
        return tuple(x if m else at for x, at, m in zip(drawn, q, moves, strict=True)) if any(moves) else drawn

    def _distance(self, a: Sequence[float], b: Sequence[float]) -> float:
        squared = 0.0
        for w, x, y in zip(self._weights, a, b, strict=True):
            squared += w * ((y - x) * (y - x))
        return math.sqrt(squared)

    def _connected(self, tree: _Tree, target: Configuration, cost: float) -> int:
        """The node by which a tree reached the target, growing towards it step by step; -1 if it did not."""
        node, distance = tree.nearest(target, self._bound - cost)
        if node < 0:
            return -1
        if self._projector is not None:
            node = self._walked(self._projector, tree, node, target, math.inf, target_is_node=True)
            return node if tree.nodes[node] == target else -1
        while distance > 0.0:
            fresh = self._step(tree.nodes[node], target, distance, self._longest)
            known = Known.BOTH if distance <= self._longest else Known.START  # the target is a node of the other tree
            if not self._step_is_free(tree.nodes[node], fresh, known):
                return -1
            node = tree.add(fresh, node, confirmed=not self._coarse)
            distance = self._distance(fresh, target)
        return node

    def _walked(
        self, projector: Projector, tree: _Tree, node: int, target: Configuration, most: float, *, target_is_node: bool
    ) -> int:
        """The node that a tree reached on its way towards a target, at most ``most`` far, by steps that keep the
        constraints: halved until they do, then doubled again."""
        gone, stride = 0.0, self._stride
        while gone < most:
            self._poll()
            near = tree.nodes[node]
            distance = self._distance(near, target)
            if not distance > 0.0:
                break
            step = min(stride, distance)
            arrives = target_is_node and step == distance
            fresh = self._step(near, target, distance, step)
            kept = projector.step(near, fresh, target, distance, step, arrives)
            if kept is None:
                if step <= LEAST_STRIDE:
                    self._idle += 1
                    break
                stride = step / 2.0
                continue
            self._idle = 0
            if not self._step_is_free(near, kept, Known.BOTH if arrives else Known.START):
                break
            gone += self._distance(near, kept)
            node = tree.add(kept, node, confirmed=not self._coarse)
            self._stride = step
            stride = min(2.0 * step, self._longest)
        return node

    def _step(self, a: Configuration, b: Configuration, distance: float, longest: float) -> Configuration:
        if distance <= longest:
            return b
        share = longest / distance
        return tuple(x + (y - x) * share for x, y in zip(a, b, strict=True))

    def _step_is_free(self, a: Configuration, b: Configuration, known: Known) -> bool:
        judge = self._oracle.edge_is_free_coarse if self._coarse else self._oracle.edge_is_free
        return judge(a, b, known=known)

    def _confirmed(self, tree: _Tree, node: int) -> bool:
        """Whether all edges from a node to its root are free; the first that is not is cut off."""
        while tree.parents[node] >= 0:
            if not self._confirm(tree, node):
                return False
            node = tree.parents[node]
        return True

    def _confirm(self, tree: _Tree, node: int) -> bool:
        """Whether the edge to a node is free at all its samples; the node is cut off if not."""
        if not tree.confirmed[node]:
            before = tree.nodes[tree.parents[node]]
            tree.confirmed[node] = self._oracle.edge_is_free(before, tree.nodes[node], known=Known.BOTH)
            if not tree.confirmed[node]:
                tree.cut(node)
        return tree.confirmed[node]


class _Tree:
    """A tree of configurations, cut off or not.

    Attributes:
        nodes: The configurations in the order in which they came.
        parents: Of each node; -1 for a root.
        blocked: Whether a step from the node was not free.
        confirmed: Whether all samples of the edge from the parent were judged.
        cut_off: Whether the node is no longer part of the tree.
        costs: Of each node, the length of its way from the root.
    """

    def __init__(self, weights: Sequence[float]) -> None:
        self._weights = weights
        self.nodes: list[Configuration] = []
        self.parents: list[int] = []
        self.blocked: list[bool] = []
        self.confirmed: list[bool] = []
        self.cut_off: list[bool] = []
        self.costs: list[float] = []
        self._points = np.full((64, len(weights)), _FAR_AWAY)

    def add(self, q: Configuration, parent: int, *, confirmed: bool) -> int:
        """Add a node; returns its number."""
        count = len(self.nodes)
        if count == len(self._points):
            self._points = np.concatenate([self._points, np.full(self._points.shape, _FAR_AWAY)])
        self._points[count] = q
        self.nodes.append(q)
        self.parents.append(parent)
        self.blocked.append(False)
        self.confirmed.append(confirmed)
        self.cut_off.append(False)
        self.costs.append(0.0 if parent < 0 else self.way(parent, q))
        return count

    def way(self, node: int, q: Configuration) -> float:
        """The length of the way from the root over a node to a configuration."""
        return self.costs[node] + _length(self.nodes[node], q)

    def nearest(self, q: Configuration, most: float = math.inf) -> tuple[int, float]:
        """The node nearest to q, of several the first, and its distance; -1 if no way from the root over a node to q
        is so short."""
        squares = np.zeros(len(self.nodes))
        for column, value, weight in zip(self._points[: len(self.nodes)].T, q, self._weights, strict=True):
            squares = squares + weight * ((value - column) * (value - column))
        if most < math.inf:
            plain = np.zeros(len(self.nodes))
            for column, value in zip(self._points[: len(self.nodes)].T, q, strict=True):
                plain = plain + (value - column) * (value - column)
            short = self.costs + np.sqrt(plain) <= most
            if not short.any():
                return -1, math.inf
            squares[~short] = math.inf
        node = int(np.argmin(squares))
        return node, math.sqrt(squares[node])

    def cut(self, node: int) -> None:
        """Take a node and all that grew from it out of the tree."""
        for k in range(node, len(self.nodes)):
            if k == node or (self.parents[k] >= 0 and self.cut_off[self.parents[k]]):
                self.cut_off[k] = True
                self._points[k] = _FAR_AWAY

    def branch(self, node: int) -> list[Configuration]:
        """The configurations from a node to its root."""
        out = []
        while node >= 0:
            out.append(self.nodes[node])
            node = self.parents[node]
        return out


def _length(a: Configuration, b: Configuration) -> float:
    """The length of the straight way between two configurations."""
    square = 0.0
    for x, y in zip(a, b, strict=True):
        square += (y - x) * (y - x)
    return math.sqrt(square)


class _Generator:
    """Random numbers that are the same on every machine: xoshiro256++ (Blackman & Vigna, ACM TOMS 47(4), 2021)."""

    def __init__(self, seed: int) -> None:
        self._state: list[int] = []
        for _ in range(4):  # by splitmix64, as its authors advise
            seed = (seed + 0x9E3779B97F4A7C15) & _WORD
            z = ((seed ^ (seed >> 30)) * 0xBF58476D1CE4E5B9) & _WORD
            z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _WORD
            self._state.append(z ^ (z >> 31))

    def uniform(self) -> float:
        """In [0, 1), a multiple of 2^-53."""
        a, b, c, d = self._state
        total = (_turned((a + d) & _WORD, 23) + a) & _WORD
        c, d = c ^ a, d ^ b
        self._state = [a ^ d, b ^ c, c ^ (b << 17 & _WORD), _turned(d, 45)]
        return (total >> 11) * 2.0**-53


def _turned(word: int, by: int) -> int:
    return (word << by | word >> (64 - by)) & _WORD
