"""Where straight lines enter and leave a solid: in closed form for each convex piece, joined where pieces meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray, along, blocks
from planner_service.geometry.composite import Pieces, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere

__all__ = ["JOINED", "Runs", "pieces_of", "runs_along"]

JOINED = 1e-6
"""Metres: pieces of one solid that are no farther apart count as joined."""

Ends = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Where lines (k,) enter and leave, in metres, +inf and -inf for a miss, and the outward unit normals there (k, 3)."""


@dataclass(frozen=True, eq=False)
class Runs:
    """The stretches of lines that are in a solid, in the order of the lines and, on each, along it.

    Attributes:
        line: Of which line each is, (r,).
        enter, leave: Metres along it from the line's origin, (r,).
        enter_normal, leave_normal: Outward unit normals of the solid there, (r, 3).
    """

    line: IntArray
    enter: FloatArray
    leave: FloatArray
    enter_normal: FloatArray
    leave_normal: FloatArray


def pieces_of(solid: Solid) -> Pieces:
    """The convex pieces of a solid; of a convex one itself."""
    return solid.pieces if hasattr(solid, "pieces") else Pieces.of([solid], np.eye(4)[None])


def runs_along(pieces: Pieces, origins: FloatArray, directions: FloatArray) -> Runs:
    """Where lines from ``origins`` (k, 3) along unit ``directions`` (k, 3) are in a solid, in its own frame."""
    rows = blocks(len(origins), 8 * max(1, len(pieces)))
    parts = [_hits(pieces, origins[each], directions[each], each.start) for each in rows]
    line, ends, normals = (np.concatenate([part[k] for part in parts]) for k in range(3))
    order = np.lexsort((ends[:, 1], ends[:, 0], line))
    line, ends, normals = line[order], ends[order], normals[order]
    first, last, reach = list[int](), list[int](), 0.0
    for k, (owner, (enter, leave)) in enumerate(zip(line.tolist(), ends.tolist(), strict=True)):
        if first and owner == line[k - 1] and enter <= reach + JOINED:
            if leave > reach:
                last[-1], reach = k, leave
        else:
            first.append(k)
            last.append(k)
            reach = leave
    return Runs(line[first], ends[first, 0], ends[last, 1], normals[first, 0], normals[last, 1])


