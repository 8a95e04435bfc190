"""Which triangle is seen at each sample of a picture: a depth buffer whose entries name triangles.

Everything is plain elementwise arithmetic and whole numbers, so that a picture has the same bits on every machine.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.view.still.camera import Camera

__all__ = ["EMPTY", "KeyArray", "cover", "nearness_of", "numbers_of", "projected", "ribbon"]

KeyArray = NDArray[np.uint64]

EMPTY = np.uint64(2**64 - 1)
"""The key of a sample without a triangle; others have depth in the upper half, a triangle's number in the lower."""

HALF = np.uint64(32)
LOWER = np.uint64(2**32 - 1)

AT_ONCE = 500_000
"""Samples at once, so that their arrays stay in a processor's cache."""

TOO_SMALL = 1e-9
"""Samples: a triangle of less area is seen from its edge."""

DISC = 12
"""Corners of the discs at the corners of a line."""


def nearness_of(keys: KeyArray) -> FloatArray:
    """Nearness (``Camera.pixels``), of keys that are not ``EMPTY``."""
    return np.asarray(1.0 - (keys >> HALF).astype(np.float64) / 2.0**32)


def numbers_of(keys: KeyArray) -> IntArray:
    """The triangles' numbers in keys that are not ``EMPTY``."""
    return (keys & LOWER).astype(np.int64)


def projected(camera: Camera, corners: FloatArray, numbers: IntArray) -> tuple[FloatArray, IntArray]:
    """Triangles (m, 3, 3) in the world as pixels and nearness, without those that face away; with their numbers.

    A triangle that reaches behind the eye is clipped, to one triangle or two.
    """
    seen, numbers = _clipped(camera.seen(corners), numbers, camera.nearest)
    triangles = camera.pixels(seen)
    front = _doubled_area(triangles) < -TOO_SMALL  # as y points down
    return triangles[front], numbers[front]


def ribbon(camera: Camera, points: FloatArray, width: float, lift: float) -> FloatArray:
    """A line through world points (k, 3), ``width`` pixels wide, as triangles of pixels and nearness.

    Args:
        lift: Share of its distance by which it is drawn nearer, so that it is visible on a surface that it lies on.
    """
    seen = camera.seen(points)
    whole = seen[:, 2] > camera.nearest
    x, y, near = camera.pixels(np.where(whole[:, None], seen, 1.0)).T
    near = near * (1.0 + lift)
    both = np.flatnonzero(whole[1:] & whole[:-1])
    dx, dy = x[both + 1] - x[both], y[both + 1] - y[both]
    length = np.sqrt(dx * dx + dy * dy)
    scale = width / 2 / np.where(length > 0.0, length, 1.0)
    across, down = -dy * scale, dx * scale
    a, b, c, d = (
        np.stack([x[both + end] + side * across, y[both + end] + side * down, near[both + end]], axis=-1)
        for end, side in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0))
    )
    strips = [np.stack(corners, axis=1) for corners in ((a, b, c), (b, c, d))]
    return np.concatenate([*strips, _discs(x[whole], y[whole], near[whole], width / 2)])


def _discs(x: FloatArray, y: FloatArray, near: FloatArray, radius: float) -> FloatArray:
    angles = [2 * math.pi * k / DISC for k in range(DISC + 1)]
    rim = [np.stack([x + radius * math.cos(angle), y + radius * math.sin(angle), near], axis=-1) for angle in angles]
    middle = np.stack([x, y, near], axis=-1)
    return np.concatenate([np.stack([middle, a, b], axis=1) for a, b in pairwise(rim)])


