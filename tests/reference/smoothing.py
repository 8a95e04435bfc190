"""Smoothing in Python: the same questions and bits as native/smoothing/smoothing.cpp."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np

from planner_service.collision.edge_sampling import KNOWN_ENDS, Known
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.path.corner_blend import BLEND_SHARE
from planner_service.path.joint_path import JointPath
from planner_service.search.problem import CoarseOracle, Configuration, Oracle

__all__ = ["blended", "pulled_in", "shortcut", "without_short_pieces"]

Edge = tuple[Configuration, Configuration]
Corner = tuple[Configuration, Configuration, Configuration]


class Judge(Protocol):
    """A method of an oracle that checks an edge."""

    def __call__(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool: ...


MIN_GAIN = 0.02
"""Share of the path's length that a random cut must gain to be worth a check: measured on a six-axis arm, 1 % costs a
fifth more states for 1 % of the length, and leaves more corners."""

MIN_PULL = 0.005
"""Share of the path's length that pulling a joint of a corner must gain: on the public Panda problems 0.3 % costs two
fifths more states for 1 % of the length."""

PULLS = (1.0, 0.5)
"""Shares of the way that a joint of a corner is pulled in, the largest first."""

PULL_ROUNDS = 2
"""Rounds over all corners: a corner that moved makes room for its neighbours."""

SHORT_PIECE = 0.1
"""Radians. A shorter piece has no room for blends at its ends that save time."""


def shortcut(
    waypoints: FloatArray, oracle: Oracle, rng: np.random.Generator, tries: int = 60, misses: int = 15
) -> list[Configuration]:
    """As of ``smoothing.shortcut``."""
    draws = rng.random(2 * tries).tolist()
    chain = [tuple(q) for q in waypoints.tolist()]
    chain = [q for k, q in enumerate(chain) if k == 0 or q != chain[k - 1]]
    verdicts = _Verdicts(oracle, chain)
    return _cut_at_random(_skip_vertices(chain, verdicts), verdicts, draws, misses)


def pulled_in(chain: list[Configuration], oracle: CoarseOracle) -> list[Configuration]:
    """As of ``smoothing.pulled_in``."""
    chain, done = list(chain), set[Corner]()
    for _ in range(PULL_ROUNDS):
        least = MIN_PULL * math.fsum(joint_distance(a, b) for a, b in pairwise(chain))
        for k in range(1, len(chain) - 1):
            corner = (chain[k - 1], chain[k], chain[k + 1])
            if corner not in done:
                done.add(corner)
                chain[k] = _pulled(corner, oracle, least)
    return chain


def without_short_pieces(chain: list[Configuration], oracle: CoarseOracle) -> list[Configuration]:
    """As of ``smoothing.without_short_pieces``."""
    chain, k = list(chain), 1
    while k < len(chain) - 1:
        before, corner, after = chain[k - 1 : k + 2]
        short = min(joint_distance(before, corner), joint_distance(corner, after)) < SHORT_PIECE
        if short and oracle.edge_is_free(before, after, known=Known.BOTH):
            del chain[k]
            k = max(1, k - 1)
        else:
            k += 1
    return chain


def blended(path: JointPath, is_free: Callable[[JointPath, int], bool], sizes: FloatArray, least: float) -> JointPath:
    """As of ``smoothing.blended``, by what says whether the blend at a waypoint is free."""
    widths, lengths = path.blends.copy(), (path.knots[1:] - path.knots[:-1]).tolist()
    for k in path.corners:
        if path.turns_back(k):
            continue
        width = min(float(sizes[k]), BLEND_SHARE * min(lengths[k - 1], lengths[k]))
        while width >= least and not is_free(path.with_blends(_only(width, k, len(widths))), k):
            width /= 2.0
        widths[k] = width if width >= least else 0.0
    return path.with_blends(widths)


def _only(width: float, k: int, count: int) -> FloatArray:
    """Blend widths for ``count`` waypoints, 0 except for the k-th."""
    widths = np.zeros(count)
    widths[k] = width
    return widths


class _Verdicts:
    """Remembers the verdicts of an oracle on edges, and which configurations are free."""

    def __init__(self, oracle: Oracle, chain: Sequence[Configuration]) -> None:
        self._oracle = oracle
        self._free = set(chain)
        self._edges = {_edge(a, b): True for a, b in pairwise(chain)}

    def is_free(self, a: Configuration, b: Configuration) -> bool:
        edge = _edge(a, b)
        free = self._edges.get(edge)
        if free is None:
            known = KNOWN_ENDS[(a in self._free) + 2 * (b in self._free)]
            free = self._edges[edge] = bool(self._oracle.edge_is_free(np.array(a), np.array(b), known=known))
            if free:
                self._free.update(edge)
        return free


def _skip_vertices(chain: list[Configuration], verdicts: _Verdicts) -> list[Configuration]:
    """From each vertex go to the farthest one that a free edge reaches."""
    kept, last = [chain[0]], 0
    while last < len(chain) - 1:
        last = next(
            k for k in range(len(chain) - 1, last, -1) if k == last + 1 or verdicts.is_free(chain[last], chain[k])
        )
        kept.append(chain[last])
    return kept


def _cut_at_random(
    chain: list[Configuration], verdicts: _Verdicts, draws: Sequence[float], misses: int
) -> list[Configuration]:
    history = [chain]
    missed = 0
    for u, v in zip(draws[::2], draws[1::2], strict=True):
        if missed >= misses or len(chain) < 3:
            break
        missed += 1
        shorter = _cut(chain, u, v)
        if shorter is not None and verdicts.is_free(*shorter[0]):
            chain, missed = shorter[1], 0
            history.append(chain)
    # The rest of a piece that is cut was checked as part of it, but at other samples. Later cuts remove most of these
    # rests, so only those of the final path are checked; if one collides, the path before that cut is tried, and so
    # on back to the first, which is known to be free.
    return next(path for path in reversed(history) if all(verdicts.is_free(a, b) for a, b in pairwise(path)))


def _cut(chain: list[Configuration], u: float, v: float) -> tuple[Edge, list[Configuration]] | None:
    """The edge that cuts from u to v (shares of the length), and the chain with it; None if it gains too little."""
    lengths = [joint_distance(a, b) for a, b in pairwise(chain)]
    total = math.fsum(lengths)
    (i, a, before), (j, b, after) = (point_at(chain, lengths, share * total) for share in sorted((u, v)))
    if i == j:
        return None
    gain = (after - before) - joint_distance(a, b)
    if gain < MIN_GAIN * total:
        return None
    head = chain[: i + 1] if a != chain[i] else chain[:i]
    tail = chain[j + 1 :] if b != chain[j + 1] else chain[j + 2 :]
    return (a, b), [*head, a, b, *tail]


def _pulled(corner: Corner, oracle: CoarseOracle, least: float) -> Configuration:
    """Where a corner, given between its neighbours, is pulled to; each pull must shorten the path by ``least``."""
    before, old, after = corner

    def detour(q: Configuration) -> float:
        return joint_distance(before, q) + joint_distance(q, after)

    share = joint_distance(before, old) / detour(old)
    target = [a + (c - a) * share for a, c in zip(before, after, strict=True)]
    joints = sorted(range(len(old)), key=lambda joint: -abs(target[joint] - old[joint]))
    places, tried = [old], {old}
    for pulled, pull in [(joints, 0.5), *(([joint], pull) for pull in PULLS for joint in joints)]:
        moved = list(places[-1])
        for joint in pulled:
            moved[joint] += (target[joint] - moved[joint]) * pull
        new = tuple(moved)
        if new not in tried and detour(places[-1]) - detour(new) >= least:
            tried.add(new)
            if _free(oracle.edge_is_free_coarse, corner, new):
                places.append(new)
    return next(q for q in reversed(places) if q == old or _free(oracle.edge_is_free, corner, q))


def _free(judge: Judge, corner: Corner, q: Configuration) -> bool:
    """Whether the edges from both neighbours of a corner, which are free states, to q are free."""
    return judge(corner[0], q, known=Known.START) and judge(q, corner[2], known=Known.BOTH)


def point_at(chain: list[Configuration], lengths: list[float], distance: float) -> tuple[int, Configuration, float]:
    """The piece at a distance along the chain, the point on it, and the distance."""
    passed = 0.0
    for k, length in enumerate(lengths):
        if distance <= passed + length or k == len(lengths) - 1:
            share = min(1.0, (distance - passed) / length)
            q = tuple(x + (y - x) * share for x, y in zip(chain[k], chain[k + 1], strict=True))
            return k, q, distance
        passed += length
    raise AssertionError("a chain has at least one piece")


def _edge(a: Configuration, b: Configuration) -> Edge:
    return (a, b) if a <= b else (b, a)
