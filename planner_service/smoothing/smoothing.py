"""Shortens a polyline and blends its corners with as few collision checks as possible.

Nine tenths of the checks of a naive shortcutter repeat an edge that it has checked before, and most of the others are
for cuts that gain next to nothing. So every verdict is remembered, the longest cuts between vertices come first, and a
cut between random points is tried only if it gains enough. Then corners that hug an obstacle with a few joints are
pulled in, joint by joint, as far as they stay free; pieces too short for a blend are cut out if that is free; and each
corner gets the widest free blend.

For an oracle with a compiled part, its ``core``, all of this is compiled as well. The Python below is the reference:
the same questions in the same order, and the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision.edge_sampling import KNOWN_ENDS, Known
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, joint_distance, read_only
from planner_service.native.loading import load_core
from planner_service.path.corner_blend import BLEND_SHARE
from planner_service.path.joint_path import JointPath
from planner_service.search.problem import CoarseOracle, Configuration, Oracle

__all__ = [
    "MIN_BLEND",
    "MIN_GAIN",
    "asked_of_core",
    "blended",
    "point_at",
    "pulled_in",
    "shortcut",
    "without_short_pieces",
]

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

MIN_BLEND = 0.01
"""Radians. A narrower blend saves no time: a jerk-limited law is as fast with a stop."""

SHORT_PIECE = 0.1
"""Radians. A shorter piece has no room for blends at its ends that save time."""


def shortcut(
    waypoints: ArrayLike,
    oracle: Oracle,
    rng: np.random.Generator,
    *,
    tries: int = 60,
    misses: int = 15,
) -> FloatArray:
    """Shorten a free polyline by replacing pieces of it with straight edges that are free.

    The result, shape (M, n), has the same ends and is never longer. First vertices are skipped, the farthest reachable
    one first; then pieces between two random points are cut (Geraerts & Overmars, IJRR 26(8), 2007). Each piece of the
    result is a piece of ``waypoints`` or an edge that the oracle found free as exactly this edge. No edge is checked
    twice, in either direction.

    Args:
        waypoints: Shape (N, n); the caller knows its pieces to be free.
        rng: Two numbers for each of the tries are drawn at once.
        tries: The most random cuts to draw.
        misses: Stop after so many cuts in a row that collide or gain too little.

    Raises:
        InvalidRequest: ``waypoints`` has no rows, or a number that is not finite. What the oracle raises passes
            through.
    """
    points = read_only(waypoints)
    if points.ndim != 2 or len(points) == 0 or not np.isfinite(points).all():
        raise InvalidRequest("waypoints", points.tolist(), "at least one row of finite joint values")
    draws = rng.random(2 * tries).tolist()
    shorter: FloatArray | None = asked_of_core(
        oracle, lambda core, asked: partial(core.shortcut, points, asked, draws, misses)
    )
    if shorter is not None:
        return shorter
    chain = [tuple(q) for q in points.tolist()]
    chain = [q for k, q in enumerate(chain) if k == 0 or q != chain[k - 1]]
    verdicts = _Verdicts(oracle, chain)
    chain = _skip_vertices(chain, verdicts)
    return read_only(_cut_at_random(chain, verdicts, draws, misses))


def pulled_in(waypoints: ArrayLike, oracle: CoarseOracle) -> FloatArray:
    """Pull each corner of a polyline (N, n) towards the straight line between its neighbours; shape (N, n).

    First all joints go half the way, then one joint at a time, while a coarse check finds both pieces free. The corner
    moves to the last of these places where a full check finds them free. The ends stay.
    """
    points = read_only(waypoints)
    pulled: FloatArray | None = asked_of_core(oracle, lambda core, asked: partial(core.pulled_in, points, asked))
    if pulled is not None:
        return pulled
    chain = [tuple(q) for q in points.tolist()]
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
    """Remove corners at pieces under 0.1 rad from a polyline (N, n) where a free edge bypasses them; shape (M, n).

    The ends stay, and the result is never longer. Each corner tried costs one edge check.
    """
    points = read_only(waypoints)
    kept: FloatArray | None = asked_of_core(
        oracle, lambda core, asked: partial(core.without_short_pieces, points, asked)
    )
    if kept is not None:
        return kept
    chain = list(points)
    k = 1
    while k < len(chain) - 1:
        before, corner, after = chain[k - 1 : k + 2]
        short = min(joint_distance(before, corner), joint_distance(corner, after)) < SHORT_PIECE
        if short and oracle.edge_is_free(before, after, known=Known.BOTH):
            del chain[k]
            k = max(1, k - 1)
        else:
            k += 1
    return read_only(chain)


def blended(
    path: JointPath,
    is_free: Callable[[JointPath, int], bool],
    sizes: FloatArray,
    *,
    least: float = MIN_BLEND,
    oracle: CoarseOracle | None = None,
) -> JointPath:
    """Blend each corner of a path as widely as is free, halving the width until it is; else the corner stays a stop.

    A blend takes less than half of each piece it joins. Corners that almost turn back are left alone.

    Args:
        is_free: Whether the blend at the given waypoint of the given path is free.
        sizes: For each waypoint the largest arc length (rad) that its blend may replace before and after the corner,
            shape (N,); 0 leaves the corner.
        least: The narrowest blend (rad).
        oracle: An oracle that finds the same blends free; its compiled part is asked instead, if it has one.
    """
    widths, corners = path.blends.copy(), list(path.corners)
    curve = path.waypoints, path.knots, path.tangents
    free = asked_of_core(oracle, lambda core, asked: partial(core.blend_widths, *curve, corners, sizes, asked, least))
    if free is not None:
        widths[corners] = free
        return path.with_blends(widths)
    lengths = (path.knots[1:] - path.knots[:-1]).tolist()
    for k in corners:
        if path.turns_back(k):
            continue
        width = min(float(sizes[k]), BLEND_SHARE * min(lengths[k - 1], lengths[k]))
        while width >= least and not is_free(path.with_blends(_only(width, k, len(widths))), k):
            width /= 2.0
        widths[k] = width if width >= least else 0.0
    return path.with_blends(widths)


def asked_of_core(oracle: Any, ask: Callable[[ModuleType, Any], Callable[[], Any]]) -> Any:
    """The answer to what ``ask`` makes of the compiled core and the compiled part of an oracle; None without these."""
    core, answers = load_core(), getattr(oracle, "core", None)
    return None if core is None or answers is None else oracle.counted(ask(core, answers))


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
