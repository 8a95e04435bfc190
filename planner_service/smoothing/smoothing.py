"""Shortening a polyline and blending its corners, asking as little as possible.

Nine tenths of the checks of a naive shortcutter repeat an edge it has asked about before, and most
of the rest are cuts that gain next to nothing. So: every verdict is remembered, the longest cuts
between vertices come first, and a cut between random points is only tried if it gains enough.
What is left are corners that hug an obstacle, with some joints only: each is pulled in, joint by joint, as far as is
free. A piece too short for a blend is cut out if that is free, a corner is blended as widely as is free.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision.edge_sampling import KNOWN_ENDS, Known
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import FloatArray, read_only
from planner_service.path.joint_path import JointPath
from planner_service.search.problem import CoarseOracle, Configuration, Oracle, joint_distance

__all__ = ["LEAST_BLEND", "blended", "pulled_in", "shortcut", "without_short_pieces"]

Edge = tuple[Configuration, Configuration]
Corner = tuple[Configuration, Configuration, Configuration]


class Judge(Protocol):
    """How an oracle is asked about an edge."""

    def __call__(self, q1: Configuration, q2: Configuration, *, known: Known = Known.NEITHER) -> bool: ...


MIN_GAIN = 0.02
"""Share of the path's length that a random cut must gain to be worth asking about: measured on a six-axis arm,
1 % costs a fifth more states for one part in a hundred of length, and leaves more corners."""

MIN_PULL = 0.005
"""Share of the path's length that pulling a joint of a corner must gain: on the public Panda problems 0.3 % asks two
fifths more states for one part in a hundred of length."""

PULLS = (1.0, 0.5)
"""How far a joint of a corner is pulled in, all the way first."""

PULL_ROUNDS = 2
"""Rounds over all corners: a corner that moved makes room for its neighbours."""

BLEND_SHARE = 0.499
"""Part of a piece that the blend at either of its ends may take: all but a run-up, which the closed-form laws need."""

LEAST_BLEND = 0.01
"""Radians. A narrower blend saves no time: a jerk-limited law is as quick when it stops."""

SHORT_PIECE = 0.1
"""Radians. At both ends of a shorter piece there is no room for a blend that saves time."""


def shortcut(
    waypoints: ArrayLike,
    oracle: Oracle,
    rng: np.random.Generator,
    *,
    tries: int = 60,
    misses: int = 15,
) -> FloatArray:
    """A path no longer than ``waypoints`` (N, n) with the same ends, shape (M, n), read-only.

    First vertices are skipped, the farthest reachable one first; then pieces between two random
    points are cut (Geraerts & Overmars, IJRR 26(8), 2007). Each piece of the result is a piece
    of ``waypoints``, which the caller found free, or an edge the oracle found free as exactly this
    edge; no edge is asked about twice, in either direction.

    Args:
        tries: Random cuts drawn at most.
        misses: Cuts refused in a row, by the oracle or as too small a gain, that end it.

    Raises:
        InvalidRequest: ``waypoints`` has no rows, or a number that is not finite. What the oracle
            raises comes out unchanged.
    """
    points = read_only(waypoints)
    if points.ndim != 2 or len(points) == 0 or not np.isfinite(points).all():
        raise InvalidRequest("waypoints", points.tolist(), "at least one row of finite joint values")
    chain = [tuple(q) for q in points.tolist()]
    chain = [q for k, q in enumerate(chain) if k == 0 or q != chain[k - 1]]
    verdicts = _Verdicts(oracle, chain)
    chain = _skip_vertices(chain, verdicts)
    return read_only(_cut_at_random(chain, verdicts, rng, tries, misses))


def pulled_in(waypoints: ArrayLike, oracle: CoarseOracle) -> FloatArray:
    """The polyline (N, n) with its corners pulled towards the straight line between their neighbours, (N, n).

    All joints half the way first, then one joint at a time, as long as a first look finds both pieces free; the last
    such place at which all their samples are free is taken. The ends stay.
    """
    chain = [tuple(q) for q in read_only(waypoints).tolist()]
    done: set[Corner] = set()
    for _ in range(PULL_ROUNDS):
        least = MIN_PULL * math.fsum(joint_distance(a, b) for a, b in pairwise(chain))
        for k in range(1, len(chain) - 1):
            corner = (chain[k - 1], chain[k], chain[k + 1])
            if corner not in done:
                done.add(corner)
                chain[k] = _pulled(corner, oracle, least)
    return read_only(chain)


def without_short_pieces(waypoints: ArrayLike, oracle: Oracle) -> FloatArray:
    """The polyline (N, n) without those corners of pieces under 0.1 rad that a free edge can leave out, (M, n).

    The ends stay, and what is left out makes it no longer. One edge is asked about for each corner tried.
    """
    chain = list(read_only(waypoints))
    k = 1
    while k < len(chain) - 1:
        before, here, after = chain[k - 1 : k + 2]
        short = min(joint_distance(before, here), joint_distance(here, after)) < SHORT_PIECE
        if short and oracle.edge_is_free(before, after, known=Known.BOTH):
            del chain[k]
            k = max(1, k - 1)
        else:
            k += 1
    return read_only(chain)


def blended(
    path: JointPath, is_free: Callable[[JointPath, int], bool], sizes: FloatArray, *, least: float = LEAST_BLEND
) -> JointPath:
    """The path with each corner blended as widely as is free, halving from its size to 0.01 rad; else it stays a stop.

    A blend takes less than half of each piece it joins. Corners that all but turn back are left.

    Args:
        is_free: Whether the blend at that waypoint of that path is free.
        sizes: For each waypoint the arc length (rad) that its blend may replace before and after the corner, shape
            (N,); 0 leaves the corner.
        least: Radians of the narrowest blend.
    """
    lengths = (path.knots[1:] - path.knots[:-1]).tolist()
    widths = path.blends.copy()
    for k in path.corners:
        if path.turns_back(k):
            continue
        width = min(float(sizes[k]), BLEND_SHARE * min(lengths[k - 1], lengths[k]))
        while width >= least and not is_free(path.with_blends(_only(width, k, len(widths))), k):
            width /= 2.0
        widths[k] = width if width >= least else 0.0
    return path.with_blends(widths)


def _only(width: float, k: int, count: int) -> FloatArray:
    """Blend widths for ``count`` waypoints, all 0 but the k-th."""
    widths = np.zeros(count)
    widths[k] = width
    return widths


class _Verdicts:
    """The oracle with a memory of edges, and of configurations known to be free."""

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
    """From each vertex on to the farthest that a free edge reaches."""
    kept, here = [chain[0]], 0
    while here < len(chain) - 1:
        here = next(
            k for k in range(len(chain) - 1, here, -1) if k == here + 1 or verdicts.is_free(chain[here], chain[k])
        )
        kept.append(chain[here])
    return kept


def _cut_at_random(
    chain: list[Configuration], verdicts: _Verdicts, rng: np.random.Generator, tries: int, misses: int
) -> list[Configuration]:
    history = [chain]
    missed = 0
    for _ in range(tries):
        if missed >= misses or len(chain) < 3:
            break
        missed += 1
        shorter = _cut(chain, *rng.random(2).tolist())
        if shorter is not None and verdicts.is_free(*shorter[0]):
            chain, missed = shorter[1], 0
            history.append(chain)
    # What a cut leaves of the pieces it cuts into was judged as part of them, but at other samples. Most of these
    # rests fall to later cuts, so only those of the final path are asked about; should one collide, the path
    # before that cut is next in line, and the first is all judged.
    return next(path for path in reversed(history) if all(verdicts.is_free(a, b) for a, b in pairwise(path)))


def _cut(chain: list[Configuration], u: float, v: float) -> tuple[Edge, list[Configuration]] | None:
    """The cut from u to v (shares of the length), and ``chain`` with it; None if that gains too little."""
    lengths = [joint_distance(a, b) for a, b in pairwise(chain)]
    total = math.fsum(lengths)
    (i, a, before), (j, b, after) = (_point_at(chain, lengths, share * total) for share in sorted((u, v)))
    if i == j:
        return None
    gain = (after - before) - joint_distance(a, b)
    if gain < MIN_GAIN * total:
        return None
    head = chain[: i + 1] if a != chain[i] else chain[:i]
    tail = chain[j + 1 :] if b != chain[j + 1] else chain[j + 2 :]
    return (a, b), [*head, a, b, *tail]


def _pulled(corner: Corner, oracle: CoarseOracle, least: float) -> Configuration:
    """Where a corner goes, given between its neighbours; each pull must gain ``least`` at least."""
    before, here, after = corner

    def detour(q: Configuration) -> float:
        return joint_distance(before, q) + joint_distance(q, after)

    share = joint_distance(before, here) / detour(here)
    target = [a + (c - a) * share for a, c in zip(before, after, strict=True)]
    joints = sorted(range(len(here)), key=lambda joint: -abs(target[joint] - here[joint]))
    places, tried = [here], {here}
    for some, pull in [(joints, 0.5), *(([joint], pull) for pull in PULLS for joint in joints)]:
        moved = list(places[-1])
        for joint in some:
            moved[joint] += (target[joint] - moved[joint]) * pull
        there = tuple(moved)
        if there not in tried and detour(places[-1]) - detour(there) >= least:
            tried.add(there)
            if _free(oracle.edge_is_free_coarse, corner, there):
                places.append(there)
    return next(q for q in reversed(places) if q == here or _free(oracle.edge_is_free, corner, q))


def _free(judge: Judge, corner: Corner, q: Configuration) -> bool:
    """Whether the edges from both neighbours of a corner, which are free, to q are."""
    return judge(corner[0], q, known=Known.START) and judge(q, corner[2], known=Known.BOTH)


def _point_at(chain: list[Configuration], lengths: list[float], distance: float) -> tuple[int, Configuration, float]:
    """The piece at that distance along the chain, the point there, and the distance."""
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
