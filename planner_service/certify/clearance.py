"""How far pairs are apart, at many configurations: lower bounds by the certificate's means, the reference.

A pair's gap is at least its best bound, and at least that of the bundle it is in. The smallest of these does not depend
on the order in which pairs are looked at, nor on which are left out because a cheaper bound of theirs is no smaller.
"""

from __future__ import annotations

import numpy as np

from planner_service.certify.interval_proof import ROUNDS
from planner_service.certify.motion_bounds import Motion
from planner_service.certify.separation import Bounds, drawn_apart, refined_gaps, rough_gaps
from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["CLEARANCE_ROUNDS", "along_deepest", "near_gaps", "slopes", "smallest_gaps"]


CLEARANCE_ROUNDS = 20
"""Steps of the search for the best direction."""

STEP = 1e-6
"""Radians (or metres) by which a joint is moved to either side for a slope."""

AT_ONCE = 20_000
"""Pairs at configurations, so that temporary arrays stay small."""


def smallest_gaps(motion: Motion, Q: FloatArray, roots: IntArray) -> FloatArray:
    """Lower bounds (metres) of the smallest gap at configurations Q (m, n), (m,); infinite if there are no pairs.

    Of a row that is not finite, and wherever a gap is no number, it is -infinity.
    """
    sound = np.isfinite(Q).all(axis=1)
    if not sound.all():
        gaps = np.full(len(Q), -np.inf)
        gaps[sound] = smallest_gaps(motion, Q[sound], roots)
        return gaps
    out = np.full(len(Q), np.inf)
    step = max(1, AT_ONCE // max(len(roots), 1))
    for start in range(0, len(Q) if len(roots) else 0, step):
        out[start : start + step] = _Batch(motion, Q[start : start + step]).smallest(roots)
    return out


class _Batch:
    def __init__(self, motion: Motion, Q: FloatArray) -> None:
        self._motion = motion
        self._count = len(Q)
        self._poses = np.concatenate([motion.fixed, motion.nodes(Q)[0]], axis=2)
        self._best = np.full(len(Q), np.inf)

    def smallest(self, roots: IntArray) -> FloatArray:
        pair, node = np.tile(roots, self._count), np.repeat(np.arange(self._count), len(roots))
        known = self._motion.spheres_apart(self._poses, pair, node)
        nearest = known.reshape(self._count, -1).argmin(axis=1) + len(roots) * np.arange(self._count)
        self._look(pair[nearest], node[nearest], known[nearest])
        while len(pair):
            pair, node, known = self._look(pair, node, known)
        return np.where(np.isnan(self._best), -np.inf, self._best)

    def _look(self, pair: IntArray, node: IntArray, known: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Lower the smallest gaps by what pairs say at nodes; the children of bundles that may lower them further."""
        may = ~(known >= self._best[node])  # NaN stays
        pair, node, known = pair[may], node[may], known[may]
        facing = self._motion.facing(self._poses, pair, node)
        gaps, n = rough_gaps(facing, np.zeros((0, 3, len(pair))))
        known = np.maximum(known, gaps)
        leaves = np.flatnonzero((self._motion.children[pair, 1] == 0) & ~(known >= self._best[node]))
        if len(leaves):
            tight, _ = refined_gaps(facing.take(leaves), gaps[leaves], n[:, leaves], CLEARANCE_ROUNDS)
            np.minimum.at(self._best, node[leaves], np.maximum(known[leaves], tight))
        child, parent = self._motion.opened(pair)
        apart = self._motion.spheres_apart(self._poses, child, node[parent])
        return child, node[parent], np.maximum(known[parent], apart)


def near_gaps(motion: Motion, Q: FloatArray, pairs: IntArray, within: float) -> tuple[IntArray, IntArray, Bounds]:
    """Pairs that are less than ``within`` metres apart at configurations Q (m, n): rows of Q, pairs and signed gaps.

    A gap below 0 is an overlap of no more than that. Pairs with bundles are opened. Sorted by rows and pairs.
    """
    poses = np.concatenate([motion.fixed, motion.nodes(Q)[0]], axis=2)
    node, pair = np.repeat(np.arange(len(Q)), len(pairs)), np.tile(pairs, len(Q))
    nodes, found, bounds = [node[:0]], [pair[:0]], [Bounds(np.zeros(0), np.zeros((3, 0)))]
    while len(pair):
        rows = np.flatnonzero(motion.spheres_apart(poses, pair, node) < within)
        pair, node = pair[rows], node[rows]
        facing = motion.facing(poses, pair, node)
        gaps, n = rough_gaps(facing, np.zeros((0, 3, len(pair))))
        rows = np.flatnonzero((motion.children[pair, 1] == 0) & (gaps < within))
        facing = facing.take(rows)
        tight, n = refined_gaps(facing, gaps[rows], n[:, rows], CLEARANCE_ROUNDS)
        hulled = facing.with_hull
        if hulled is not None:
            deep = np.flatnonzero(hulled & (tight < 0.0))
            tight[deep], n[:, deep] = drawn_apart(facing.take(deep), tight[deep], n[:, deep], ROUNDS)
        close = np.flatnonzero(tight < within)
        nodes.append(node[rows[close]])
        found.append(pair[rows[close]])
        bounds.append(Bounds(tight[close], n[:, close]))
        split = np.flatnonzero(gaps < within)
        pair, parent = motion.opened(pair[split])
        node = node[split[parent]]
    rows, pairs, near = np.concatenate(nodes), np.concatenate(found), Bounds.joined(*bounds)
    order = np.lexsort((pairs, rows))
    return rows[order], pairs[order], near.take(order)


def slopes(motion: Motion, q: FloatArray, pair: IntArray, n: FloatArray) -> FloatArray:
    """How gaps of pairs change with each joint at q (n,), metres per rad or m, (pairs, n).

    Along fixed directions (3, pairs): where a gap is the largest along any, this is how the gap itself changes.
    """
    Q = np.repeat(q[None], 2 * len(q), axis=0)
    joints = np.arange(len(q))
    Q[2 * joints, joints] += STEP
    Q[2 * joints + 1, joints] -= STEP
    poses = np.concatenate([motion.fixed, motion.nodes(Q)[0]], axis=2)
    node = np.repeat(np.arange(len(Q)), len(pair))
    facing = motion.facing(poses, np.tile(pair, len(Q)), node)
    gaps = facing.along(np.tile(n, len(Q))).reshape(len(q), 2, len(pair))
    return np.asarray((gaps[:, 0] - gaps[:, 1]).T / (2.0 * STEP))


def along_deepest(motion: Motion, q: FloatArray, pair: IntArray, owner: IntArray, found: Bounds) -> Bounds:
    """Gaps of pairs at q (n,) along one direction for all of an owner (p,), that of its smallest gap in ``found``."""
    poses = np.concatenate([motion.fixed, motion.nodes(q[None])[0]], axis=2)
    facing = motion.facing(poses, pair, np.zeros(len(pair), dtype=np.intp))
    turns = motion.second_axes(poses, pair)
    out = found.n.copy()
    for each in np.unique(owner).tolist():
        rows = np.flatnonzero(owner == each)
        deepest = rows[found.gaps[rows].argmin()]
        u, v, w = found.n[:, deepest]
        R = turns[:, :, deepest]
        x, y, z = R[:, 0] * u + R[:, 1] * v + R[:, 2] * w  # in the world
        S = turns[:, :, rows]
        out[:, rows] = S[0] * x + S[1] * y + S[2] * z
    return Bounds(facing.along(out), out)
