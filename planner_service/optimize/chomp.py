"""CHOMP: covariant gradient descent in a distance field (Zucker et al., IJRR 32(9-10), 2013).

The robot is a set of balls that enclose its moving pieces, each pushed away from the obstacles by the field's gradient.
Self-collisions and allowed contacts are ignored here: the collision checker decides about the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, cross
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere
from planner_service.geometry.validation import number, whole
from planner_service.optimize.curve import Samples, summed
from planner_service.optimize.distance_field import DistanceField, field_of
from planner_service.optimize.problem import RAMP, CurveProblem, MethodResult
from planner_service.robot.kinematic_tree import chain_to_base

__all__ = ["Balls", "Chomp"]

PITCH = 0.04
"""The largest distance (m) between balls along each side of a piece; a ball then reaches at most 15 mm beyond it."""

PRICES = (100.0, 1_000.0, 10_000.0)
"""Penalties for each square metre of shortfall, in units of a straight curve, one after the other."""

FIRST_MOVE, MIN_MOVE = 0.05, 1e-5
"""Radians that a step moves the joint that moves most: at first, and at least."""

SHRINK, GROW = 0.5, 1.3

SMALL_GAIN = 1e-4
"""Share of the merit that a step must gain for another one at this price."""


@dataclass(frozen=True)
class Chomp:
    """Looks up distances of balls in a grid that is computed once for a scene.

    A step costs hardly more among many obstacles than on an empty table. But balls are larger than the pieces they
    enclose, and the robot's links do not keep apart.

    Attributes:
        iterations: The most steps.
        voxel: Metres between points of the grid.
    """

    name: ClassVar[str] = "chomp"

    iterations: int = 300
    voxel: float = 0.02

    def __post_init__(self) -> None:
        whole("iterations", self.iterations, 1, 100_000)
        number("voxel", self.voxel, "metres in [0.002, 0.1]", 0.002, 0.1)

    def minimise(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> MethodResult:
        """See ``Method``."""
        descent = _Descent(problem, corners, held, field_of(problem.checker, self.voxel))
        done = 0
        for price in PRICES:
            descent.begin(price)
            while done < self.iterations and descent.advance():
                problem.checker.ledger.poll()  # the checker counts no looked-up distances
                done += 1
        return MethodResult(descent.corners, done)


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls that enclose the moving pieces of a robot: body, centre in its frame and radius; (b,), (b, 3), (b,).

    ``piece`` is the piece of each, (b,); ``whole`` has one ball around each whole piece, and is None in that itself.
    """

    body: IntArray
    centre: FloatArray
    radius: FloatArray
    piece: IntArray
    whole: Balls | None = None

    @classmethod
    def of(cls, checker: CollisionChecker) -> Balls:
        """The balls of a checker's robot and of what it carries."""
        moving = [part for part in checker.parts.parts if part.body > 0]
        rows = [
            (part.body, *_moved(part.T, centre), radius, number)
            for number, part in enumerate(moving)
            for centre, radius in _held_by(part.shape)
        ]
        balls = cls._from(rows)
        return replace(balls, whole=cls._from([balls._around(number) for number in range(len(moving))]))

    @classmethod
    def _from(cls, rows: Sequence[tuple[float, ...]]) -> Balls:
        table = np.array(rows, dtype=np.float64).reshape(-1, 6)
        return cls(table[:, 0].astype(np.intp), table[:, 1:4], table[:, 4], table[:, 5].astype(np.intp))

    def _around(self, piece: int) -> tuple[float, ...]:
        """A ball around all balls of a piece."""
        mine = self.piece == piece
        centre, radius = self.centre[mine], self.radius[mine]
        middle = 0.5 * (centre.min(axis=0) + centre.max(axis=0))
        away = centre - middle
        reach = np.sqrt(away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1] + away[:, 2] * away[:, 2]) + radius
        return (float(self.body[mine][0]), *middle.tolist(), float(reach.max()), float(piece))

    def placed(self, poses: tuple[FloatArray, FloatArray], row: IntArray, ball: IntArray) -> FloatArray:
        """The centres of balls (k,) in the world frame, each at the configuration of its row of poses; (k, 3)."""
        R, t = (part[row, self.body[ball]] for part in poses)
        c = self.centre[ball]
        return np.asarray(t + (R[..., 0] * c[:, 0, None] + R[..., 1] * c[:, 1, None] + R[..., 2] * c[:, 2, None]))


