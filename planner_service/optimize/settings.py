"""``Optimise``: how a path is to be optimised; what came of it is an ``Optimum``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import FloatArray, number, numbers, read_only, whole
from planner_service.optimize.chomp import Chomp
from planner_service.optimize.curve import course_path, evenly
from planner_service.optimize.method import Method
from planner_service.optimize.problem import Figures, Task, Terms
from planner_service.optimize.trajopt import TrajOpt
from planner_service.path.joint_path import JointPath

__all__ = ["FEW_CORNERS", "METHODS", "MOST_CLEARANCE", "Optimise", "Optimum"]

MOST_CLEARANCE = 0.1
"""Metres; more is a unit mistake."""

MANY_CORNERS, FEW_CORNERS = 8, 3
"""Measured: with 8, ToppRa is 1 to 3 % faster than with 6 or 5; with 3, SCurve is up to 30 % faster than with 8."""

METHODS: Mapping[str, type[Any]] = MappingProxyType({TrajOpt().name: TrajOpt, Chomp().name: Chomp})
"""Every method that can be made from its name and settings, by that name."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where an optimisation stopped. It need not be free: only ``CollisionChecker`` and the certificate say so.

    Attributes:
        corners: Of the curve, shape (c, n), its ends those of the route; read-only.
        before: The route in numbers.
        after: The curve in numbers.
        iterations: Of the method; 0 where the route was a straight line that keeps its distance, and is left as it is.
        gradients: Of distances, worked out on the way; distances themselves are counted by the checker.
    """

    corners: FloatArray
    before: Figures
    after: Figures
    iterations: int
    gradients: int

    @property
    def path(self) -> JointPath:
        """The curve, blended all the way."""
        return course_path(self.corners)


@dataclass(frozen=True)
class Optimise:
    """A short, smooth curve that keeps its distance, made from a path (``PlanRequest.polish``) or from a straight line
    (``PlanRequest.planner``).

    It is the lesson's programme: the sum of squared first differences of waypoints and ``smoothness`` times that of
    second differences, while every pair keeps ``clearance`` at every waypoint and between them. The waypoints are
    points of the very curve that is then proven and timed: a polygon with few corners, blended all the way.

    Attributes:
        waypoints: Points of the curve at which cost and distances are taken; between them distances are looked at, too.
        smoothness: Weight of squared second differences. Above some hundreds little changes, at 0 curves are short
            and have narrow bends.
        clearance: Metres that the robot keeps from everything, and a quarter of it from itself; near an end that is
            nearer, as much as that leaves. In a request no less than twice its padding.
        corners: Of the polygon, between its ends: with more of them there is room for more bends, and by ``ToppRa`` a
            curve is a little faster; laws that keep their speed on a blend (``SCurve``, ``Trapezoidal``) are slower.
            None for 8, in a request with such a law for 3.
        method: ``TrajOpt()`` or ``Chomp()``.
        starts: As a planner: lines it begins with, one after the other until the result is free: the straight one
            first, then lines through a configuration drawn from the request's seed.

    Raises:
        InvalidRequest: a value is of the wrong kind or out of its range.
    """

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
        number("clearance", self.clearance, f"metres in [0, {MOST_CLEARANCE:g}]", 0.0, MOST_CLEARANCE)
        if isinstance(self.method, type) or not callable(getattr(self.method, "minimise", None)):
            raise InvalidRequest("method", self.method, "TrajOpt() or Chomp()")
        if self.waypoints <= self._corners + 1:
            raise InvalidRequest("waypoints", self.waypoints, f"more than the {self._corners} corners and an end")

    @property
    def name(self) -> str:
        """Lower case, as on the command line."""
        return "optimise"

    @property
    def _corners(self) -> int:
        return MANY_CORNERS if self.corners is None else self.corners

    def improved(
        self, route: ArrayLike, checker: CollisionChecker, *, held: tuple[int, int] = (1, 1), warm: bool = False
    ) -> Optimum:
        """The curve that comes of a polyline (N, n), which need not be free; its ends stay.

        Args:
            checker: Measures and counts distances; with padding 0 these are those of the pieces themselves.
            held: How many corners stay as they are at the start and at the goal, the ends included: with two the
                curve leaves the start along their line.
            warm: The polyline's own points are the corners to begin with, such as those of an earlier optimum;
                else ``corners`` are laid evenly along it.

        Raises:
            InvalidRequest: not at least two finite rows of n joint values within the limits; nothing to move between
                what is held; or the compiled kernel was not built.
        """
        points = _route(route, checker.robot.n)
        corners = points if warm else evenly(points, self._corners + 2)
        _require_held(held, len(corners))
        task = Task(checker, Terms(self.waypoints, self.smoothness, self.clearance), points)
        before = task.route_figures()
        if len(points) == 2 and before.shortfall == 0.0:  # nothing is shorter than a straight line, or smoother
            return Optimum(read_only(corners), before, before, 0, 0)
        found = self.method.minimise(task, corners, held)
        return Optimum(read_only(found.corners), before, task.figures(found.corners), found.iterations, task.gradients)


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
