"""Arrays: their types, read-only copies of them, and arithmetic that has the same bits on every machine.

BLAS and the vectorised sines of numpy differ from processor to processor in the last bit, on which a verdict may hang.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "BoolArray",
    "FloatArray",
    "IntArray",
    "Vector",
    "along",
    "as_sent",
    "axis_matrix",
    "blocks",
    "cosines_and_sines",
    "cross",
    "cross_of",
    "dot",
    "frozen",
    "joint_distance",
    "minus",
    "order_of_rows",
    "product",
    "quartered",
    "read_only",
    "rpy_matrix",
    "rpy_of",
    "set_fields",
    "sorted_rows",
    "turned",
    "unique_rows",
    "vector",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
Vector = tuple[float, float, float]
AnyArray = TypeVar("AnyArray", bound=NDArray[Any])

AT_ONCE = 50_000
"""Numbers in a temporary array: few enough for a processor's cache."""

_QUARTER = (1.57079632673412561417, 6.07710050650619224932e-11)
"""A quarter turn in two parts: small multiples of the first are exact."""


def read_only(values: ArrayLike) -> FloatArray:
    """An immutable float64 copy of ``values`` that are known to be numbers; for others see ``validation.numbers``."""
    return frozen(np.array(values, dtype=np.float64))


def frozen(array: AnyArray) -> AnyArray:
    """The array itself, made read-only."""
    array.flags.writeable = False
    return array


def as_sent(value: object, state: dict[str, Any]) -> None:
    """``__setstate__`` of values with arrays: arrays from another process are made read-only again."""
    for held in state.values():
        for array in held if isinstance(held, tuple) else (held,):
            if isinstance(array, np.ndarray):
                frozen(array)
    value.__dict__.update(state)


def set_fields(value: object, **fields: object) -> None:
    """For ``__post_init__`` of a frozen dataclass: replace these fields."""
    for name, content in fields.items():
        object.__setattr__(value, name, content)


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """The scalar product of the first three numbers of each."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def joint_distance(a: Iterable[float], b: Iterable[float]) -> float:
    """The L2 norm of ``b - a``, summed in joint order for equal bits on every CPU."""
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += (y - x) * (y - x)
    return math.sqrt(total)


def vector(values: Sequence[float]) -> Vector:
    """Three numbers as a tuple."""
    x, y, z = values
    return (x, y, z)


def turned(direction: Vector, T: FloatArray) -> Vector:
    """The direction rotated by ``T``, a rotation (3, 3) or a pose (4, 4)."""
    x, y, z = T[:3, :3].tolist()
    return (dot(x, direction), dot(y, direction), dot(z, direction))


def minus(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def cross_of(a: Sequence[float], b: Sequence[float]) -> Vector:
    """The vector product of two vectors, by scalar arithmetic."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def cross(a: FloatArray, b: FloatArray, axis: int = -1) -> FloatArray:
    """Vector products of vectors whose components lie along ``axis``."""
    (x, y, z), (u, v, w) = np.moveaxis(a, axis, 0), np.moveaxis(b, axis, 0)
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=axis)


def along(points: FloatArray, directions: FloatArray) -> FloatArray:
    """Components of points (n, 3) along directions (..., 3), (..., n)."""
    d = directions[..., None, :]
    return np.asarray(d[..., 0] * points[:, 0] + d[..., 1] * points[:, 1] + d[..., 2] * points[:, 2])


def product(A: FloatArray, B: FloatArray) -> FloatArray:
    """The matrix products A B of a matrix (4, 4) and matrices (..., 4, 4)."""
    a, b, c, d = (A[:, k : k + 1] * B[..., k : k + 1, :] for k in range(4))
    return np.asarray(a + b + c + d)