def _moved(T: FloatArray, x: Sequence[float]) -> list[float]:
    return [float(T[k, 0] * x[0] + T[k, 1] * x[1] + T[k, 2] * x[2] + T[k, 3]) for k in range(3)]


def _held_by(shape: Shape) -> Iterator[tuple[tuple[float, ...], float]]:
    """Balls that enclose a shape: centres in its frame, and radii."""
    if isinstance(shape, Sphere):
        yield (0.0, 0.0, 0.0), shape.radius
        return
    size: tuple[float, ...]
    middle: tuple[float, ...] = (0.0, 0.0, 0.0)
    if isinstance(shape, Box):
        size = shape.size
    elif isinstance(shape, Capsule):
        size = (0.0, 0.0, shape.length)
    elif isinstance(shape, Cylinder):
        size = (2.0 * shape.radius, 2.0 * shape.radius, shape.length)
    elif isinstance(shape, Mesh):
        low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
        size, middle = tuple((high - low).tolist()), tuple((0.5 * (low + high)).tolist())
    else:
        raise InvalidRequest("method", type(shape).__name__, "shapes that balls are known for")
    counts = [max(1, math.ceil(side / PITCH)) for side in size]
    cells = [side / count for side, count in zip(size, counts, strict=True)]
    grown = shape.radius if isinstance(shape, Capsule) else 0.0
    radius = 0.5 * math.sqrt(math.fsum(cell * cell for cell in cells)) + grown
    lows = [m - side / 2.0 for m, side in zip(middle, size, strict=True)]
    places = product(*(range(count) for count in counts))
    centres = [
        tuple(low + cell * (k + 0.5) for low, cell, k in zip(lows, cells, place, strict=True)) for place in places
    ]
    if isinstance(shape, Mesh):  # not the corners of the box around it
        within = shape.distance(np.array(centres)) <= radius
        centres = [centre for centre, kept in zip(centres, within.tolist(), strict=True) if kept]
    yield from ((centre, radius) for centre in centres)


@dataclass(frozen=True, eq=False)
class _Lacking:
    """Points (m, n) with their poses, and for each ball too near: row, ball, shortfall (m), gradient, centre."""

    points: FloatArray
    poses: tuple[FloatArray, FloatArray]
    row: IntArray
    ball: IntArray
    metres: FloatArray
    gradient: FloatArray
    centre: FloatArray


