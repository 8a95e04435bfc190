"""Obstacles of many pieces, as clouds are: pieces that stand together are looked at as one box before one by one.

Like the other sieves these only say "apart" when that is proven, and leave the rest for FCL.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner_service.collision.bounds import Boxes, Placed, Solids, beyond_faces, box_of, rough_gaps
from planner_service.collision.pairs import Parts
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Crowds"]


GROUP = 24
"""Pieces that stand together; 16 and 32 cost about the same on a cloud of 10,000 boxes."""

AT_ONCE = 20_000
"""Pairs looked at in one go, so that memory stays small."""

FEW = 200
"""Groups up to which a look at all pieces in them takes no longer than one at more separating axes."""

LEFT_TO_FCL = 20
"""Pieces about which FCL is asked in less time than separating axes take."""

ROUNDING = 1e-9
"""Metres by which the box around a group is larger: far above rounding."""


class _Riders(NamedTuple):
    """Riding solids in m configurations: poses, lower and upper corners of the boxes around them, (m, riding, ...)."""

    R: FloatArray
    t: FloatArray
    low: FloatArray
    high: FloatArray
    margin: float

    def boxes(self, half: FloatArray, row: IntArray, i: IntArray) -> Boxes:
        """The boxes of solids i along their own axes, in configurations ``row``."""
        return Boxes(half[i], self.R[row, i], self.t[row, i])

    def placed(self, solids: Solids, row: IntArray, i: IntArray) -> Placed:
        """The solids i in configurations ``row``."""
        return Placed(solids.take(i), self.R[row, i], self.t[row, i])


class Crowds:
    """The groups of the crowds among the parts, and which pairs these are.

    Attributes:
        pairs: Which of the pairs have a crowd's piece, (p,).
    """

    def __init__(self, parts: Parts, solids: Solids, R: FloatArray, t: FloatArray) -> None:
        """From the solids of all parts, and poses R (s, 3, 3), t (s, 3) of those that stand, after the riding ones."""
        n = parts.riding
        crowds = parts.crowds
        starts = [k for first, end in crowds for k in range(first, end, GROUP)]
        ends = [min(k + GROUP, end) for first, end in crowds for k in range(first, end, GROUP)]
        self._start, self._size = np.array(starts, dtype=np.intp), np.subtract(ends, starts, dtype=np.intp)
        crowd = np.concatenate([np.zeros(0, dtype=np.intp), *(np.arange(*run) for run in crowds)])
        firsts = np.cumsum(self._size) - self._size
        self._groups = _around(solids.take(crowd), R[crowd - n], t[crowd - n], firsts, self._size)
        reach = box_of(self._groups.solids, self._groups.R)
        self._low, self._high = self._groups.t - reach, self._groups.t + reach
        own = box_of(solids.take(slice(n, None)), R)
        members = self._start[:, None] - n + np.arange(GROUP)
        real = np.arange(GROUP) < self._size[:, None]
        members = np.where(real, members, 0)
        self._low_members = np.where(real[..., None], (t - own)[members], np.inf)  # what is none meets nothing
        self._high_members = np.where(real[..., None], (t + own)[members], -np.inf)
        self._riding, self._solids = n, solids
        self._half, self._boxes = solids.box[:n], Boxes(solids.box[n:], R, t)
        self._group_boxes = Boxes(self._groups.solids.box, self._groups.R, self._groups.t)
        in_crowd = np.zeros(len(parts.parts), dtype=bool)
        in_crowd[crowd] = True
        self.pairs: BoolArray = in_crowd[parts.pairs[:, 1]]
        column = np.full(len(parts.parts), -1, dtype=np.intp)
        column[self._start] = np.arange(len(self._start))
        starting = np.flatnonzero(column[parts.pairs[:, 1]] >= 0)
        i, j = parts.pairs[starting].T
        self._first_pair = np.full((n, len(self._start)), -1, dtype=np.intp)
        self._first_pair[i, column[j]] = starting

    def candidates(self, R: FloatArray, t: FloatArray, reach: FloatArray, margin: float) -> tuple[IntArray, IntArray]:
        """Rows and pairs not proven farther apart than ``margin``, in no order.

        Args:
            R, t: Poses of the riding solids in m configurations, (m, riding, 3, 3) and (m, riding, 3).
            reach: Half lengths of the boxes around them along the world's axes, the margin included, (m, riding, 3).
        """
        low, high = t - reach, t + reach
        riders = _Riders(R, t, low, high, margin)
        meet = _meet(low.min(axis=0)[:, None], high.max(axis=0)[:, None], self._low, self._high)
        i, group = np.nonzero(meet & (self._first_pair >= 0))
        if len(t) == 1:
            row = np.zeros_like(i)
        else:
            row, column = np.nonzero(_meet(low[:, i], high[:, i], self._low[group], self._high[group]))
            i, group = i[column], group[column]
        if len(row):
            left = np.concatenate([self._sieved(riders, row[k], i[k], group[k]) + k.start for k in _slices(row)])
            row, i, group = row[left], i[left], group[left]
        if not len(row):
            return row, row
        rows, pairs = [row[:0]], [row[:0]]
        for k in _slices(row, GROUP):
            members = self._members(riders, row[k], i[k], group[k])
            rows.append(members[0])
            pairs.append(members[1])
        return np.concatenate(rows), np.concatenate(pairs)

    def _sieved(self, riders: _Riders, row: IntArray, i: IntArray, group: IntArray) -> IntArray:
        """Which of some riding solids i and groups, in configurations ``row``, are not proven apart."""
        apart = beyond_faces(riders.boxes(self._half, row, i), self._group_boxes.take(group), riders.margin)
        left = np.flatnonzero(~apart)
        if len(left) > FEW:
            rough = rough_gaps(riders.placed(self._solids, row[left], i[left]), self._groups.take(group[left]))
            left = left[rough <= riders.margin]
        return left

    def _members(self, riders: _Riders, row: IntArray, i: IntArray, group: IntArray) -> tuple[IntArray, IntArray]:
        """Rows and pairs of the pieces of such groups that are not proven apart either."""
        low, high = riders.low[row, i][:, None], riders.high[row, i][:, None]
        which, place = np.nonzero(_meet(low, high, self._low_members[group], self._high_members[group]))
        row, i, group = row[which], i[which], group[which]
        pair, part = self._first_pair[i, group] + place, self._start[group] - self._riding + place
        if len(row) > LEFT_TO_FCL:
            apart = beyond_faces(riders.boxes(self._half, row, i), self._boxes.take(part), riders.margin)
            left = np.flatnonzero(~apart)
            if len(left) > LEFT_TO_FCL:
                rough = rough_gaps(riders.placed(self._solids, row[left], i[left]), self._pieces(part[left]))
                left = left[rough <= riders.margin]
            row, pair = row[left], pair[left]
        return row, pair

    def nearest(self, R: FloatArray, t: FloatArray, most: float | None) -> IntArray:
        """Pairs of one configuration (1, riding, ...): of groups that may be nearer than ``most`` metres.

        Args:
            most: None for the one group with the smallest bound.
        """
        i, group = np.nonzero(self._first_pair >= 0)
        if not len(i):  # whatever rides may touch the crowds
            return np.zeros(0, dtype=np.intp)
        gaps = rough_gaps(Placed(self._solids.take(i), R[0, i], t[0, i]), self._groups.take(group))
        near = np.array([gaps.argmin()]) if most is None else np.flatnonzero(gaps <= most)
        firsts, sizes = self._first_pair[i[near], group[near]], self._size[group[near]]
        ranges = [np.arange(first, first + size) for first, size in zip(firsts.tolist(), sizes.tolist(), strict=True)]
        return np.concatenate([np.zeros(0, dtype=np.intp), *ranges])

    def _pieces(self, part: IntArray) -> Placed:
        return Placed(self._solids.take(part + self._riding), self._boxes.R[part], self._boxes.t[part])


def _meet(low: FloatArray, high: FloatArray, other_low: FloatArray, other_high: FloatArray) -> BoolArray:
    """Whether boxes overlap, by their lower and upper corners (..., 3)."""
    out = (low[..., 0] <= other_high[..., 0]) & (high[..., 0] >= other_low[..., 0])
    for k in (1, 2):
        out &= (low[..., k] <= other_high[..., k]) & (high[..., k] >= other_low[..., k])
    return np.asarray(out)


def _slices(rows: IntArray, each: int = 1) -> list[slice]:
    """Of rows that stand for ``each`` pairs."""
    step = max(1, AT_ONCE // each)
    return [slice(k, k + step) for k in range(0, len(rows), step)]


def _around(solids: Solids, R: FloatArray, t: FloatArray, firsts: IntArray, sizes: IntArray) -> Placed:
    """Boxes around groups of solids that stand one after the other, along the axes of the first of each."""
    group = np.repeat(np.arange(len(firsts)), sizes)
    turn = R[firsts].transpose(0, 2, 1)
    reach = box_of(solids, turn[group] @ R)
    centre = (turn[group] @ t[..., None])[..., 0]
    low, high = np.minimum.reduceat(centre - reach, firsts), np.maximum.reduceat(centre + reach, firsts)
    none = np.zeros(len(firsts))
    half = 0.5 * (high - low) + ROUNDING
    around = Solids(half, none, none, np.full(len(firsts), -1, dtype=np.intp), ())
    return Placed(around, R[firsts], (R[firsts] @ (0.5 * (low + high))[..., None])[..., 0])