def blocks(rows: int, width: int) -> list[slice]:
    """Slices of rows whose products with ``width`` numbers stay small; an empty one if there are no rows."""
    step = max(1, AT_ONCE // width)
    return [slice(k, k + step) for k in range(0, max(rows, 1), step)]


def order_of_rows(columns: Sequence[IntArray]) -> IntArray:
    """The stable order of rows of whole numbers, given as columns (k,) of which the first counts most."""
    key, room = _packed(columns)
    return np.argsort(key, kind="stable") if room else np.lexsort(columns[::-1])


def sorted_rows(rows: IntArray) -> IntArray:
    """Rows of whole numbers (k, n), each once and sorted."""
    columns = list(rows.T)
    key, room = _packed(columns)
    if not room:
        return np.unique(rows, axis=0)
    return _unpacked(np.unique(key), columns)


def merged_rows(rows: IntArray, others: IntArray) -> IntArray:
    """``sorted_rows`` of two lists of rows (k, n) and (m, n) that are sorted, each once; for few others."""
    if not (len(rows) and len(others)):
        return rows if len(rows) else others
    together = np.concatenate([rows, others])
    both, room = _packed(list(together.T))
    if not room:
        return sorted_rows(together)
    keys, more = both[: len(rows)], both[len(rows) :]
    at = np.searchsorted(keys, more)
    new = keys[np.minimum(at, len(keys) - 1)] != more
    return np.asarray(np.insert(rows, at[new], others[new], axis=0))


def _unpacked(key: NDArray[Any], columns: Sequence[IntArray]) -> IntArray:
    """The rows of keys that were packed with these columns."""
    out = np.empty((len(key), len(columns)), dtype=columns[0].dtype)
    for k in range(len(columns) - 1, 0, -1):
        low, high = int(columns[k].min()), int(columns[k].max())
        key, rest = np.divmod(key, high - low + 1)
        out[:, k] = rest + low
    out[:, 0] = key + int(columns[0].min())
    return out


def _packed(columns: Sequence[IntArray]) -> tuple[IntArray, bool]:
    """One whole number for each row, in their order, and whether 64 bits suffice; none if not."""
    key: IntArray = np.zeros(len(columns[0]), dtype=np.int64)
    room = 1
    for column in columns if len(key) else ():
        low = int(column.min())
        span = int(column.max()) - low + 1
        room *= span
        if room >= 2**62:
            return key, False
        if span > 1:
            key = np.asarray(key * span + (column - low), dtype=np.int64)
    return key, len(key) > 0


def unique_rows(rows: FloatArray) -> tuple[FloatArray, IntArray]:
    """The different rows of numbers (k, n), and which of them each row is, (k,)."""
    codes = [np.unique(column, return_inverse=True)[1] for column in rows.T]
    key, room = _packed(codes)
    if not room:
        different, numbers = np.unique(rows, axis=0, return_inverse=True)
        return different, numbers.reshape(-1)
    _, first, numbers = np.unique(key, return_index=True, return_inverse=True)
    return rows[first], numbers


def quartered(triangles: FloatArray) -> FloatArray:
    """Triangles (k, 3, 3) cut in four at the middles of their sides, (4 k, 3, 3); the last k are the inner ones."""
    middles = 0.5 * (triangles + np.roll(triangles, -1, axis=1))  # of the sides ab, bc, ca
    (a, b, c), (ab, bc, ca) = (np.moveaxis(corners, 1, 0) for corners in (triangles, middles))
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(corners, axis=1) for corners in parts])


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


def rpy_of(R: FloatArray) -> Vector:
    """Roll, pitch and yaw of a rotation matrix (3, 3): ``rpy_matrix`` gives it again, up to rounding.

    Near a pitch of a quarter turn yaw is anything, so roll is what is left of the rotation after that yaw.
    """
    (r00, r01, r02), (r10, r11, r12), (r20, _, _) = R.tolist()
    across = math.hypot(r00, r10)
    yaw = math.atan2(r10, r00) if across > 0.0 else 0.0
    c, s = math.cos(yaw), math.sin(yaw)
    return (math.atan2(s * r02 - c * r12, c * r11 - s * r01), math.atan2(-r20, across), yaw)


def axis_matrix(axis: Vector, angle: float) -> list[list[float]]:
    """Rotation matrix about a unit axis, by rows (Rodrigues)."""
    x, y, z = axis
    s, k = math.sin(angle), math.cos(angle)
    v = 1.0 - k
    return [
        [k + x * x * v, x * y * v - z * s, x * z * v + y * s],
        [y * x * v + z * s, k + y * y * v, y * z * v - x * s],
        [z * x * v - y * s, z * y * v + x * s, k + z * z * v],
    ]


def cosines_and_sines(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cosines and sines of angles, to a few 1e-16, by Taylor series: the same bits on every processor."""
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
