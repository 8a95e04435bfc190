"""Moving bodies and their forward kinematics, for one configuration or many.

A body is everything that moves as one: the links between two joints. ``BodyTree`` computes poses in one fixed order of
operations, so that a pose has the same bits alone and in a batch, and whatever BLAS is installed: collision verdicts
depend on these bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import (
    FloatArray,
    Vector,
    axis_matrix,
    cosines_and_sines,
    read_only,
    set_fields,
)
from planner_service.geometry.shapes import Pose, Shape
from planner_service.geometry.validation import numbers

__all__ = [
    "MAX_MULTIPLIER",
    "MIN_MULTIPLIER",
    "Body",
    "BodyPose",
    "BodyTree",
    "LinkFrame",
    "LinkShape",
    "body_matrix",
    "chain_to_base",
    "joint_motion",
]

MIN_MULTIPLIER, MAX_MULTIPLIER = 1e-6, 1e3
"""Sizes of a multiplier: beyond these it is a mistake."""

BodyPose = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
"""r00, r01, r02, r10, ..., r22, x, y, z."""

IDENTITY: BodyPose = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

PRISMATIC = 3
"""Kind of a step that slides; steps of kind 0, 1, 2 turn about x, y, z."""


@dataclass(frozen=True, eq=False)
class Body:
    """One moving body.

    Attributes:
        name: The joint that moves it; "base" for the fixed one.
        parent: Index of the body that carries it; -1 for the base.
        placement: 4 x 4 T_parent_joint at q = 0. The body's frame is that joint frame, moved by q along or about
            ``axis``.
        axis: Unit vector in the joint frame.
        prismatic: It slides by q metres instead of turning by q radians.
        q_index: The entry of q that moves it; -1 for the base. Several bodies may have the same one: the body of a
            joint of q, and those of the joints that mimic it.
        multiplier: It moves by this times the entry of q; 1 unless its joint mimics another.
    """

    name: str
    parent: int
    placement: FloatArray
    axis: FloatArray
    prismatic: bool
    q_index: int
    multiplier: float = 1.0

    def __post_init__(self) -> None:
        set_fields(self, placement=read_only(self.placement), axis=read_only(self.axis))


def body_matrix(pose: BodyPose) -> FloatArray:
    """The pose of a body as a matrix (4, 4)."""
    a, b, c, d, e, f, g, h, i, x, y, z = pose
    return np.array([[a, b, c, x], [d, e, f, y], [g, h, i, z], [0.0, 0.0, 0.0, 1.0]])


def chain_to_base(bodies: Sequence[Body], index: int) -> list[int]:
    """The body at ``index`` and those that carry it, in this order, without the fixed base."""
    chain = []
    while index > 0:
        chain.append(index)
        index = bodies[index].parent
    return chain


def joint_motion(axis: Vector, position: float, *, slides: bool) -> FloatArray:
    """4 x 4 T_joint_body at a position: a slide along the axis, or a turn about it."""
    T = np.eye(4)
    if slides:
        T[:3, 3] = np.array(axis) * position
    else:
        T[:3, :3] = axis_matrix(axis, position)
    return T


@dataclass(frozen=True)
class LinkShape:
    """A collision shape of URDF link ``link``; ``pose`` is T_body_shape."""

    link: str
    body: int
    shape: Shape
    pose: Pose


@dataclass(frozen=True)
class LinkFrame:
    """The frame of URDF link ``link``; ``pose`` is T_body_link."""

    link: str
    body: int
    pose: Pose


Matrix = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True)
class _Step:
    """The motion of one body: an optional fixed rotation, a motion along or about an axis, another rotation."""

    parent: int
    q_index: int
    kind: int
    sign: float
    offset: tuple[float, float, float]
    slide: tuple[float, float, float]
    before: Matrix | None
    after: Matrix | None
    multiplier: float

    def row(self) -> list[float]:
        """All fields in a row of 31 numbers; a 1 comes before each rotation, and 0 in place of none."""
        before, after = ([0.0] * 10 if matrix is None else [1.0, *matrix] for matrix in (self.before, self.after))
        return [
            self.parent,
            self.q_index,
            self.kind,
            self.sign,
            *self.offset,
            *self.slide,
            *before,
            *after,
            self.multiplier,
        ]


class BodyTree:
    """Poses of the bodies of one robot.

    Args:
        bodies: Parents before children; the first is the fixed base.

    Attributes:
        table: What compiled code needs to compute the same bits, a row of 31 numbers for each body but the base.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self._steps = tuple(_step(body) for body in bodies[1:])
        self._plain = tuple(
            (s.parent, s.q_index, s.multiplier, s.kind, s.sign, *s.offset, s.before, s.after, s.slide)
            for s in self._steps
        )
        self._n = 1 + max((step.q_index for step in self._steps), default=-1)
        self._columns = np.array([step.q_index for step in self._steps], dtype=np.intp)
        self._multipliers = read_only([step.multiplier for step in self._steps])
        self._offsets = read_only([step.offset for step in self._steps]).reshape(-1, 3).T[:, :, None, None]
        self._slides = read_only([step.slide for step in self._steps]).reshape(-1, 3)[:, :, None, None, None]
        self.table = read_only([step.row() for step in self._steps]).reshape(-1, 31)
        parents = [step.parent for step in self._steps]
        self._parents = slice(0, -1) if parents == list(range(len(parents))) else parents

    def poses(self, q: Sequence[float] | FloatArray) -> list[BodyPose]:
        """Pose of every body in the world, by scalar arithmetic; q must be finite."""
        values: Sequence[float] = q.tolist() if isinstance(q, np.ndarray) else q
        if len(values) != self._n:
            raise InvalidRequest("q", values, f"{self._n} numbers")
        sin, cos = math.sin, math.cos
        out = [IDENTITY]
        for parent, q_index, multiplier, kind, sign, x, y, z, before, after, slide in self._plain:
            a, b, c, d, e, f, g, h, i, px, py, pz = out[parent]
            px += a * x + b * y + c * z
            py += d * x + e * y + f * z
            pz += g * x + h * y + i * z
            if before is not None:
                a, b, c, d, e, f, g, h, i = _times((a, b, c, d, e, f, g, h, i), before)
            angle = multiplier * values[q_index]
            if kind == PRISMATIC:
                u, v, w = slide
                px += (a * u + b * v + c * w) * angle
                py += (d * u + e * v + f * w) * angle
                pz += (g * u + h * v + i * w) * angle
            else:
                s = sign * sin(angle)
                k = cos(angle)
                if kind == 1:
                    a, c = a * k - c * s, c * k + a * s
                    d, f = d * k - f * s, f * k + d * s
                    g, i = g * k - i * s, i * k + g * s
                elif kind == 2:
                    a, b = a * k + b * s, b * k - a * s
                    d, e = d * k + e * s, e * k - d * s
                    g, h = g * k + h * s, h * k - g * s
                else:
                    b, c = b * k + c * s, c * k - b * s
                    e, f = e * k + f * s, f * k - e * s
                    h, i = h * k + i * s, i * k - h * s
                if after is not None:
                    a, b, c, d, e, f, g, h, i = _times((a, b, c, d, e, f, g, h, i), after)
            out.append((a, b, c, d, e, f, g, h, i, px, py, pz))
        return out

    def poses_batch(self, Q: ArrayLike, *, portable: bool = False) -> tuple[FloatArray, FloatArray]:
        """Rotations (m, bodies, 3, 3) and positions (m, bodies, 3) for configurations (m, n), bit for bit as ``poses``.

        Args:
            portable: Give the same bits on every processor instead; used to construct paths.
        """
        q = numbers("Q", Q, f"configurations of shape (m, {self._n})")
        if q.ndim != 2 or q.shape[1] != self._n:
            raise InvalidRequest("Q", q.shape, f"configurations of shape (m, {self._n})")
        m, count = q.shape[0], len(self._steps)
        moved = q.T[self._columns] * self._multipliers[:, None]
        turns = np.empty((count, 2, 1, 1, m))
        if portable:
            cosines, sines = cosines_and_sines(moved.ravel())
        else:
            # math's sine and not numpy's, which picks its own by instruction set
            angles = moved.ravel().tolist()
            cosines, sines = (np.fromiter(map(f, angles), np.float64, len(angles)) for f in (math.cos, math.sin))
        turns[:, 0], turns[:, 1] = cosines.reshape(count, 1, 1, m), sines.reshape(count, 1, 1, m)
        out = np.empty((count + 1, 4, 3, m))  # body, column of T, row of T, configuration
        out[0] = BASE
        for frames, step, turn in zip(out[1:], self._steps, turns, strict=True):
            columns = out[step.parent] if step.before is None else _turned(out[step.parent], step.before)
            if step.kind == PRISMATIC:
                frames[:3] = columns[:3]
            else:
                _spin(columns, step, turn, frames)
        moves = _combination(out[self._parents], self._offsets)
        for frames, step, move, slide, way in zip(out[1:], self._steps, moves, self._slides, moved, strict=True):
            np.add(out[step.parent, 3], move, out=frames[3])
            if step.kind == PRISMATIC:
                frames[3] += _combination(frames[None], slide)[0] * way
        return out[:, :3].transpose(3, 0, 2, 1), out[:, 3].transpose(2, 0, 1)


