"""Boxes of joint values in which a robot collides wherever it is: its walls.

At the centre of a box two solids overlap by some depth. While the joints stay in the box, no point of one moves by more
than a bound against the other: for each joint, from the outermost inwards, half of the box's width times how far a
point can be from the axis. Where the depth is larger than the bound, every configuration of the box collides.
"""

from __future__ import annotations

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

__all__ = ["Judgement", "SolidPair", "Walls", "solid_pairs"]

ROUNDING = 1e-9
"""Relative, and far above what rounding does to a motion bound."""

Frames = tuple[FloatArray, FloatArray]
"""Orientations (m, 3, 3) and positions (m, 3)."""


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
    solids: tuple[Piece, Piece]
    moving: tuple[tuple[int, ...], tuple[int, ...]]
    columns: frozenset[int]


@dataclass(frozen=True, eq=False)
class Judgement:
    """What was found out about boxes, (m,) each.

    Attributes:
        pair: The number of a pair that overlaps all over the box; -1 where none is known to.
        hopeless: No box within can ever be shown to be a wall.
    """

    pair: IntArray
    hopeless: BoolArray


def solid_pairs(robot: Robot, listed: ProofPairs) -> list[SolidPair]:
    """The pairs of a list whose overlap is a collision wherever the robot is: those of a fixed way out are not."""
    excepted = {frozenset(names) for retreat in robot.retreats for names in retreat.pairs}
    pieces = (*listed.riding, *listed.standing)
    out = []
    for row, (a, b) in enumerate(listed.pairs[: listed.judged].tolist()):
        names, solids = listed.names(row), (pieces[a], pieces[b])
        one, two = (() if p.body == FIXED else tuple(chain_to_base(robot.bodies, p.body)) for p in solids)
        moving = tuple(k for k in one if k > 0 and k not in two), tuple(k for k in two if k > 0 and k not in one)
        columns = frozenset(robot.bodies[body].q_index for body in (*moving[0], *moving[1]))
        if columns and frozenset(names) not in excepted:
            out.append(SolidPair(names, solids, moving, columns))
    return out


class Walls:
    """Judges boxes of some joints of a robot, by the pairs that depend on no others.

    Args:
        columns: The entries of q of these joints.

    Attributes:
        pairs: Those pairs.
        asked: (box, pair) bounds so far.
    """

    def __init__(self, robot: Robot, pairs: Sequence[SolidPair], columns: Sequence[int]) -> None:
        self._robot, self._columns = robot, list(columns)
        self.pairs = [pair for pair in pairs if pair.columns <= set(columns)]
        pieces = {id(piece): piece for pair in self.pairs for piece in pair.solids}
        self._solids = {key: _Solid(piece) for key, piece in pieces.items()}
        self.asked = 0

    def reaches(self) -> list[float]:
        """How far a solid can be from the axis of each of the joints, about, in metres; 1 for one that slides."""
        far = dict.fromkeys(self._columns, 0.0)
        bodies = self._robot.bodies
        for pair in self.pairs:
            for chain, piece in zip(pair.moving, pair.solids, strict=True):
                solid = self._solids[id(piece)]
                length = solid.radius + _norm(solid.centre)
                for body in (bodies[k] for k in chain):
                    reach = abs(body.multiplier) * (1.0 if body.prismatic else length)
                    far[body.q_index] = max(far[body.q_index], reach)
                    length += _norm(body.placement[:3, 3])
        return list(far.values())

    def judged(self, centres: FloatArray, half: FloatArray) -> Judgement:
        """Judge boxes of one size.

        Args:
            centres: Their centres (m, k), in the order of the joints.
            half: Half of their widths, (k,).
        """
        Q = np.repeat(self._robot.home[None], len(centres), axis=0)
        Q[:, self._columns] = centres
        bodies = self._robot.body_poses_batch(Q, portable=True)
        travel = np.zeros(self._robot.n)
        travel[self._columns] = half * (1.0 + ROUNDING)
        wall, hopeless = np.full(len(Q), -1, dtype=np.intp), np.ones(len(Q), dtype=bool)
        placed = {key: solid.placed(*bodies) for key, solid in self._solids.items()}
        for row, pair in enumerate(self.pairs):
            motion = np.zeros(len(Q))
            for chain, piece in zip(pair.moving, pair.solids, strict=True):
                motion += self._motion(chain, self._solids[id(piece)].radius, placed[id(piece)][1], bodies, travel)
            motion *= 1.0 + ROUNDING
            first, second = (self._solids[id(piece)] for piece in pair.solids)
            depth = _depth(first, second, *(placed[id(piece)] for piece in pair.solids))
            overlap = (wall < 0) & (depth > motion + 2.0 * MARGIN)
            wall[overlap] = row
            hopeless &= depth + motion <= 0.0
        self.asked += len(self.pairs) * len(Q)
        return Judgement(wall, hopeless)

    def _motion(
        self, chain: Sequence[int], radius: float, centres: FloatArray, bodies: Frames, travel: FloatArray
    ) -> FloatArray:
        """How far points of a ball move, at most, against the body that carries all of a chain, (m,)."""
        R, p = bodies
        out = np.zeros(len(R))
        for index in chain:
            body = self._robot.bodies[index]
            way = float(travel[body.q_index]) * abs(body.multiplier)
            if body.prismatic:
                out += way
                continue
            a, b, c = _columns(_turned(R[:, index], body.axis))
            x, y, z = _columns(centres - p[:, index])
            i, j, k = y * c - z * b, z * a - x * c, x * b - y * a
            out += way * (np.sqrt(i * i + j * j + k * k) + radius + out)
        return out


