"""Motions of arms that start one after the other, each on its own clock, and the proof that they do not touch.

Arm i has gone t_i seconds of its motion, from 0 to its duration T_i. Two arms whose clocks run as planned are at (t_1,
t_2) on a line t_1 - t_2 = c in the rectangle of both motions, along whose sides it goes on where one of them stands
before its start or after its end; c is how much later the second starts. If either may be late by up to d seconds, at
any time, as long as it likes, every c' within d of c occurs, and so do all points between these lines: the band.

Lemma. Let s be a stretch [a, b] of arm 1's motion, and u one of arm 2's. Of each joint j let m_j be the middle between
its values at both ends of the stretch of its arm, and r_j half of the way that it travels there. Then at every point of
the rectangle s x u, every joint is within r_j of m_j. Proof: from a to any place, and from there to b, joint j travels
r_j * 2 in all, so that the values at a and b differ from that at the place by no more than what is travelled on either
side; the mean of the two differs by no more than half of their sum. So a proof that the two arms are apart at m with
room r, as of a tube, proves the rectangle.

A band is covered by rectangles. Those that are not proven are quartered, until one is small and its middle is not free,
or too small: it says which c it stands in the way of.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from planner_service.certify import Certifier
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["Between", "Clock", "best_start", "between_arms", "tolerated"]

FIRST, SMALL, LAST = 3, 6, 9
"""Halvings of both motions: where a proof begins, where a rectangle is given up whose middle is not free, and where any
is: a motion of 2 s is cut into pieces of 16 ms, and of 4 ms where it comes close without touching."""

ROUNDING = 1e-9
"""Radians or metres that a joint is given beyond its travel, for rounding: its values have errors of 1e-14."""

SHORTEST, LONGEST, FINEST = 0.05, 2.0, 0.001
"""Seconds of delay: which are asked for first and last, and how finely."""

NO_WAY: FloatArray = np.zeros((0, 2))

QUARTERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])

NUDGE = 1e-9
"""Seconds by which a start is put beyond what stands in its way."""

Span = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Clock:
    """The motion of some joints of the whole in time.

    Attributes:
        columns: Those joints.
        duration: Seconds.
        q: Their values at 2**LAST + 1 times, evenly from start to end.
        travel: How far each has travelled by then.
    """

    columns: IntArray
    duration: float
    q: FloatArray
    travel: FloatArray

    @classmethod
    def of(cls, trajectory: Trajectory, columns: Sequence[int], own: Sequence[int] | None = None) -> Clock:
        """The motion of all joints of a trajectory, or of its ``own``, as joints ``columns`` of the whole."""
        times = np.linspace(0.0, trajectory.duration, (1 << LAST) + 1)
        s = np.clip(np.asarray(trajectory.s(times)), 0.0, trajectory.path.length)
        q, travel = trajectory.path(s), trajectory.path.travel(s)
        if own is not None:
            q, travel = q[:, own], travel[:, own]
        return cls(np.array(columns, dtype=np.intp), trajectory.duration, q, travel)

    @classmethod
    def standing(cls, q: FloatArray, columns: Sequence[int]) -> Clock:
        """No motion."""
        rows = np.repeat(np.asarray(q, dtype=np.float64)[None], (1 << LAST) + 1, axis=0)
        return cls(np.array(columns, dtype=np.intp), 0.0, rows, np.zeros_like(rows))


UNKNOWN, PROVEN, OPEN, GIVEN_UP = range(4)
"""Of a rectangle."""


class Between:
    """What is proven between two arms on their motions; what was proven once is not asked again.

    Args:
        still: q of the whole, of which both arms' joints are replaced.
        padding: Metres that the arms keep from each other.

    Attributes:
        bounds: Bounds asked so far.
        rectangles: How many were asked.
    """

    def __init__(
        self, certifier: Certifier, first: Clock, second: Clock, still: FloatArray, padding: float = 0.0
    ) -> None:
        self._certifier, self._first, self._second = certifier, first, second
        self._still, self._padding = still, padding
        self._known = {level: np.zeros((1 << level, 1 << level), dtype=np.uint8) for level in range(FIRST, LAST + 1)}
        self.bounds = self.rectangles = 0

    def in_the_way(self, lead: float, delay: float) -> FloatArray:
        """Leads that are not proven, from where to where, (k, 2), for what is in the band of this one; none if it is.

        Args:
            lead: Seconds by which the second starts later than the first.
            delay: Seconds by which either may be late at any time.
        """
        blocked = [NO_WAY]
        size = 1 << FIRST
        cells: IntArray = np.indices((size, size)).reshape(2, -1).T
        for level in range(FIRST, LAST + 1):
            low, high = self._leads(level, cells)
            met = ((low <= lead + delay) & (high >= lead - delay)).any(axis=1)
            cells, low, high = cells[met], low[met], high[met]
            self._ask(level, cells)
            outcome = self._known[level][cells[:, 0], cells[:, 1]]
            lost = outcome == GIVEN_UP
            ways = np.stack([low[lost], high[lost]], axis=-1).reshape(-1, 2)
            blocked.append(ways[ways[:, 0] <= ways[:, 1]])
            quartered = cells[outcome == OPEN]
            if not len(quartered):
                break
            cells = (2 * quartered[:, None] + QUARTERS).reshape(-1, 2)
        return np.concatenate(blocked)

    def _leads(self, level: int, cells: IntArray) -> tuple[FloatArray, FloatArray]:
        """The leads whose lines, with what goes on along the sides, meet each rectangle: five spans, low and high.

        A span that is not there is empty: it begins at infinity and ends at -infinity.
        """
        last = (1 << level) - 1
        times = np.array([self._first.duration, self._second.duration])
        (a0, b0), (a1, b1) = (cells * times / (last + 1)).T, ((cells + 1) * times / (last + 1)).T
        none, every = np.full(len(cells), math.inf), np.full(len(cells), -math.inf)
        i, j = cells.T
        low = [
            a0 - b1,
            np.where(j == 0, a0, none),
            np.where(i == 0, every, none),
            np.where(i == last, times[0] - b1, none),
            np.where(j == last, every, none),
        ]
        high = [
            a1 - b0,
            np.where(j == 0, none, every),
            np.where(i == 0, -b0, every),
            np.where(i == last, none, every),
            np.where(j == last, a1 - times[1], every),
        ]
        return np.stack(low, axis=1), np.stack(high, axis=1)

    def _ask(self, level: int, cells: IntArray) -> None:
        """Prove the rectangles that are not known."""
        known = self._known[level]
        new = cells[known[cells[:, 0], cells[:, 1]] == UNKNOWN]
        if not len(new):
            return
        step = 1 << (LAST - level)
        middle = np.repeat(self._still[None], len(new), axis=0)
        room = np.zeros_like(middle)
        for clock, begin in zip((self._first, self._second), (new * step).T, strict=True):
            end = begin + step
            middle[:, clock.columns] = 0.5 * (clock.q[begin] + clock.q[end])
            room[:, clock.columns] = 0.5 * (clock.travel[end] - clock.travel[begin]) + ROUNDING
        hopeful = self._certifier.clearances(middle) > self._padding
        free = np.zeros(len(new), dtype=np.bool_)
        asked = middle[hopeful]
        free[hopeful], bounds = self._certifier.certify_each(asked, asked, room[hopeful], padding=self._padding)
        self.bounds += bounds + len(new)
        self.rectangles += len(new)
        lost = (level >= SMALL and ~hopeful) | (level == LAST)
        known[new[:, 0], new[:, 1]] = np.where(free, PROVEN, np.where(lost, GIVEN_UP, OPEN))


def between_arms(robot: Robot, first: frozenset[str], second: frozenset[str], still: Sequence[str]) -> Certifier:
    """A certifier that judges what moves with one arm against what moves with the other, and nothing else."""
    links = list(dict.fromkeys(item.link for item in robot.shapes))
    other = [
        (a, b) for a, b in combinations(links, 2) if not ((a in first and b in second) or (a in second and b in first))
    ]
    return Certifier(robot, Scene(()), allowed=other, still=still)


def tolerated(between: Between, lead: float, delay: float) -> float:
    """The seconds that either may be late at this lead, ``delay`` at least, which is proven."""
    least, wanted = delay, max(2.0 * delay, SHORTEST)
    while wanted <= LONGEST:
        found = between.in_the_way(lead, wanted)
        if not len(found):
            least, wanted = wanted, 2.0 * wanted
            continue
        wanted = _below(found, lead, wanted)
        while wanted > least:  # what is proven only to a lesser delay may come nearer
            found = between.in_the_way(lead, wanted)
            if not len(found):
                return wanted
            wanted = _below(found, lead, wanted)
        return least
    return least


def _below(found: FloatArray, lead: float, delay: float) -> float:
    """The delay that leaves out what was found, and is less than one that does not."""
    nearest = float(np.maximum(found[:, 0] - lead, lead - found[:, 1]).min())
    return min(delay - FINEST, math.floor(nearest / FINEST - 1.0) * FINEST)


def best_start(pairs: Sequence[tuple[Between, float]], delay: float, latest: float) -> float | None:
    """How many seconds an arm waits at least before it starts; None if no wait up to ``latest`` is proven.

    Args:
        pairs: What is proven between each arm that goes before and this one, and when that starts.
    """
    wait, ways, either = 0.0, NO_WAY, np.array([-delay, delay])
    while wait <= latest:
        found = np.concatenate([NO_WAY, *(between.in_the_way(wait - start, delay) + start for between, start in pairs)])
        if not len(found):
            return wait
        ways = np.concatenate([ways, found + either])
        for low, high in ways[np.argsort(ways[:, 0])].tolist():
            if low <= wait <= high:
                wait = high + NUDGE
    return None
