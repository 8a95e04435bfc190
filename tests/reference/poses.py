"""Poses of bodies as the compiled core computes them, operation by operation, from ``BodyTree.table``."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planner_service.geometry.arrays import FloatArray

__all__ = ["poses"]

Frame = tuple[list[list[float]], list[float]]


def poses(table: FloatArray, q: Sequence[float]) -> list[Frame]:
    """Rotation and position of every body at q."""
    frames: list[Frame] = [([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0])]
    for parent, entry, kind, sign, *rest in table.tolist():
        offset, slide, before, after, angle = rest[:3], rest[3:6], rest[6:16], rest[16:26], rest[26] * q[int(entry)]
        R, p = frames[int(parent)]
        p = [at + _along(row, offset) for at, row in zip(p, R, strict=True)]
        R = _turned(R, before)
        if kind == 3.0:
            p = [at + _along(row, slide) * angle for at, row in zip(p, R, strict=True)]
        else:
            u, v = (int(kind) + 1) % 3, (int(kind) + 2) % 3
            s, c = sign * math.sin(angle), math.cos(angle)
            R = [row.copy() for row in R]
            for row in R:
                row[u], row[v] = row[u] * c + row[v] * s, row[v] * c - row[u] * s
            R = _turned(R, after)
        frames.append((R, p))
    return frames


def _along(row: Sequence[float], v: Sequence[float]) -> float:
    return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]


def _turned(R: list[list[float]], rotation: Sequence[float]) -> list[list[float]]:
    """A rotation after another, which is none if its first number is 0."""
    if rotation[0] == 0.0:
        return R
    return [[_along(row, rotation[1 + k :: 3]) for k in range(3)] for row in R]