class _Descent:
    """The current corners, and the length of the next step."""

    def __init__(
        self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int], grid: DistanceField | None
    ) -> None:
        self._problem, self.corners, self._grid = problem, corners, grid
        self._free = slice(held[0], len(corners) - held[1])
        self._balls = Balls.of(problem.checker)
        self._price, self._move = PRICES[0], FIRST_MOVE
        metric = problem.curvature(problem.samples(corners), len(corners))[self._free, self._free]
        self._inverse = _inverse(metric)
        self._targets = self._aims()
        self._merit = math.inf

    def begin(self, price: float) -> None:
        """Continue with another price."""
        self._price, self._move = price, FIRST_MOVE
        self._merit = self._worth(self._problem.samples(self.corners), self.corners)

    def advance(self) -> bool:
        """Take one step; False if none gains enough."""
        problem, corners = self._problem, self.corners
        samples = problem.samples(corners)
        slope = self._slope(samples)
        direction = summed(self._inverse[:, :, None].transpose(1, 0, 2) * slope[:, None, :])
        size = float(np.abs(direction).max())
        while self._move >= MIN_MOVE and size > 0.0:
            moved = corners.copy()
            step = direction * (self._move / size)
            moved[self._free] = np.clip(corners[self._free] - step, problem.lower, problem.upper)
            merit = self._worth(problem.samples(moved), moved)
            if merit < self._merit:
                worthwhile = self._merit - merit > SMALL_GAIN * self._merit
                self.corners, self._merit = moved, merit
                self._move = min(GROW * self._move, FIRST_MOVE)
                return worthwhile
            self._move *= SHRINK
        return False

    def _slope(self, samples: Samples) -> FloatArray:
        """The gradient of the merit by the free corners, (f, n)."""
        H = 2.0 * self._problem.curvature(samples, len(self.corners))
        smooth = np.add.accumulate(H[:, :, None] * self.corners[None], axis=1)[:, -1]
        by_point = self._pushed(self._lacking(samples, self.corners))
        weights = samples.matrix(len(self.corners))
        pushed = summed(weights[:, :, None] * by_point[:, None, :])
        return np.asarray((smooth + self._price * pushed)[self._free])

    def _aims(self) -> FloatArray:
        """The distance that each ball should keep at each point, (m, b): near the ends no more than it has there."""
        problem, balls = self._problem, self._balls
        poses = problem.checker.robot.body_poses_batch(problem.route[[0, -1]], portable=True)
        travelled = problem.length * (np.arange(problem.points) / (problem.points - 1))
        out = np.full((problem.points, len(balls.radius)), problem.aim)
        for end, far in enumerate((travelled, problem.length - travelled)):
            every = np.arange(len(balls.radius))
            centre = balls.placed(poses, np.full_like(every, end), every)
            own = math.inf if self._grid is None else self._grid.at(centre)[0] - balls.radius
            out = np.minimum(out, own + RAMP * far[:, None])
        return out

    def _lacking(self, samples: Samples, corners: FloatArray) -> _Lacking:
        problem, balls = self._problem, self._balls
        points = np.minimum(np.maximum(samples.of(corners), problem.lower), problem.upper)
        poses = problem.checker.robot.body_poses_batch(points, portable=True)
        row, ball = self._close(poses)
        centre = balls.placed(poses, row, ball)
        wanted = self._targets[row, ball] + balls.radius[ball]
        metres: FloatArray = np.zeros(0)
        gradient: FloatArray = np.zeros((0, 3))
        if self._grid is not None:
            near = self._grid.may_be_within(centre, wanted)
            row, ball, centre, wanted = row[near], ball[near], centre[near], wanted[near]
            value, gradient = self._grid.at(centre)
            metres = wanted - value
        short = metres > 0.0
        return _Lacking(points, poses, row[short], ball[short], metres[short], gradient[short], centre[short])

    def _close(self, poses: tuple[FloatArray, FloatArray]) -> tuple[IntArray, IntArray]:
        """The rows and balls of pieces that may be too near an obstacle."""
        none: IntArray = np.zeros(0, dtype=np.intp)
        whole = self._balls.whole
        if self._grid is None or whole is None:
            return none, none
        m, count = len(poses[0]), len(whole.radius)
        row, piece = np.repeat(np.arange(m), count), np.tile(np.arange(count), m)
        wanted = whole.radius[piece] + self._problem.aim
        near = self._grid.may_be_within(whole.placed(poses, row, piece), wanted).reshape(m, count)
        rows, balls = near[:, self._balls.piece].nonzero()
        return rows, balls

    def _worth(self, samples: Samples, corners: FloatArray) -> float:
        """The merit of corners: their cost, plus the squared shortfall per waypoint times the price."""
        metres = self._lacking(samples, corners).metres
        return (
            self._problem.cost(samples, corners)
            + self._price * math.fsum((metres * metres).tolist()) / self._problem.between
        )

    def _pushed(self, lacking: _Lacking) -> FloatArray:
        """The gradient of the squared shortfall by the points, (m, n): forces on balls as torques on joints."""
        problem = self._problem
        problem.gradients += len(lacking.row)
        force = lacking.gradient * (-2.0 * lacking.metres / problem.between)[:, None]
        R, t = lacking.poses
        out = np.zeros(lacking.points.shape)
        bodies = problem.checker.robot.bodies
        for index, body in enumerate(bodies[1:], 1):
            carries = np.array([index in chain_to_base(bodies, at) for at in range(len(bodies))])
            moved = carries[self._balls.body[lacking.ball]]
            rows, f = lacking.row[moved], force[moved]
            axis = summed((R[rows, index] * body.axis).transpose(2, 0, 1))
            speed = axis if body.prismatic else cross(axis, lacking.centre[moved] - t[rows, index], axis=1)
            power = speed[:, 0] * f[:, 0] + speed[:, 1] * f[:, 1] + speed[:, 2] * f[:, 2]
            out[:, body.q_index] += body.multiplier * np.bincount(rows, weights=power, minlength=len(out))
        return out


def _inverse(matrix: FloatArray) -> FloatArray:
    """The inverse of a positive definite matrix, by elimination: a library's bits would depend on the processor."""
    count = len(matrix)
    rows = np.concatenate([matrix, np.eye(count)], axis=1)
    for k in range(count):
        rows[k] /= rows[k, k]
        others = np.arange(count) != k
        rows[others] -= rows[others, k, None] * rows[k]
    return np.asarray(rows[:, count:])
