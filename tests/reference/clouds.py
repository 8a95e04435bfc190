"""Clouds one cell after the other: which cubes hold a point, and how far points are from the nearest of these."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

__all__ = ["cells_of", "distances"]

Cell = tuple[int, int, int]


def cells_of(points: Iterable[Iterable[float]], edge: float) -> set[Cell]:
    """The cubes of a grid of this edge, in metres, that hold one of the points."""
    out = set[Cell]()
    for point in points:
        x, y, z = (math.floor(value / edge) for value in point)
        out.add((x, y, z))
    return out


def distances(points: NDArray[np.float64], cells: Iterable[Cell], edge: float) -> NDArray[np.float64]:
    """Metres from each point (n, 3) to the nearest of the cubes, 0 inside, (n,)."""
    out = np.full(len(points), np.inf)
    for cell in cells:
        low = np.array(cell) * edge
        off = np.maximum(np.maximum(low - points, points - (low + edge)), 0.0)
        out = np.minimum(out, np.sqrt((off * off).sum(axis=1)))
    return out
