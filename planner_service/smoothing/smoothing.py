"""Shortens a polyline and blends its corners with as few collision checks as possible.

Nine tenths of the checks of a naive shortcutter repeat an edge that it has checked before, and most of the others are
for cuts that gain next to nothing. So every verdict is remembered, the longest cuts between vertices come first, and a
cut between random points is tried only if it gains enough. Then corners that hug an obstacle with a few joints are
pulled in, joint by joint, as far as they stay free; pieces too short for a blend are cut out if that is free; and each
corner gets the widest free blend.

All of this is compiled: native/smoothing/smoothing.cpp.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.search.problem import CoarseOracle, CompiledOracle, ConstrainedOracle, Oracle, compiled

__all__ = [
    "MIN_BLEND",
    "Draws",
    "SeededDraws",
    "blended",
    "pulled_in",
    "shortcut",
    "shortcut_on_constraints",
    "widest_blends",
    "without_short_pieces",
]

BLEND_SHARE = 0.499
"""Of a piece, what the blend at one of its ends may replace."""

LONGEST = 1.0
"""Length of a projected step at most (rad)."""

MIN_BLEND = 0.01
"""Radians. A narrower blend saves no time: a jerk-limited law is as fast with a stop."""


class Draws(Protocol):
    """Where random numbers come from, such as a numpy Generator."""

    def random(self, size: int, /) -> FloatArray:
        """The next numbers in [0, 1), (size,)."""


class SeededDraws:
    """The numbers of ``default_rng(seed)``: to seed one takes as long as a hundred checks, so the first are kept."""

    def __init__(self, *seed: int) -> None:
        self._seed, self._drawn = seed, 0

    def random(self, size: int, /) -> FloatArray:
        """As ``Draws``."""
        first, self._drawn = self._drawn, self._drawn + size
        known = _first_draws(self._seed)
        if self._drawn > len(known):
            known = np.random.default_rng(self._seed).random(self._drawn)
        return known[first : self._drawn]


@lru_cache(maxsize=64)
def _first_draws(seed: tuple[int, ...]) -> FloatArray:
    """As many as two calls of ``shortcut`` draw."""
    return read_only(np.random.default_rng(seed).random(240))


def shortcut(
    waypoints: ArrayLike,
    oracle: Oracle,
    rng: Draws,
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
    points = np.array(waypoints, dtype=np.float64)
    if points.ndim != 2 or len(points) == 0 or not np.isfinite(points).all():
        raise InvalidRequest("waypoints", points.tolist(), "at least one row of finite joint values")
    draws = rng.random(2 * tries).tolist()
    asked = compiled(oracle)
    shorter: FloatArray = asked.counted(partial(load_core().shortcut, points, asked.core, draws, misses))
    return shorter


def pulled_in(waypoints: ArrayLike, oracle: CoarseOracle) -> FloatArray:
    """Pull each corner of a polyline (N, n) towards the straight line between its neighbours; shape (N, n).

    First all joints go half the way, then one joint at a time, while a coarse check finds both pieces free. The corner
    moves to the last of these places where a full check finds them free. The ends stay.
    """
    points = np.array(waypoints, dtype=np.float64)
    asked = compiled(oracle)
    pulled: FloatArray = asked.counted(partial(load_core().pulled_in, points, asked.core))
    return pulled


def without_short_pieces(waypoints: ArrayLike, oracle: Oracle) -> FloatArray:
    """Remove corners at pieces under 0.1 rad from a polyline (N, n) where a free edge bypasses them; shape (M, n).

    The ends stay, and the result is never longer. Each corner tried costs one edge check.
    """
    points = np.array(waypoints, dtype=np.float64)
    asked = compiled(oracle)
    kept: FloatArray = asked.counted(partial(load_core().without_short_pieces, points, asked.core))
    return kept


def shortcut_on_constraints(
    waypoints: ArrayLike,
    oracle: ConstrainedOracle,
    rng: Draws,
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
    points, draws = np.array(waypoints, dtype=np.float64), rng.random(2 * tries).tolist()
    shorter: FloatArray = oracle.counted(partial(load_core().shortcut_on, points, oracle.core, draws, misses, LONGEST))
    return shorter


def blended(
    path: JointPath,
    oracle: CompiledOracle,
    sizes: FloatArray,
    *,
    least: float = MIN_BLEND,
    corners: Sequence[int] | None = None,
) -> JointPath:
    """Blend corners of a path as widely as is free, halving the width until it is; else the corner stays a stop.

    A blend takes less than half of each piece it joins. Corners that almost turn back are left alone.

    Args:
        oracle: Says which blends are free.
        sizes: For each waypoint the largest arc length (rad) that its blend may replace before and after the corner,
            shape (N,); 0 leaves the corner.
        least: The narrowest blend (rad).
        corners: Some of ``path.corners``; all if not given.
    """
    widths, chosen = path.blends.copy(), list(path.corners if corners is None else corners)
    curve = path.waypoints, path.knots, path.tangents
    widths[chosen] = oracle.counted(partial(load_core().blend_widths, *curve, chosen, sizes, oracle.core, least))
    return path.with_blends(widths)


def widest_blends(path: JointPath, sizes: FloatArray, *, least: float = MIN_BLEND) -> JointPath:
    """The same path with every blend as wide as there is room, as ``blended`` makes it where all are free.

    Nothing is checked.
    """
    widths = path.blends.copy()
    for k in path.corners:
        room = BLEND_SHARE * float(min(path.knots[k] - path.knots[k - 1], path.knots[k + 1] - path.knots[k]))
        width = 0.0 if path.turns_back(k) else min(float(sizes[k]), room)
        widths[k] = width if width >= least else 0.0
    return path.with_blends(widths)
