"""The bisection behind a certificate: which pairs are proven apart on which stretches of a curve.

Clearance bounds at both ends of a stretch and a bound of the motion in between prove a pair apart on all of it: on the
way the gap shrinks by no more than the two move (Schwarzer, Saha & Latombe, IEEE T-RO 21(3), 2005). What is not proven
is cut in half. All pairs share one tree over the whole curve, so that a configuration is placed once, and each pair
goes only as deep as it has to. A pair with a bundle of pieces gives way to those with what is in it once the bundle is
larger than the motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planner_service.certify.motion_bounds import Motion, Nodes
from planner_service.certify.separation import Bounds, Facing, drawn_apart, refined_gaps, rough_gaps
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.path.joint_path import JointPath

__all__ = ["MAX_BOUNDS", "NO_LEAVES", "Obstruction", "ProofTree", "Roots", "Span", "no_end", "too_close"]

FRACTION = 0.75
"""A stretch stays open while it proves less than this share of the smallest gap at any node so far: 0.5 asks 2 % fewer
bounds on paths among obstacles, and proves a clearance that is a third smaller."""

MAX_BOUNDS = 300_000
"""A curve that needs more, and ten for each pair, is as good as touching; ordinary ones take about two thousand."""

FAR = 0.1
"""Metres: pairs that one bound proves farther apart on a whole curve are not looked at again."""

BATCH = 4096
"""Rows judged between two calls of ``charge``, so that a caller can stop a long proof within some milliseconds."""

NEAR = 0.05
"""Metres: at the ends of a curve, nearer pairs get a tight bound."""

CLOSE = 2.0
"""In between, those do that are nearer than this many times the smallest gap so far. Tight bounds for all open pairs
save one bound in a hundred and take a fifth more time."""

ROUNDS, LAST_ROUNDS = 4, 200
"""Steps of the search for the best direction: usually, and before a pair is refused."""

Span = tuple[float, float]

NO_LEAVES: FloatArray = np.zeros((0, 9))


class Obstruction(NamedTuple):
    """Where a proof ended: the pair, the stretch of s, where on it, and why; ``spent`` if there was no end to it."""

    pair: int
    span: Span
    s: float
    detail: str
    spent: bool = False


class Roots(NamedTuple):
    """What is to be proven: spans of s, and rows (k, 2), each the number of a pair and that of its span."""

    spans: list[Span]
    rows: IntArray


@dataclass(frozen=True, eq=False)
class _Open:
    """What is not proven yet: nodes at the ends of each stretch, and rows of a pair, its stretch and what is known.

    Attributes:
        motion: How far the two move against each other on the stretch, at most.
    """

    left: IntArray
    right: IntArray
    pair: IntArray
    stretch: IntArray
    before: Bounds
    after: Bounds
    motion: FloatArray


class ProofTree:
    """One proof; ``run`` it once.

    Args:
        motion: Robot and scene.
        path: The curve.
        enough: Metres by which every pair must be proven apart, and more; if negative, by how much they may overlap.
        charge: Called with the number of bounds before each batch; what it raises comes out unchanged.
        together: A stretch stays open for every pair as long as it does for one: what proofs without a list of open
            pairs do, here to compare with.
        tracing: Keep what is proven as ``leaves``, and prove it by plain bounds of motions; see ``Nodes``.

    Attributes:
        bounds: (configuration, pair) bounds so far.
        proven: The smallest gap proven for any stretch so far; infinite before the first.
        leaves: What is proven, (k, 9): the pair, from where to where in s, and unit directions at both ends from the
            second piece towards the first, in the second's axes; zero at an end where none was needed.
    """

    def __init__(
        self,
        motion: Motion,
        path: JointPath,
        enough: float,
        charge: Callable[[int], None] = lambda bounds: None,
        *,
        together: bool = False,
        tracing: bool = False,
    ) -> None:
        self._motion, self._path, self._enough, self._charge = motion, path, enough, charge
        self._together = together
        self.bounds = 0
        self.proven = math.inf
        self._most = MAX_BOUNDS
        self._smallest = math.inf
        self._leaf = motion.children[:, 1] == 0
        self._traced: list[FloatArray] | None = [] if tracing else None
        self._nodes = Nodes(motion, path, plain=tracing)

    @property
    def leaves(self) -> FloatArray:
        return np.concatenate(self._traced) if self._traced else NO_LEAVES

    def run(self, task: Roots) -> Obstruction | None:
        """Where the proof ends; None when all is proven.

        Of several pairs that cannot be proven the one with the smallest bound is named.
        """
        spans, roots = task
        self._most = MAX_BOUNDS + 10 * max(len(roots), int(self._leaf.sum()))
        if not self._together and self._path.length > 0.0:
            roots = roots[~self._far(spans, roots)]
        remaining = self._rooted(spans, roots)
        while isinstance(remaining, _Open):
            if not len(remaining.pair):
                return None
            splitting = ~self._leaf[remaining.pair] & (self._motion.size[remaining.pair] >= remaining.motion)
            remaining = (
                self._split(remaining, splitting)
                if np.any(splitting)
                else self._stuck(remaining) or self._halved(remaining)
            )
        return remaining

    def _far(self, spans: Sequence[Span], roots: IntArray) -> BoolArray:
        """Rows of ``roots`` whose bounding spheres are ``FAR`` apart all along: a bound in the middle of each."""
        pair, stretch = roots.T
        start, end = np.array(spans, dtype=np.float64).reshape(-1, 2).T
        count = len(spans)
        first = self._nodes.add(np.concatenate([start, 0.5 * (start + end), end]))
        left, middle, right = (first + np.arange(k * count, (k + 1) * count) for k in range(3))
        self._charge(len(pair))
        self.bounds += len(pair)
        apart = self._motion.spheres_apart(self._nodes.poses, pair, middle[stretch])
        moved = [self._nodes.motions(*ends) for ends in ((left, middle), (middle, right))]
        gaps = apart - np.maximum(*(self._motion.pair_motions(half, pair, stretch) for half in moved))
        far = gaps >= max(self._enough, FAR)
        self.proven = float(gaps[far].min(initial=math.inf))
        if self._traced is not None and far.any():
            facing = self._motion.facing(self._nodes.poses, pair[far], middle[stretch[far]])
            n = facing.x / np.sqrt(facing.x[0] * facing.x[0] + facing.x[1] * facing.x[1] + facing.x[2] * facing.x[2])
            none = np.zeros_like(n)
            s = self._nodes.s
            for ends, directions in (((left, middle), (none, n)), ((middle, right), (n, none))):
                start, stop = (s[node[stretch[far]]] for node in ends)
                self._traced.append(np.column_stack([pair[far], start, stop, directions[0].T, directions[1].T]))
        return np.asarray(far)

    def _rooted(self, spans: Sequence[Span], roots: IntArray) -> _Open | Obstruction:
        """What both ends of each span leave open."""
        pair, stretch = roots.T.copy()
        s, back = np.unique(np.array(spans, dtype=np.float64).reshape(-1, 2).T, return_inverse=True)
        left, right = self._nodes.add(s) + back.reshape(2, -1)
        judged: list[Bounds] = []
        for nodes in (left, right) if len(s) > 1 else (left,):  # a point has one end
            node = nodes[stretch]
            ends, bad = self._judged(pair, node, np.zeros((0, 3, len(pair))), NEAR)
            if bad is not None:
                where = float(self._nodes.s[node[bad]])
                return self._obstructed(pair, ends, bad, (where, where), where)
            judged.append(ends)
        return self._kept(left, right, pair, stretch, judged[0], judged[-1])

    def _split(self, open_: _Open, splitting: BoolArray) -> _Open | Obstruction:
        """The same with some pairs replaced by their children, as far as these are not proven."""
        rows, rest = np.flatnonzero(splitting), np.flatnonzero(~splitting)
        pair, parent = self._motion.opened(open_.pair[rows])
        stretch = open_.stretch[rows][parent]
        hints = np.stack([open_.before.n[:, rows], open_.after.n[:, rows]])[:, :, parent]
        ends = []
        for nodes, known in ((open_.left, open_.before), (open_.right, open_.after)):
            bounds, bad = self._judged(pair, nodes[stretch], hints, self._close())
            if bad is not None:
                s = float(self._nodes.s[nodes[stretch[bad]]])
                return self._obstructed(pair, bounds, bad, (s, s), s)
            ends.append(Bounds.joined(known.take(rest), bounds))
        pairs, stretches = np.concatenate([open_.pair[rest], pair]), np.concatenate([open_.stretch[rest], stretch])
        return self._kept(open_.left, open_.right, pairs, stretches, ends[0], ends[1])

    def _close(self) -> float:
        return CLOSE * max(self._smallest, self._enough) if self._enough > 0.0 else NEAR

    def _halved(self, open_: _Open) -> _Open | Obstruction:
        """What a look at the middle of each stretch leaves open of its halves."""
        left, right, pair, stretch = open_.left, open_.right, open_.pair, open_.stretch
        middle = self._middle(open_)
        nodes = self._nodes.add(middle) + np.arange(len(middle))
        before, after = open_.before, open_.after
        hints = np.stack([before.n, after.n, before.n + after.n])
        ends, bad = self._judged(pair, nodes[stretch], hints, self._close())
        if bad is not None:
            k = stretch[bad]
            span = (float(self._nodes.s[left[k]]), float(self._nodes.s[right[k]]))
            return self._obstructed(pair, ends, bad, span, float(middle[k]))
        starts, stops = np.concatenate([left, nodes]), np.concatenate([nodes, right])
        pairs, stretches = np.concatenate([pair, pair]), np.concatenate([stretch, stretch + len(left)])
        return self._kept(starts, stops, pairs, stretches, Bounds.joined(before, ends), Bounds.joined(ends, after))

    def _middle(self, open_: _Open) -> FloatArray:
        return np.asarray(0.5 * (self._nodes.s[open_.left] + self._nodes.s[open_.right]))

    def _stuck(self, open_: _Open) -> Obstruction | None:
        """Why the proof cannot go on, None when it can."""
        start, end, middle = self._nodes.s[open_.left], self._nodes.s[open_.right], self._middle(open_)
        pointlike = ((middle <= start) | (middle >= end))[open_.stretch]
        spent = self.bounds + len(open_.pair) > self._most
        if not spent and not np.any(pointlike):
            return None
        gaps = np.minimum(open_.before.gaps, open_.after.gaps)
        row = int((gaps if spent else np.where(pointlike, gaps, np.inf)).argmin())
        k = open_.stretch[row]
        detail = no_end(self._most if spent else None)
        span = (float(start[k]), float(end[k]))
        return Obstruction(int(open_.pair[row]), span, float(middle[k]), detail, spent)

    def _judged(self, pair: IntArray, node: IntArray, hints: FloatArray, close: float) -> tuple[Bounds, int | None]:
        """Bounds of pairs at nodes, one each, and a row without a bundle that is not far enough apart, if any.

        Args:
            hints: Directions to try, (k, 3, pairs).
            close: Pairs that are nearer get a tight bound.
        """
        parts: list[Bounds] = []
        for start in range(0, max(len(pair), 1), BATCH):
            rows = slice(start, start + BATCH)
            self._charge(len(pair[rows]))
            self.bounds += len(pair[rows])
            facing = self._motion.facing(self._nodes.poses, pair[rows], node[rows])
            rough = Bounds(*rough_gaps(facing, hints[:, :, rows]))
            ends, bad = self._tightened(facing, rough, pair[rows], close)
            parts.append(ends)
            if bad is not None:
                break
        return Bounds.joined(*parts), None if bad is None else start + bad

    def _tightened(self, facing: Facing, ends: Bounds, pair: IntArray, close: float) -> tuple[Bounds, int | None]:
        """The same with better bounds of pairs that are ``close``, and a row that is not far enough apart, if any is.

        Something in a bundle is no farther away than the bundle and its size: that counts for the smallest gap.
        """
        leaf = self._leaf[pair]
        ends = self._refined(facing, ends, np.flatnonzero(leaf & (ends.gaps < close)), ROUNDS)
        far = np.where(leaf, ends.gaps, ends.gaps + 2.0 * self._motion.size[pair])
        self._smallest = min(self._smallest, float(far.min(initial=math.inf)))
        bad = np.flatnonzero(leaf & ~(ends.gaps > self._enough))
        if not len(bad):
            return ends, None
        ends = self._refined(facing, ends, bad, LAST_ROUNDS)
        worst = int(bad[ends.gaps[bad].argmin()])
        return ends, None if ends.gaps[worst] > self._enough else worst

    def _refined(self, facing: Facing, ends: Bounds, rows: IntArray, rounds: int) -> Bounds:
        """The same with better bounds of some rows, also of overlaps where these are what is judged."""
        if not len(rows):
            return ends
        gaps, n = ends.gaps.copy(), ends.n.copy()
        gaps[rows], n[:, rows] = refined_gaps(facing.take(rows), gaps[rows], n[:, rows], rounds)
        hulled = facing.with_hull
        if self._enough <= 0.0 and hulled is not None:
            rows = rows[hulled[rows] & (gaps[rows] < 0.0)]
            gaps[rows], n[:, rows] = drawn_apart(facing.take(rows), gaps[rows], n[:, rows], ROUNDS)
        return Bounds(gaps, n)

    def _obstructed(self, pair: IntArray, ends: Bounds, row: int, span: Span, s: float) -> Obstruction:
        return Obstruction(int(pair[row]), span, s, too_close(s, float(ends.gaps[row]), self._enough))

    def _kept(
        self, left: IntArray, right: IntArray, pair: IntArray, stretch: IntArray, before: Bounds, after: Bounds
    ) -> _Open:
        """Accept the rows that are proven; the others, their stretches numbered anew."""
        one, two = before.gaps, after.gaps
        motion = self._motion.pair_motions(self._nodes.motions(left, right), pair, stretch)
        bound = np.minimum(0.5 * (one + two - motion), np.minimum(one, two))
        proven = bound >= (max(self._enough, FRACTION * self._smallest) if self._enough > 0.0 else self._enough)
        used = np.zeros(len(left), dtype=bool)
        used[stretch[~proven]] = True
        if self._together:
            proven = ~used[stretch]
        self.proven = min(self.proven, float(bound[proven].min(initial=math.inf)))
        if self._traced is not None:
            start, stop = self._nodes.s[left][stretch], self._nodes.s[right][stretch]
            rows = np.column_stack([pair, start, stop, before.n.T, after.n.T])
            self._traced.append(rows[proven])
        rest = np.flatnonzero(~proven)
        number = (np.cumsum(used) - 1)[stretch[rest]]
        ends = before.take(rest), after.take(rest)
        return _Open(left[used], right[used], pair[rest], number, *ends, motion[rest])


def too_close(s: float, gap: float, enough: float) -> str:
    """The words for a pair of which no more than ``gap`` metres is proven at s."""
    mm = gap * 1e3
    proven = f"a gap of {mm:.4f} mm is proven" if mm > 0.0 else f"they overlap by at most {-mm:.4f} mm"
    if enough <= 0.0:
        return f"at s = {s:.6g} {proven}; less than {-enough * 1e3:.4f} mm is allowed"
    return f"at s = {s:.6g} {proven}; more than {enough * 1e3:.4f} mm is needed"


def no_end(most: int | None) -> str:
    """The words for a proof that did not end within so many bounds, or at a point if None."""
    return "no shorter stretch has numbers of its own" if most is None else f"{most:,} bounds did not suffice"
