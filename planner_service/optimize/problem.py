"""What is minimised: the lesson's programme on points of a curve, its constraints as penalties.

    sum |q[k+1] - q[k]|^2  +  w sum |q[k+1] - 2 q[k] + q[k-1]|^2      while every pair keeps its distance at every q[k]

and at points between two q[k], so close together that nothing thin is stepped over. Lengths are in radians (metres for
prismatic joints), distances in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.collision.proximity import NearPairs
from planner_service.geometry.shapes import FloatArray
from planner_service.optimize.curve import Samples, evenly, sampled, squares, summed

__all__ = ["Figures", "Look", "Task", "Terms"]

SPARE = 1.05
"""Distance kept at points, as a share of what was asked, so that between two points it is kept as well."""

OWN_SHARE = 0.25
"""Part of what was asked that the robot keeps from itself and from what it carries: where links are, is known better
than where obstacles are, and many arms cannot fold without coming nearer."""

RAMP = 0.1
"""Metres by which a pair must move apart for each radian from an end at which it is nearer than asked."""

BEYOND = 0.012
"""Metres beyond what is kept within which a pair has a say in a step: with 20 mm steps take a third longer, with 10 mm
more of them are taken back."""

MOST_BETWEEN = 8
"""Points looked at for each waypoint at most."""


@dataclass(frozen=True)
class Terms:
    """What is asked of a curve: ``waypoints`` on it, the weight of second differences, metres to keep."""

    waypoints: int
    smoothness: float
    clearance: float


@dataclass(frozen=True)
class Figures:
    """A curve in numbers, at its waypoints.

    Attributes:
        cost: Sum of squared first differences and ``smoothness`` times that of second ones, rad^2.
        length: Sum of the distances between waypoints, rad.
        roughness: Sum of squared second differences, rad^2.
        clearance: Metres of the nearest pair at all points that were looked at; what is farther than was looked for
            counts as just so far.
        shortfall: Metres by which pairs are nearer than they should be, summed over points, for each waypoint's one.
    """

    cost: float
    length: float
    roughness: float
    clearance: float
    shortfall: float


@dataclass(frozen=True, eq=False)
class Look:
    """The points of a curve, the pairs near there, and the distances these should keep, (k,)."""

    samples: Samples
    near: NearPairs
    targets: FloatArray


class Task:
    """One curve to improve, from a start to a goal.

    Args:
        route: The polyline (N, n) it begins with: its ends stay, and what is near there may remain as near there.

    Attributes:
        between: Points looked at for each waypoint.
        unit: Cost of a curve as long as the route and straight, rad^2; costs are told in it while minimised.
        gradients: How many were worked out so far.
    """

    def __init__(self, checker: CollisionChecker, terms: Terms, route: FloatArray) -> None:
        self.checker, self.terms, self.route = checker, terms, route
        limits = checker.robot.limits
        self.lower, self.upper = limits.lower, limits.upper
        self.gradients = 0
        points = evenly(route, terms.waypoints)
        steps = np.abs(points[1:] - points[:-1])
        self.length = math.fsum(np.sqrt(summed((steps * steps).T)).tolist())
        motion = float(summed((steps * checker.robot.reach()).T).max())
        self.between = min(MOST_BETWEEN, max(1, math.ceil(motion / max(terms.clearance, 1e-3))))
        self.unit = self.length * self.length / (terms.waypoints - 1)
        self.aim = terms.clearance * SPARE
        self._own = checker.own_pairs
        ends = checker.near(route[[0, -1]], self.aim)
        self._ends = [{p: d for row, p, d in zip(*_lists(ends), strict=True) if row == end} for end in (0, 1)]

    @property
    def points(self) -> int:
        """How many points of a curve are looked at, its ends included."""
        return (self.terms.waypoints - 1) * self.between + 1

    def samples(self, corners: FloatArray) -> Samples:
        """Where a curve with these corners is looked at."""
        return sampled(corners, self.points)

    def look(self, samples: Samples, corners: FloatArray, within: float) -> Look:
        """The pairs that are less than ``within`` metres apart at the points of a curve between its ends."""
        points = np.minimum(np.maximum(samples.of(corners), self.lower), self.upper)
        return self._looked(samples, points, within)

    def _looked(self, samples: Samples, points: FloatArray, within: float) -> Look:
        found = self.checker.near(points[1:-1], within)
        near = NearPairs(found.rows + 1, found.pairs, found.distances, found.points, found.gradients)
        return Look(samples, near, self._targets(near))

    def _targets(self, near: NearPairs) -> FloatArray:
        """What each pair is to keep: what was asked, but near an end not more than it can have there."""
        last = self.points - 1
        way = near.rows * (self.length / last)
        out = np.where(self._own[near.pairs], self.aim * OWN_SHARE, self.aim)
        for known, far in zip(self._ends, (way, self.length - way), strict=True):
            if known:
                at_end = np.array([known.get(pair, self.aim) for pair in near.pairs.tolist()])
                out = np.minimum(out, at_end + RAMP * far)
        return out

    def shortfall(self, look: Look) -> float:
        """Metres by which pairs are nearer than they should be, summed over points, for each waypoint's one."""
        short = np.maximum(look.targets - look.near.distances, 0.0)
        return math.fsum(short.tolist()) / self.between

    def cost(self, samples: Samples, corners: FloatArray) -> float:
        """In units of a straight curve."""
        return self._cost(samples.of(corners)[:: self.between]) / self.unit

    def _cost(self, waypoints: FloatArray) -> float:
        first, second = squares(waypoints)
        return first + self.terms.smoothness * second

    def curvature(self, samples: Samples, count: int) -> FloatArray:
        """The matrix H (count, count) with which ``cost`` is trace(C^T H C) for that many corners C."""
        waypoints = samples.matrix(count)[:: self.between]
        first = waypoints[1:] - waypoints[:-1]
        second = first[1:] - first[:-1]
        gram = summed(first[:, :, None] * first[:, None, :])
        return np.asarray((gram + self.terms.smoothness * summed(second[:, :, None] * second[:, None, :])) / self.unit)

    @cached_property
    def reach(self) -> float:
        """Metres within which pairs are looked at for a step: what comes nearer from beyond is seen after it."""
        return self.aim + BEYOND

    def figures(self, corners: FloatArray) -> Figures:
        """A curve in numbers."""
        samples = self.samples(corners)
        return self._figures(samples, samples.of(corners))

    def route_figures(self) -> Figures:
        """The route in numbers, at as many points."""
        return self._figures(Samples(np.zeros(0, dtype=np.intp), np.zeros((0, 3))), evenly(self.route, self.points))

    def _figures(self, samples: Samples, points: FloatArray) -> Figures:
        points = np.minimum(np.maximum(points, self.lower), self.upper)
        look = self._looked(samples, points, self.reach)
        waypoints = points[:: self.between]
        steps = waypoints[1:] - waypoints[:-1]
        length = math.fsum(np.sqrt(summed((steps * steps).T)).tolist())
        clearance = min([self.reach, *look.near.distances.tolist(), *(d for end in self._ends for d in end.values())])
        return Figures(self._cost(waypoints), length, squares(waypoints)[1], clearance, self.shortfall(look))


def _lists(near: NearPairs) -> tuple[list[int], list[int], list[float]]:
    return near.rows.tolist(), near.pairs.tolist(), near.distances.tolist()
