"""``Optimise``, the settings of path optimisation, and ``Optimum``, its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.validation import number, numbers, whole
from planner_service.optimize.chomp import Chomp
from planner_service.optimize.curve import course_path, evenly
from planner_service.optimize.problem import CurveObjective, CurveProblem, Figures, Method
from planner_service.optimize.trajopt import TrajOpt
from planner_service.path.joint_path import JointPath

__all__ = ["FEW_CORNERS", "MAX_CLEARANCE", "METHODS", "Optimise", "Optimum"]

MAX_CLEARANCE = 0.1
"""Metres; a larger value is probably a mistake of units."""

MANY_CORNERS, FEW_CORNERS = 8, 3
"""Measured: with 8, ToppRa is 1 to 3 % faster than with 6 or 5; with 3, SCurve is up to 30 % faster than with 8."""

METHODS: Mapping[str, type[Any]] = MappingProxyType({TrajOpt.name: TrajOpt, Chomp.name: Chomp})
"""The methods by name."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """The curve at which an optimisation stopped. It need not be free: the checker and the certificate decide that.

    Attributes:
        corners: The curve's corners, shape (c, n), with the ends of the route; read-only.
        before: The figures of the route.
        after: The figures of the curve.
        iterations: Iterations of the method; 0 if the route is a straight line that keeps its distance, and stays.
        gradients: Gradients of distances that were computed; the checker counts the distances themselves.
    """

    corners: FloatArray
    before: Figures
    after: Figures
    iterations: int
    gradients: int

    @property
    def path(self) -> JointPath:
        """The curve with its corners blended."""
        return course_path(self.corners)


@dataclass(frozen=True)
class Optimise:
    """Finds a short, smooth curve that keeps its distance, from a path (``PlanRequest.polish``) or from a straight line
    (``PlanRequest.planner``).

    It minimises the sum of squared first differences of waypoints plus ``smoothness`` times that of second
    differences, while every pair keeps ``clearance`` at every waypoint and between them. The waypoints are points of
    the curve that is then proven and timed: a polygon with few corners, each blended as widely as possible.

    Attributes:
        waypoints: Points of the curve at which cost and distances are computed; distances also between them.
        smoothness: Weight of squared second differences. Above some hundreds little changes; at 0 curves are short
            with narrow bends.
        clearance: Metres that the robot keeps from everything else, and a quarter of it from itself; near an end that
            is nearer, as much as possible there. In a request at least twice its padding.
        corners: Corners between the ends of the polygon. More corners allow more bends and are slightly faster with
            ``ToppRa``, but slower with laws of constant speed on blends (``SCurve``, ``Trapezoidal``). None for 8, or
            for 3 in a request with such a law.
        method: ``TrajOpt()`` or ``Chomp()``.
        starts: As a planner, how many initial lines to try until the result is free: first the straight one, then
            lines through a configuration drawn from the request's seed.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range.
    """

    name: ClassVar[str] = "optimise"

    waypoints: int = 50
    smoothness: float = 100.0
    clearance: float = 0.02
    corners: int | None = None
    method: Method = field(default_factory=TrajOpt)
    starts: int = 1

    def __post_init__(self) -> None:
        whole("waypoints", self.waypoints, 4, 1000)
        if self.corners is not None:
            whole("corners", self.corners, 1, 200)
        whole("starts", self.starts, 1, 100)
        number("smoothness", self.smoothness, "a number from 0 to 1e6", 0.0, 1e6)
        number("clearance", self.clearance, f"metres in [0, {MAX_CLEARANCE:g}]", 0.0, MAX_CLEARANCE)
        if isinstance(self.method, type) or not callable(getattr(self.method, "minimise", None)):
            raise InvalidRequest("method", self.method, "TrajOpt() or Chomp()")
        if self.waypoints <= self._corners + 1:
            raise InvalidRequest("waypoints", self.waypoints, f"more than the {self._corners} corners and an end")

    @property
    def _corners(self) -> int:
        return MANY_CORNERS if self.corners is None else self.corners

    def improved(
        self, route: ArrayLike, checker: CollisionChecker, *, held: tuple[int, int] = (1, 1), warm: bool = False
    ) -> Optimum:
        """Optimise a polyline (N, n), which need not be free; its ends stay.

        Args:
            checker: Measures and counts distances, from the pieces themselves if its padding is 0.
            held: How many corners stay fixed at the start and at the goal, including the ends; with two, the curve
                leaves the start along the line between them.
            warm: Start with the polyline's own points as corners, such as those of an earlier optimum, instead of
                ``corners`` evenly spaced along it.

        Raises:
            InvalidRequest: Not at least two finite rows of n joint values within the limits; no free corner between
                those held.
        """
        points = _route(route, checker.robot.n)
        corners = points if warm else evenly(points, self._corners + 2)
        _require_held(held, len(corners))
        problem = CurveProblem(checker, CurveObjective(self.waypoints, self.smoothness, self.clearance), points)
        before = problem.route_figures()
        if len(points) == 2 and before.shortfall == 0.0:  # a straight line cannot be improved
            return Optimum(read_only(corners), before, before, 0, 0)
        end = self.method.minimise(problem, corners, held)
        return Optimum(read_only(end.corners), before, problem.figures(end.corners), end.iterations, problem.gradients)


def _require_held(held: Any, corners: int) -> None:
    both = isinstance(held, (tuple, list)) and len(held) == 2 and all(type(k) is int and k >= 1 for k in held)
    if not both or sum(held) >= corners:
        raise InvalidRequest("held", held, f"at least one at each end, and fewer than the {corners} corners")


def _route(values: ArrayLike, n: int) -> FloatArray:
    points = numbers("route", values, f"at least two rows of {n} joint values")
    if points.ndim != 2 or len(points) < 2 or points.shape[1] != n or not np.isfinite(points).all():
        raise InvalidRequest("route", points.shape, f"at least two finite rows of {n} joint values, shape (N, {n})")
    if not (points[1:] != points[:-1]).any():
        raise InvalidRequest("route", points[0].tolist(), "two configurations that differ")
    return points
