"""The optimisation problem, a cost on points of a curve and distances to keep as penalties; and what a method is.

    minimise  sum |q[k+1] - q[k]|^2  +  w sum |q[k+1] - 2 q[k] + q[k-1]|^2

while every pair keeps its distance at every q[k] and at points between them, which are so dense that nothing thin is
stepped over. Lengths are in radians (metres for prismatic joints), distances in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.collision.backends import NearPairs
from planner_service.geometry.arrays import FloatArray
from planner_service.optimize.curve import Samples, evenly, sampled, squares, summed

__all__ = ["CurveObjective", "CurveProblem", "Figures", "Method", "MethodResult", "PairDistances"]


SPARE = 1.05
"""Distance to keep at points, relative to the clearance, so that the clearance holds between two points too."""

OWN_SHARE = 0.25
"""Share of the clearance that the robot keeps from itself and from what it carries: the positions of links are known
better than those of obstacles, and many arms cannot fold without coming nearer."""

RAMP = 0.1
"""Metres by which a pair must move apart per radian from an end at which it is nearer than the clearance."""

BEYOND = 0.012
"""Pairs within this distance (m) beyond the one to keep count in a step. With 20 mm steps take a third longer, with
10 mm more of them are rejected."""

MAX_POINTS_PER_WAYPOINT = 8


@dataclass(frozen=True)
class CurveObjective:
    """The cost of a curve: how many ``waypoints`` it counts at, the weight of second differences, the clearance (m)."""

    waypoints: int
    smoothness: float
    clearance: float


@dataclass(frozen=True)
class Figures:
    """Figures of a curve, at its waypoints.

    Attributes:
        cost: The sum of squared first differences plus ``smoothness`` times that of second differences, rad^2.
        length: The sum of the distances between waypoints, rad.
        roughness: The sum of squared second differences, rad^2.
        clearance: The distance of the nearest pair at any point, m; distances beyond the search radius count as that.
        shortfall: How much too near pairs are, m, summed over points and divided by the points per waypoint.
    """

    cost: float
    length: float
    roughness: float
    clearance: float
    shortfall: float


@dataclass(frozen=True, eq=False)
class PairDistances:
    """The points of a curve, the near pairs at them, and the distances that these should keep, (k,)."""

    samples: Samples
    near: NearPairs
    targets: FloatArray


class CurveProblem:
    """The problem of improving one curve from a start to a goal.

    Args:
        route: The initial polyline (N, n). Its ends stay, and pairs that are near at an end may stay as near there.

    Attributes:
        between: Points per waypoint.
        unit: The cost of a straight curve as long as the route, rad^2: the unit of costs during minimisation.
        reach: Metres within which pairs count in a step; pairs that come nearer from beyond count in the next.
        gradients: How many gradients of distances were computed so far.
    """

    def __init__(self, checker: CollisionChecker, objective: CurveObjective, route: FloatArray) -> None:
        self.checker, self.objective, self.route = checker, objective, route
        limits = checker.robot.limits
        self.lower, self.upper = limits.lower, limits.upper
        self.gradients = 0
        points = evenly(route, objective.waypoints)
        steps = np.abs(points[1:] - points[:-1])
        self.length = math.fsum(np.sqrt(summed((steps * steps).T)).tolist())
        motion = float(summed((steps * checker.robot.reach()).T).max())
        self.between = min(MAX_POINTS_PER_WAYPOINT, max(1, math.ceil(motion / max(objective.clearance, 1e-3))))
        self.unit = self.length * self.length / (objective.waypoints - 1)
        self.aim = objective.clearance * SPARE
        self.reach = self.aim + BEYOND
        ends = checker.near(route[[0, -1]], self.aim)
        columns = ends.rows.tolist(), ends.pairs.tolist(), ends.distances.tolist()
        self._ends = [{p: d for row, p, d in zip(*columns, strict=True) if row == end} for end in (0, 1)]

    @property
    def points(self) -> int:
        """How many points of a curve are checked, including its ends."""
        return (self.objective.waypoints - 1) * self.between + 1

    def samples(self, corners: FloatArray) -> Samples:
        """The points at which a curve with these corners is checked."""
        return sampled(corners, self.points)

    def look(self, samples: Samples, corners: FloatArray, within: float) -> PairDistances:
        """The pairs that are less than ``within`` metres apart at the points of a curve between its ends."""
        points = np.minimum(np.maximum(samples.of(corners), self.lower), self.upper)
        return self._looked(samples, points, within)

    def _looked(self, samples: Samples, points: FloatArray, within: float) -> PairDistances:
        inner = self.checker.near(points[1:-1], within)
        near = NearPairs(inner.rows + 1, inner.pairs, inner.distances, inner.points, inner.gradients)
        return PairDistances(samples, near, self._targets(near))

    def _targets(self, near: NearPairs) -> FloatArray:
        """The distance that each pair should keep: the clearance, but near an end no more than is possible there."""
        last = self.points - 1
        travelled = near.rows * (self.length / last)
        out = np.where(self.checker.are_own(near.pairs), self.aim * OWN_SHARE, self.aim)
        for known, far in zip(self._ends, (travelled, self.length - travelled), strict=True):
            if known:
                at_end = np.array([known.get(pair, self.aim) for pair in near.pairs.tolist()])
                out = np.minimum(out, at_end + RAMP * far)
        return out

    def shortfall(self, look: PairDistances) -> float:
        """How much too near pairs are (m), summed over points and divided by the points per waypoint."""
        short = np.maximum(look.targets - look.near.distances, 0.0)
        return math.fsum(short.tolist()) / self.between

    def cost(self, samples: Samples, corners: FloatArray) -> float:
        """The cost of corners, in units of a straight curve."""
        return self._cost(samples.of(corners)[:: self.between]) / self.unit

    def _cost(self, waypoints: FloatArray) -> float:
        first, second = squares(waypoints)
        return first + self.objective.smoothness * second

    def curvature(self, samples: Samples, count: int) -> FloatArray:
        """The matrix H (count, count) for which ``cost`` is trace(C^T H C), with ``count`` corners C."""
        waypoints = samples.matrix(count)[:: self.between]
        first = waypoints[1:] - waypoints[:-1]
        second = first[1:] - first[:-1]
        gram = summed(first[:, :, None] * first[:, None, :])
        return np.asarray(
            (gram + self.objective.smoothness * summed(second[:, :, None] * second[:, None, :])) / self.unit
        )

    def figures(self, corners: FloatArray) -> Figures:
        """The figures of the curve with these corners."""
        samples = self.samples(corners)
        return self._figures(samples, samples.of(corners))

    def route_figures(self) -> Figures:
        """The figures of the route, at as many points."""
        return self._figures(Samples(np.zeros(0, dtype=np.intp), np.zeros((0, 3))), evenly(self.route, self.points))

    def _figures(self, samples: Samples, points: FloatArray) -> Figures:
        points = np.minimum(np.maximum(points, self.lower), self.upper)
        look = self._looked(samples, points, self.reach)
        waypoints = points[:: self.between]
        steps = waypoints[1:] - waypoints[:-1]
        length = math.fsum(np.sqrt(summed((steps * steps).T)).tolist())
        clearance = min([self.reach, *look.near.distances.tolist(), *(d for end in self._ends for d in end.values())])
        return Figures(self._cost(waypoints), length, squares(waypoints)[1], clearance, self.shortfall(look))


@dataclass(frozen=True, eq=False)
class MethodResult:
    """The corners (c, n) of the curve at which a method stopped, which need not be free, and its iterations."""

    corners: FloatArray
    iterations: int


class Method(Protocol):
    """Improves a curve; its fields are its settings. Equal problems have equal results."""

    @property
    def name(self) -> str:
        """The name on the command line, in lower case."""

    def minimise(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> MethodResult:
        """A curve of lower cost or with fewer pairs too near, or the same; the first and last ``held`` corners stay."""
