"""Moving bodies and their forward kinematics, for one configuration or many.

A body is everything that moves as one: the links between two joints. Compiled code computes their poses in one fixed
order of operations, so that a pose has the same bits alone and in a batch: collision verdicts depend on these bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import (
    FloatArray,
    Vector,
    axis_matrix,
    read_only,
    set_fields,
)
from planner_service.geometry.shapes import Pose, Shape
from planner_service.geometry.validation import numbers
from planner_service.native.loading import load_core

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

PRISMATIC = 3
"""Kind of a step that slides; steps of kind 0, 1, 2 turn about x, y, z."""

REAL = "fiub"
"""Kinds of numpy's real numbers."""


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


class BodyTree:
    """Poses of the bodies of one robot.

    Args:
        bodies: Parents before children; the first is the fixed base.

    Attributes:
        table: What compiled code needs to compute the same bits, a row of 31 numbers for each body but the base.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self._n = 1 + max((body.q_index for body in bodies[1:]), default=-1)
        self.table = read_only([_row(body) for body in bodies[1:]]).reshape(-1, 31)

    def poses(self, q: Sequence[float] | FloatArray) -> list[BodyPose]:
        """Pose of every body in the world; q must be finite."""
        plain = type(q) in (list, tuple) and len(q) == self._n and PLAIN.issuperset(map(type, q))
        values = np.asarray(q if plain or type(q) is np.ndarray else numbers("q", q, f"{self._n} numbers"))
        if values.shape != (self._n,) or values.dtype.kind not in REAL:
            raise InvalidRequest("q", q, f"{self._n} numbers")
        core: Any = load_core()
        return list(map(tuple, core.body_poses(self.table, np.ascontiguousarray(values, np.float64)).tolist()))

    def poses_batch(self, Q: ArrayLike, *, portable: bool = False) -> tuple[FloatArray, FloatArray]:
        """Rotations (m, bodies, 3, 3) and positions (m, bodies, 3) for configurations (m, n), bit for bit as ``poses``.

        Args:
            portable: Give the same bits on every processor instead; used to construct paths.
        """
        q = numbers("Q", Q, f"configurations of shape (m, {self._n})")
        if q.ndim != 2 or q.shape[1] != self._n:
            raise InvalidRequest("Q", q.shape, f"configurations of shape (m, {self._n})")
        core: Any = load_core()
        out = core.body_poses_batch(self.table, np.ascontiguousarray(q), portable)
        return out[:, :3].transpose(3, 0, 2, 1), out[:, 3].transpose(2, 0, 1)


def _times(left: Matrix, right: Matrix) -> Matrix:
    a, b, c, d, e, f, g, h, i = left
    j, k, m, n, o, p, r, s, t = right
    return (
        a * j + b * n + c * r, a * k + b * o + c * s, a * m + b * p + c * t,
        d * j + e * n + f * r, d * k + e * o + f * s, d * m + e * p + f * t,
        g * j + h * n + i * r, g * k + h * o + i * s, g * m + h * p + i * t,
    )  # fmt: skip


PLAIN = frozenset({float, int})
"""What takes no closer look: an object of another type may be of any length."""

UNIT_MATRIX: Matrix = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def _row(body: Body) -> list[float]:
    """The motion of a body for compiled code: a fixed rotation, a motion along or about an axis, another rotation.

    In this order: its parent, its entry of q, the kind and the sign of its motion, its offset in the parent, the way it
    slides, both rotations (each 1 and nine entries, or ten 0 for none), and the multiplier.
    """
    before: Matrix = tuple(body.placement[:3, :3].ravel().tolist())  # type: ignore[assignment]
    axis = body.axis.tolist()
    kind, sign, after = 2, 1.0, UNIT_MATRIX
    if body.prismatic:
        kind = PRISMATIC
    elif sorted(abs(v) for v in axis) == [0.0, 0.0, 1.0]:
        kind = max(range(3), key=lambda k: abs(axis[k]))
        sign = axis[kind]
    else:  # an oblique axis: turn it onto z, turn about z, turn back
        onto = _onto_z(axis)
        before = _times(before, onto)
        after = (onto[0], onto[3], onto[6], onto[1], onto[4], onto[7], onto[2], onto[5], onto[8])
    turns = [[0.0] * 10 if matrix == UNIT_MATRIX else [1.0, *matrix] for matrix in (before, after)]
    offset = body.placement[:3, 3].tolist()
    return [body.parent, body.q_index, kind, sign, *offset, *axis, *turns[0], *turns[1], float(body.multiplier)]


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
