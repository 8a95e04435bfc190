"""The CHOMP family: covariant descent among looked-up distances (Zucker et al., IJRR 32(9-10), 2013).

The robot is a set of balls that hold its moving pieces; each is pushed out of the field of what stands in the scene.
The robot's own links are not kept apart here, nor is an allowed contact left alone: the checker judges the result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, FloatArray, Shape, Sphere, number, whole
from planner_service.optimize.curve import IntArray, Samples, summed
from planner_service.optimize.distance_field import DistanceField, field_of
from planner_service.optimize.method import Found
from planner_service.optimize.problem import RAMP, Task
from planner_service.robot.kinematic_tree import Body

__all__ = ["Balls", "Chomp"]

PITCH = 0.04
"""Metres between balls along each side of a piece, at most: a ball then reaches 15 mm beyond the piece, or less."""

PRICES = (100.0, 1_000.0, 10_000.0)
"""Cost of a square metre of distance lacking, in units of a straight curve; one after the other."""

FIRST_MOVE, LEAST_MOVE = 0.05, 1e-5
"""Radians by which a step moves the joint of a corner that moves most: at first, and when it is given up."""

SHRINK, GROW = 0.5, 1.3

SMALL_GAIN = 1e-4
"""Part of the merit that a step must gain for another one at this price to be worth taking."""


@dataclass(frozen=True)
class Chomp:
    """Distances of balls are looked up in a grid that is made once for a scene: a step costs next to nothing more in a
    crowd than on an empty table; but balls are larger than what they hold, and links do not see each other.

    Attributes:
        iterations: Steps at most.
        voxel: Metres between points of the grid.
    """

    iterations: int = 300
    voxel: float = 0.02

    def __post_init__(self) -> None:
        whole("iterations", self.iterations, 1, 100_000)
        number("voxel", self.voxel, "metres in [0.002, 0.1]", 0.002, 0.1)

    @property
    def name(self) -> str:
        """Lower case, as on the command line."""
        return "chomp"

    def minimise(self, task: Task, corners: FloatArray, held: tuple[int, int]) -> Found:
        """See ``Method``."""
        descent = _Descent(task, corners, held, field_of(task.checker, self.voxel))
        done = 0
        for price in PRICES:
            descent.begin(price)
            while done < self.iterations and descent.advance():
                task.checker.ledger.poll()  # looking up distances asks the checker nothing
                done += 1
        return Found(descent.corners, done)


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls that hold the moving pieces of a robot: body, centre in it and radius; (b,), (b, 3), (b,).

    ``piece`` numbers the pieces they are of, and ``whole`` are balls around whole pieces, one each; None for these.
    """

    body: IntArray
    centre: FloatArray
    radius: FloatArray
    piece: IntArray
    whole: Balls | None = None

    @classmethod
    def of(cls, checker: CollisionChecker) -> Balls:
        """Those of a checker's robot and of what it carries."""
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
        """A ball around those of a piece."""
        mine = self.piece == piece
        centre, radius = self.centre[mine], self.radius[mine]
        middle = 0.5 * (centre.min(axis=0) + centre.max(axis=0))
        away = centre - middle
        reach = np.sqrt(away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1] + away[:, 2] * away[:, 2]) + radius
        return (float(self.body[mine][0]), *middle.tolist(), float(reach.max()), float(piece))

    def placed(self, poses: tuple[FloatArray, FloatArray], row: IntArray, ball: IntArray) -> FloatArray:
        """The centres of some balls, each at one of the configurations that poses of bodies are for, (k, 3)."""
        R, t = (part[row, self.body[ball]] for part in poses)
        c = self.centre[ball]
        return np.asarray(t + (R[..., 0] * c[:, 0, None] + R[..., 1] * c[:, 1, None] + R[..., 2] * c[:, 2, None]))


def _moved(T: FloatArray, x: Sequence[float]) -> list[float]:
    return [float(T[k, 0] * x[0] + T[k, 1] * x[1] + T[k, 2] * x[2] + T[k, 3]) for k in range(3)]


def _held_by(shape: Shape) -> Iterator[tuple[tuple[float, ...], float]]:
    """Balls that hold a shape: centres in its frame, and radii."""
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
    """Points (m, n) with poses there, and of each ball too near at one: row, ball, metres lacking, gradient, centre."""

    points: FloatArray
    poses: tuple[FloatArray, FloatArray]
    row: IntArray
    ball: IntArray
    metres: FloatArray
    gradient: FloatArray
    centre: FloatArray


