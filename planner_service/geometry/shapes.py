"""Poses and convex shapes: the words in which robots and scenes say where things are.

Lengths in metres, quaternions as (w, x, y, z). Every shape is centred on its own origin and
convex; cylinders and capsules lie along local z. All shapes answer the same few questions
(``support``, ``distance``, ``grown``), on which the collision checker and its bounds are built.
What callers give is read here too, strictly (``number``, ``whole``, ``numbers``, ``vectors``, ``text``, ``items``,
``instance``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import islice
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner_service.errors import InvalidRequest

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "FloatArray",
    "Pose",
    "Shape",
    "Sphere",
    "as_sent",
    "copied_in",
    "cosines_and_sines",
    "finite_numbers",
    "flag",
    "instance",
    "items",
    "margin_of",
    "number",
    "numbers",
    "points_of",
    "read_only",
    "rpy_matrix",
    "text",
    "vectors",
    "whole",
]

T = TypeVar("T")

FloatArray = NDArray[np.float64]

_QUARTER = (1.57079632673412561417, 6.07710050650619224932e-11)
"""Of a turn, in two parts: small multiples of the first are exact."""

MAX_LENGTH = 1e3
"""No robot on a table is a kilometre long: a longer length is a unit mistake."""

MAX_ITEMS = 1_000_000
"""Elements of a list a caller gives; an iterator without an end would fill the memory."""

MAX_COORDINATE, MAX_DIRECTION = 1e100, 1e308
"""Of points, whose squares then stay in the range of floats, and of directions, whose products with lengths do."""

MAX_NUMBERS = 20_000_000
"""Numbers of an array a caller gives, 160 MB."""


def read_only(values: ArrayLike) -> FloatArray:
    """A private, immutable float64 copy of ``values``, which are known to be numbers; see ``numbers`` for others."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def copied_in(value: object, *names: str) -> None:
    """For ``__post_init__``: hold read-only copies of the arrays, lists and mappings that ``names`` were given as."""
    for name in names:
        held = getattr(value, name)
        if isinstance(held, np.ndarray):
            held = held.copy()
            held.flags.writeable = False
        elif isinstance(held, Mapping):
            held = dict(held)
        elif held is not None:
            held = items(name, held, object, "a sequence")
        object.__setattr__(value, name, held)


def as_sent(value: object, state: dict[str, Any]) -> None:
    """``__setstate__`` of values with arrays: from another process they come as numbers, and are read-only again."""
    for held in state.values():
        for array in held if isinstance(held, tuple) else (held,):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False
    value.__dict__.update(state)


def number(field: str, value: object, expected: str, lowest: float, highest: float) -> float:
    """The real number in [``lowest``, ``highest``] that a caller gave.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``: another number, NaN, or no real number.
    """
    plain = value.item() if isinstance(value, np.generic) else value  # numpy's would round the bounds to their type
    if not isinstance(plain, (int, float)) or isinstance(plain, bool) or not lowest <= plain <= highest:
        raise InvalidRequest(field, value, expected)
    try:
        return float(plain)
    except OverflowError:  # an integer that no float holds, where any number would do
        raise InvalidRequest(field, value, expected) from None


