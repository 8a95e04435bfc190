"""Shortens a polyline that keeps constraints: pieces are replaced by straight ways projected onto the constraints.

As in smoothing.py, the compiled core does the same with the same bits, counts and order of questions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import FloatArray, joint_distance, read_only
from planner_service.kinematics.projection import LEAST_STRIDE, Projector
from planner_service.path.joint_path import JointPath
from planner_service.search.constrained import ConstrainedOracle
from planner_service.search.problem import Configuration
from planner_service.smoothing.smoothing import MIN_GAIN, asked_of_core, point_at

__all__ = ["blend_is_kept", "shortcut_on_constraints"]

LONGEST = 1.0
"""Length of a projected step at most (rad)."""

KEPT_SAMPLES = 8
"""Parts into which a blend is divided to see whether it keeps the constraints; the proof has the last word."""

Chain = list[Configuration]


def shortcut_on_constraints(
    waypoints: ArrayLike,
    oracle: ConstrainedOracle,
    rng: np.random.Generator,
    *,
    tries: int = 60,
    misses: int = 15,
) -> FloatArray:
    """Shorten a polyline (N, n) that is free and keeps the constraints, to another one, (M, n), with the same ends.

    Far vertices are connected first, then random points, by straight ways whose every step is projected onto the
    constraints; at last as many waypoints are left out as straight edges allow.

    Args:
        tries: The most random cuts to draw.
        misses: Stop after so many cuts in a row that gain too little or are not free.
    """
    points, draws = read_only(waypoints), rng.random(2 * tries).tolist()
    shorter: FloatArray | None = asked_of_core(
        oracle, lambda core, asked: partial(core.shortcut_on, points, asked, draws, misses, LONGEST)
    )
    if shorter is not None:
        return shorter
    chain = [tuple(q) for q in points.tolist()]
    chain = [q for k, q in enumerate(chain) if k == 0 or q != chain[k - 1]]
    chain = _skip_by_bridges(chain, oracle)
    missed = 0
    for u, v in zip(draws[::2], draws[1::2], strict=True):
        if missed >= misses or len(chain) < 3:
            break
        missed += 1
        cut = _cut_by_bridge(chain, min(u, v), max(u, v), oracle)
        if cut is not None:
            chain, missed = cut, 0
    return read_only(_with_few_waypoints(chain, oracle))


def blend_is_kept(path: JointPath, k: int, projector: Projector) -> bool:
    """Whether the blend at waypoint k of a path keeps the constraints at a few samples."""
    start, length = path.knots[k] - path.blends[k], 2.0 * path.blends[k]
    samples = path(np.array([start + length * (i / KEPT_SAMPLES) for i in range(1, KEPT_SAMPLES)]))
    return all(projector.has_room(tuple(q)) for q in samples.tolist())


def _length(chain: Sequence[Configuration]) -> float:
    return math.fsum(joint_distance(a, b) for a, b in pairwise(chain))


def _is_free(chain: Sequence[Configuration], oracle: ConstrainedOracle) -> bool:
    return all(oracle.edge_is_free(a, b) for a, b in pairwise(chain))


def _bridge(start: Configuration, end: Configuration, oracle: ConstrainedOracle) -> Chain:
    """The straight way between two configurations, projected step by step; empty if it does not get there."""
    out, stride = [start], LONGEST
    while True:
        left = joint_distance(out[-1], end)
        if not left > 0.0:
            return out
        step = min(stride, left)
        share = step / left
        fresh = end if step == left else tuple(x + (y - x) * share for x, y in zip(out[-1], end, strict=True))
        kept = oracle.projector.step(out[-1], fresh, end, left, step, step == left)
        if kept is not None:
            out.append(kept)
            stride = min(2.0 * step, LONGEST)
        elif step <= LEAST_STRIDE:
            return []
        else:
            stride = step / 2.0


def _skip_by_bridges(chain: Chain, oracle: ConstrainedOracle) -> Chain:
    """From each vertex by a bridge to the last, or half as far, and so on, if the bridge is free and shorter."""
    kept, last = [chain[0]], 0
    while last < len(chain) - 1:
        span = len(chain) - 1 - last
        while span > 1:
            piece = chain[last : last + span + 1]
            way = _bridge(piece[0], piece[-1], oracle)
            if way and _length(way) < _length(piece) and _is_free(way, oracle):
                kept += way[1:]
                break
            span //= 2
        if span == 1:
            kept.append(chain[last + 1])
        last += span
    return kept


def _cut_by_bridge(chain: Chain, u: float, v: float, oracle: ConstrainedOracle) -> Chain | None:
    """The chain with a bridge from u to v (shares of the length); None if it gains too little or is not free."""
    lengths = [joint_distance(a, b) for a, b in pairwise(chain)]
    total = math.fsum(lengths)
    (i, a, before), (j, b, after) = (point_at(chain, lengths, share * total) for share in (u, v))
    if i == j or (after - before) - joint_distance(a, b) < MIN_GAIN * total:
        return None
    way = _bridge(a, b, oracle)
    if not way or (after - before) - _length(way) < MIN_GAIN * total:
        return None
    head = chain[: i + 1] if a != chain[i] else chain[:i]
    tail = chain[j + 1 :] if b != chain[j + 1] else chain[j + 2 :]
    return [*head, *way, *tail] if _is_free([*head[-1:], *way, *tail[:1]], oracle) else None


def _with_few_waypoints(chain: Chain, oracle: ConstrainedOracle) -> Chain:
    """From each vertex straight on to the last, or half as far, and so on, if that is free."""
    kept, last = [chain[0]], 0
    while last < len(chain) - 1:
        span = len(chain) - 1 - last
        while span > 1 and not oracle.edge_is_free(chain[last], chain[last + span]):
            span //= 2
        last += span
        kept.append(chain[last])
    return kept