class _Descent:
    """Where the corners stand, and how far the next step may go."""

    def __init__(self, task: Task, corners: FloatArray, held: tuple[int, int], grid: DistanceField | None) -> None:
        self._task, self.corners, self._grid = task, corners, grid
        self._free = slice(held[0], len(corners) - held[1])
        self._balls = Balls.of(task.checker)
        self._price, self._move = PRICES[0], FIRST_MOVE
        metric = task.curvature(task.samples(corners), len(corners))[self._free, self._free]
        self._inverse = _inverse(metric)
        self._targets = self._aims()
        self._merit = math.inf

    def begin(self, price: float) -> None:
        """Go on at another price."""
        self._price, self._move = price, FIRST_MOVE
        self._merit = self._worth(self._task.samples(self.corners), self.corners)

    def advance(self) -> bool:
        """One step; False if none was worth taking."""
        task, corners = self._task, self.corners
        samples = task.samples(corners)
        slope = self._slope(samples)
        way = summed(self._inverse[:, :, None].transpose(1, 0, 2) * slope[:, None, :])
        size = float(np.abs(way).max())
        while self._move >= LEAST_MOVE and size > 0.0:
            moved = corners.copy()
            step = way * (self._move / size)
            moved[self._free] = np.clip(corners[self._free] - step, task.lower, task.upper)
            there = task.samples(moved)
            merit = self._worth(there, moved)
            if merit < self._merit:
                worthwhile = self._merit - merit > SMALL_GAIN * self._merit
                self.corners, self._merit = moved, merit
                self._move = min(GROW * self._move, FIRST_MOVE)
                return worthwhile
            self._move *= SHRINK
        return False

    def _slope(self, samples: Samples) -> FloatArray:
        """The derivative of the merit by the free corners, (f, n)."""
        H = 2.0 * self._task.curvature(samples, len(self.corners))
        smooth = np.add.accumulate(H[:, :, None] * self.corners[None], axis=1)[:, -1]
        by_point = self._pushed(self._lacking(samples, self.corners))
        weights = samples.matrix(len(self.corners))
        pushed = summed(weights[:, :, None] * by_point[:, None, :])
        return np.asarray((smooth + self._price * pushed)[self._free])

    def _aims(self) -> FloatArray:
        """The distance that each ball is to keep at each point, (m, b): near the ends no more than it has there."""
        task, balls = self._task, self._balls
        poses = task.checker.robot.body_poses_batch(task.route[[0, -1]], portable=True)
        way = task.length * (np.arange(task.points) / (task.points - 1))
        out = np.full((task.points, len(balls.radius)), task.aim)
        for end, far in enumerate((way, task.length - way)):
            every = np.arange(len(balls.radius))
            centre = balls.placed(poses, np.full_like(every, end), every)
            own = math.inf if self._grid is None else self._grid.at(centre)[0] - balls.radius
            out = np.minimum(out, own + RAMP * far[:, None])
        return out

    def _lacking(self, samples: Samples, corners: FloatArray) -> _Lacking:
        task, balls = self._task, self._balls
        points = np.minimum(np.maximum(samples.of(corners), task.lower), task.upper)
        poses = task.checker.robot.body_poses_batch(points, portable=True)
        row, ball = self._close(poses)
        centre = balls.placed(poses, row, ball)
        wanted = self._targets[row, ball] + balls.radius[ball]
        metres: FloatArray = np.zeros(0)
        gradient: FloatArray = np.zeros((0, 3))
        if self._grid is not None:
            some = self._grid.may_be_within(centre, wanted)
            row, ball, centre, wanted = row[some], ball[some], centre[some], wanted[some]
            value, gradient = self._grid.at(centre)
            metres = wanted - value
        short = metres > 0.0
        return _Lacking(points, poses, row[short], ball[short], metres[short], gradient[short], centre[short])

    def _close(self, poses: tuple[FloatArray, FloatArray]) -> tuple[IntArray, IntArray]:
        """Rows and balls of pieces that may be too near something there."""
        none: IntArray = np.zeros(0, dtype=np.intp)
        whole = self._balls.whole
        if self._grid is None or whole is None:
            return none, none
        m, count = len(poses[0]), len(whole.radius)
        row, piece = np.repeat(np.arange(m), count), np.tile(np.arange(count), m)
        wanted = whole.radius[piece] + self._task.aim
        near = self._grid.may_be_within(whole.placed(poses, row, piece), wanted).reshape(m, count)
        rows, balls = near[:, self._balls.piece].nonzero()
        return rows, balls

    def _worth(self, samples: Samples, corners: FloatArray) -> float:
        """The merit of corners: their cost, and for each waypoint the squares of the distances lacking."""
        metres = self._lacking(samples, corners).metres
        return (
            self._task.cost(samples, corners) + self._price * math.fsum((metres * metres).tolist()) / self._task.between
        )

    def _pushed(self, lacking: _Lacking) -> FloatArray:
        """The derivative of the squares lacking by the points, (m, n): what forces on balls are by joints."""
        task = self._task
        task.gradients += len(lacking.row)
        force = lacking.gradient * (-2.0 * lacking.metres / task.between)[:, None]
        R, t = lacking.poses
        out = np.zeros(lacking.points.shape)
        bodies = task.checker.robot.bodies
        for index, body in enumerate(bodies[1:], 1):
            carries = np.array([index in _chain(bodies, at) for at in range(len(bodies))])
            moved = carries[self._balls.body[lacking.ball]]
            rows, f = lacking.row[moved], force[moved]
            axis = summed((R[rows, index] * body.axis).transpose(2, 0, 1))
            speed = axis if body.prismatic else _cross(axis, lacking.centre[moved] - t[rows, index])
            power = speed[:, 0] * f[:, 0] + speed[:, 1] * f[:, 1] + speed[:, 2] * f[:, 2]
            out[:, body.q_index] += np.bincount(rows, weights=power, minlength=len(out))
        return out


def _chain(bodies: Sequence[Body], index: int) -> set[int]:
    """A body and those that carry it."""
    found = set()
    while index > 0:
        found.add(index)
        index = bodies[index].parent
    return found


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def _inverse(matrix: FloatArray) -> FloatArray:
    """Of a positive definite matrix, by elimination: without a library whose bits depend on the processor."""
    count = len(matrix)
    rows = np.concatenate([matrix, np.eye(count)], axis=1)
    for k in range(count):
        rows[k] /= rows[k, k]
        others = np.arange(count) != k
        rows[others] -= rows[others, k, None] * rows[k]
    return np.asarray(rows[:, count:])
