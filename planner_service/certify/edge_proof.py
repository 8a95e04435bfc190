"""The verdict on one straight edge: proven free, proven to collide, or neither; the reference.

The same bounds as a certificate's, but only a verdict is wanted: a stretch is closed as soon as its bound suffices. The
middle of the edge is looked at first, for a bound there counts in both directions and most pairs are far; then the
ends, then the middle of what is left open.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from planner_service.certify.interval_proof import ROUNDS
from planner_service.certify.motion_bounds import Motion, Nodes
from planner_service.certify.overlap import Contact, settled
from planner_service.certify.separation import Bounds, refined_gaps, rough_gaps
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.path.joint_path import JointPath

__all__ = ["MAX_EDGE_BOUNDS", "EdgeProof", "EdgeTree", "EdgeVerdict", "Judged"]

MAX_EDGE_BOUNDS = 4096
"""Bounds after which an edge is undecided; ordinary ones take about forty."""

CLOSED, OPEN, OVERLAPPING, LOST = range(4)
"""States of a row."""


class EdgeVerdict(Enum):
    """What is proven of an edge."""

    FREE = 0
    """Every judged pair stays apart all along it."""
    COLLIDING = 1
    """Somewhere on it a judged pair is too near."""
    UNDECIDED = 2
    """Neither is proven: it comes as near as the margin."""


@dataclass(frozen=True)
class EdgeProof:
    """What is proven of a straight edge.

    Attributes:
        verdict: FREE: every judged pair is farther apart than the padding all along. COLLIDING: a pair is nearer than
            the padding, overlapping if that is 0, at some place. UNDECIDED: neither is proven.
        s: Where, in path length from the first end: a place of that collision, or one that could not be decided.
        a: One of the pair, by name; empty if free.
        b: The other; empty if free.
    """

    verdict: EdgeVerdict
    s: float = 0.0
    a: str = ""
    b: str = ""

    @property
    def free(self) -> bool:
        """Whether the whole edge is proven free."""
        return self.verdict is EdgeVerdict.FREE

    @property
    def colliding(self) -> bool:
        """Whether a collision is proven."""
        return self.verdict is EdgeVerdict.COLLIDING


class Judged(NamedTuple):
    """A verdict, None if the ends are no configurations; the number of a pair (-1 if there is none), and where."""

    verdict: EdgeVerdict | None
    pair: int = -1
    s: float = 0.0


class _Over(Exception):
    """The verdict is known."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Pairs not closed yet, on the stretch between two nodes each, and bounds and directions at both."""

    pair: IntArray
    left: IntArray
    right: IntArray
    before: Bounds
    after: Bounds
    motion: FloatArray

    def take(self, rows: IntArray) -> _Rows:
        ends = self.before.take(rows), self.after.take(rows)
        return _Rows(self.pair[rows], self.left[rows], self.right[rows], *ends, self.motion[rows])

    @classmethod
    def joined(cls, parts: list[_Rows]) -> _Rows:
        pair, left, right, motion = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("pair", "left", "right", "motion")
        )
        before, after = Bounds.joined(*(part.before for part in parts)), Bounds.joined(*(part.after for part in parts))
        return cls(pair, left, right, before, after, motion)


