"""The segments of a path between its stops, and the limits of ds/dt and its derivatives along each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.validation import function_or_none
from planner_service.path.corner_blend import STEEPEST, STEEPEST_SLOPE
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import JointLimits
from planner_service.timing.limit_check import MIN_SHARE
from planner_service.timing.profiles import ScalarLimits, Section
from planner_service.timing.torque_limits import TorqueLimits

__all__ = ["PathSegment", "Rates", "SpeedLimit", "path_segments", "smallest_ratio", "straight_sections"]

SpeedLimit = Callable[[FloatArray], FloatArray]
"""The largest ds/dt allowed at each s, shape (m,) in and out; ``math.inf`` where there is no limit."""

SAMPLES, SPACING = 16, 0.05
"""A speed limit is sampled at the ends of at least that many intervals of each section, at most that long (rad)."""

MARGIN = 1e-3
"""Relative amount by which sampled speed limits are lowered, because they may be lower between samples."""


class Rates(NamedTuple):
    """The largest abs(dq/ds), abs(d2q/ds2) and abs(d3q/ds3) of each joint on each section, (sections, n)."""

    tangent: FloatArray
    bend: FloatArray
    twist: FloatArray


@dataclass(frozen=True, eq=False)
class PathSegment:
    """The part of a path between two stops: one or more of its pieces, and the limits along them.

    Attributes:
        pieces: Indices of the pieces of the path, which lie between its breaks.
        s_start: Where on the first piece the segment starts, if not with a stop.
        blend_share: Share of the limits that a law which checks them at grid points only may use on blends.
        torque: Torque limits, which only TOPP-RA keeps; None for none.
    """

    path: JointPath
    pieces: range
    limits: JointLimits
    speed_limit: SpeedLimit | None = None
    s_start: float | None = None
    blend_share: float = 1.0
    torque: TorqueLimits | None = None

    @property
    def start(self) -> float:
        """Where it starts in s."""
        return float(self.path.breaks[self.pieces[0]]) if self.s_start is None else self.s_start

    @property
    def length(self) -> float:
        """Its arc length."""
        return float(self.path.breaks[self.pieces[-1] + 1]) - self.start

    @cached_property
    def moving(self) -> IntArray:
        """Indices of the joints that move anywhere on it."""
        return np.flatnonzero(np.abs(self._tangents).max(axis=(0, 1)) > 0.0)

    def sections(self, *, jerk: bool) -> list[Section]:
        """Its straight sections, including the waypoints that lie on them, and its blends.

        On a blend the speed limit is such that no limit is exceeded at constant speed. Jerk limits are ignored
        without ``jerk``.
        """
        firsts, breaks = self._first_pieces, self.path.breaks.tolist()
        starts = [self.start, *(breaks[k] for k in firsts[1:])]
        ends = [*(breaks[k] for k in firsts[1:]), breaks[self.pieces[-1] + 1]]
        lengths = [end - start for start, end in zip(starts, ends, strict=True)]
        blended = self.path.blended[firsts].tolist()
        limits = self._section_limits(blended, jerk)
        if self.speed_limit is not None:
            limits = list(map(self._with_speed_limit, starts, lengths, limits))
        return list(map(Section, starts, lengths, limits, blended))

    def _with_speed_limit(self, start: float, length: float, limits: ScalarLimits) -> ScalarLimits:
        """The limits of a section, its speed no higher than the samples of the speed limit."""
        count = max(SAMPLES, math.ceil(length / SPACING))
        samples = np.minimum(start + length * (np.arange(count + 1) / count), start + length)
        return limits._replace(speed=min(limits.speed, float(self.speed_limits_at(samples).min())))

    @cached_property
    def _first_pieces(self) -> list[int]:
        """The first piece of each section."""
        blended = self.path.blended.tolist()
        return [k for k in self.pieces if k == self.pieces[0] or blended[k] or blended[k - 1]]

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """The path and its derivatives by s, (m, n), for s of shape (m,); at both ends those of the segment itself.

        A straight section has one direction, that of its first piece, whatever rounding makes of short pieces.
        """
        return self.path.on_pieces(self._first_pieces_at(s), s, order)

    def limit_shares(self, s: FloatArray) -> FloatArray:
        """The shares of the limits that may be used at each s, shape (m,)."""
        return np.where(self.path.blended[self._first_pieces_at(s)], self.blend_share, 1.0)

    def _first_pieces_at(self, s: FloatArray) -> IntArray:
        """The first piece of the section on which each s lies."""
        firsts = np.array(self._first_pieces)
        pieces: IntArray = firsts[np.searchsorted(self.path.breaks[firsts[1:]], s, side="right")]
        return pieces

    def speed_limits_at(self, s: FloatArray) -> FloatArray:
        """The speed limit at each s, lowered by ``MARGIN``; infinity without one.

        Raises:
            InvalidRequest: it returned another shape, or values that are not positive.
        """
        if self.speed_limit is None:
            return np.full(len(s), math.inf)
        with np.errstate(over="ignore"):
            speeds = np.asarray(self.speed_limit(np.minimum(s, self.path.length)), dtype=np.float64)
        if speeds.shape != s.shape or not np.all(speeds > 0.0):
            value = speeds.shape if speeds.shape != s.shape else float(speeds[~(speeds > 0.0)][0])
            expected = f"a positive ds/dt, or infinity, for each of {len(s)} values of s"
            raise InvalidRequest("speed_limit", value, expected)
        return speeds * (1.0 - MARGIN)

    @cached_property
    def _tangents(self) -> FloatArray:
        """dq/ds at both ends of each piece, shape (2, m, n), with exact zeros for joints that stand still."""
        pieces = np.arange(self.pieces.start, self.pieces.stop)
        at = self.path.breaks[pieces[0] : pieces[-1] + 2]
        ends = self.path.on_pieces(np.concatenate([pieces, pieces]), np.concatenate([at[:-1], at[1:]]), 1)
        return np.where(np.abs(ends) > MIN_SHARE, ends, 0.0).reshape(2, len(pieces), -1)

    @cached_property
    def rates(self) -> Rates:
        """The largest rates of each joint on each section."""
        rows = [first - self.pieces.start for first in self._first_pieces]
        breaks = self.path.breaks[[*self._first_pieces, self.pieces.stop]]
        on_blend = self.path.blended[self._first_pieces][:, None]
        length = (breaks[1:] - breaks[:-1])[:, None]
        before, after = self._tangents[:, rows]
        tangent, turn = np.abs(before), np.where(on_blend, np.abs(after - before), 0.0)
        tangent = np.where(on_blend, np.maximum(tangent, np.abs(after)), tangent)
        return Rates(tangent, turn * 2.0 * STEEPEST / length, turn * 4.0 * STEEPEST_SLOPE / (length * length))

    def _section_limits(self, blended: Sequence[bool], jerk: bool) -> list[ScalarLimits]:
        """The limits of each section; on blends from the steepest slopes, abs(dq/ds) being largest at an end."""
        limits, rates = self.limits, self.rates
        speed = smallest_ratio(limits.velocity, rates.tangent)
        acceleration = smallest_ratio(limits.acceleration, rates.tangent)
        speed = np.minimum(speed, np.sqrt(smallest_ratio(limits.acceleration, rates.bend)))
        jerks = [math.inf] * len(blended)
        if jerk:
            cubes = smallest_ratio(limits.jerk, rates.twist).tolist()
            speed = np.minimum(speed, [math.pow(cube, 1.0 / 3.0) for cube in cubes])
            jerks = np.where(blended, math.inf, smallest_ratio(limits.jerk, rates.tangent)).tolist()
        return list(map(ScalarLimits, speed.tolist(), acceleration.tolist(), jerks))


def smallest_ratio(limits: FloatArray, shares: FloatArray) -> FloatArray:
    """For each row of shares the smallest limit / share of the joints with a share; infinity if none has one."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a law may not use that limit
        return np.asarray(np.where(shares > 0.0, limits / shares, math.inf).min(axis=1))


