"""The verdict on one straight edge: proven free, proven to collide, or neither; the reference.

The same bounds as a certificate's, but only a verdict is wanted: a stretch is closed as soon as its bound suffices. The
middle of the edge is looked at first, for a bound there counts in both directions and most pairs are far; then the
ends, then the middle of what is left open.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from planner_service.certify.interval_proof import ROUNDS
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.overlap import Contact, settled
from planner_service.certify.separation import refined_gaps, rough_gaps
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
    """A verdict, the number of a pair (-1 if free), and where."""

    verdict: EdgeVerdict
    pair: int
    s: float


class _Over(Exception):
    """The verdict is known."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Pairs not closed yet, on the stretch between two nodes each, and bounds and directions at both."""

    pair: IntArray
    left: IntArray
    right: IntArray
    before: tuple[FloatArray, FloatArray]
    after: tuple[FloatArray, FloatArray]
    motion: FloatArray

    def take(self, rows: IntArray) -> _Rows:
        before, after = ((gaps[rows], n[:, rows]) for gaps, n in (self.before, self.after))
        return _Rows(self.pair[rows], self.left[rows], self.right[rows], before, after, self.motion[rows])

    @classmethod
    def joined(cls, parts: list[_Rows]) -> _Rows:
        pair, left, right, motion = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("pair", "left", "right", "motion")
        )
        before, after = (
            (np.concatenate([end[0] for end in ends]), np.concatenate([end[1] for end in ends], axis=1))
            for ends in ([part.before for part in parts], [part.after for part in parts])
        )
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
        self._poses: FloatArray = motion.fixed
        self._s: FloatArray = np.zeros(0)
        self._travel: FloatArray = np.zeros((0, path.n))
        self._radii: FloatArray = np.zeros((0, motion.depth, motion.riding))
        self._asked = 0
        self._found = Judged(EdgeVerdict.FREE, -1, 0.0)

    def run(self, roots: IntArray) -> Judged:
        """The verdict on the pairs ``roots``."""
        with suppress(_Over):
            rows = self._ends(*self._middle(roots))
            while len(rows.pair):
                rows = self._split(rows)
                if len(rows.pair):
                    rows = self._halved(rows)
        return self._found

    def _placed(self, s: list[float]) -> int:
        """Add nodes; the number of the first."""
        first = len(self._s)
        poses, radii = self._motion.nodes(self._path(s))
        self._poses = np.concatenate([self._poses, poses], axis=2)
        self._s = np.concatenate([self._s, s])
        self._travel = np.concatenate([self._travel, self._path.travel(s)])
        self._radii = np.concatenate([self._radii, radii])
        return first

    def _charge(self, count: int, pair: int, node: int) -> None:
        self._asked += count
        if self._asked > MAX_EDGE_BOUNDS:
            self._lose(pair, node)
            raise _Over

    def _lose(self, pair: int, node: int) -> None:
        if self._found.verdict is EdgeVerdict.FREE:
            self._found = Judged(EdgeVerdict.UNDECIDED, pair, float(self._s[node]))

    def _closed(self, one: FloatArray, two: FloatArray, motion: FloatArray) -> BoolArray:
        bound = np.maximum(0.5 * (one + two - motion), np.maximum(one, two) - motion)
        return np.asarray(bound > self._enough)

    def _judged(
        self, pair: IntArray, node: IntArray, hints: FloatArray, closes: Callable[[IntArray, FloatArray], BoolArray]
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Bounds and directions of pairs at nodes, and the states of the rows.

        Args:
            closes: Whether bounds of some rows close what is open there.
        """
        facing = self._motion.facing(self._poses, pair, node)
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
        return gaps, n, state

    def _told(self, pair: IntArray, node: IntArray, state: IntArray) -> IntArray:
        """The rows that are open; raise if one overlaps."""
        over = np.flatnonzero(state == OVERLAPPING)
        if len(over):
            k = int(over[0])
            self._found = Judged(EdgeVerdict.COLLIDING, int(pair[k]), float(self._s[node[k]]))
            raise _Over
        for k in np.flatnonzero(state == LOST).tolist():
            self._lose(int(pair[k]), int(node[k]))
        return np.flatnonzero(state == OPEN)

    def _middle(self, roots: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Pairs that a look at the middle leaves open, with their bounds and directions."""
        motion, length = self._motion, self._path.length
        middle = self._placed([0.5 * length])
        half = self._travel[middle]
        half = np.maximum(half, self._path.travel(length) - half)
        about = motion.motions_about(self._radii[middle : middle + 1], half[None])

        def moved(pair: IntArray) -> FloatArray:
            return motion.pair_motions(about, pair, np.zeros(len(pair), dtype=np.intp))

        clear = motion.spheres_clear(self._poses, roots, np.full(len(roots), middle), moved(roots) + self._enough)
        pair: IntArray = roots[~clear]
        hints: FloatArray = np.zeros((0, 3, len(pair)))
        open_parts: list[tuple[IntArray, FloatArray, FloatArray]] = [(roots[:0], np.zeros(0), np.zeros((3, 0)))]
        while len(pair):
            node, motions = np.full(len(pair), middle), moved(pair)
            self._charge(len(pair), int(pair[0]), middle)
            gaps, n, state = self._judged(pair, node, hints, self._alone(motions))
            rows = self._told(pair, node, state)
            splits = ~self._leaf[pair[rows]] & (motion.size[pair[rows]] >= motions[rows])
            stay, split = rows[~splits], rows[splits]
            open_parts.append((pair[stay], gaps[stay], n[:, stay]))
            pair, parent = motion.opened(pair[split])
            hints = n[None][:, :, split[parent]]
        return (
            np.concatenate([part[0] for part in open_parts]),
            np.concatenate([part[1] for part in open_parts]),
            np.concatenate([part[2] for part in open_parts], axis=1),
        )

    def _motions(self, left: IntArray, right: IntArray, pair: IntArray) -> FloatArray:
        """How far pairs move against each other between nodes."""
        travel = self._travel[right] - self._travel[left]
        motions = self._motion.motions(self._radii[left], self._radii[right], travel)
        return self._motion.pair_motions(motions, pair, np.arange(len(pair)))

    def _ends(self, pair: IntArray, gaps: FloatArray, n: FloatArray) -> _Rows:
        """Halves of the edge that the middle leaves open, with a look at its ends."""
        if len(pair):
            self._placed([0.0, self._path.length])
        parts = []
        for end in (1, 2):  # nodes, the middle being 0
            left, right = (np.full(len(pair), node) for node in ((1, 0) if end == 1 else (0, 2)))
            motion = self._motions(left, right, pair) if len(pair) else gaps
            rows = np.flatnonzero(~(gaps - motion > self._enough))
            known = (gaps[rows], n[:, rows])
            half = _Rows(pair[rows], left[rows], right[rows], known, known, motion[rows])
            if len(rows):
                self._charge(len(rows), int(half.pair[0]), end)
                node = np.full(len(rows), end)
                bounds, way, state = self._judged(half.pair, node, known[1][None], self._beside(known[0], half.motion))
                ends = (known, (bounds, way)) if end == 2 else ((bounds, way), known)
                half = _Rows(half.pair, half.left, half.right, *ends, half.motion).take(
                    self._told(half.pair, node, state)
                )
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
        parts, asks = [rows.take(np.flatnonzero(~splits))], rows.take(np.flatnonzero(splits))
        while len(asks.pair):
            fresh = self._opened(asks)
            splits = ~self._leaf[fresh.pair] & (size[fresh.pair] >= fresh.motion)
            parts.append(fresh.take(np.flatnonzero(~splits)))
            asks = fresh.take(np.flatnonzero(splits))
        return _Rows.joined(parts)

    def _opened(self, asks: _Rows) -> _Rows:
        """What is in some bundles, as far as it is not closed."""
        pair, parent = self._motion.opened(asks.pair)
        row = asks.take(parent)
        self._charge(2 * len(pair), int(pair[0]), int(row.left[0]))
        motion = self._motions(row.left, row.right, pair)
        hints = np.stack([row.before[1], row.after[1]])
        one, way, first = self._judged(pair, row.left, hints, self._alone(motion))
        left = np.flatnonzero(first == OPEN)
        motion_left = motion[left]
        two, other, second = self._judged(
            pair[left], row.right[left], hints[:, :, left], self._beside(one[left], motion_left)
        )
        state, node = first.copy(), row.left.copy()
        state[left], node[left] = second, row.right[left]
        rows = self._told(pair, node, state)
        place = np.cumsum(first == OPEN) - 1
        gaps, n = two[place[rows]], other[:, place[rows]]
        return _Rows(pair[rows], row.left[rows], row.right[rows], (one[rows], way[:, rows]), (gaps, n), motion[rows])

    def _halved(self, rows: _Rows) -> _Rows:
        """What a look at the middle of each stretch leaves open of its halves."""
        self._charge(len(rows.pair), int(rows.pair[0]), int(rows.left[0]))
        _, first, number = np.unique(rows.left, return_index=True, return_inverse=True)
        middles = 0.5 * (self._s[rows.left[first]] + self._s[rows.right[first]])
        node = self._placed(middles.tolist()) + number
        motions = [self._motions(*ends, rows.pair) for ends in ((rows.left, node), (node, rows.right))]
        (one, a), (two, b) = rows.before, rows.after

        def halves(chosen: IntArray, gap: FloatArray) -> tuple[BoolArray, BoolArray]:
            return self._closed(one[chosen], gap, motions[0][chosen]), self._closed(
                gap, two[chosen], motions[1][chosen]
            )

        gaps, n, state = self._judged(
            rows.pair, node, np.stack([a, b, a + b]), lambda chosen, gap: np.logical_and(*halves(chosen, gap))
        )
        left = self._told(rows.pair, node, state)
        closed = halves(left, gaps[left])
        chosen, known = rows.take(left), (gaps[left], n[:, left])
        parts = [
            _Rows(chosen.pair, chosen.left, node[left], chosen.before, known, motions[0][left]),
            _Rows(chosen.pair, node[left], chosen.right, known, chosen.after, motions[1][left]),
        ]
        both = _Rows.joined(parts)
        order = np.arange(2 * len(left)).reshape(2, -1).T.ravel()  # a row's halves one after the other
        return both.take(order[~np.stack(closed, axis=1).ravel()])