BASE = np.eye(4, 3)[:, :, None]
PLANES = (slice(1, 3), slice(2, None, -2), slice(0, 2))
"""The two columns that a turn about x, y, z mixes, in right-handed order: (y, z), (z, x), (x, y)."""


def _spin(columns: FloatArray, step: _Step, turn: FloatArray, here: FloatArray) -> None:
    """Turn columns about a coordinate axis; ``turn`` holds cosines and sines."""
    plane = PLANES[step.kind]
    (u_cos, w_cos), (u_sin, w_sin) = columns[:3][plane] * turn
    first, second = here[:3][plane]
    if step.sign > 0:
        np.add(u_cos, w_sin, out=first)
        np.subtract(w_cos, u_sin, out=second)
    else:
        np.subtract(u_cos, w_sin, out=first)
        np.add(w_cos, u_sin, out=second)
    here[step.kind] = columns[step.kind]
    if step.after is not None:
        here[:3] = _turned(here, step.after)


def _combination(frames: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted columns of frames (k, 4, 3, m), added left to right; weights (3, k, 1, 1)."""
    total: FloatArray = frames[:, 0] * weights[0]
    total += frames[:, 1] * weights[1]
    total += frames[:, 2] * weights[2]
    return total


def _turned(columns: FloatArray, matrix: Matrix) -> FloatArray:
    a, b, c = columns[0], columns[1], columns[2]
    return np.stack([a * matrix[j] + b * matrix[3 + j] + c * matrix[6 + j] for j in range(3)])


def _times(left: Matrix, right: Matrix) -> Matrix:
    a, b, c, d, e, f, g, h, i = left
    j, k, m, n, o, p, r, s, t = right
    return (
        a * j + b * n + c * r, a * k + b * o + c * s, a * m + b * p + c * t,
        d * j + e * n + f * r, d * k + e * o + f * s, d * m + e * p + f * t,
        g * j + h * n + i * r, g * k + h * o + i * s, g * m + h * p + i * t,
    )  # fmt: skip


UNIT_MATRIX: Matrix = IDENTITY[:9]


def _step(body: Body) -> _Step:
    rotation: Matrix = tuple(body.placement[:3, :3].ravel().tolist())  # type: ignore[assignment]
    offset = tuple(body.placement[:3, 3].tolist())
    axis = body.axis.tolist()
    kind, sign, after = 2, 1.0, None
    if body.prismatic:
        kind = PRISMATIC
    elif sorted(abs(v) for v in axis) == [0.0, 0.0, 1.0]:
        kind = max(range(3), key=lambda k: abs(axis[k]))
        sign = axis[kind]
    else:  # an oblique axis: turn it onto z, turn about z, turn back
        onto = _onto_z(axis)
        rotation = _times(rotation, onto)
        after = (onto[0], onto[3], onto[6], onto[1], onto[4], onto[7], onto[2], onto[5], onto[8])
    before = None if rotation == UNIT_MATRIX else rotation
    slide = (axis[0], axis[1], axis[2])
    return _Step(body.parent, body.q_index, kind, sign, offset, slide, before, after, float(body.multiplier))


def _onto_z(axis: Sequence[float]) -> Matrix:
    """A rotation whose third column is ``axis``."""
    x, y, z = axis
    smallest = min(range(3), key=lambda k: abs(axis[k]))
    helper = [1.0 if k == smallest else 0.0 for k in range(3)]
    ux, uy, uz = helper[1] * z - helper[2] * y, helper[2] * x - helper[0] * z, helper[0] * y - helper[1] * x
    norm = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / norm, uy / norm, uz / norm
    vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    return (ux, vx, x, uy, vy, y, uz, vz, z)
