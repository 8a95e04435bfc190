"""Motions of arms that start one after the other, each on its own clock, and the proof that they do not touch.

Arm i has gone t_i seconds of its motion, from 0 to its duration T_i. Two arms whose clocks run as planned are at (t_1,
t_2) on a line t_1 - t_2 = c in the rectangle of both motions, along whose sides it goes on where one of them stands
before its start or after its end; c is how much later the second starts. If either may be late by up to d seconds, at
any time, as long as it likes, every c' within d of c occurs, and so do all points between these lines: the band.

A band is covered by rectangles: a stretch of one arm's motion and a stretch of the other's, on which both arms are
proven apart at once (diagram.hpp states the lemma). Those that are not proven are quartered, until in the middle of one
both arms are too near, or it is too small: it says which c it stands in the way of.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from planner_service.certify import Certifier
from planner_service.certify.diagram import HALVINGS
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["Between", "Clock", "best_start", "between_arms", "tolerated"]

LAST = HALVINGS
"""Halvings of both motions: a motion of 2 s is cut into pieces of 4 ms where it comes close without touching."""

SHORTEST, LONGEST, FINEST = 0.05, 2.0, 0.001
"""Seconds of delay: which are asked for first and last, and how finely."""

NO_WAY: FloatArray = np.zeros((0, 2))

NUDGE = 1e-9
"""Seconds by which a start is put beyond what stands in its way."""


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


class Between:
    """What is proven between two arms on their motions; what was proven once is not asked again.

    Args:
        still: q of the whole, of which both arms' joints are replaced.
        padding: Metres that the arms keep from each other.
    """

    def __init__(
        self, certifier: Certifier, first: Clock, second: Clock, still: FloatArray, padding: float = 0.0
    ) -> None:
        self._diagram = certifier.diagram(first, second, still, padding=padding)

    @property
    def bounds(self) -> int:
        """Bounds asked so far."""
        return int(self._diagram.asked)

    @property
    def rectangles(self) -> int:
        """How many were asked."""
        return int(self._diagram.rectangles)

    def in_the_way(self, lead: float, delay: float) -> FloatArray:
        """Leads that are not proven, from where to where, (k, 2), for what is in the band of this one; none if it is.

        Args:
            lead: Seconds by which the second starts later than the first.
            delay: Seconds by which either may be late at any time.
        """
        return np.frombuffer(self._diagram.blocked(lead, delay, LAST)).reshape(-1, 2)

    def proven(self, level: int) -> BoolArray:
        """Of each rectangle whether it is proven, where both motions are halved so often: [of the first, second]."""
        out = np.zeros((1 << level, 1 << level), dtype=np.bool_)
        self._diagram.proven(level, out)
        return out


class Turned:
    """The same, of the second arm and the first."""

    def __init__(self, between: Between) -> None:
        self._between = between

    def in_the_way(self, lead: float, delay: float) -> FloatArray:
        """As of ``Between``."""
        return -self._between.in_the_way(-lead, delay)[:, ::-1]

    def proven(self, level: int) -> BoolArray:
        """As of ``Between``."""
        return self._between.proven(level).T


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


def best_start(pairs: Sequence[tuple[Between | Turned, float]], delay: float, latest: float) -> float | None:
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
