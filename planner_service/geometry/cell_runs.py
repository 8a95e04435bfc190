"""Cells of a grid joined to boxes, and the order of boxes in which neighbours in the list are neighbours in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry.arrays import FloatArray, IntArray, order_of_rows

__all__ = ["CellRuns", "along_a_curve", "extremes", "joined"]

Number = TypeVar("Number", bound=np.generic)

BITS = 16
"""Bits of each coordinate along the curve."""

SPREAD = ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249))
"""Steps that move so many bits apart, and the bits that each leaves."""


@dataclass(frozen=True, eq=False)
class CellRuns:
    """The cells of a cloud joined to boxes: along z, then y, then x, each time those that together fill a larger one.

    Attributes:
        low, high: Corners (k, 3) of the boxes in whole edges, along a curve.
        keys: Where on the curve each is, (k,).
        around: The least and the largest sum of both corners, (2, 3): they place the curve.
    """

    low: IntArray
    high: IntArray
    keys: IntArray
    around: IntArray

    @classmethod
    def of(cls, cells: IntArray) -> CellRuns:
        """From sorted cells (n, 3), each once."""
        low, high = _joined_along(*_joined_in_slabs(cells), 0)
        both = low + high
        around = extremes(both)
        keys = _on_a_curve(both.astype(np.float64), around.astype(np.float64))
        order = np.argsort(keys, kind="stable")
        return cls(low[order], high[order], keys[order], around)

    def changed(self, cells: IntArray, slabs: IntArray) -> tuple[CellRuns | None, IntArray]:
        """The same of cells (n, 3) that are others only at some x (k,), and which of these boxes each is, -1 if none.

        Boxes that do not touch such a slab stay. None if the whole curve runs elsewhere.
        """
        nothing: IntArray = np.zeros(0, dtype=np.intp)
        if not len(slabs):
            return self, np.arange(len(self.low))
        first = int(min(self.low[:, 0].min(), slabs[0], cells[0, 0])) - 1
        marked = np.zeros(int(max(self.high[:, 0].max(), slabs[-1] + 1, cells[-1, 0] + 1)) - first + 2, dtype=bool)
        marked[slabs - first] = True
        before = np.concatenate([[0], np.cumsum(marked)])
        ends = self.low[:, 0] - first, self.high[:, 0] - first
        near = before[ends[1] + 1] > before[ends[0] - 1]
        kept = np.flatnonzero(~near)
        low, high = _cut_in_slabs(self.low[near], self.high[near])
        beside = ~marked[low[:, 0] - first]
        fresh = _joined_in_slabs(cells[marked[cells[:, 0] - first]])
        low, high = (np.concatenate([old[beside], new]) for old, new in zip((low, high), fresh, strict=True))
        low, high = _joined_along(low, high, 0)
        both = np.concatenate([self.low[kept] + self.high[kept], low + high])
        around = extremes(both)
        if not np.array_equal(around, self.around) or int((around[1] - around[0]).max()) >= 2**BITS:
            return None, nothing
        keys = _on_a_curve((low + high).astype(np.float64), around.astype(np.float64))
        order = np.argsort(keys, kind="stable")
        at = np.searchsorted(self.keys[kept], keys[order])
        old = (self.low[kept], self.high[kept], self.keys[kept], kept)
        new = (low[order], high[order], keys[order], np.full(len(order), -1))
        low, high, keys, origin = (np.insert(one, at, two, axis=0) for one, two in zip(old, new, strict=True))
        return CellRuns(low, high, keys, around), origin


def _joined_in_slabs(cells: IntArray) -> tuple[IntArray, IntArray]:
    """Corners of the boxes that cells of the same x make, joined along z, then y."""
    low, high = cells, cells + 1
    for axis in (2, 1):
        low, high = _joined_along(low, high, axis)
    return low, high


def _joined_along(low: IntArray, high: IntArray, axis: int) -> tuple[IntArray, IntArray]:
    if not len(low):
        return low, high
    columns = [column for k in (2, 1, 0) if k != axis for column in (low[:, k], high[:, k] - low[:, k])]
    return joined(low, high, axis, order_of_rows([*columns, low[:, axis]]))


def _cut_in_slabs(low: IntArray, high: IntArray) -> tuple[IntArray, IntArray]:
    """Boxes (k, 3) cut along x into boxes of one cell."""
    long = high[:, 0] - low[:, 0]
    low, high = np.repeat(low, long, axis=0), np.repeat(high, long, axis=0)
    low[:, 0] += np.arange(len(low)) - np.repeat(np.cumsum(long) - long, long)
    high[:, 0] = low[:, 0] + 1
    return low, high


def joined(
    low: NDArray[Number], high: NDArray[Number], axis: int, order: IntArray
) -> tuple[NDArray[Number], NDArray[Number]]:
    """Boxes (k, 3) after joining neighbours along an axis that together fill a larger box.

    Args:
        order: One in which such neighbours follow each other.
    """
    low, high = low[order], high[order]
    same = low[1:, axis] == high[:-1, axis]
    for k in range(3):
        if k != axis:
            same &= (low[1:, k] == low[:-1, k]) & (high[1:, k] == high[:-1, k])
    first = np.flatnonzero(np.concatenate([[True], ~same]))
    last = np.append(first[1:], len(low)) - 1
    merged = high[first]
    merged[:, axis] = high[last, axis]
    return low[first], merged


def along_a_curve(points: FloatArray) -> IntArray:
    """The order of points (k, 3) along a curve: neighbours in it are neighbours in space."""
    return np.argsort(_on_a_curve(points, extremes(points)), kind="stable")


def extremes(rows: NDArray[Number]) -> NDArray[Number]:
    """The least and the largest of each column of rows (k, n), (2, n)."""
    return np.array([[column.min() for column in rows.T], [column.max() for column in rows.T]])


def _on_a_curve(points: FloatArray, around: FloatArray) -> IntArray:
    """Where points (k, 3) are on a Z-order curve (Morton 1966) through a box around them, given by corners (2, 3)."""
    extent = float((around[1] - around[0]).max())
    scale = (2**BITS - 1) / extent if extent > 0.0 else 0.0
    whole = ((points - around[0]) * scale).astype(np.int64)
    for shift, mask in SPREAD:  # two zeros between any two bits
        whole = (whole | whole << shift) & mask
    return np.asarray(whole[:, 0] | whole[:, 1] << 1 | whole[:, 2] << 2)