def whole(field: str, value: object, lowest: int, highest: int) -> int:
    """The whole number in [``lowest``, ``highest``] that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: another number, a boolean, or no integer.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not lowest <= value <= highest:
        raise InvalidRequest(field, value, f"a whole number from {lowest:,} to {highest:,}")
    return int(value)


def numbers(field: str, values: object, expected: str) -> FloatArray:
    """A private, immutable float64 copy of the real numbers a caller gave, in the shape they have.

    Their shape, and whether they are finite, is for the caller to check.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``: texts, booleans, complex numbers, other objects,
            hidden (masked) entries, rows of unequal length, integers that no float holds, or 20 million numbers.
    """
    try:
        _count(values)
        array = np.asarray(values)
    except Exception:  # another library's object may raise anything when numpy looks at it
        raise InvalidRequest(field, values, expected) from None
    if array.dtype.kind not in "iuf":
        raise InvalidRequest(field, values, expected)
    if array.dtype.itemsize == 8 and array.dtype.kind == "f":
        return read_only(array)
    with np.errstate(over="ignore"):  # a longer float that becomes infinite is found where finite ones are asked for
        return read_only(array)


def finite_numbers(field: str, values: object, n: int) -> FloatArray:
    """``n`` finite numbers as ``numbers`` reads them, shape (n,).

    Raises:
        InvalidRequest: as ``numbers``, or another count of them, or one that is not finite.
    """
    expected = f"{n} finite numbers, shape ({n},)"
    array = numbers(field, values, expected)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise InvalidRequest(field, values, expected)
    return array


def vectors(field: str, values: object, largest: float = MAX_DIRECTION) -> FloatArray:
    """Finite vectors that a caller gave, shape (..., 3); float64 arrays are not copied.

    Raises:
        InvalidRequest: as ``numbers``, or another shape, or a number that is not finite or beyond ``largest``.
    """
    expected = "finite vectors, shape (..., 3)"
    array = values if type(values) is np.ndarray and values.dtype == np.float64 else numbers(field, values, expected)
    if array.shape[-1:] != (3,) or not (np.isfinite(array) & (np.abs(array) <= largest)).all():
        raise InvalidRequest(field, values, expected)
    return array


def text(field: str, value: object, expected: str = "a text") -> str:
    """The text a caller gave.

    Raises:
        InvalidRequest: naming ``field``: it is none.
    """
    return instance(field, value, str, expected)


def flag(field: str, value: object) -> bool:
    """The yes or no that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: neither True nor False.
    """
    return bool(instance(field, value, (bool, np.bool_), "True or False"))


def instance(field: str, value: object, kind: type[T] | tuple[type[T], ...], expected: str) -> T:
    """What a caller gave, if it is of that kind.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``.
    """
    if not isinstance(value, kind):
        raise InvalidRequest(field, value, expected)
    return value


def items(
    field: str, values: object, kind: type[T] | tuple[type[T], ...], expected: str, most: int = MAX_ITEMS
) -> tuple[T, ...]:
    """The elements of a list or another iterable, each of that kind.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``: a text, a mapping, a set (which has no order),
            something that has no elements, an element of another kind, or more than ``most``.
    """
    if isinstance(values, (str, bytes, Mapping, Set)):
        raise InvalidRequest(field, values, expected)
    try:
        given = iter(values)  # type: ignore[call-overload]
    except TypeError:
        raise InvalidRequest(field, values, expected) from None
    found: list[T] = []
    for value in islice(given, most):
        if not isinstance(value, kind):
            raise InvalidRequest(f"{field}[{len(found)}]", value, expected)
        found.append(value)
    for _ in given:
        raise InvalidRequest(field, values, f"{expected}, at most {most:,}")
    return tuple(found)


def _count(values: object) -> int:
    """How many numbers numpy would find in ``values``.

    Raises:
        ValueError: too many, or it would take something for a number that is none: a boolean or a hidden entry.
    """
    if isinstance(values, np.ndarray):
        mask = getattr(values, "mask", False)
        if values.dtype.kind == "b" or (mask is not False and bool(np.any(mask))):
            raise ValueError
        count = values.size
    elif isinstance(values, (list, tuple)):
        count = 0
        for value in values:
            count += 1 if type(value) is float else _count(value)
            if count > MAX_NUMBERS:
                break
    elif isinstance(values, (bool, np.bool_)):
        raise ValueError
    else:
        count = len(values) if hasattr(values, "__len__") else 1
    if count > MAX_NUMBERS:
        raise ValueError
    return count


def rpy_matrix(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation matrix of URDF's fixed-axis angles, Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3)."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _finite_tuple(field: str, values: Any, size: int) -> tuple[float, ...]:
    if type(values) is tuple and len(values) == size and all(type(v) is float and math.isfinite(v) for v in values):
        return values
    found = numbers(field, values, f"{size} finite numbers")
    if found.shape != (size,) or not np.isfinite(found).all():
        raise InvalidRequest(field, values, f"{size} finite numbers")
    return tuple(found.tolist())


def _length(field: str, value: Any) -> float:
    return number(field, value, f"a positive length up to {MAX_LENGTH:g} m", math.ulp(0.0), MAX_LENGTH)


@dataclass(frozen=True)
class Pose:
    """Where a frame is in another: position in metres, orientation as a unit quaternion (w, x, y, z).

    Raises:
        InvalidRequest: a number is not finite, or the quaternion's norm is off 1 by more than 1e-3
            (closer ones are normalised).
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        position = _finite_tuple("position", self.position, 3)
        quaternion = _finite_tuple("quaternion", self.quaternion, 4)
        norm = math.sqrt(sum(v * v for v in quaternion))
        if abs(norm - 1.0) > 1e-3:
            raise InvalidRequest("quaternion", quaternion, f"a unit quaternion (w, x, y, z); its norm is {norm:.6g}")
        if abs(norm - 1.0) > 1e-12:  # an already unit one stays bit for bit what it was
            quaternion = tuple(v / norm for v in quaternion)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "quaternion", quaternion)

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
        off = max(abs(_dot(u, v) - (u is v)) for u in (a, b, c) for v in (a, b, c))
        mirrored = _dot(a, (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0])) < 0.0
        if off > 1e-6 or mirrored or max(*map(abs, last), abs(one - 1.0)) > 1e-9:
            raise InvalidRequest("matrix", matrix, "an orthonormal rotation and a last row 0 0 0 1")
        return cls((a[3], b[3], c[3]), _quaternion((a, b, c)))

    @classmethod
    def from_rpy(cls, position: Sequence[float], rpy: Sequence[float]) -> Pose:
        """The pose of URDF's ``<origin xyz rpy>``: fixed-axis roll, pitch, yaw in radians."""
        roll, pitch, yaw = _finite_tuple("rpy", rpy, 3)
        x, y, z = _finite_tuple("position", position, 3)
        return cls((x, y, z), _quaternion(rpy_matrix(roll, pitch, yaw).tolist()))

    @property
    def rotation(self) -> FloatArray:
        """Rotation matrix, shape (3, 3)."""
        return np.array(self.rotation_rows)

    @property
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
        T = np.eye(4)
        T[:3, :3] = self.rotation
        T[:3, 3] = self.position
        return T

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


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Of the first three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


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
        x, y, z = _finite_tuple("size", self.size, 3)
        object.__setattr__(self, "size", (_length("size[0]", x), _length("size[1]", y), _length("size[2]", z)))

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
        object.__setattr__(self, "radius", _length("radius", self.radius))

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
        object.__setattr__(self, "radius", _length("radius", self.radius))
        object.__setattr__(self, "length", _length("length", self.length))

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
        object.__setattr__(self, "radius", _length("radius", self.radius))
        object.__setattr__(self, "length", _length("length", self.length))

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


