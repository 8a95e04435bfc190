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

_ROUNDING = 1e-9
"""Metres by which the box around a group is larger: far above rounding."""


class Clearances:
    """Gaps and overlaps of one numbered list of parts; holds nothing that changes."""

    def __init__(self, robot: Robot, parts: Parts) -> None:
        self._robot = robot
        self._riders = parts.riding
        self._solids = parts.solids
        n = parts.riding
        T = np.array([part.T for part in parts.parts]).reshape(-1, 4, 4)
        T[:, :3, 3] += (T[:, :3, :3] @ centres_of(parts.shapes)[..., None])[..., 0]
        self._bodies = np.array([part.body for part in parts.parts[:n]], dtype=np.intp)
        self._R_part, self._t_part = T[:n, :3, :3].copy(), T[:n, :3, 3].copy()
        self._R_world, self._t_world = T[n:, :3, :3].copy(), T[n:, :3, 3].copy()
        self._i, self._j = parts.pairs[:, 0], parts.pairs[:, 1]
        self._crowds = _Crowds(parts, self._solids, self._R_world, self._t_world) if parts.crowds else None
        plain = np.ones(len(parts.pairs), dtype=bool) if self._crowds is None else ~self._crowds.pairs
        self._plain = np.flatnonzero(plain)

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
        i, j, n = self._i[pair], self._j[pair], self._riders
        R_j, t_j = np.empty((len(j), 3, 3)), np.empty((len(j), 3))
        own = j < n
        R_j[own], t_j[own] = R[j[own]], t[j[own]]
        R_j[~own], t_j[~own] = self._R_world[j[~own] - n], self._t_world[j[~own] - n]
        return Placed(self._solids.take(i), R[i], t[i]), Placed(self._solids.take(j), R_j, t_j)


class _Crowds:
    """Obstacles of many pieces, as clouds are: groups of pieces that stand together, and which pairs these are.

    Attributes:
        pairs: Which of the pairs have a crowd's piece, (p,).
    """

    def __init__(self, parts: Parts, solids: Solids, R: FloatArray, t: FloatArray) -> None:
        """From the solids of all parts, and poses R (s, 3, 3), t (s, 3) of those that stand, after the riding ones."""
        n, crowds = parts.riding, parts.crowds
        starts = [k for first, end in crowds for k in range(first, end, _GROUP)]
        ends = [min(k + _GROUP, end) for first, end in crowds for k in range(first, end, _GROUP)]
        start, self._size = np.array(starts, dtype=np.intp), np.subtract(ends, starts, dtype=np.intp)
        crowd = np.concatenate([np.zeros(0, dtype=np.intp), *(np.arange(*run) for run in crowds)])
        firsts = np.cumsum(self._size) - self._size
        self._groups = _around(solids.take(crowd), R[crowd - n], t[crowd - n], firsts, self._size)
        self._solids = solids
        in_crowd = np.zeros(len(parts.parts), dtype=bool)
        in_crowd[crowd] = True
        self.pairs: BoolArray = in_crowd[parts.pairs[:, 1]]
        column = np.full(len(parts.parts), -1, dtype=np.intp)
        column[start] = np.arange(len(start))
        starting = np.flatnonzero(column[parts.pairs[:, 1]] >= 0)
        i, j = parts.pairs[starting].T
        self._first_pair = np.full((n, len(start)), -1, dtype=np.intp)
        self._first_pair[i, column[j]] = starting

    def nearest(self, R: FloatArray, t: FloatArray, most: float | None) -> IntArray:
        """Pairs of groups that may be nearer than ``most`` metres to riding solids at R (riding, 3, 3), t (riding, 3).

        Args:
            most: None for the one group with the smallest bound.
        """
        i, group = np.nonzero(self._first_pair >= 0)
        if not len(i):  # whatever rides may touch the crowds
            return np.zeros(0, dtype=np.intp)
        gaps = bounds.rough_gaps(Placed(self._solids.take(i), R[i], t[i]), self._groups.take(group))
        near = np.array([gaps.argmin()]) if most is None else np.flatnonzero(gaps <= most)
        firsts, sizes = self._first_pair[i[near], group[near]], self._size[group[near]]
        ranges = [np.arange(first, first + size) for first, size in zip(firsts.tolist(), sizes.tolist(), strict=True)]
        return np.concatenate([np.zeros(0, dtype=np.intp), *ranges])


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
