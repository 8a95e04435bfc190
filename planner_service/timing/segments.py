"""What limits the motion between two stops of a path: the joints, and a limit of ds/dt, along each part of the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import FloatArray
from planner_service.path.corner_blend import STEEPEST, STEEPEST_SLOPE
from planner_service.path.joint_path import JointPath
from planner_service.timing.limit_check import STANDING
from planner_service.timing.profiles import Bounds, Part

if TYPE_CHECKING:
    from planner_service.robot.model import JointLimits

__all__ = ["SpeedLimit", "Stretch", "straight_parts", "stretches"]

SpeedLimit = Callable[[FloatArray], FloatArray]
"""The largest ds/dt allowed at each s, shape (m,) in and out; ``math.inf`` where there is none."""

SAMPLES, SPACING = 16, 0.05
"""A speed limit is asked for at the ends of at least that many intervals of each part, at most that long (rad)."""

BETWEEN = 1e-3
"""Share by which a speed limit is undercut, for what it may fall to between samples."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """The part of a path between two stops: its pieces between breaks, one or more.

    ``since`` is where on its first piece it begins, should it not begin with a stop. Laws that
    look at grid points alone may use ``blend_share`` of the limits on blends.
    """

    path: JointPath
    pieces: range
    limits: JointLimits
    speed_limit: SpeedLimit | None = None
    since: float | None = None
    blend_share: float = 1.0

    @property
    def start(self) -> float:
        """Where it begins in s."""
        return float(self.path.breaks[self.pieces[0]]) if self.since is None else self.since

    @property
    def length(self) -> float:
        """Its arc length."""
        return float(self.path.breaks[self.pieces[-1] + 1]) - self.start

    @cached_property
    def moving(self) -> NDArray[np.intp]:
        """Indices of the joints that do not stand still all along it."""
        return np.flatnonzero(np.abs(self._tangents).max(axis=(0, 1)) > 0.0)

    def parts(self, *, jerk: bool) -> list[Part]:
        """Straight parts, whatever waypoints lie on them, and blends, with the bounds of ds/dt along each.

        Of a blend the speed is bounded so that no limit breaks while it is constant. Without ``jerk`` its limits are
        not asked.
        """
        firsts, breaks = self._firsts, self.path.breaks.tolist()
        starts = [self.start, *(breaks[k] for k in firsts[1:])]
        ends = [*(breaks[k] for k in firsts[1:]), breaks[self.pieces[-1] + 1]]
        lengths = [end - start for start, end in zip(starts, ends, strict=True)]
        blended = self.path.blended[firsts].tolist()
        whole = [end - breaks[first] for first, end in zip(firsts, ends, strict=True)]
        bounds = self._bounds(blended, whole, jerk)
        if self.speed_limit is not None:
            bounds = list(map(self._slowed, starts, lengths, bounds))
        return list(map(Part, starts, lengths, bounds, blended))

    def _slowed(self, start: float, length: float, bounds: Bounds) -> Bounds:
        """The bounds of a part with what the speed limit leaves of its speed."""
        count = max(SAMPLES, math.ceil(length / SPACING))
        samples = np.minimum(start + length * (np.arange(count + 1) / count), start + length)
        return bounds._replace(speed=min(bounds.speed, float(self.allowed(samples).min())))

    @cached_property
    def _firsts(self) -> list[int]:
        """The first piece of each part."""
        blended = self.path.blended.tolist()
        return [k for k in self.pieces if k == self.pieces[0] or blended[k] or blended[k - 1]]

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Derivatives of the path, shape (m, n), for s of shape (m,), also at both ends of the stretch its own.

        A straight part has one direction, that of its first piece, whatever rounding makes of short ones.
        """
        return self.path.on_pieces(self._first_at(s), s, order)

    def shares(self, s: FloatArray) -> FloatArray:
        """The parts of the limits that may be used at each s, shape (m,)."""
        return np.where(self.path.blended[self._first_at(s)], self.blend_share, 1.0)

    def _first_at(self, s: FloatArray) -> NDArray[np.intp]:
        """The first piece of the part on which each s lies."""
        firsts = np.array(self._firsts)
        found: NDArray[np.intp] = firsts[np.searchsorted(self.path.breaks[firsts[1:]], s, side="right")]
        return found

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

    @cached_property
    def _tangents(self) -> FloatArray:
        """dq/ds at both ends of each piece, shape (2, m, n), with exact zeros for joints that stand still."""
        pieces = np.arange(self.pieces.start, self.pieces.stop)
        at = self.path.breaks[pieces[0] : pieces[-1] + 2]
        ends = self.path.on_pieces(np.concatenate([pieces, pieces]), np.concatenate([at[:-1], at[1:]]), 1)
        return np.where(np.abs(ends) > STANDING, ends, 0.0).reshape(2, len(pieces), -1)

    def _bounds(self, blended: Sequence[bool], lengths: Sequence[float], jerk: bool) -> list[Bounds]:
        """Of each part; on blends with the largest slopes that one has, dq/ds being largest at an end."""
        limits, rows = self.limits, [first - self.pieces.start for first in self._firsts]
        on, length = np.array(blended)[:, None], np.array(lengths)[:, None]
        before, after = self._tangents[:, rows]
        share, turn = np.abs(before), np.where(on, np.abs(after - before), 0.0)
        share = np.where(on, np.maximum(share, np.abs(after)), share)
        speed, acceleration = _least(limits.velocity, share), _least(limits.acceleration, share)
        speed = np.minimum(speed, np.sqrt(_least(limits.acceleration, turn * 2.0 * STEEPEST / length)))
        jerks = [math.inf] * len(rows)
        if jerk:
            least = _least(limits.jerk, turn * 4.0 * STEEPEST_SLOPE / (length * length)).tolist()
            speed = np.minimum(speed, [math.pow(value, 1.0 / 3.0) for value in least])
            jerks = np.where(on[:, 0], math.inf, _least(limits.jerk, share)).tolist()
        return list(map(Bounds, speed.tolist(), acceleration.tolist(), jerks))


