"""Poses and convex shapes: what robots and scenes are made of.

Lengths in metres, quaternions as (w, x, y, z). Every shape is convex and centred on its own origin; cylinders and
capsules lie along local z. All shapes have the same few methods (``support``, ``distance``, ``grown``), on which the
collision checker and its bounds are built.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, cross_of, dot, rpy_matrix, set_fields
from planner_service.geometry.validation import MAX_LENGTH, finite_tuple, margin_of, number, numbers, points_of, vectors

__all__ = ["Box", "Capsule", "Cylinder", "Pose", "Shape", "Sphere"]


def _length(field: str, value: Any) -> float:
    return number(field, value, f"a positive length up to {MAX_LENGTH:g} m", math.ulp(0.0), MAX_LENGTH)


@dataclass(frozen=True)
class Pose:
    """The pose of one frame in another: position in metres, orientation as a unit quaternion (w, x, y, z).

    Raises:
        InvalidRequest: a number is not finite, or the quaternion's norm differs from 1 by more than 1e-3 (closer ones
            are normalised).
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        position = finite_tuple("position", self.position, 3)
        quaternion = finite_tuple("quaternion", self.quaternion, 4)
        w, x, y, z = quaternion
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        if abs(norm - 1.0) > 1e-3:
            raise InvalidRequest("quaternion", quaternion, f"a unit quaternion (w, x, y, z); its norm is {norm:.6g}")
        if abs(norm - 1.0) > 1e-12:  # an already unit one stays bit for bit what it was
            quaternion = tuple(v / norm for v in quaternion)
        set_fields(self, position=position, quaternion=quaternion)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Pose:
        """The pose of a 4 x 4 homogeneous matrix.

        Raises:
            InvalidRequest: not 4 x 4, not finite, or its rotation is not orthonormal within 1e-6
                or mirrors (determinant -1).
        """
        T = numbers("matrix", matrix, "a finite 4 x 4 matrix")
        if T.shape != (4, 4) or not np.isfinite(T).all():
            raise InvalidRequest("matrix", matrix, "a finite 4 x 4 matrix")
        a, b, c, (*last, one) = T.tolist()
        lengths, angles = (dot(a, a), dot(b, b), dot(c, c)), (dot(a, b), dot(b, c), dot(c, a))
        off = max(*[abs(square - 1.0) for square in lengths], *map(abs, angles))
        mirrored = dot(a, cross_of(b, c)) < 0.0
        if off > 1e-6 or mirrored or max(*map(abs, last), abs(one - 1.0)) > 1e-9:
            raise InvalidRequest("matrix", matrix, "an orthonormal rotation and a last row 0 0 0 1")
        return cls((a[3], b[3], c[3]), _quaternion((a, b, c)))

    @classmethod
    def from_rpy(cls, position: Sequence[float], rpy: Sequence[float]) -> Pose:
        """The pose of URDF's ``<origin xyz rpy>``: fixed-axis roll, pitch, yaw in radians."""
        roll, pitch, yaw = finite_tuple("rpy", rpy, 3)
        x, y, z = finite_tuple("position", position, 3)
        return cls((x, y, z), _quaternion(rpy_matrix(roll, pitch, yaw).tolist()))

    @property
    def rotation(self) -> FloatArray:
        """Rotation matrix, shape (3, 3)."""
        return np.array(self.rotation_rows)

    @cached_property
    def rotation_rows(self) -> tuple[tuple[float, float, float], ...]:
        """The rows of the rotation matrix."""
        w, x, y, z = self.quaternion
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )

    @property
    def matrix(self) -> FloatArray:
        """Homogeneous matrix, shape (4, 4)."""
        rows = [(*row, at) for row, at in zip(self.rotation_rows, self.position, strict=True)]
        return np.array([*rows, (0.0, 0.0, 0.0, 1.0)])

    def inverse(self) -> Pose:
        """The pose of the outer frame in this one."""
        w, x, y, z = self.quaternion
        turned = Pose(quaternion=(w, -x, -y, -z))
        px, py, pz = turned._rotated(self.position)
        return Pose((-px, -py, -pz), turned.quaternion)

    def __matmul__(self, other: Pose) -> Pose:
        """``T_a_b @ T_b_c`` is ``T_a_c``, in scalar arithmetic, so that it has the same bits on every machine."""
        w, x, y, z = self.quaternion
        ow, ox, oy, oz = other.quaternion
        px, py, pz = self._rotated(other.position)
        tx, ty, tz = self.position
        quaternion = (
            w * ow - x * ox - y * oy - z * oz,
            w * ox + x * ow + y * oz - z * oy,
            w * oy - x * oz + y * ow + z * ox,
            w * oz + x * oy - y * ox + z * ow,
        )
        return Pose((tx + px, ty + py, tz + pz), quaternion)

    def _rotated(self, point: tuple[float, float, float]) -> tuple[float, float, float]:
        px, py, pz = point
        x, y, z = (row[0] * px + row[1] * py + row[2] * pz for row in self.rotation_rows)
        return (x, y, z)


