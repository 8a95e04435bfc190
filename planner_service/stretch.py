"""What limits the motion between two stops of a path: the joints, and a limit of ds/dt, along each part of the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner_service.blend import STEEPEST, STEEPEST_SLOPE
from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray
from planner_service.path import JointPath
from planner_service.peaks import STANDING
from planner_service.profiles import Bounds, Part

if TYPE_CHECKING:
    from planner_service.robot import JointLimits

__all__ = ["SpeedLimit", "Stretch", "stretches"]

SpeedLimit = Callable[[FloatArray], FloatArray]
"""The largest ds/dt allowed at each s, shape (m,) in and out; ``math.inf`` where there is none."""

SAMPLES, SPACING = 16, 0.05
"""A speed limit is asked for at the ends of at least that many intervals of each part, at most that long (rad)."""

BETWEEN = 1e-3
"""Share by which a speed limit is undercut, for what it may fall to between samples."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """The part of a path between two stops: its pieces between breaks, one or more."""

    path: JointPath
    pieces: range
    limits: JointLimits
    speed_limit: SpeedLimit | None = None

    @property
    def start(self) -> float:
        """Where it begins in s."""
        return float(self.path.breaks[self.pieces[0]])

    @property
    def length(self) -> float:
        """Its arc length."""
        return float(self.path.breaks[self.pieces[-1] + 1]) - self.start

    @property
    def moving(self) -> NDArray[np.intp]:
        """Indices of the joints that do not stand still all along it."""
        ends = np.concatenate([self._tangents(piece) for piece in self.pieces])
        return np.flatnonzero(np.abs(ends).max(axis=0) > 0.0)

    def parts(self, *, jerk: bool) -> list[Part]:
        """Straight parts, whatever waypoints lie on them, and blends, with the bounds of ds/dt along each.

        Of a blend the speed is bounded so that no limit breaks while it is constant. Without ``jerk`` its limits are
        not asked.
        """
        blended, found = self.path.blended, []
        for first, end in pairwise([*self._firsts(), self.pieces[-1] + 1]):
            start = float(self.path.breaks[first])
            length = float(self.path.breaks[end]) - start
            bounds = self._blend_bounds(first, length, jerk) if blended[first] else self._straight_bounds(first, jerk)
            if self.speed_limit is not None:
                count = max(SAMPLES, math.ceil(length / SPACING))
                samples = np.minimum(start + length * (np.arange(count + 1) / count), start + length)
                bounds = bounds._replace(speed=min(bounds.speed, float(self.allowed(samples).min())))
            found.append(Part(start, length, bounds, bool(blended[first])))
        return found

    def _firsts(self) -> list[int]:
        """The first piece of each part."""
        blended = self.path.blended
        return [k for k in self.pieces if k == self.pieces[0] or blended[k] or blended[k - 1]]

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Derivatives of the path, shape (m, n), for s of shape (m,), also at both ends of the stretch its own.

        A straight part has one direction, that of its first piece, whatever rounding makes of short ones.
        """
        firsts = np.array(self._firsts())
        return self.path.on_pieces(firsts[np.searchsorted(self.path.breaks[firsts[1:]], s, side="right")], s, order)

    def allowed(self, s: FloatArray) -> FloatArray:
        """What the speed limit leaves of ds/dt at each s, a little less than it says.

        Raises:
            InvalidRequest: it answers with another shape, or what is not a positive number.
        """
        if self.speed_limit is None:
            return np.full(len(s), math.inf)
        with np.errstate(over="ignore"):
            speeds = np.asarray(self.speed_limit(np.minimum(s, self.path.length)), dtype=np.float64)
        if speeds.shape != s.shape or not np.all(speeds > 0.0):
            found = speeds.shape if speeds.shape != s.shape else float(speeds[~(speeds > 0.0)][0])
            expected = f"a positive ds/dt, or infinity, for each of {len(s)} values of s"
            raise InvalidRequest("speed_limit", found, expected)
        return speeds * (1.0 - BETWEEN)

    def _tangents(self, piece: int) -> FloatArray:
        """dq/ds at both ends of a piece of the path, shape (2, n), with exact zeros for joints that stand still."""
        ends = self.path.on_pieces(np.array([piece, piece]), self.path.breaks[piece : piece + 2], 1)
        return np.where(np.abs(ends) > STANDING, ends, 0.0)

    def _straight_bounds(self, piece: int, jerk: bool) -> Bounds:
        share = np.abs(self._tangents(piece)[0])
        limits = self.limits
        v, a = _least(limits.velocity, share), _least(limits.acceleration, share)
        return Bounds(v, a, _least(limits.jerk, share) if jerk else math.inf)

    def _blend_bounds(self, piece: int, length: float, jerk: bool) -> Bounds:
        """With the largest slopes that a blend has; dq/ds is largest at an end."""
        before, after = self._tangents(piece)
        share, turn = np.maximum(np.abs(before), np.abs(after)), np.abs(after - before)
        slowest = _least(self.limits.velocity, share)
        slowest = min(slowest, math.sqrt(_least(self.limits.acceleration, turn * 2.0 * STEEPEST / length)))
        if jerk:
            slowest = min(
                slowest, math.pow(_least(self.limits.jerk, turn * 4.0 * STEEPEST_SLOPE / (length * length)), 1.0 / 3.0)
            )
        return Bounds(slowest, _least(self.limits.acceleration, share), math.inf)


def _least(limits: FloatArray, shares: FloatArray) -> float:
    """The smallest limit / share of the joints that have a share, infinity if none has."""
    some = shares > 0.0
    with np.errstate(over="ignore"):  # a law may not use that limit
        return float((limits[some] / shares[some]).min(initial=math.inf))


def stretches(path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None) -> Iterator[Stretch]:
    """The parts of a path between its stops, none for a single point."""
    if path.length > 0.0:
        stops = np.searchsorted(path.breaks, [0.0, *path.knots[list(path.corners)], path.length])
        for first, end in pairwise(stops.tolist()):
            yield Stretch(path, range(first, end), limits, speed_limit)
