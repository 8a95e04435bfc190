"""How far apart the pairs of one configuration are at least, and how far touching ones overlap at most."""

from __future__ import annotations

import math

import numpy as np

from planner_service.collision import bounds
from planner_service.collision.bounds import Placed, Solids, centres_of
from planner_service.collision.pairs import Parts
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.robot.model import Robot

__all__ = ["NOT_FINITE", "Clearances"]

NOT_FINITE = "a configuration that is not finite reached the judge"

_LIKELY_SMALLEST = 8
"""Pairs with the smallest rough bounds, refined first."""

_REFINED_AT_ONCE = 64
"""Then so many at a time, as long as one could be smaller."""

_GROUP = 24
"""Pieces of a crowd that stand together, looked at as one box before one by one; 16 and 32 cost about the same on a
cloud of 10,000 boxes."""

_MANY_GROUPS = 4_096
"""Groups from which on boxes around some of them are looked at first."""

_ROUNDING = 1e-9
"""Metres by which the box around a group is larger: far above rounding."""


class Clearances:
    """Gaps and overlaps of one numbered list of parts; holds nothing that changes."""

    def __init__(self, robot: Robot, parts: Parts) -> None:
        self._robot = robot
        self._riders = n = parts.riding
        self._pairs, self._placing = parts.pairs, _Placing(parts)
        T = np.array([part.T for part in parts.parts[:n]]).reshape(-1, 4, 4)
        self._bodies = parts.bodies.astype(np.intp)
        self._R_part, self._t_part = T[:, :3, :3], T[:, :3, 3]
        self._t_part += (self._R_part @ centres_of(parts.shapes[:n])[..., None])[..., 0]
        self._crowds = _Crowds(parts, self._placing) if parts.crowds else None
        self._plain = _plain_pairs(parts)

    def smallest_gap(self, q: FloatArray) -> float:
        """A proven lower bound in metres of the smallest gap of any pair at q (n,), infinite without pairs.

        Raises:
            BrokenInvariant: q is not finite.
        """
        R, t = self._place(q)
        least = self._smallest(R, t, self._plain)
        if self._crowds is not None:
            least = min(least, self._smallest(R, t, self._crowds.nearest(R, t, None)))
            least = min(least, self._smallest(R, t, self._crowds.nearest(R, t, least)))
        return least

    def _smallest(self, R: FloatArray, t: FloatArray, pairs: IntArray) -> float:
        """Of some pairs: rough bounds of all first; then only those are refined that could be the smallest."""
        if len(pairs) == 0:
            return math.inf
        a, b = self._placed(R, t, pairs)
        rough = bounds.rough_gaps(a, b)
        order = np.argsort(rough, kind="stable")
        least, done, count = math.inf, 0, _LIKELY_SMALLEST
        while done < len(order) and rough[order[done]] <= least:
            likely = order[done : done + count]
            likely = likely[rough[likely] <= least]
            least = min(least, float(bounds.refined_gaps(a.take(likely), b.take(likely)).min()))
            done, count = done + len(likely), _REFINED_AT_ONCE
        return least

    def overlaps(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Upper bounds in metres of how far pairs (k,) overlap at q (n,); negative for a pair proven apart.

        Raises:
            BrokenInvariant: q is not finite.
        """
        R, t = self._place(q)
        return np.asarray(-bounds.refined_gaps(*self._placed(R, t, pairs)))

    def _place(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses of the riding parts: R (parts, 3, 3) and t (parts, 3)."""
        if not np.isfinite(q).all():
            raise BrokenInvariant(NOT_FINITE)
        poses = np.array(self._robot.body_poses(q.tolist()))
        R_body, t_body = poses[:, :9].reshape(-1, 3, 3)[self._bodies], poses[:, 9:][self._bodies]
        return R_body @ self._R_part, t_body + (R_body @ self._t_part[..., None])[..., 0]

    def _placed(self, R: FloatArray, t: FloatArray, pair: IntArray) -> tuple[Placed, Placed]:
        i, j = self._pairs.of(pair).T
        R_j, t_j = np.empty((len(j), 3, 3)), np.empty((len(j), 3))
        own = j < self._riders
        R_j[own], t_j[own] = R[j[own]], t[j[own]]
        R_j[~own], t_j[~own] = self._placing.of(j[~own])
        return Placed(self._placing.solids(i), R[i], t[i]), Placed(self._placing.solids(j), R_j, t_j)


class _Placing:
    """The solids of parts by their numbers, and where those are that stand."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self._centres = parts, centres_of(parts.kinds)

    def solids(self, part: IntArray) -> Solids:
        """The solids of parts."""
        return self._parts.solids.take(self._parts.numbers[part])

    def of(self, part: IntArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (k, 3, 3) and centres (k, 3) of parts that stand."""
        standing, number = self._parts.standing, part - self._parts.riding
        R = standing.rotations[standing.turns[number]]
        return R, standing.positions[number] + (R @ self._centres[self._parts.numbers[part], :, None])[..., 0]


def _plain_pairs(parts: Parts) -> IntArray:
    """The numbers of all pairs but those with a crowd."""
    runs = np.concatenate([np.zeros((0, 4), dtype=np.intp), *(parts.pairs.between(*run) for run in parts.crowds)])
    runs = runs[runs[:, 0].argsort()]
    begins, ends = [0, *(runs[:, 0] + runs[:, 3]).tolist()], [*runs[:, 0].tolist(), len(parts.pairs)]
    return np.concatenate([np.arange(begin, end) for begin, end in zip(begins, ends, strict=True)])


class _Crowds:
    """Obstacles of many pieces, as clouds are: groups of pieces that stand together."""

    def __init__(self, parts: Parts, placing: _Placing) -> None:
        starts = [np.arange(first, end, _GROUP) for first, end in parts.crowds]
        sizes = [np.minimum(start + _GROUP, run[1]) - start for start, run in zip(starts, parts.crowds, strict=True)]
        self._size = np.concatenate(sizes)
        crowd = np.concatenate([np.arange(*run) for run in parts.crowds])
        self._groups = _around(
            placing.solids(crowd), *placing.of(crowd), np.cumsum(self._size) - self._size, self._size
        )
        self._placing = placing
        self._first_pair = np.full((parts.riding, len(self._size)), -1, dtype=np.intp)
        column = 0
        for start, run in zip(starts, parts.crowds, strict=True):
            pairs = parts.pairs.between(*run)  # an obstacle is judged all or not at all
            self._first_pair[pairs[:, 1], column : column + len(start)] = pairs[:, :1] + (start - run[0])
            column += len(start)
        self._regions = _Regions(self._groups, self._first_pair >= 0) if column > _MANY_GROUPS else None

    def nearest(self, R: FloatArray, t: FloatArray, most: float | None) -> IntArray:
        """Pairs of groups that may be nearer than ``most`` metres to riding solids at R (riding, 3, 3), t (riding, 3).

        Args:
            most: None for the one group with the smallest bound.
        """
        if self._regions is None:
            i, group = np.nonzero(self._first_pair >= 0)
        else:
            i, group = self._regions.near(self._placing, R, t, most)
        if not len(i):  # whatever rides may touch the crowds
            return np.zeros(0, dtype=np.intp)
        gaps = bounds.rough_gaps(Placed(self._placing.solids(i), R[i], t[i]), self._groups.take(group))
        near = np.array([gaps.argmin()]) if most is None else np.flatnonzero(gaps <= most)
        firsts, sizes = self._first_pair[i[near], group[near]], self._size[group[near]]
        ranges = [np.arange(first, first + size) for first, size in zip(firsts.tolist(), sizes.tolist(), strict=True)]
        return np.concatenate([np.zeros(0, dtype=np.intp), *ranges])


class _Regions:
    """Boxes around groups that follow each other, where there are too many to look at each."""

    def __init__(self, groups: Placed, judged: BoolArray) -> None:
        """From the groups, and which of them each riding solid is judged against, (riding, groups)."""
        starts = np.arange(0, judged.shape[1], _GROUP)
        self._sizes = np.diff(starts, append=judged.shape[1])
        self._starts, self._judged = starts, judged
        self._boxes = _around(groups.solids, groups.R, groups.t, starts, self._sizes)

    def near(self, placing: _Placing, R: FloatArray, t: FloatArray, most: float | None) -> tuple[IntArray, IntArray]:
        """Riding solids and groups that may be nearer than ``most`` metres; None for those of one box around some."""
        i, region = np.nonzero(np.logical_or.reduceat(self._judged, self._starts, axis=1))
        if not len(i):
            return i, region
        gaps = bounds.rough_gaps(Placed(placing.solids(i), R[i], t[i]), self._boxes.take(region))
        near = np.array([gaps.argmin()]) if most is None else np.flatnonzero(gaps <= most)
        i, region, count = i[near], region[near], self._sizes[region[near]]
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        i, group = np.repeat(i, count), np.repeat(self._starts[region], count) + within
        judged = self._judged[i, group]
        return i[judged], group[judged]


def _around(solids: Solids, R: FloatArray, t: FloatArray, firsts: IntArray, sizes: IntArray) -> Placed:
    """Boxes around groups of solids that stand one after the other, along the axes of the first of each."""
    group = np.repeat(np.arange(len(firsts)), sizes)
    turn = R[firsts].transpose(0, 2, 1)
    reach = bounds.box_of(solids, turn[group] @ R)
    centre = (turn[group] @ t[..., None])[..., 0]
    low, high = np.minimum.reduceat(centre - reach, firsts), np.maximum.reduceat(centre + reach, firsts)
    none = np.zeros(len(firsts))
    half = 0.5 * (high - low) + _ROUNDING
    around = Solids(half, none, none, np.full(len(firsts), -1, dtype=np.intp), ())
    return Placed(around, R[firsts], (R[firsts] @ (0.5 * (low + high))[..., None])[..., 0])
