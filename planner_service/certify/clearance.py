"""How far the nearest pair is apart, at many configurations: lower bounds by the certificate's means, the reference.

A pair's gap is at least its best bound, and at least that of the bundle it is in. The smallest of these does not depend
on the order in which pairs are looked at, nor on which are left out because a cheaper bound of theirs is no smaller.
"""

from __future__ import annotations

import numpy as np

from planner_service.certify.motion_bounds import Motion
from planner_service.certify.separation import refined_gaps, rough_gaps
from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["CLEARANCE_ROUNDS", "smallest_gaps"]


CLEARANCE_ROUNDS = 20
"""Steps of the search for the best direction."""

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