def _quaternion(rows: Sequence[Sequence[float]]) -> tuple[float, float, float, float]:
    """Unit quaternion with w >= 0 of a rotation matrix (Shepperd's method: the largest component first)."""
    (r00, r01, r02, *_), (r10, r11, r12, *_), (r20, r21, r22, *_) = rows
    squares = (1.0 + r00 + r11 + r22, 1.0 + r00 - r11 - r22, 1.0 - r00 + r11 - r22, 1.0 - r00 - r11 + r22)
    k = squares.index(max(squares))
    s = 2.0 * math.sqrt(squares[k])
    a, b, c = (r21 - r12) / s, (r02 - r20) / s, (r10 - r01) / s
    d, e, f = (r01 + r10) / s, (r02 + r20) / s, (r12 + r21) / s
    w, x, y, z = ((s / 4, a, b, c), (a, s / 4, d, e), (b, d, s / 4, f), (c, e, f, s / 4))[k]
    sign = -1.0 if w < 0 else 1.0
    norm = math.sqrt(w * w + x * x + y * y + z * z) * sign
    return (w / norm, x / norm, y / norm, z / norm)


@runtime_checkable
class Shape(Protocol):
    """A convex solid centred on its own origin."""

    def support(self, direction: FloatArray) -> FloatArray:
        """A point of the solid farthest along each direction; (..., 3) in, (..., 3) out, any length of direction."""

    def distance(self, points: FloatArray) -> FloatArray:
        """Distance from each point to the solid, 0 inside; (..., 3) in, (...) out; exact up to rounding."""

    def grown(self, margin: float) -> Shape:
        """A shape of the same kind that holds every point within ``margin`` of this one."""


@dataclass(frozen=True)
class Box:
    """A cuboid with full edge lengths ``size`` = (x, y, z), in metres, about its middle."""

    size: tuple[float, float, float]

    def __post_init__(self) -> None:
        x, y, z = finite_tuple("size", self.size, 3)
        set_fields(self, size=(_length("size[0]", x), _length("size[1]", y), _length("size[2]", z)))

    @property
    def half(self) -> tuple[float, float, float]:
        """Half edge lengths."""
        x, y, z = self.size
        return (x / 2, y / 2, z / 2)

    def support(self, direction: FloatArray) -> FloatArray:
        return np.asarray(np.where(vectors("direction", direction) < 0, -1.0, 1.0) * np.array(self.half))

    def distance(self, points: FloatArray) -> FloatArray:
        outside = np.maximum(np.abs(points_of(points)) - np.array(self.half), 0.0)
        return np.asarray(np.sqrt((outside * outside).sum(axis=-1)))

    def grown(self, margin: float) -> Box:
        x, y, z = self.size
        margin = margin_of(margin)
        return Box((x + 2 * margin, y + 2 * margin, z + 2 * margin))


@dataclass(frozen=True)
class Sphere:
    """A ball of ``radius`` metres."""

    radius: float

    def __post_init__(self) -> None:
        set_fields(self, radius=_length("radius", self.radius))

    def support(self, direction: FloatArray) -> FloatArray:
        return self.radius * _unit(vectors("direction", direction))

    def distance(self, points: FloatArray) -> FloatArray:
        points = points_of(points)
        return np.asarray(np.maximum(np.sqrt((points * points).sum(axis=-1)) - self.radius, 0.0))

    def grown(self, margin: float) -> Sphere:
        return Sphere(self.radius + margin_of(margin))


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along local z, in metres, about its middle; ``length`` is its full length."""

    radius: float
    length: float

    def __post_init__(self) -> None:
        set_fields(self, radius=_length("radius", self.radius), length=_length("length", self.length))

    def support(self, direction: FloatArray) -> FloatArray:
        d = vectors("direction", direction)
        point = np.zeros(d.shape)
        point[..., :2] = self.radius * _unit(d[..., :2])
        point[..., 2] = np.where(d[..., 2] < 0, -0.5, 0.5) * self.length
        return point

    def distance(self, points: FloatArray) -> FloatArray:
        points = points_of(points)
        radial = np.maximum(np.sqrt(points[..., 0] ** 2 + points[..., 1] ** 2) - self.radius, 0.0)
        axial = np.maximum(np.abs(points[..., 2]) - self.length / 2, 0.0)
        return np.asarray(np.sqrt(radial * radial + axial * axial))

    def grown(self, margin: float) -> Cylinder:
        margin = margin_of(margin)
        return Cylinder(self.radius + margin, self.length + 2 * margin)


@dataclass(frozen=True)
class Capsule:
    """All points within ``radius`` metres of a segment of ``length`` along local z, so that the caps come on top."""

    radius: float
    length: float

    def __post_init__(self) -> None:
        set_fields(self, radius=_length("radius", self.radius), length=_length("length", self.length))

    def support(self, direction: FloatArray) -> FloatArray:
        d = vectors("direction", direction)
        point = self.radius * _unit(d)
        point[..., 2] += np.where(d[..., 2] < 0, -0.5, 0.5) * self.length
        return point

    def distance(self, points: FloatArray) -> FloatArray:
        points = points_of(points)
        axial = np.maximum(np.abs(points[..., 2]) - self.length / 2, 0.0)
        span = np.sqrt(points[..., 0] ** 2 + points[..., 1] ** 2 + axial * axial)
        return np.asarray(np.maximum(span - self.radius, 0.0))

    def grown(self, margin: float) -> Capsule:
        return Capsule(self.radius + margin_of(margin), self.length)


def _unit(direction: FloatArray) -> FloatArray:
    """Directions scaled to length 1; a zero direction stays zero, which is a point of every shape."""
    d = np.asarray(direction, dtype=np.float64)
    largest = np.abs(d).max(axis=-1, keepdims=True)
    d = d / np.where(largest > 0, largest, 1.0)  # first, or the squares of 1e-200 and 1e200 leave the range of floats
    norm = np.sqrt((d * d).sum(axis=-1, keepdims=True))
    return np.asarray(d / np.where(norm > 0, norm, 1.0))