def _least(limits: FloatArray, shares: FloatArray) -> FloatArray:
    """Of each row of shares the smallest limit / share of the joints that have a share, infinity if none has."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a law may not use that limit
        return np.asarray(np.where(shares > 0.0, limits / shares, math.inf).min(axis=1))


def stretches(
    path: JointPath, limits: JointLimits, speed_limit: SpeedLimit | None, since: float | None = None
) -> Iterator[Stretch]:
    """The parts of a path between its stops, none for a single point; of what is left from ``since`` on, if given."""
    if speed_limit is not None and (isinstance(speed_limit, type) or not callable(speed_limit)):
        raise InvalidRequest("speed_limit", speed_limit, "a function of s, or None")
    if path.length > (since or 0.0):
        stops = np.searchsorted(path.breaks, [0.0, *path.knots[list(path.corners)], path.length]).tolist()
        if since is not None:
            here = int(path.pieces_at(np.array([since]))[0])
            stops = [here, *(stop for stop in stops if stop > here)]
        for first, end in pairwise(stops):
            yield Stretch(path, range(first, end), limits, speed_limit, since)
            since = None


def straight_parts(path: JointPath, limits: JointLimits, *, jerk: bool) -> list[Part]:
    """The parts between the stops of a path without blends, as the stretches between them have them, at once."""
    if not path.length > 0.0:
        return []
    starts = [0.0, *path.knots[list(path.corners)].tolist()]
    firsts = path.breaks.searchsorted(starts)
    share = np.abs(path.on_pieces(firsts, path.breaks[firsts], 1))
    share = np.where(share > STANDING, share, 0.0)
    rows = [limits.velocity, limits.acceleration, *([limits.jerk] if jerk else [])]
    bounds = [_least(row, share).tolist() for row in rows] + ([] if jerk else [[math.inf] * len(starts)])
    lengths = [end - start for start, end in pairwise([*starts, path.length])]
    return [Part(s, length, Bounds(*own), False) for s, length, *own in zip(starts, lengths, *bounds, strict=True)]
