"""How gaps of pairs change, by the certificate's means."""

from __future__ import annotations

import numpy as np

from planner_service.certify.motion_bounds import Motion
from planner_service.certify.separation import Bounds
from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["CLEARANCE_ROUNDS", "along_deepest", "slopes"]


CLEARANCE_ROUNDS = 20
"""Steps of the search for the best direction of a clearance."""

STEP = 1e-6
"""Radians (or metres) by which a joint is moved to either side for a slope."""


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
