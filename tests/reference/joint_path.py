"""Laying out paths in Python: the same bits as native/path/path.cpp."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.path.joint_path import MIN_FORWARD, OVERSHOOT

__all__ = ["Layout", "allowed_blends", "layout", "pieces", "polyline_length", "turns_back"]

MERGE, MERGE_SHARE = 1e-12, 2e-15
COLLINEAR, ROUNDING, NOISY = 1e-12, 1e-15, 1e-9

Layout = tuple[FloatArray, FloatArray, FloatArray, tuple[int, ...]]
"""Points, knots, tangents and turns."""


def distances(points: FloatArray) -> FloatArray:
    """L2 distance between successive rows, summed joint by joint."""
    steps = points[1:] - points[:-1]
    return np.asarray(np.sqrt(np.add.accumulate(steps * steps, axis=1)[:, -1]))


def polyline_length(points: FloatArray) -> float:
    """L2 length of a polyline (N, n)."""
    return math.fsum(distances(points).tolist())


def merged(points: FloatArray) -> FloatArray:
    """The points without those that coincide with the one before; the first and last stay bit for bit."""
    steps, total = distances(points), 0.0
    for step in steps.tolist():
        total += step
    near = max(MERGE, MERGE_SHARE * total)
    if not steps.size or steps.min() > near:
        return points
    kept = [0]
    for k in range(1, len(points)):
        if distances(points[[kept[-1], k]])[0] > near:
            kept.append(k)
    last = len(points) - 1
    if kept[-1] != last:
        while len(kept) > 1 and distances(points[[kept[-1], last]])[0] <= near:
            kept.pop()
        if distances(points[[kept[-1], last]])[0] > 0.0:
            kept.append(last)
    return points[kept]


def layout(given: FloatArray) -> Layout:
    """What ``JointPath`` is made of before its blends."""
    points = merged(given)
    steps = distances(points)
    knots = np.array(list(accumulate(steps.tolist(), initial=0.0)))
    lengths, moves = knots[1:] - knots[:-1], points[1:] - points[:-1]
    tangents = moves / steps[:, np.newaxis]
    turns: tuple[int, ...] = ()
    if len(points) > 2:
        change = np.abs(tangents[1:] - tangents[:-1]).max(axis=1)
        inverse = 1.0 / lengths
        noise = ROUNDING * np.abs(points).max() * (inverse[1:] + inverse[:-1])
        turning = change > COLLINEAR + noise
        if noise.max() > NOISY:
            turning |= turned(tangents, lengths, ROUNDING * np.abs(points).max(), turning)
        turns = tuple((np.flatnonzero(turning) + 1).tolist())
    return points, knots, tangents, turns


def turns_back(tangents: FloatArray, k: int) -> bool:
    """Whether the corner at inner point k almost turns back."""
    before, after = tangents[k - 1 : k + 1].tolist()
    squares = [(u + v) * (u + v) for u, v in zip(before, after, strict=True)]
    return math.fsum(squares) < MIN_FORWARD * MIN_FORWARD


def turned(tangents: FloatArray, lengths: FloatArray, rounding: float, turning: BoolArray) -> BoolArray:
    """Which inner points are corners made of many pieces, each too short for an exact direction.

    Each piece is compared with the longest one since the last corner, whose direction is the most exact.
    """
    turned = np.zeros_like(turning)
    best = 0
    for k in range(1, len(tangents)):
        noise = rounding / lengths[k] + rounding / lengths[best]
        turned[k - 1] = np.abs(tangents[k] - tangents[best]).max() > COLLINEAR + noise
        if turned[k - 1] or turning[k - 1] or lengths[k] >= lengths[best]:
            best = k
    return turned


def allowed_blends(laid: Layout, widths: Sequence[float]) -> list[float]:
    """The widths at corners, 0 elsewhere; a ``ValueError`` says which are none.

    Raises:
        ValueError: A blend turns back, or two overlap.
    """
    _, knots, tangents, turns = laid
    kept, lengths = [0.0] * len(widths), (knots[1:] - knots[:-1]).tolist()
    for k in turns:
        kept[k] = widths[k]
        if kept[k] > 0.0 and turns_back(tangents, k):
            raise ValueError(f"blends[{k}]")
    over = [a + b - length for (a, b), length in zip(pairwise(kept), lengths, strict=True)]
    if any(excess > OVERSHOOT * max(pair) for excess, pair in zip(over, pairwise(kept), strict=True)):
        k = over.index(max(over))
        raise ValueError(f"blends[{k}:{k + 2}]")
    return kept


def pieces(knots: Sequence[float], blends: Sequence[float]) -> Iterator[tuple[float, int, int]]:
    """Each piece between breaks: where it starts, the line it is part of, and the row of its blend or -1."""
    row, at = -1, 0.0
    for k in range(len(knots) - 1):
        if blends[k] > 0.0:
            row += 1
            yield at, k, row
            at = knots[k] + blends[k]
        end = knots[k + 1] - blends[k + 1]
        if end > at:
            yield at, k, -1
            at = end
