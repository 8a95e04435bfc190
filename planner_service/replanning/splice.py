"""Going on from a motion that is under way: what is left of it, the quickest stop along it, and another path.

Whatever comes next begins with the old motion itself, the same curve under the same law, for at least ``HOLD`` seconds:
so position, velocity and acceleration do not jump at the splice. After that the speed changes, and later the path. A
law that bounds acceleration but not jerk lets the acceleration jump wherever its pieces meet: here where the old law
ends, never at the splice.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, pairwise, product
from typing import NamedTuple

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Trajectory
from planner_service.robot.model import JointLimits
from planner_service.timing.laws import TimingFailed, ToppRa
from planner_service.timing.limit_check import MIN_SHARE, TOLERANCE, peaks
from planner_service.timing.segments import SpeedLimit

__all__ = ["HOLD", "SwitchPoint", "Underway"]

HOLD = 0.0107
"""Seconds for which the old law goes on after the splice: one cycle of a slow controller. It is not a whole number of
milliseconds, so that the next splice hardly ever falls on the instant at which two laws meet and acceleration jumps."""

SHARES = (0.9985, 0.995, 0.98, 0.95)
"""Parts of the limits that a law may use on blends, one after the other, until what it makes of them holds
the limits between its grid points too: what has begun cannot be slowed down as a whole."""

MARGINS = (0.0, 0.003, 0.01, 0.03, 0.1)
"""Shares of the possible braking that are not used on blends, for the same reason."""

LATER = (0.0, 0.02, 0.05, 0.1)
"""Seconds for which the old law goes on longer if nothing else is within the limits: on blends it may be at them."""

INTERVALS = 24
"""Intervals of constant braking on a whole blend."""

MEETING = 5e-10
"""Arc length up to which s is taken for a break of the path."""

RUN_IN = 1e-4
"""Radians before a blend begins or ends within which no law takes over: there is no room there to change speed."""

SLIVER = 1e-12
"""Seconds. A shorter piece of time is left out."""

AT_REST = 1e-9
"""Share of the highest speed; anything slower is standing still."""


class SwitchPoint(NamedTuple):
    """An instant from which another law may take over: its time, s and ds/dt."""

    time: float
    s: float
    rate: float


class _Row(NamedTuple):
    """A piece of s(t): seconds, and four coefficients."""

    seconds: float
    c0: float
    c1: float
    c2: float
    c3: float


class _Braking(NamedTuple):
    """A stop along a path: its rows, and where it ends."""

    rows: list[_Row]
    end: float


class _Window(NamedTuple):
    """The least and the largest value that is within the limits."""

    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Underway:
    """A motion under way, which another is to follow.

    Attributes:
        now: Where it is, in seconds on its clock.
        splice: Where the next motion begins, not before ``now``.
        path: What is left of its path at ``now``, from the waypoint before on: arc lengths below are along it.
    """

    trajectory: Trajectory
    now: float
    splice: float

    @cached_property
    def _first(self) -> int:
        """The last waypoint that is passed at ``now`` with its blend."""
        path = self.trajectory.path
        return int(np.flatnonzero(path.knots + path.blends <= float(self.trajectory.s(self.now)) + SLIVER)[-1])

    @cached_property
    def path(self) -> JointPath:
        old, first = self.trajectory.path, self._first
        blends = old.blends[first:].copy()
        blends[0] = 0.0
        return JointPath(old.waypoints[first:], blends)

    @property
    def rests(self) -> bool:
        """Whether the old motion has ended at the splice."""
        return self.splice >= self.trajectory.duration

    @property
    def arrived(self) -> bool:
        """Whether so little is left at the splice that a motion along it would be lost in rounding."""
        return self.s(self.splice) >= self.end

    def s(self, t: float) -> float:
        """Arc length at an instant of the old motion."""
        return self.moved(float(self.trajectory.s(t)))

    @property
    def end(self) -> float:
        """Arc length where the old motion ends."""
        return self.moved(self.trajectory.end)

    def moved(self, s: float) -> float:
        """An arc length of the old path on what is left of it."""
        begin, length, breaks = self._places
        left = min(max(s - begin, 0.0), length)
        for k in range(bisect_left(breaks, left - 2.0 * MEETING), len(breaks)):
            if abs(breaks[k] - left) <= MEETING:
                return breaks[k]
            if breaks[k] > left:
                break
        return left

    @cached_property
    def _places(self) -> tuple[float, float, list[float]]:
        """Where what is left begins on the old path, its length, and where its pieces meet."""
        breaks: list[float] = self.path.breaks.tolist()
        return float(self.trajectory.path.knots[self._first]), self.path.length, breaks

    @cached_property
    def _begins(self) -> list[float]:
        """Arc lengths where the pieces of the old law begin: ``moved`` of all at once."""
        begin, length, breaks = self._places
        left = np.minimum(np.maximum(self.trajectory.coefficients[:, 0] - begin, 0.0), length)
        out, ends = left.copy(), np.append(breaks, math.inf)
        at, open_ones = ends.searchsorted(left - 2.0 * MEETING), np.ones(len(left), dtype=bool)
        while open_ones.any():
            here = ends[np.minimum(at, len(breaks))]
            meeting = open_ones & (np.abs(here - left) <= MEETING)
            out[meeting] = here[meeting]
            open_ones &= ~meeting & ~(here > left)
            at = at + 1
        begins: list[float] = out.tolist()
        return begins

    def rows(self, until: float) -> list[_Row]:
        """The old law from the splice on."""
        law, splice = self.trajectory, self.splice
        out = []
        first = max(int(law.knots.searchsorted(splice)) - 1, 0)
        pieces = zip(law.knots.tolist(), law.durations.tolist(), self._begins, law.coefficients.tolist(), strict=False)
        for began, h, s, (c0, c1, c2, c3) in islice(pieces, first, None):
            x, end = max(splice - began, 0.0), min(until - began, h)
            if end - x > SLIVER:
                at = self.moved(c0 + x * (c1 + x * (c2 + x * c3))) if x > 0.0 else s
                rate = max(c1 + x * (2.0 * c2 + 3.0 * c3 * x), 0.0)
                out.append(_Row(end - x, at, rate, c2 + 3.0 * c3 * x, c3))
        return out

    def rest(self) -> Trajectory:
        """The old motion from the splice on."""
        return self._along(self.path, self.rows(self.trajectory.duration), self.end)

    def _along(self, path: JointPath, rows: Sequence[_Row], end: float) -> Trajectory:
        """The motion along a path up to ``end`` that rows describe; it begins at the splice."""
        table = np.array(rows).reshape(-1, 5)
        begin = float(table[0, 1]) if len(table) else end
        return Trajectory(path, table[:, 0], table[:, 1:], self.trajectory.dilation, (begin, end))

    def switch_points(self) -> Iterator[SwitchPoint]:
        """Where another law may take over: as soon as possible, then after each blend that is still ahead."""
        law, path = self.trajectory, self.path
        t = min(self.splice + HOLD, law.duration)
        soon = self._rests[(self._rests >= t) & (self._rests <= t + HOLD)]
        t = float(soon[0]) if len(soon) else t
        s = self.s(t)
        blended = path.blends > 0.0
        ends = (path.knots + path.blends)[blended].tolist()
        near = [x for x in sorted([*ends, *(path.knots - path.blends)[blended].tolist()]) if s < x <= s + RUN_IN]
        later = [x for x in ends if x > s + RUN_IN]
        if not near:
            yield SwitchPoint(t, s, self._rate(t))
        for x in [*near[-1:], *later]:
            knots = law.knots[:-1][np.abs(np.array(self._begins) - x) <= MEETING]
            if len(knots):
                yield SwitchPoint(float(knots[0]), x, self._rate(float(knots[0])))

    @cached_property
    def _rests(self) -> FloatArray:
        """When the old motion rests, at its end for the last time."""
        speeds = np.append(self.trajectory.coefficients[:, 1], 0.0)
        rests: FloatArray = self.trajectory.knots[speeds <= AT_REST * speeds.max()]
        return rests

    def _rate(self, t: float) -> float:
        rate, highest = float(self.trajectory.s(t, 1)), self.trajectory.coefficients[:, 1].max(initial=0.0)
        return 0.0 if rate <= AT_REST * highest else rate

    # -- the quickest stop

    def braked(self, limits: JointLimits) -> Trajectory:
        """The quickest stop along the old curve within limits: with the smallest margin that keeps to them.

        If the old law itself stops as quickly, at a corner or at its end, it is left to do so. The path ends with the
        piece on which the robot stops.
        """
        begin = min(self.splice + HOLD, self.trajectory.duration)
        rest = float(self._rests[self._rests >= begin][0])
        for later, margin in product(LATER, MARGINS):
            since = begin + later
            if since >= rest:
                break
            braking = self._braking(self.s(since), self._rate(since), limits, margin)
            if braking is None:
                continue
            stop = self._along(self._up_to(braking.end), [*self.rows(since), *braking.rows], braking.end)
            if peaks(stop, limits).highest <= 1.0 + TOLERANCE:
                return stop
        end = self.s(rest)
        return self._along(self._up_to(end), self.rows(rest), end)

    def stop_from(self, switch: SwitchPoint, limits: JointLimits) -> float:
        """Roughly where a stop along the old curve ends that begins at a switch point."""
        if not switch.rate > 0.0:
            return switch.s
        braking = self._braking(switch.s, switch.rate, limits, 0.0)
        return self.end if braking is None else braking.end

    def _braking(self, s: float, rate: float, limits: JointLimits, margin: float) -> _Braking | None:
        """The stop that begins at s at a speed of ``rate``; None if the old law rests before it has ended."""
        path, rows, most = self.path, list[_Row](), limits.acceleration.tolist()
        rest = min([k for k in path.knots[list(path.corners)].tolist() if k > s], default=self.end)
        while s < min(rest, self.end):
            piece = path.pieces_at(np.array([s]))
            at = self._grid(s, int(piece[0]), min(rest, self.end))
            slopes, bends = (path.on_pieces(np.repeat(piece, len(at)), at, order).tolist() for order in (1, 2))
            for k, (a, b) in enumerate(pairwise(at.tolist())):
                square, length = rate * rate, b - a
                window = _window(slopes[k : k + 2], bends[k : k + 2], square, length, most)
                if window is None:
                    window = _window(slopes[k : k + 1], bends[k : k + 1], square, length, most)
                if window is None:
                    return None
                change = window.low + margin * (window.high - window.low)
                square += 2.0 * change * length
                if square <= 0.0:
                    rows.append(_Row(rate / -change, a, rate, change / 2.0, 0.0))
                    return _Braking(rows, min(a + rate * rate / (-2.0 * change), b))
                after = math.sqrt(square)
                rows.append(_Row(2.0 * (b - a) / (rate + after), a, rate, change / 2.0, 0.0))
                rate = after
            s = float(at[-1])
        return None

    def _grid(self, s: float, piece: int, end: float) -> FloatArray:
        """Arc lengths from s to the end of its piece, or to ``end`` if that is nearer: in small steps on a blend."""
        begins, ends = self.path.breaks[piece : piece + 2].tolist()
        stop = min(ends, end)
        steps = max(1, math.ceil(INTERVALS * (stop - s) / (ends - begins))) if self.path.blended[piece] else 1
        return np.asarray(np.minimum(s + (stop - s) * (np.arange(steps + 1) / steps), stop))

    def _up_to(self, s: float) -> JointPath:
        """The path as far as the waypoint that follows s, or the one after if s is within a blend."""
        path = self.path
        last = int(np.flatnonzero(path.knots - path.blends >= s - SLIVER)[0])
        if last == len(path.waypoints) - 1:
            return path
        blends = path.blends[: last + 1].copy()
        blends[-1] = 0.0
        return JointPath(path.waypoints[: last + 1], blends)

    # -- another path

    def onward(
        self,
        path: JointPath,
        switch: SwitchPoint,
        timing: ToppRa,
        limits: JointLimits,
        *,
        speed_limit: SpeedLimit | None = None,
    ) -> tuple[Trajectory, LimitPeaks]:
        """Along a path that is the old curve up to the switch point at least: the old law up to there, then another.

        Returns:
            The motion from the splice on, and how close it comes to its limits, which it holds.

        Raises:
            TimingFailed: What comes after cannot be entered that fast, or there is no solution.
        """
        head = self.rows(switch.time)
        for share in SHARES:
            phases = timing.continue_to_rest(
                path, limits, switch.s, switch.rate, speed_limit=speed_limit, blend_share=share
            )
            rows = [_Row(p.duration, p.position, p.speed, p.acceleration / 2.0, p.jerk / 6.0) for p in phases]
            try:
                trajectory = self._along(path, [*head, *rows], path.length)
            except InvalidRequest as error:
                raise TimingFailed(f"the laws do not meet ({error})") from error
            ratios = peaks(trajectory, limits)
            if ratios.highest <= 1.0 + TOLERANCE:
                return trajectory, ratios
        raise TimingFailed(f"limits are exceeded by {ratios.highest - 1.0:.2%}")


def _window(
    slopes: Sequence[Sequence[float]],
    bends: Sequence[Sequence[float]],
    square: float,
    length: float,
    acceleration: Sequence[float],
) -> _Window | None:
    """The values of d2s/dt2 within the limits at both ends of an interval; None if there are none.

    Args:
        slopes, bends: Derivatives of the path at both ends, or at the first alone, n numbers each.
        square: Of ds/dt at the first end.
        length: Of the interval.
        acceleration: The limits, n numbers.
    """
    low, high = -math.inf, math.inf
    for twice, q1, q2 in zip((0.0, 2.0 * length), slopes, bends, strict=False):
        for slope, bend, most in zip(q1, q2, acceleration, strict=True):
            per_change = slope + twice * bend  # at the second end the square is square + 2 length u
            if abs(per_change) > MIN_SHARE:
                fixed = bend * square
                a, b = (-most - fixed) / per_change, (most - fixed) / per_change
                low, high = max(low, min(a, b)), min(high, max(a, b))
    return _Window(low, high) if -math.inf < low <= high else None
