"""Which pairs FCL has to be asked about: all but those proven apart, for a whole batch of configurations.

Three sieves, each cheaper per pair than the next: world-aligned boxes swept over the whole batch;
the same boxes per configuration; separating axes for what is left. A pair that passes as "apart" is apart by more
than ``MARGIN`` in exact arithmetic, beyond the micrometre in which FCL's own answer is undefined
and far beyond rounding (1e-15), so FCL would say the same. Where the kernel was not built, this stands in for it.
"""

from __future__ import annotations

import numpy as np

from planner_service.collision import bounds
from planner_service.collision.bounds import Placed, Solids, centres_of, parted
from planner_service.collision.numpy_groups import Crowds
from planner_service.collision.pairs import Parts
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.robot.model import Robot

__all__ = ["MARGIN", "NOT_FINITE", "Broadphase"]

MARGIN = 2e-6
"""Metres by which a pair must be proven apart for FCL not to be asked; ``doubt_of`` small solids comes on top."""

NOT_FINITE = "a configuration that is not finite reached the judge"

_FEW = 10
"""Up to this many configurations scalar kinematics are faster than arrays."""

_ASKED_AT_ONCE = 30
"""Up to this many pairs FCL is faster than a look at their separating axes; for a single configuration it always is:
one with many boxes overlapping collides, and FCL finds out at the first pairs."""

_LIKELY_SMALLEST = 8
"""Pairs with the smallest rough bounds, refined first."""

_REFINED_AT_ONCE = 64
"""Then so many at a time, as long as one could be smaller."""