def cover(triangles: FloatArray, numbers: IntArray, size: tuple[int, int]) -> KeyArray:
    """For each sample of a picture of ``size`` (width, height) the key of the nearest triangle, (height, width).

    A sample belongs to a triangle that its middle is in; of triangles that share an edge to one of them.

    Args:
        triangles: Pixels right and down, and nearness (0 to 1), of three corners each, (m, 3, 3).
        numbers: What to put into the keys, (m,), each below 2**32.
    """
    width, height = size
    keys = np.full(height * width, EMPTY)
    kept = np.abs(_doubled_area(triangles)) > TOO_SMALL
    triangles, numbers = triangles[kept], numbers[kept]
    triangles = np.take_along_axis(triangles, triangles[:, :, 1].argsort(axis=1, kind="stable")[:, :, None], axis=1)
    first, end = (np.clip(np.ceil(triangles[:, k, 1] - 0.5), 0, height).astype(np.int64) for k in (0, 2))
    which = np.repeat(np.arange(len(triangles)), end - first)
    row = _counted(first, end - first)
    spans = _spans(triangles, which, row, width)
    count = spans[1] - spans[0]
    chunk = np.cumsum(count) // AT_ONCE
    bounds = [0, *(np.flatnonzero(chunk[1:] != chunk[:-1]) + 1).tolist(), len(count)]
    slope, low = _planes(triangles)
    for part in (slice(a, b) for a, b in pairwise(bounds)):
        of, left, many = which[part], spans[0][part], count[part]
        near_left = low[of] + slope[of, 1] * (row[part] + 0.5) + slope[of, 0] * (left + 0.5)
        step = _counted(np.zeros_like(many), many)
        near = np.repeat(near_left, many) + np.repeat(slope[of, 0], many) * step
        key = np.clip((1.0 - near) * 2.0**32, 0.0, 2.0**32 - 1.0).astype(np.uint64) << HALF
        key |= np.repeat(numbers[of].astype(np.uint64), many)
        np.minimum.at(keys, np.repeat(row[part] * width + left, many) + step, key)
    return keys.reshape(height, width)


def _counted(first: IntArray, count: IntArray) -> IntArray:
    """first[0], first[0] + 1, ... (count[0] of them), first[1], ..."""
    return np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count - first, count)


def _spans(triangles: FloatArray, which: IntArray, row: IntArray, width: int) -> tuple[IntArray, IntArray]:
    """First and end of the samples that a triangle, its corners sorted downwards, covers in a row of a picture."""
    y = row.astype(np.float64) + 0.5
    a, b, c = (triangles[which, k, :2] for k in range(3))
    upper = (y < b[:, 1])[:, None]
    one, other = _crossing(a, c, y), _crossing(np.where(upper, a, b), np.where(upper, b, c), y)
    left, right = np.minimum(one, other), np.maximum(one, other)
    first, end = (np.clip(np.ceil(x - 0.5), 0, width).astype(np.int64) for x in (left, right))
    return first, end


def _crossing(a: FloatArray, b: FloatArray, y: FloatArray) -> FloatArray:
    """Where lines from a (k, 2) down to b (k, 2) are at heights y (k,)."""
    return np.asarray(a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))


def _planes(triangles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nearness as slopes along x and y (m, 2) and its value at 0 (m,)."""
    a, b, c = triangles.transpose(1, 0, 2)
    u, v = (b - a).T, (c - a).T
    area = u[0] * v[1] - u[1] * v[0]
    along = (u[2] * v[1] - u[1] * v[2]) / area
    down = (u[0] * v[2] - u[2] * v[0]) / area
    return np.stack([along, down], axis=-1), a[:, 2] - along * a[:, 0] - down * a[:, 1]


def _doubled_area(triangles: FloatArray) -> FloatArray:
    a, b, c = triangles.transpose(1, 0, 2)
    u, v = (b - a).T, (c - a).T
    return np.asarray(u[0] * v[1] - u[1] * v[0])


def _clipped(seen: FloatArray, numbers: IntArray, nearest: float) -> tuple[FloatArray, IntArray]:
    """Triangles cut off ``nearest`` metres ahead."""
    ahead = seen[:, :, 2] > nearest
    count = ahead[:, 0].astype(np.int64) + ahead[:, 1] + ahead[:, 2]
    whole, single, double = (np.flatnonzero(count == k) for k in (3, 1, 2))
    a, b, c = _from(seen[single], ahead[single])
    tips = np.stack([a, _cut(a, b, nearest), _cut(a, c, nearest)], axis=1)
    o, p, q = _from(seen[double], ~ahead[double])
    last = _cut(q, o, nearest)
    stumps = [np.stack(corners, axis=1) for corners in ((p, q, last), (p, last, _cut(p, o, nearest)))]
    order = np.concatenate([whole, single, double, double])
    return np.concatenate([seen[whole], tips, *stumps]), numbers[order]


def _from(triangles: FloatArray, which: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The corners of triangles (m, 3, 3), in their order, from the first of which ``which`` (m, 3) is true."""
    order = (which.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles, order[:, :, None], axis=1).transpose(1, 0, 2)
    return a, b, c


def _cut(a: FloatArray, b: FloatArray, nearest: float) -> FloatArray:
    """Where segments from a to b are ``nearest`` metres ahead, which one end is nearer than."""
    share = (nearest - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    cut = a + share * (b - a)
    cut[:, 2] = nearest
    return np.asarray(cut)
