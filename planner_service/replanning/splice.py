"""Going on from a motion that is under way: what is left of it, the quickest stop along it, and another path.

Whatever comes next begins with the old motion itself, the same curve under the same law, for at least ``HOLD`` seconds:
so position, velocity and acceleration do not jump at the splice. After that the speed changes, and later the path. A
law that bounds acceleration but not jerk lets the acceleration jump wherever its pieces meet: here where the old law
ends, never at the splice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import LimitPeaks, Trajectory
from planner_service.robot.model import JointLimits
from planner_service.timing.laws import TAYLOR, TimingFailed, ToppRa
from planner_service.timing.limit_check import TOLERANCE, peaks
from planner_service.timing.segments import SpeedLimit

if TYPE_CHECKING:
    from planner_service.native import _core

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

    @cached_property
    def _core(self) -> _core.Underway:
        """What is left of the motion, compiled."""
        law = self.trajectory
        tables = *self.path.tables, *law.tables[7:11]
        core: _core.Underway = load_core().Underway(*tables, float(law.path.knots[self._first]), law.end, self.splice)
        return core

    def s(self, t: float) -> float:
        """Arc length at an instant of the old motion."""
        return self._core.at(t)[0]

    @property
    def end(self) -> float:
        """Arc length where the old motion ends."""
        return self.moved(self.trajectory.end)

    def moved(self, s: float) -> float:
        """An arc length of the old path on what is left of it; where its pieces meet, exactly there."""
        return self._core.moved(s)

    @cached_property
    def _begins(self) -> FloatArray:
        """Arc lengths where the pieces of the old law begin."""
        return np.array(list(map(self._core.moved, self.trajectory.coefficients[:, 0].tolist())))

    def rest(self) -> Trajectory:
        """The old motion from the splice on."""
        return self._along(self.path, self._core.rows(self.trajectory.duration), self.end)

    def _along(self, path: JointPath, rows: FloatArray, end: float) -> Trajectory:
        """The motion along a path up to ``end`` of which rows say seconds and four coefficients, from the splice on."""
        begin = float(rows[0, 1]) if len(rows) else end
        return Trajectory(path, rows[:, 0], rows[:, 1:], self.trajectory.dilation, (begin, end))

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
            knots = law.knots[:-1][np.abs(self._begins - x) <= MEETING]
            if len(knots):
                yield SwitchPoint(float(knots[0]), x, self._rate(float(knots[0])))

    @cached_property
    def _rests(self) -> FloatArray:
        """When the old motion rests, at its end for the last time."""
        speeds = np.append(self.trajectory.coefficients[:, 1], 0.0)
        rests: FloatArray = self.trajectory.knots[speeds <= AT_REST * speeds.max()]
        return rests

    def _rate(self, t: float) -> float:
        rate, highest = self._core.at(t)[1], self.trajectory.coefficients[:, 1].max(initial=0.0)
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
            rows, s_end = braking
            stop = self._along(self._up_to(s_end), np.concatenate([self._core.rows(since), rows]), s_end)
            if peaks(stop, limits).highest <= 1.0 + TOLERANCE:
                return stop
        end = self.s(rest)
        return self._along(self._up_to(end), self._core.rows(rest), end)

    def stop_from(self, switch: SwitchPoint, limits: JointLimits) -> float:
        """Roughly where a stop along the old curve ends that begins at a switch point."""
        if not switch.rate > 0.0:
            return switch.s
        braking = self._braking(switch.s, switch.rate, limits, 0.0)
        return self.end if braking is None else braking[1]

    def _braking(self, s: float, rate: float, limits: JointLimits, margin: float) -> tuple[FloatArray, float] | None:
        """The rows of the stop that begins at s at a speed of ``rate``, and where it ends.

        None if the old law rests before.
        """
        corners = self.path.knots[list(self.path.corners)].tolist()
        rest = min([self.end, *(k for k in corners if k > s)])
        return self._core.braking(s, rate, rest, limits.acceleration, margin)

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
        head = self._core.rows(switch.time)
        for share in SHARES:
            rows = timing.rows_to_rest(path, limits, switch.s, switch.rate, speed_limit=speed_limit, blend_share=share)
            rows[:, 1:] /= TAYLOR
            try:
                trajectory = self._along(path, np.concatenate([head, rows]), path.length)
            except InvalidRequest as error:
                raise TimingFailed(f"the laws do not meet ({error})") from error
            ratios = peaks(trajectory, limits)
            if ratios.highest <= 1.0 + TOLERANCE:
                return trajectory, ratios
        raise TimingFailed(f"limits are exceeded by {ratios.highest - 1.0:.2%}")