class Broadphase:
    """The sieves for one numbered list of parts; holds nothing that changes."""

    def __init__(self, robot: Robot, parts: Parts) -> None:
        self._robot = robot
        self._parts = parts
        self._solids = Solids.of(parts.shapes)
        self._margin = MARGIN + bounds.doubt_of(self._solids)
        n = parts.riding
        T = np.array([part.T for part in parts.parts]).reshape(-1, 4, 4)
        T[:, :3, 3] += (T[:, :3, :3] @ centres_of(parts.shapes)[..., None])[..., 0]
        self._bodies = np.array([part.body for part in parts.parts[:n]], dtype=np.intp)
        self._R_part, self._t_part = T[:n, :3, :3].copy(), T[:n, :3, 3].copy()
        self._R_world, self._t_world = T[n:, :3, :3].copy(), T[n:, :3, 3].copy()
        reach = bounds.box_of(self._solids.take(slice(n, None)), self._R_world)
        self._low_world, self._high_world = self._t_world - reach, self._t_world + reach
        self._riding = self._solids.take(slice(n))
        self._i, self._j = parts.pairs[:, 0], parts.pairs[:, 1]
        self._crowds = Crowds(parts, self._solids, self._R_world, self._t_world) if parts.crowds else None
        plain = np.ones(len(parts.pairs), dtype=bool) if self._crowds is None else ~self._crowds.pairs
        self._plain = np.flatnonzero(plain)
        self._i_plain, self._j_plain = self._i[self._plain], self._j[self._plain]
        self._with_hull = (self._solids.hulls[self._i] >= 0) | (self._solids.hulls[self._j] >= 0)

    def candidates(self, Q: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows of Q (m, n) and the numbers of their pairs that are not proven apart, sorted by row, then pair."""
        R, t = self._place(Q)
        reach = bounds.box_of(self._riding, R) + self._margin
        row, pair = self._overlapping(t, reach)
        rough = len(row) > _ASKED_AT_ONCE and len(Q) > 1
        if rough:
            left = bounds.rough_gaps(*self._placed(R, t, row, pair)) <= self._margin
            row, pair = row[left], pair[left]
        if self._crowds is not None:
            rows, pairs = self._crowds.candidates(R, t, reach, self._margin)
            if len(rows):
                row, pair = np.concatenate([row, rows]), np.concatenate([pair, pairs])
                order = np.lexsort((pair, row))
                row, pair = row[order], pair[order]
            rough = len(row) > _ASKED_AT_ONCE and len(Q) > 1
        if rough and len(row) and self._with_hull[pair].any():
            row, pair = self._parted(R, t, row, pair)
        return row, pair

    def _parted(self, R: FloatArray, t: FloatArray, row: IntArray, pair: IntArray) -> tuple[IntArray, IntArray]:
        """What is left of rows and pairs once hulls are looked at as they are, not as the boxes around them."""
        hulls = np.flatnonzero(self._with_hull[pair])
        left = np.ones(len(pair), dtype=bool)
        left[hulls] = ~parted(*self._placed(R, t, row[hulls], pair[hulls]), self._margin)
        return row[left], pair[left]

    def smallest_gap(self, q: FloatArray) -> float:
        """A proven lower bound in metres of the smallest gap of any pair at q (n,), infinite without pairs."""
        R, t = self._place(q[None])
        least = self._smallest(R, t, self._plain)
        if self._crowds is not None:
            least = min(least, self._smallest(R, t, self._crowds.nearest(R, t, None)))
            least = min(least, self._smallest(R, t, self._crowds.nearest(R, t, least)))
        return least

    def _smallest(self, R: FloatArray, t: FloatArray, pairs: IntArray) -> float:
        """Of some pairs: rough bounds of all first; then only those are refined that could be the smallest."""
        if len(pairs) == 0:
            return float("inf")
        a, b = self._placed(R, t, np.zeros_like(pairs), pairs)
        rough = bounds.rough_gaps(a, b)
        order = np.argsort(rough, kind="stable")
        least, done, count = float("inf"), 0, _LIKELY_SMALLEST
        while done < len(order) and rough[order[done]] <= least:
            likely = order[done : done + count]
            likely = likely[rough[likely] <= least]
            least = min(least, float(bounds.refined_gaps(a.take(likely), b.take(likely)).min()))
            done, count = done + len(likely), _REFINED_AT_ONCE
        return least

    def overlaps(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Upper bounds in metres of how far pairs (k,) overlap at q (n,); negative for a pair proven apart."""
        R, t = self._place(q[None])
        return np.asarray(-bounds.refined_gaps(*self._placed(R, t, np.zeros_like(pairs), pairs)))

    def _place(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses of the riding parts: R (m, parts, 3, 3) and t (m, parts, 3).

        Rounding is free to differ from CPU to CPU here, unlike in the poses FCL gets: ``MARGIN`` covers it.

        Raises:
            BrokenInvariant: Q is not finite: no sieve would find anything near.
        """
        if not np.isfinite(Q).all():
            raise BrokenInvariant(NOT_FINITE)
        if len(Q) <= _FEW:
            numbers = np.array([self._robot.body_poses(q) for q in Q.tolist()])
            R_body, t_body = numbers[..., :9].reshape(*numbers.shape[:2], 3, 3), numbers[..., 9:]
        else:
            R_body, t_body = self._robot.body_poses_batch(Q)
        R_body, t_body = R_body[:, self._bodies], t_body[:, self._bodies]
        return R_body @ self._R_part, t_body + (R_body @ self._t_part[..., None])[..., 0]

    def _overlapping(self, t: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and pairs whose world-aligned boxes overlap: first those swept by the batch, then row by row."""
        low, high = t - reach, t + reach
        swept_low = np.concatenate([low.min(axis=0), self._low_world])
        swept_high = np.concatenate([high.max(axis=0), self._high_world])
        i, j = self._i_plain, self._j_plain
        pair = self._plain[((swept_low[i] <= swept_high[j]) & (swept_high[i] >= swept_low[j])).all(axis=-1)]
        if len(t) == 1:
            return np.zeros_like(pair), pair
        i, j = self._i[pair], self._j[pair]
        own = j < self._parts.riding
        low_j, high_j = np.empty((len(t), len(j), 3)), np.empty((len(t), len(j), 3))
        low_j[:, own], high_j[:, own] = low[:, j[own]], high[:, j[own]]
        low_j[:, ~own], high_j[:, ~own] = swept_low[j[~own]], swept_high[j[~own]]
        row, column = np.nonzero(((low[:, i] <= high_j) & (high[:, i] >= low_j)).all(axis=-1))
        return row, pair[column]

    def _placed(self, R: FloatArray, t: FloatArray, row: IntArray, pair: IntArray) -> tuple[Placed, Placed]:
        i, j = self._i[pair], self._j[pair]
        n = self._parts.riding
        R_j, t_j = np.empty((len(j), 3, 3)), np.empty((len(j), 3))
        own = j < n
        R_j[own], t_j[own] = R[row[own], j[own]], t[row[own], j[own]]
        R_j[~own], t_j[~own] = self._R_world[j[~own] - n], self._t_world[j[~own] - n]
        return Placed(self._solids.take(i), R[row, i], t[row, i]), Placed(self._solids.take(j), R_j, t_j)