def path_segments(
    path: JointPath,
    limits: JointLimits,
    speed_limit: SpeedLimit | None,
    s_start: float | None = None,
    torque: TorqueLimits | None = None,
) -> Iterator[PathSegment]:
    """The segments of a path between its stops, from ``s_start`` on if given; none for a single point."""
    function_or_none("speed_limit", speed_limit, "a function of s")
    if path.length > (s_start or 0.0):
        stops = np.searchsorted(path.breaks, [0.0, *path.knots[list(path.corners)], path.length]).tolist()
        if s_start is not None:
            first_piece = int(path.pieces_at(np.array([s_start]))[0])
            stops = [first_piece, *(stop for stop in stops if stop > first_piece)]
        for first, end in pairwise(stops):
            yield PathSegment(path, range(first, end), limits, speed_limit, s_start, torque=torque)
            s_start = None


def straight_sections(path: JointPath, limits: JointLimits, *, jerk: bool) -> list[Section]:
    """The sections of a path without blends, one between each two stops, all computed at once."""
    if not path.length > 0.0:
        return []
    starts = [0.0, *path.knots[list(path.corners)].tolist()]
    firsts = path.breaks.searchsorted(starts)
    share = np.abs(path.on_pieces(firsts, path.breaks[firsts], 1))
    share = np.where(share > MIN_SHARE, share, 0.0)
    rows = [limits.velocity, limits.acceleration, *([limits.jerk] if jerk else [])]
    ratios = [smallest_ratio(row, share).tolist() for row in rows] + ([] if jerk else [[math.inf] * len(starts)])
    lengths = [end - start for start, end in pairwise([*starts, path.length])]
    return [
        Section(start, length, ScalarLimits(*own), False)
        for start, length, *own in zip(starts, lengths, *ratios, strict=True)
    ]