class _Solid:
    """A piece: a ball around it, balls inside of it, and its frame in its body or in the world."""

    def __init__(self, piece: Piece) -> None:
        rows = np.array(piece.frame)
        self._body, self._R, self._p = piece.body, rows[:, :3], rows[:, 3]
        self.inside = inside_of(piece.shape)
        middle = _middle(piece.shape)
        self.radius = _radius(piece.shape, middle)
        self.middle = middle
        self.centre: FloatArray = self._p + _turned(self._R[None], middle)[0]

    def placed(self, R: FloatArray, p: FloatArray) -> Frames:
        """Its orientations and the centres of the ball around it, the bodies being at R (m, bodies, 3, 3) and p."""
        if self._body == FIXED:
            return np.broadcast_to(self._R, (len(R), 3, 3)), np.broadcast_to(self.centre, (len(R), 3))
        own = R[:, self._body]
        turned: FloatArray = (
            own[:, :, 0, None] * self._R[0] + own[:, :, 1, None] * self._R[1] + own[:, :, 2, None] * self._R[2]
        )
        return turned, _turned(own, self.centre) + p[:, self._body]


def _depth(first: _Solid, second: _Solid, at: Frames, other: Frames) -> FloatArray:
    """How deep two solids overlap, at least, (m,); negative where they do not, as far as is known."""
    best: FloatArray = np.full(len(at[0]), -np.inf)
    for a, b, (R, c), (S, d) in ((first, second, at, other), (second, first, other, at)):
        if b.inside.exact or a is first:  # balls in balls are the same the other way round
            for centre, radius in zip(a.inside.centres, a.inside.radii.tolist(), strict=True):
                way = _turned(R, centre - a.middle) + c - d
                np.maximum(best, radius + b.inside.depth(_turned_back(S, way) + b.middle), out=best)
    return best


def _middle(shape: Shape) -> FloatArray:
    """The middle of the box around a mesh; 0 for other shapes."""
    if not isinstance(shape, Mesh):
        return np.zeros(3)
    return np.asarray(0.5 * (shape.vertices.min(axis=0) + shape.vertices.max(axis=0)), dtype=np.float64)


def _radius(shape: Shape, middle: FloatArray) -> float:
    """Of a ball about ``middle`` that holds a shape, in metres."""
    if isinstance(shape, Mesh):
        x, y, z = (shape.vertices - middle).T
        return float(np.sqrt((x * x + y * y + z * z).max())) * (1.0 + ROUNDING)
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


def _turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R v for matrices (m, 3, 3) and a vector (3,) or vectors (m, 3)."""
    x, y, z = _columns(vectors)
    return np.asarray(R[:, :, 0] * x[..., None] + R[:, :, 1] * y[..., None] + R[:, :, 2] * z[..., None])


def _turned_back(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R^T v for matrices (m, 3, 3) and vectors (m, 3)."""
    x, y, z = _columns(vectors)
    return np.asarray(R[:, 0] * x[..., None] + R[:, 1] * y[..., None] + R[:, 2] * z[..., None])


def _norm(vector: FloatArray) -> float:
    x, y, z = vector.tolist()
    return float(np.sqrt(x * x + y * y + z * z))