class EdgeTree:
    """One edge; ``run`` it once.

    Args:
        path: Two waypoints, or one.
        enough: Metres by which every pair must be proven apart, and more.
        nearer: Metres; a pair that is proven nearer collides.
    """

    def __init__(self, motion: Motion, path: JointPath, enough: float, nearer: float) -> None:
        self._motion, self._path, self._enough, self._nearer = motion, path, enough, nearer
        self._leaf = motion.children[:, 1] == 0
        self._nodes = Nodes(motion, path)
        self._asked = 0
        self._found = Judged(EdgeVerdict.FREE)

    def run(self, roots: IntArray) -> Judged:
        """The verdict on the pairs ``roots``."""
        with suppress(_Over):
            rows = self._ends(*self._middle(roots))
            while len(rows.pair):
                rows = self._split(rows)
                if len(rows.pair):
                    rows = self._halved(rows)
        return self._found

    def _charge(self, count: int, pair: int, node: int) -> None:
        self._asked += count
        if self._asked > MAX_EDGE_BOUNDS:
            self._lose(pair, node)
            raise _Over

    def _lose(self, pair: int, node: int) -> None:
        if self._found.verdict is EdgeVerdict.FREE:
            self._found = Judged(EdgeVerdict.UNDECIDED, pair, float(self._nodes.s[node]))

    def _closed(self, one: FloatArray, two: FloatArray, motion: FloatArray) -> BoolArray:
        bound = np.maximum(0.5 * (one + two - motion), np.maximum(one, two) - motion)
        return np.asarray(bound > self._enough)

    def _judged(
        self, pair: IntArray, node: IntArray, hints: FloatArray, closes: Callable[[IntArray, FloatArray], BoolArray]
    ) -> tuple[Bounds, IntArray]:
        """Bounds of pairs at nodes, and the states of the rows.

        Args:
            closes: Whether bounds of some rows close what is open there.
        """
        facing = self._motion.facing(self._nodes.poses, pair, node)
        gaps, n = rough_gaps(facing, hints)
        every = np.arange(len(pair))
        state = np.where(closes(every, gaps), CLOSED, OPEN)
        rows = np.flatnonzero((state == OPEN) & self._leaf[pair])
        if len(rows):
            gaps[rows], n[:, rows] = refined_gaps(facing.take(rows), gaps[rows], n[:, rows], ROUNDS)
        for k in rows[~(gaps[rows] > self._enough)].tolist():
            one = facing.take(np.array([k]))
            gaps[k], n[:, k], contact = settled(one, float(gaps[k]), n[:, k], self._enough, self._nearer)
            state[k] = {Contact.APART: OPEN, Contact.OVERLAP: OVERLAPPING, Contact.UNCLEAR: LOST}[contact]
        apart = rows[state[rows] == OPEN]
        state[apart] = np.where(closes(apart, gaps[apart]), CLOSED, OPEN)
        return Bounds(gaps, n), state

    def _left_open(self, pair: IntArray, node: IntArray, state: IntArray) -> IntArray:
        """The rows that are open; raise if one overlaps."""
        over = np.flatnonzero(state == OVERLAPPING)
        if len(over):
            k = int(over[0])
            self._found = Judged(EdgeVerdict.COLLIDING, int(pair[k]), float(self._nodes.s[node[k]]))
            raise _Over
        for k in np.flatnonzero(state == LOST).tolist():
            self._lose(int(pair[k]), int(node[k]))
        return np.flatnonzero(state == OPEN)

    def _middle(self, roots: IntArray) -> tuple[IntArray, Bounds]:
        """Pairs that a look at the middle leaves open, with their bounds."""
        motion, length = self._motion, self._path.length
        middle = self._nodes.add([0.5 * length])
        half = self._nodes.travel[middle]
        half = np.maximum(half, self._path.travel(length) - half)
        about = motion.motions_about(self._nodes.radii[middle : middle + 1], half[None])

        def moved(pair: IntArray) -> FloatArray:
            return motion.pair_motions(about, pair, np.zeros(len(pair), dtype=np.intp))

        clear = motion.spheres_clear(self._nodes.poses, roots, np.full(len(roots), middle), moved(roots) + self._enough)
        pair: IntArray = roots[~clear]
        hints: FloatArray = np.zeros((0, 3, len(pair)))
        pairs, bounds = [roots[:0]], [Bounds(np.zeros(0), np.zeros((3, 0)))]
        while len(pair):
            node, motions = np.full(len(pair), middle), moved(pair)
            self._charge(len(pair), int(pair[0]), middle)
            known, state = self._judged(pair, node, hints, self._alone(motions))
            rows = self._left_open(pair, node, state)
            splits = ~self._leaf[pair[rows]] & (motion.size[pair[rows]] >= motions[rows])
            stay, split = rows[~splits], rows[splits]
            pairs.append(pair[stay])
            bounds.append(known.take(stay))
            pair, parent = motion.opened(pair[split])
            hints = known.n[None][:, :, split[parent]]
        return np.concatenate(pairs), Bounds.joined(*bounds)

    def _motions(self, left: IntArray, right: IntArray, pair: IntArray) -> FloatArray:
        """How far pairs move against each other between nodes."""
        return self._motion.pair_motions(self._nodes.motions(left, right), pair, np.arange(len(pair)))

    def _ends(self, pair: IntArray, middle: Bounds) -> _Rows:
        """Halves of the edge that the middle leaves open, with a look at its ends."""
        if len(pair):
            self._nodes.add([0.0, self._path.length])
        parts = []
        for end in (1, 2):  # nodes, the middle being 0
            left, right = (np.full(len(pair), node) for node in ((1, 0) if end == 1 else (0, 2)))
            motion = self._motions(left, right, pair) if len(pair) else middle.gaps
            rows = np.flatnonzero(~(middle.gaps - motion > self._enough))
            known = middle.take(rows)
            half = _Rows(pair[rows], left[rows], right[rows], known, known, motion[rows])
            if len(rows):
                self._charge(len(rows), int(half.pair[0]), end)
                node = np.full(len(rows), end)
                bounds, state = self._judged(half.pair, node, known.n[None], self._beside(known.gaps, half.motion))
                half = replace(half, after=bounds) if end == 2 else replace(half, before=bounds)
                half = half.take(self._left_open(half.pair, node, state))
            parts.append(half)
        return _Rows.joined(parts)

    def _alone(self, motion: FloatArray) -> Callable[[IntArray, FloatArray], BoolArray]:
        """Whether bounds at one place close what moves so far from there."""
        return lambda rows, gaps: gaps - motion[rows] > self._enough

    def _beside(self, known: FloatArray, motion: FloatArray) -> Callable[[IntArray, FloatArray], BoolArray]:
        """Whether bounds close stretches of which the other end has ``known`` ones."""
        return lambda rows, gaps: self._closed(known[rows], gaps, motion[rows])

    def _split(self, rows: _Rows) -> _Rows:
        """The same with bundles that are larger than the motion replaced by what is in them."""
        size = self._motion.size
        splits = ~self._leaf[rows.pair] & (size[rows.pair] >= rows.motion)
        parts, bundles = [rows.take(np.flatnonzero(~splits))], rows.take(np.flatnonzero(splits))
        while len(bundles.pair):
            fresh = self._opened(bundles)
            splits = ~self._leaf[fresh.pair] & (size[fresh.pair] >= fresh.motion)
            parts.append(fresh.take(np.flatnonzero(~splits)))
            bundles = fresh.take(np.flatnonzero(splits))
        return _Rows.joined(parts)

    def _opened(self, asks: _Rows) -> _Rows:
        """What is in some bundles, as far as it is not closed."""
        pair, parent = self._motion.opened(asks.pair)
        row = asks.take(parent)
        self._charge(2 * len(pair), int(pair[0]), int(row.left[0]))
        motion = self._motions(row.left, row.right, pair)
        hints = np.stack([row.before.n, row.after.n])
        before, first = self._judged(pair, row.left, hints, self._alone(motion))
        left = np.flatnonzero(first == OPEN)
        closes = self._beside(before.gaps[left], motion[left])
        after, second = self._judged(pair[left], row.right[left], hints[:, :, left], closes)
        state, node = first.copy(), row.left.copy()
        state[left], node[left] = second, row.right[left]
        rows = self._left_open(pair, node, state)
        ends = before.take(rows), after.take((np.cumsum(first == OPEN) - 1)[rows])
        return _Rows(pair[rows], row.left[rows], row.right[rows], *ends, motion[rows])

    def _halved(self, rows: _Rows) -> _Rows:
        """What a look at the middle of each stretch leaves open of its halves."""
        self._charge(len(rows.pair), int(rows.pair[0]), int(rows.left[0]))
        _, first, number = np.unique(rows.left, return_index=True, return_inverse=True)
        middles = 0.5 * (self._nodes.s[rows.left[first]] + self._nodes.s[rows.right[first]])
        node = self._nodes.add(middles) + number
        motions = [self._motions(*ends, rows.pair) for ends in ((rows.left, node), (node, rows.right))]
        a, b = rows.before, rows.after

        def halves(chosen: IntArray, gap: FloatArray) -> tuple[BoolArray, BoolArray]:
            first = self._closed(a.gaps[chosen], gap, motions[0][chosen])
            return first, self._closed(gap, b.gaps[chosen], motions[1][chosen])

        hints = np.stack([a.n, b.n, a.n + b.n])
        bounds, state = self._judged(rows.pair, node, hints, lambda rows, gap: np.logical_and(*halves(rows, gap)))
        left = self._left_open(rows.pair, node, state)
        closed = halves(left, bounds.gaps[left])
        chosen, known = rows.take(left), bounds.take(left)
        parts = [
            _Rows(chosen.pair, chosen.left, node[left], chosen.before, known, motions[0][left]),
            _Rows(chosen.pair, node[left], chosen.right, known, chosen.after, motions[1][left]),
        ]
        both = _Rows.joined(parts)
        order = np.arange(2 * len(left)).reshape(2, -1).T.ravel()  # a row's halves one after the other
        return both.take(order[~np.stack(closed, axis=1).ravel()])