def _hits(
    pieces: Pieces, origins: FloatArray, directions: FloatArray, start: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Of each line through each piece that it meets: its number from ``start``, its ends (h, 2), normals (h, 2, 3)."""
    lines, ends, normals = list[IntArray](), list[FloatArray](), list[FloatArray]()
    rotations = np.broadcast_to(pieces.rotations, (len(pieces), 3, 3))
    for number, shape in enumerate(pieces.kinds):
        which = np.flatnonzero(pieces.numbers == number)
        R = rotations[which][:, None]
        away = origins - pieces.positions[which][:, None]
        o, d = (_rotated(np.swapaxes(R, -1, -2), rows).reshape(-1, 3) for rows in (away, directions[None]))
        enter, leave, into, out = _through(shape, o, d)
        met = np.flatnonzero(leave > enter)
        R = R[met // len(origins), 0]
        lines.append(met % len(origins) + start)
        ends.append(np.stack([enter[met], leave[met]], axis=1))
        normals.append(np.stack([_rotated(R, into[met]), _rotated(R, out[met])], axis=1))
    if not lines:
        return np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros((0, 2, 3))
    return np.concatenate(lines), np.concatenate(ends), np.concatenate(normals)


def _rotated(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (..., 3) turned by rotations (..., 3, 3), summed in a fixed order."""
    return np.asarray(R[..., 0] * vectors[..., :1] + R[..., 1] * vectors[..., 1:2] + R[..., 2] * vectors[..., 2:])


def _through(shape: Shape, o: FloatArray, d: FloatArray) -> Ends:
    """Of lines in a shape's own frame."""
    if isinstance(shape, Mesh):
        return _planes(shape.normals, shape.offsets, o, d)
    if isinstance(shape, Box):
        return _planes(np.concatenate([np.eye(3), -np.eye(3)]), np.array(shape.half * 2), o, d)
    if isinstance(shape, Sphere):
        return _round(o, d, shape.radius)
    if isinstance(shape, Cylinder):
        return _tube(o, d, shape.radius, shape.length / 2.0)
    assert isinstance(shape, Capsule)
    tip = np.array([0.0, 0.0, shape.length / 2.0])
    parts = [
        _tube(o, d, shape.radius, shape.length / 2.0),
        *(_round(o + s * tip, d, shape.radius) for s in (-1.0, 1.0)),
    ]
    enter, leave = (np.stack([part[k] for part in parts]) for k in range(2))
    enter, leave = np.where(leave > enter, enter, np.inf), np.where(leave > enter, leave, -np.inf)
    first, last = enter.argmin(axis=0), leave.argmax(axis=0)
    at = np.arange(len(o))
    into, out = (np.stack([part[k] for part in parts]) for k in (2, 3))
    return enter[first, at], leave[last, at], into[first, at], out[last, at]


def _planes(normals: FloatArray, offsets: FloatArray, o: FloatArray, d: FloatArray) -> Ends:
    """Of a convex body ``normals . x <= offsets``."""
    parts = []
    for rows in blocks(len(o), 4 * len(normals)):
        speed, room = along(normals, d[rows]), offsets - along(normals, o[rows])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t = room / speed
        beside = ((speed == 0.0) & (room < 0.0)).any(axis=1)
        into, out = np.where(speed < 0.0, t, -np.inf), np.where(speed > 0.0, t, np.inf)
        first, last = into.argmax(axis=1), out.argmin(axis=1)
        at = np.arange(len(into))
        enter, leave = np.where(beside, np.inf, into[at, first]), np.where(beside, -np.inf, out[at, last])
        parts.append((enter, leave, normals[first], normals[last]))
    enter, leave, first_normals, last_normals = (np.concatenate([part[k] for part in parts]) for k in range(4))
    return enter, leave, first_normals, last_normals


def _round(o: FloatArray, d: FloatArray, radius: float) -> Ends:
    """Of a ball about the origin."""
    middle = -(o * d).sum(axis=1)
    foot = o + middle[:, None] * d
    square = radius * radius - (foot * foot).sum(axis=1)
    half = np.sqrt(np.maximum(square, 0.0))
    enter, leave = np.where(square > 0.0, middle - half, np.inf), np.where(square > 0.0, middle + half, -np.inf)
    into, out = (foot + (sign * half)[:, None] * d for sign in (-1.0, 1.0))
    return enter, leave, into / radius, out / radius


def _tube(o: FloatArray, d: FloatArray, radius: float, half: float) -> Ends:
    """Of a cylinder along z about the origin."""
    ends = _planes(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), np.array([half, half]), o, d)
    flat = d * np.array([1.0, 1.0, 0.0])
    speed = np.sqrt((flat * flat).sum(axis=1))
    rolling = speed > 0.0
    rate = np.where(rolling, speed, 1.0)
    enter, leave, into, out = _round(o * np.array([1.0, 1.0, 0.0]), flat / rate[:, None], radius)
    inside = ~rolling & (o[:, 0] ** 2 + o[:, 1] ** 2 < radius * radius)
    enter = np.where(rolling, enter / rate, np.where(inside, -np.inf, np.inf))
    leave = np.where(rolling, leave / rate, np.where(inside, np.inf, -np.inf))
    side_first, side_last = enter > ends[0], leave < ends[1]
    return (
        np.where(side_first, enter, ends[0]),
        np.where(side_last, leave, ends[1]),
        np.where(side_first[:, None], into, ends[2]),
        np.where(side_last[:, None], out, ends[3]),
    )
