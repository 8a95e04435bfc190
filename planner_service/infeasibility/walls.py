"""Boxes of joint values in which a robot collides wherever it is: its walls.

At the centre of a box a ball inside of one solid reaches into another one by some depth. While the joints stay in the
box, the centre of the ball does not move by more than a bound against the other solid: for each joint, from the
outermost inwards, half of the box's width times the distance from the axis, and never more than twice this distance.
Where the depth is larger than the bound, every configuration of the box collides. A joint that the box says nothing
about may be anywhere in its range; that costs little where the ball lies on its axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.certify import MARGIN
from planner_service.certify.pairs import FIXED, Piece, ProofPairs
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere
from planner_service.infeasibility.depth import inside_of
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot

__all__ = ["Judgement", "SolidPair", "Walls", "Witness", "solid_pairs"]

ROUNDING = 1e-9
"""Relative, and far above what rounding does to a motion bound."""

CHORD = 2.0
"""Times the distance from an axis: no turn moves a point farther."""

Frames = tuple[FloatArray, FloatArray]
"""Orientations (m, 3, 3) and positions (m, 3), or those of all bodies, (m, bodies, ...)."""


@dataclass(frozen=True, eq=False)
class SolidPair:
    """Two convex solids that must be apart.

    Attributes:
        names: Of their owners.
        solids: The two; the second may stand in the world.
        moving: For each of the two the bodies that move it against the other, its own first.
        columns: The entries of q on which their relative pose depends.
    """

    names: tuple[str, str]
    solids: tuple[_Solid, _Solid]
    moving: tuple[tuple[int, ...], tuple[int, ...]]
    columns: frozenset[int]


@dataclass(frozen=True, eq=False)
class Judgement:
    """What was found out about m boxes.

    Attributes:
        pair: The number of a pair that overlaps all over the box, (m,); -1 where none is known to.
        doubtful: Of each pair whether it may be shown to overlap in some box within, (m, pairs).
    """

    pair: IntArray
    doubtful: BoolArray


@dataclass(frozen=True, eq=False)
class Witness:
    """What shows that boxes are walls: a point of each of the two solids, and how deep it lies in it.

    Attributes:
        centres: (m, 2, 3), in the frame of the body that each solid is fixed to, or of the world.
        depths: (m, 2), at least; of the second, negative where the point is outside by no more than that.
    """

    centres: FloatArray
    depths: FloatArray


def solid_pairs(robot: Robot, listed: ProofPairs) -> list[SolidPair]:
    """The pairs of a list whose overlap is a collision wherever the robot is: those of a fixed way out are not."""
    excepted = {frozenset(names) for retreat in robot.retreats for names in retreat.pairs}
    solids = [_Solid(piece) for piece in (*listed.riding, *listed.standing)]
    chains = [() if s.body == FIXED else tuple(chain_to_base(robot.bodies, s.body)) for s in solids]
    out = []
    for row, (a, b) in enumerate(listed.pairs[: listed.judged].tolist()):
        names, one, two = listed.names(row), chains[a], chains[b]
        moving = tuple(k for k in one if k > 0 and k not in two), tuple(k for k in two if k > 0 and k not in one)
        columns = frozenset(robot.bodies[body].q_index for body in (*moving[0], *moving[1]))
        if columns and frozenset(names) not in excepted:
            out.append(SolidPair(names, (solids[a], solids[b]), moving, columns))
    return out


class Walls:
    """Judges boxes of some joints of a robot, by the pairs that can overlap whatever the other joints do.

    Attributes:
        columns: The entries of q of these joints.
        pairs: Those pairs.
        asked: (box, pair) bounds so far.
    """

    def __init__(self, robot: Robot, pairs: Sequence[SolidPair], columns: Sequence[int]) -> None:
        self._robot, self.columns = robot, tuple(columns)
        lower, upper = robot.bounds
        self._middle = np.where(np.isfinite(lower + upper), 0.5 * (lower + upper), 0.0)
        self._free = 0.5 * (upper - lower) * (1.0 + ROUNDING)
        self._free[list(self.columns)] = 0.0
        here = robot.body_poses_batch(self._middle[None], portable=True)
        self.pairs: list[SolidPair] = []
        self._overlaps: list[tuple[_Overlap, ...]] = []
        for pair in pairs:
            if pair.columns & set(self.columns) and self._outermost(pair):
                found = self._balls(pair, here)
                if found:
                    self.pairs.append(pair)
                    self._overlaps.append(found)
        self.asked = 0

    def _balls(self, pair: SolidPair, here: Frames) -> tuple[_Overlap, ...]:
        """The balls of a pair's solids that other joints do not move too far, and what they reach into."""
        out, (first, second) = [], pair.solids
        for solid, other, turned in ((first, second, False), (second, first, True)):
            if turned and not other.inside.exact:  # balls in balls are the same the other way round
                continue
            own, against = pair.moving[::-1] if turned else pair.moving
            points = solid.points(here)
            moved = self._motion(own, points, here, self._free[None])
            moved += self._motion(against, points, here, self._free[None])
            kept = moved[0] < solid.inside.radii + other.inside.radii.max(initial=-math.inf)
            if kept.any():
                out.append(_Overlap(solid, other, own, against, solid.centres[kept], solid.inside.radii[kept]))
        return tuple(out)

    def _outermost(self, pair: SolidPair) -> bool:
        """Whether no joint of a box comes after one that is free to move: then it moves the solid always alike."""
        bodies = self._robot.bodies
        for chain in pair.moving:
            boxed = [bodies[body].q_index in self.columns for body in chain]
            if boxed != sorted(boxed):
                return False
        return True

    def reaches(self) -> list[float]:
        """How far a solid can be from the axis of each of the joints, about, in metres; 1 for one that slides."""
        far = dict.fromkeys(self.columns, 0.0)
        bodies = self._robot.bodies
        for pair in self.pairs:
            for chain, solid in zip(pair.moving, pair.solids, strict=True):
                length = solid.radius + _norm(solid.middle)
                for body in (bodies[k] for k in chain):
                    reach = abs(body.multiplier) * (1.0 if body.prismatic else length)
                    if body.q_index in far:
                        far[body.q_index] = max(far[body.q_index], reach)
                    length += _norm(body.placement[:3, 3])
        return list(far.values())

    def judged(self, centres: FloatArray, half: FloatArray, doubtful: BoolArray | None = None) -> Judgement:
        """Judge boxes.

        Args:
            centres: Their centres (m, k), in the order of the joints.
            half: Half of their widths, (m, k).
            doubtful: The pairs that were in a box around each, (m, pairs); all if None.
        """
        bodies, travel = self._placed(centres, half)
        wall = np.full(len(centres), -1, dtype=np.intp)
        left = np.ones((len(centres), len(self.pairs)), dtype=np.bool_) if doubtful is None else doubtful.copy()
        self.asked += int(left.sum())
        for row, overlaps in enumerate(self._overlaps):
            asked = np.flatnonzero((wall < 0) & left[:, row])
            rows = asked[self._may_touch(overlaps[0], _of(bodies, asked), travel[asked])]
            left[asked, row] = False
            at = _of(bodies, rows)
            for overlap in overlaps if len(rows) else ():
                depth, motion = self._depth(overlap, at, travel[rows])
                wall[rows[(depth - motion).max(axis=-1) > 2.0 * MARGIN]] = row
                left[rows, row] |= (depth + motion).max(axis=-1) > 0.0
        return Judgement(wall, left)

    def witness(self, centres: FloatArray, half: FloatArray, pair: IntArray) -> Witness:
        """What shows that boxes are walls, each by the pair (m,) that it was judged to be."""
        bodies, travel = self._placed(centres, half)
        out = Witness(np.zeros((len(centres), 2, 3)), np.zeros((len(centres), 2)))
        for row in np.unique(pair).tolist():
            best = np.full(len(centres), -math.inf)
            rows = np.flatnonzero(pair == row)
            at = _of(bodies, rows)
            for overlap in self._overlaps[row]:
                depth, motion = self._depth(overlap, at, travel[rows])
                ball = (depth - motion).argmax(axis=-1)
                sure = (depth - motion)[np.arange(len(rows)), ball]
                better = sure > best[rows]
                best[rows[better]] = sure[better]
                order = [1, 0] if overlap.solid is self.pairs[row].solids[1] else [0, 1]
                found = overlap.witness(_of(at, better), ball[better])
                out.centres[rows[better]] = found.centres[:, order]
                out.depths[rows[better]] = found.depths[:, order]
        return out

    def _placed(self, centres: FloatArray, half: FloatArray) -> tuple[Frames, FloatArray]:
        """Where bodies are at the centres of boxes, and how far each entry of q may be from there, (m, n)."""
        Q = np.repeat(self._middle[None], len(centres), axis=0)
        Q[:, list(self.columns)] = centres
        travel = np.repeat(self._free[None], len(centres), axis=0)
        travel[:, list(self.columns)] = half * (1.0 + ROUNDING)
        return self._robot.body_poses_batch(Q, portable=True), travel

    def _may_touch(self, overlap: _Overlap, bodies: Frames, travel: FloatArray) -> BoolArray:
        """Where in a box the balls around two solids may overlap, (m,)."""
        first, second = (each.around(bodies) for each in (overlap.solid, overlap.other))
        motion = self._motion(overlap.own, first, bodies, travel)
        motion += self._motion(overlap.against, second, bodies, travel)
        apart = _length(first - second) - overlap.solid.radius - overlap.other.radius
        return np.asarray((motion - apart)[:, 0] > 0.0)

    def _depth(self, overlap: _Overlap, bodies: Frames, travel: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How deep balls reach into a solid, at least, and how far they move against it, at most, (m, balls) each."""
        points = _carried(overlap.solid.body, overlap.centres, bodies)
        depth = overlap.radii + overlap.other.depth(points, bodies)
        motion = self._motion(overlap.own, points, bodies, travel)
        if overlap.against:
            beside = overlap.other.beside(points, bodies)
            motion += self._motion(overlap.against, points, bodies, travel, beside=beside)
        return depth, motion * (1.0 + ROUNDING)

    def _motion(
        self,
        chain: Sequence[int],
        points: FloatArray,
        bodies: Frames,
        travel: FloatArray,
        beside: FloatArray | float = 0.0,
    ) -> FloatArray:
        """How far points (m, b, 3) move, at most, with a chain of bodies against the one that carries them, (m, b).

        Args:
            beside: How far the points that are meant are from these, at most.
        """
        R, p = bodies
        out = np.zeros(points.shape[:2])
        for index in chain:
            body = self._robot.bodies[index]
            way = travel[:, body.q_index, None] * abs(body.multiplier)
            if body.prismatic:
                out += way
                continue
            a, b, c = (v[:, None] for v in _columns(_turned(R[:, index], body.axis)))
            x, y, z = _columns(points - p[:, None, index])
            i, j, k = y * c - z * b, z * a - x * c, x * b - y * a
            out += np.minimum(way, CHORD) * (np.sqrt(i * i + j * j + k * k) + beside + out)
        return out


class _Solid:
    """A piece: a ball around it, balls inside of it, all in the frame of its body or of the world."""

    def __init__(self, piece: Piece) -> None:
        rows = np.array(piece.frame)
        self.body, self._R, self._p = piece.body, rows[:, :3], rows[:, 3]
        self.inside = inside_of(piece.shape)
        middle = _middle(piece.shape)
        self.radius = _radius(piece.shape, middle)
        self.middle = self._in_body(middle[None])[0]
        self.centres = self._in_body(self.inside.centres)

    def _in_body(self, points: FloatArray) -> FloatArray:
        return np.asarray(_turned(self._R[None], points) + self._p)

    def points(self, bodies: Frames) -> FloatArray:
        """The centres of its balls, (m, b, 3)."""
        return _carried(self.body, self.centres, bodies)

    def around(self, bodies: Frames) -> FloatArray:
        """The centre of the ball around it, (m, 1, 3)."""
        return _carried(self.body, self.middle[None], bodies)

    def own(self, points: FloatArray, bodies: Frames) -> FloatArray:
        """Points (m, b, 3) of the world in the frame of its body."""
        if self.body == FIXED:
            return points
        R, p = bodies[0][:, self.body], bodies[1][:, self.body]
        return _turned_back(R[:, None], points - p[:, None])

    def depth(self, points: FloatArray, bodies: Frames) -> FloatArray:
        """At least how deep points (m, b, 3) of the world lie in it; outside, minus at least the distance."""
        return self.inside.depth(_turned_back(self._R[None, None], self.own(points, bodies) - self._p))

    def beside(self, points: FloatArray, bodies: Frames) -> FloatArray | float:
        """How far the centre of the ball that tells the depth of points is from them; 0 if the depth is exact."""
        if self.inside.exact:
            return 0.0
        return _length(self.deepest(self.own(points, bodies))[0] - self.own(points, bodies))

    def deepest(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """For points (..., 3) in the frame of its body, a point inside it near each, and how deep that one lies."""
        if self.inside.exact:
            return points, self.inside.depth(_turned_back(self._R[None, None], points - self._p))
        depths = self.inside.radii - _length(points[..., None, :] - self.centres)
        ball = depths.argmax(axis=-1)
        return self.centres[ball], self.inside.radii[ball]


@dataclass(frozen=True, eq=False)
class _Overlap:
    """Balls of one solid that may reach into another.

    Attributes:
        own, against: The bodies that move the solid, and the other one, against each other; outermost first.
        centres, radii: Of the balls, (b, 3) in the frame of their body and (b,).
    """

    solid: _Solid
    other: _Solid
    own: tuple[int, ...]
    against: tuple[int, ...]
    centres: FloatArray
    radii: FloatArray

    def witness(self, bodies: Frames, ball: IntArray) -> Witness:
        """The chosen balls (m,), and what they reach into."""
        centres = self.centres[ball]
        points = _carried(self.solid.body, self.centres, bodies)[np.arange(len(ball)), ball]
        second, depth = self.other.deepest(self.other.own(points[:, None], bodies))
        return Witness(np.stack([centres, second[:, 0]], axis=1), np.stack([self.radii[ball], depth[:, 0]], axis=1))


def _of(bodies: Frames, rows: IntArray | BoolArray) -> Frames:
    return bodies[0][rows], bodies[1][rows]


def _carried(body: int, points: FloatArray, bodies: Frames) -> FloatArray:
    """Points (b, 3) of a body in the world, (m, b, 3)."""
    if body == FIXED:
        return np.broadcast_to(points, (len(bodies[0]), *points.shape))
    return np.asarray(_turned(bodies[0][:, None, body], points) + bodies[1][:, None, body])


def _middle(shape: Shape) -> FloatArray:
    """The middle of the box around a mesh; 0 for other shapes."""
    if not isinstance(shape, Mesh):
        return np.zeros(3)
    return np.asarray(0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)), dtype=np.float64)


def _radius(shape: Shape, middle: FloatArray) -> float:
    """Of a ball about ``middle`` that holds a shape, in metres."""
    if isinstance(shape, Mesh):
        return float(_length(shape.vertices - middle).max()) * (1.0 + ROUNDING)
    if isinstance(shape, Sphere):
        return shape.radius
    if isinstance(shape, Capsule):
        return shape.radius + shape.length / 2.0
    if isinstance(shape, Cylinder):
        return float(np.hypot(shape.radius, shape.length / 2.0)) * (1.0 + ROUNDING)
    assert isinstance(shape, Box)
    return _norm(np.array(shape.half)) * (1.0 + ROUNDING)


def _columns(vectors: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    return vectors[..., 0], vectors[..., 1], vectors[..., 2]


def _length(vectors: FloatArray) -> FloatArray:
    x, y, z = _columns(vectors)
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R v for matrices (..., 3, 3) and vectors (..., 3)."""
    x, y, z = _columns(vectors)
    return np.asarray(R[..., 0] * x[..., None] + R[..., 1] * y[..., None] + R[..., 2] * z[..., None])


def _turned_back(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R^T v for matrices (..., 3, 3) and vectors (..., 3)."""
    x, y, z = _columns(vectors)
    return np.asarray(R[..., 0, :] * x[..., None] + R[..., 1, :] * y[..., None] + R[..., 2, :] * z[..., None])


def _norm(vector: FloatArray) -> float:
    return float(_length(vector))
