"""A motion that stops on its way and waits until another has passed: the time-optimal one through a diagram.

The other arms' motions are given, and so is this arm's path. Its own law brings it to rest at some places of the path,
and from rest at one to rest at a later one. What can be reached when is found over a grid of times: at a place it may
stand as long as it is proven apart from the others there, and it may leave for a later place, or for the end, when the
whole way there is. Of all that reach the end, the first is taken: none comes to a place from which it cannot go on.

This looks at rectangles of one size, and at whole steps of time. The caller proves what is found.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from planner_service.cell.clocks import Between, Turned
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.path.trajectory import Trajectory
from planner_service.planning.accounting import motion_report
from planner_service.planning.request import Pace
from planner_service.planning.result import PlanResult
from planner_service.robot.model import Robot
from planner_service.timing.laws import TimingFailed, time_with_peaks
from planner_service.timing.limit_check import peaks

__all__ = ["HALVINGS", "Passing", "can_pass", "waiting"]

HALVINGS = 7
"""Of both motions, for rectangles that are looked at."""

PLACES = 7
"""Where an arm may wait, evenly in the time of its motion without a stop, and moved off its blends."""

STEPS = 64
"""Of time, in that motion."""

RUN_UP = 1e-3
"""Share of a path that a place is off its waypoints at least, to get to speed."""


@dataclass(frozen=True, eq=False)
class Passing:
    """Another arm's motion that is given.

    Attributes:
        between: What is proven of that arm's plan and this one's, neither with a stop.
        plan: The other arm's plan, without a stop.
        trajectory: What it does: the same, or with stops.
        start: Seconds at which it starts.
    """

    between: Between | Turned
    plan: Trajectory
    trajectory: Trajectory
    start: float

    def reached(self, times: FloatArray) -> FloatArray:
        """The part of the time of its plan that it has come to at some times."""
        return _reached(self.plan, self.trajectory, times - self.start)


class _Legs(NamedTuple):
    """The motion from a place to a later one: its pieces, and the rectangles that it is in during each step, (m,)."""

    durations: FloatArray
    coefficients: FloatArray
    first: IntArray
    last: IntArray

    @property
    def seconds(self) -> float:
        return float(self.durations.sum())


def can_pass(between: Between) -> bool:
    """Whether any way from both starts to both ends goes through rectangles that are proven, and never back."""
    free = between.proven(HALVINGS)
    reached = np.zeros(free.shape[1], dtype=np.bool_)
    reached[0] = True
    for row in free:
        came = row & (reached | np.append(False, reached[:-1]))
        stretch = np.cumsum(~row)  # of places that are free and follow each other
        first = np.flatnonzero(came)
        reached = came
        if len(first):
            # a place is reached from the first that was, on its stretch
            begins = np.full(stretch[-1] + 1, len(row))
            np.minimum.at(begins, stretch[first], first)
            reached = row & (np.arange(len(row)) >= begins[stretch])
    return bool(reached[-1])


def waiting(
    plan: PlanResult, robot: Robot, pace: Pace, others: Sequence[Passing], delay: float, latest: float
) -> tuple[PlanResult, float] | None:
    """The plan with stops on its way, and when it starts, so that it ends as early as it can; None if none is found.

    Args:
        robot: Of the plan.
        others: The motions that it has to keep clear of.
        delay: Seconds by which any may be late at any time.
        latest: Seconds by which all of these have ended, with their delays.
    """
    if not others:
        return plan, 0.0
    if pace.max_tool_speed is not None or pace.keeps_torques:  # these slow down all of a motion, or hold its load
        return None
    trajectory = plan.unwrap()[1]
    if not trajectory.duration > 0.0:
        return None
    try:
        search = _Search(trajectory, pace, robot, others, delay, latest)
        found = search.run(one=True)
        found = search.run(one=False) if found is None else found
    except TimingFailed:
        return None
    if found is None:
        return None
    timed, start, stops = found
    if timed is trajectory:
        return plan, start
    highest = peaks(timed, pace.limits(robot))
    before = plan.motion
    motion = motion_report(robot, timed, highest, math.inf if before is None else before.stop_duration)
    words = [f"it waits for {seconds:.2f} s on its way" for seconds in stops]
    return replace(plan, trajectory=timed, motion=motion, notes=(*plan.notes, *words)), start


class _Search:
    """One motion among others."""

    def __init__(
        self, trajectory: Trajectory, pace: Pace, robot: Robot, others: Sequence[Passing], delay: float, latest: float
    ) -> None:
        self._trajectory, self._pace, self._limits = trajectory, pace, pace.limits(robot)
        self._step = trajectory.duration / STEPS
        size = 1 << HALVINGS
        self._count = math.ceil(latest / self._step) + 2
        times = np.asarray(np.arange(self._count) * self._step, dtype=np.float64)
        self._taken = list[tuple[IntArray, IntArray, IntArray]]()
        for other in others:
            table = np.zeros((size + 1, size + 1), dtype=np.intp)
            table[1:, 1:] = (~other.between.proven(HALVINGS)).cumsum(axis=0).cumsum(axis=1)
            first = _rectangles(other.reached(times - delay))[0]
            last = _rectangles(other.reached(times + (self._step + delay)))[1]
            self._taken.append((table, first, last))
        self._places = _places(trajectory)
        whole = trajectory.durations, trajectory.coefficients
        self._known = {(0, len(self._places) + 1): self._legs(trajectory, *whole, 0.0)}

    def run(self, *, one: bool) -> tuple[Trajectory, float, list[float]] | None:
        """The motion that ends first, when it starts, and how long it waits; with ``one`` stop, or as many as help."""
        end = len(self._places) + 1
        if one:
            for place in range(1, end):
                self._time((place,))
        else:
            for places in combinations(range(1, end), 2):
                self._time(places)
        arrived: dict[int, IntArray] = {}  # the step at which the arm came that stands there
        came: dict[tuple[int, int], tuple[int, int]] = {}
        reached, best = [np.zeros(self._count, dtype=np.bool_) for _ in range(end)], (math.inf, -1, -1)
        reached[0][0] = True
        stays = self._free(*_rectangles(np.array([1.0])))[:, 0]
        stays = np.logical_and.accumulate(stays[::-1])[::-1]
        for place in range(end):
            arrived[place] = self._standing(place, reached[place])
            here = arrived[place] >= 0
            if not here.any():
                continue
            for goal in range(place + 1, end + 1):
                legs = self._known.get((place, goal))
                if legs is None:
                    continue
                leaves = here & self._safe(legs)
                took = math.ceil(legs.seconds / self._step - 1e-9)
                if goal == end:
                    leaves &= stays[np.minimum(np.arange(self._count) + took, self._count - 1)]
                    first = int(leaves.argmax())
                    seconds = first * self._step + legs.seconds + (0.0 if place == 0 else self._step)
                    if leaves.any() and seconds < best[0]:  # a stop is to gain something
                        best = seconds, place, first
                    continue
                for step in np.flatnonzero(leaves[: self._count - took]).tolist():
                    if not reached[goal][step + took]:
                        reached[goal][step + took] = True
                        came[goal, step + took] = (place, step)
        return None if best[1] < 0 else self._motion(best[1], best[2], arrived, came)

    def _motion(
        self, place: int, step: int, arrived: Mapping[int, IntArray], came: Mapping[tuple[int, int], tuple[int, int]]
    ) -> tuple[Trajectory, float, list[float]]:
        """The motion that leaves a place for the end at a step."""
        goal, pieces, stops = len(self._places) + 1, list[tuple[FloatArray, FloatArray]](), list[float]()
        while True:
            legs = self._known[place, goal]
            pieces.insert(0, (legs.durations, legs.coefficients))
            if place == 0:
                break
            before, left = came[place, int(arrived[place][step])]
            seconds = (step - left) * self._step - self._known[before, place].seconds
            stops.insert(0, seconds)
            if seconds > 0.0:
                pieces.insert(0, (np.array([seconds]), np.array([[legs.coefficients[0, 0], 0.0, 0.0, 0.0]])))
            goal, place, step = place, before, left
        if not stops:
            return self._trajectory, step * self._step, stops
        durations, coefficients = (np.concatenate(tables) for tables in zip(*pieces, strict=True))
        path, dilation = self._trajectory.path, self._trajectory.dilation
        return Trajectory(path, durations, coefficients, dilation), step * self._step, stops

    def _standing(self, place: int, reached: BoolArray) -> IntArray:
        """Of each step the last at which the arm can have come to a place where it stands since; -1 for none."""
        s = [0.0, *self._places][place]
        free = self._free(*_rectangles(self._share(np.array([s]))))[:, 0].tolist()
        out, since = np.full(self._count, -1), -1
        for step, (came, stands) in enumerate(zip(reached.tolist(), free, strict=True)):
            since = step if came else since
            out[step] = since
            since = since if stands else -1
        return out

    def _safe(self, legs: _Legs) -> BoolArray:
        """Of each step whether the arm can leave then."""
        return np.asarray(self._free(legs.first, legs.last, moving=True).all(axis=1))

    def _free(self, first: IntArray, last: IntArray, *, moving: bool = False) -> BoolArray:
        """Whether rectangles (m,) are proven at each step, (steps, m); ``moving``: the k-th one k steps later."""
        at = np.arange(self._count)[:, None] + (np.arange(len(first)) if moving else 0)
        at = np.minimum(at, self._count - 1)
        out = np.ones((self._count, len(first)), dtype=np.bool_)
        for table, begin, end in self._taken:
            i, k = begin[at], end[at] + 1
            out &= (table[k, last + 1] - table[i, last + 1] - table[k, first] + table[i, first]) == 0
        return out

    def _share(self, s: FloatArray) -> FloatArray:
        """The part of the time of the motion without a stop that it takes to some s."""
        return _shares(self._trajectory, s)

    def _time(self, places: tuple[int, ...]) -> None:
        """The legs of the motion that stops at some places, as far as they are not known."""
        s = [self._places[place - 1] for place in places]
        path = self._trajectory.path.with_stops(s)
        timed, _ = time_with_peaks(self._pace.timing, path, self._limits, None)
        stops = path.knots[[int(np.abs(path.knots - at).argmin()) for at in s]]
        cuts = [0, *(int(np.abs(timed.coefficients[:, 0] - at).argmin()) for at in stops), len(timed.durations)]
        ends = (0, *places, len(self._places) + 1)
        for k, key in enumerate(pairwise(ends)):
            if key in self._known:
                continue
            durations, coefficients = (table[cuts[k] : cuts[k + 1]] for table in (timed.durations, timed.coefficients))
            self._known[key] = self._legs(timed, durations, coefficients, float(timed.knots[cuts[k]]))

    def _legs(self, timed: Trajectory, durations: FloatArray, coefficients: FloatArray, begin: float) -> _Legs:
        """Some pieces of a motion, from a time on."""
        seconds = float(durations.sum())
        times = np.minimum(np.arange(math.ceil(seconds / self._step - 1e-9) + 1) * self._step, seconds) + begin
        share = self._share(np.asarray(timed.s(np.minimum(times, timed.duration))))
        return _Legs(durations, coefficients, _rectangles(share[:-1])[0], _rectangles(share[1:])[1])


def _reached(plan: Trajectory, trajectory: Trajectory, times: FloatArray) -> FloatArray:
    return _shares(plan, np.asarray(trajectory.s(np.clip(times, 0.0, trajectory.duration))))


def _shares(plan: Trajectory, s: FloatArray) -> FloatArray:
    """The parts of a plan's time that it takes to some s."""
    times = np.linspace(0.0, 1.0, (4 << HALVINGS) + 1)
    return np.asarray(np.interp(s, np.asarray(plan.s(times * plan.duration)), times))


def _rectangles(share: FloatArray) -> tuple[IntArray, IntArray]:
    """The first and the last rectangle that parts of a motion's time are in."""
    at, last = share * (1 << HALVINGS), (1 << HALVINGS) - 1
    return np.clip(np.ceil(at - 1e-6) - 1.0, 0, last).astype(np.intp), np.clip(at + 1e-6, 0, last).astype(np.intp)


def _places(trajectory: Trajectory) -> list[float]:
    """Some s of a motion at which it can stop, in order."""
    path = trajectory.path
    ends = path.breaks
    out = list[float]()
    for share in np.arange(1, PLACES + 1) / (PLACES + 1):
        s = float(trajectory.s(share * trajectory.duration))
        piece = int(path.pieces_at(np.array([s]))[0])
        room = RUN_UP * path.length
        lines = [
            k
            for k in range(len(ends) - 1)
            if not path.blended[k] and ends[k + 1] - ends[k] > 2.0 * room and abs(k - piece) <= 1
        ]
        near = [min(max(s, float(ends[k]) + room), float(ends[k + 1]) - room) for k in lines]
        if near:
            best = min(near, key=lambda at: abs(at - s))
            if not out or best > out[-1] + room:
                out.append(best)
    return out