def margin_of(margin: object) -> float:
    """Metres by which a caller wants a shape grown."""
    return number("margin", margin, f"metres in [0, {MAX_LENGTH:g}]", 0.0, MAX_LENGTH)


def points_of(points: object) -> FloatArray:
    """Points that a caller gave."""
    return vectors("points", points, MAX_COORDINATE)


def _unit(direction: FloatArray) -> FloatArray:
    """Directions scaled to length 1; a zero direction stays zero, which is a point of every shape here."""
    d = np.asarray(direction, dtype=np.float64)
    largest = np.abs(d).max(axis=-1, keepdims=True)
    d = d / np.where(largest > 0, largest, 1.0)  # first, or the squares of 1e-200 and 1e200 leave the range of floats
    norm = np.sqrt((d * d).sum(axis=-1, keepdims=True))
    return np.asarray(d / np.where(norm > 0, norm, 1.0))


def cosines_and_sines(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of angles, to a few 1e-16, by Taylor's series: the same bits on every processor, as no library promises."""
    quarters = np.floor(x * (2.0 / math.pi) + 0.5)
    r = (x - quarters * _QUARTER[0]) - quarters * _QUARTER[1]
    u = r * r
    s, c = np.zeros_like(u), np.zeros_like(u)
    for k in range(8, 0, -1):
        sign = -1.0 if k % 2 else 1.0
        s, c = s * u + sign / math.factorial(2 * k + 1), c * u + sign / math.factorial(2 * k)
    s, c = r + r * u * s, 1.0 + u * c
    turns = quarters.astype(np.int64)
    sine, cosine = np.where(turns & 1, c, s), np.where(turns & 1, s, c)
    return np.where((turns + 1) & 2, -cosine, cosine), np.where(turns & 2, -sine, sine)
