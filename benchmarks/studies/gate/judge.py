"""Whether an arm that is moved along straight ways touches anything, by Coal, looking every 0.2 mm or closer.

Each pair of shapes is looked at for itself: where Coal says how far the two are apart, no look is needed until their
joints have moved them so far, by the auditor's own bound of that pair's motion. So fewer looks tell as much, and ways
beside each other share them.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from auditor.checker import IndependentChecker
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["LOOK", "Corners", "Hit", "Judge"]

LOOK = 0.0002
"""Metres that a pair moves, at most, on a line of which one look in the middle is enough, whatever it says."""

TRUSTED = 0.9
"""Of a distance that Coal states, the share on which a longer step relies."""

SLOPE = 1e-4
"""Radians (or metres) for the gap's slope."""

SWEEPS = 4
"""Over all joints, in the search for the corner of a room that is nearest to contact."""

MANY = 24
"""Pairs; where more are asked for in one place, what is known is from there on."""

STRIDES = (16, 4, 1)
"""Corners of a way of which the middle one is looked at first."""


@dataclass(frozen=True)
class Hit:
    """Where something touches.

    Attributes:
        what: The pair, as ``a x b``.
        at: The configuration.
        line: The number of the line that it is on; -1 at a corner.
    """

    what: str
    at: tuple[float, ...]
    line: int


@dataclass(frozen=True, eq=False)
class Corners:
    """Places on a way, and what is known of them.

    Attributes:
        places: Configurations (m, n).
        room: Metres that each pair may move from there before it may touch, as far as was looked, (m, pairs); below 0
            where nothing is known.
    """

    places: FloatArray
    room: FloatArray


class Judge:
    """Looks at ways of one robot in one scene.

    Two looks at a pair, with gaps g and h, at the ends of a line on which it moves less than g + h by the auditor's
    bound are enough: whatever is on the line is nearer to one of its ends than that end's gap. The bound is the sum of
    what each joint moves the pair at most, so it holds between any two configurations, on a line or beside it, and a
    look at one way tells of others. Nine tenths of a gap are relied on.

    Attributes:
        looks: Gaps that Coal was asked for.
        nearest: The smallest of them since it was set to infinity, and where that was, (n,).
    """

    def __init__(self, checker: IndependentChecker) -> None:
        self._checker = checker
        self.reach, self.reaches = checker.reach, checker.pair_reaches()
        self.looks = 0
        self.nearest: tuple[float, FloatArray] = (np.inf, np.empty(0))
        self._place: FloatArray = np.zeros(len(checker.joints))
        self._room: FloatArray = np.full(len(self.reaches), -np.inf)  # known there

    def moved(self, name: str, position: ArrayLike, quaternion: ArrayLike) -> Judge:
        """The judge of the same scene with an obstacle elsewhere; see ``IndependentChecker.moved``."""
        other = copy(self)
        other._checker = self._checker.moved(name, position, quaternion)
        other._room = np.full(len(self.reaches), -np.inf)
        return other

    def gap(self, q: FloatArray) -> float:
        """The smallest of Coal's distances at q (n,), metres."""
        return float(self._smallest(q, 0.0)[1].min())

    def walked(self, points: FloatArray) -> Hit | None:
        """What touches on a polyline (m + 1, n)."""
        ends = np.arange(len(points))
        return self.touched(points[:-1], points[1:], self.corners(points), np.stack([ends[:-1], ends[1:]], axis=1))

    def corners(self, places: FloatArray) -> Corners:
        """Places (m, n) of a way of which nothing is known yet."""
        return Corners(places, np.full((len(places), len(self.reaches)), -np.inf))

    def touched(self, a: FloatArray, b: FloatArray, corners: Corners, near: IntArray) -> Hit | None:
        """What touches on straight lines, or at corners that were looked at.

        Args:
            a: Where they begin, (s, n).
            b: Where they end, (s, n).
            corners: Places near them, each on one of the ways; what is learnt of them is kept there.
            near: The numbers of the corners near the beginning and the end of each line, (s, 2).
        """
        count, some = len(corners.places), self._any(a, b, corners)
        lines = np.flatnonzero(np.ones(len(a)))
        for stride in (*STRIDES, 0):
            first, last = near[lines].T
            R, room = self.reaches[some].T, corners.room[:, some]
            spare_a = room[first] - np.abs(a[lines] - corners.places[first]) @ R
            spare_b = room[last] - np.abs(b[lines] - corners.places[last]) @ R
            unclear = _unclear(spare_a, spare_b, np.abs(b[lines] - a[lines]) @ R)
            rows, columns = unclear.any(axis=1), unclear.any(axis=0)
            lines, some, R, unclear = lines[rows], some[columns], R[:, columns], unclear[np.ix_(rows, columns)]
            if not len(lines):
                return None
            if not stride:
                break
            wanted = np.zeros((count, len(some)), dtype=bool)
            for column in (first[rows], last[rows]):
                np.logical_or.at(wanted, column, unclear)
            begins = np.arange(0, count, stride)
            asked = np.logical_or.reduceat(wanted, begins)
            middles = np.minimum(begins + stride // 2, count - 1)
            blocks = np.flatnonzero(asked.any(axis=1))
            hit, found = self._looked(corners.places[middles[blocks]], asked[blocks], some, np.full(len(blocks), -1))
            if hit is not None:
                return hit
            for block, gaps in zip(blocks.tolist(), found, strict=True):
                part = slice(block * stride, min(block * stride + stride, count))
                moved = np.abs(corners.places[part] - corners.places[middles[block]]) @ R
                corners.room[part, some] = np.maximum(corners.room[part, some], gaps - moved)
        left = np.ix_(rows, columns)
        return self._halved(a[lines], b[lines], some, unclear, spare_a[left], spare_b[left], lines)

    def _any(self, a: FloatArray, b: FloatArray, corners: Corners) -> IntArray:
        """The pairs that may touch on any of some lines, by what is known of one place."""
        left = self._reached(a, b, np.arange(len(self.reaches)))
        if not len(left):
            return left
        middle = corners.places[len(corners.places) // 2]
        self._room -= self.reaches @ np.abs(middle - self._place)
        self._place = middle
        self._room[left] = TRUSTED * self._gaps(middle, left)
        left = self._reached(a, b, left)
        known = self._room[left] - np.abs(corners.places - middle) @ self.reaches[left].T
        corners.room[:, left] = np.maximum(corners.room[:, left], known)
        return left

    def _reached(self, a: FloatArray, b: FloatArray, pairs: IntArray) -> IntArray:
        off = np.maximum(np.abs(a - self._place), np.abs(b - self._place)).max(axis=0, initial=0.0)
        left: IntArray = pairs[self.reaches[pairs] @ off >= self._room[pairs]]
        return left

    def _halved(
        self,
        a: FloatArray,
        b: FloatArray,
        some: IntArray,
        unclear: BoolArray,
        spare_a: FloatArray,
        spare_b: FloatArray,
        lines: IntArray,
    ) -> Hit | None:
        """What touches on lines that are halved until each half is known, or as short as a look.

        Args:
            some: Numbers of pairs.
            unclear: Of which lines more is to be known, (s, pairs).
            spare_a: Metres that a pair may move from where a line begins, (s, pairs).
            spare_b: From where it ends.
            lines: Their numbers, (s,).
        """
        R = self.reaches[some].T
        while len(lines):
            middle = 0.5 * (a + b)
            hit, spare = self._looked(middle, unclear, some, lines)
            if hit is not None:
                return hit
            half = 0.5 * np.abs(b - a) @ R
            unclear &= 2.0 * half > LOOK
            halves = (a, middle, spare_a, spare), (middle, b, spare, spare_b)
            unclear = np.concatenate([unclear & _unclear(x, y, half) for _, _, x, y in halves])
            left = unclear.any(axis=1)
            a, b, spare_a, spare_b = (np.concatenate(both)[left] for both in zip(*halves, strict=True))
            unclear, lines = unclear[left], np.concatenate([lines, lines])[left]
        return None

    def _looked(
        self, places: FloatArray, asked: BoolArray, some: IntArray, lines: IntArray
    ) -> tuple[Hit | None, FloatArray]:
        """What touches at places (m, n) of the pairs asked for, (m, pairs), and how far each may move from there."""
        rows, columns = asked.nonzero()
        numbers = np.split(some[columns], np.cumsum(asked.sum(axis=1))[:-1])
        found = self._checker.gaps_at(places, numbers)
        self.looks += len(rows)
        room = np.full(asked.shape, -np.inf)
        room[rows, columns] = found
        k = int(found.argmin())
        if found[k] < self.nearest[0]:
            self.nearest = float(found[k]), places[rows[k]]
        if found[k] > 0.0:
            return None, TRUSTED * room
        names, row = self._checker.pairs[int(some[columns[k]])], int(rows[k])
        return Hit(f"{names[0]} x {names[1]}", tuple(places[row].tolist()), int(lines[row])), room

    def slope(self, q: FloatArray) -> FloatArray:
        """By how much the smallest gap grows with each joint, metres a radian (or metre), (n,)."""
        asked, gaps = self._smallest(q, 2.0 * SLOPE * float(self.reaches.max()))  # what may be the smallest beside
        near = asked[gaps <= gaps.min() + 2.0 * SLOPE * self.reaches.max()]
        return np.asarray(np.diff(self._beside(q, near).min(axis=2), axis=0)[0] / (2.0 * SLOPE))

    def lowest(self, q: FloatArray, room: FloatArray, below: float = np.inf) -> float:
        """The smallest gap found at corners of a room about q, (n,) each; only what may be less than ``below`` counts.

        Of each pair that may be the nearest a corner is looked for by its slope, and from there joint by joint as long
        as its gap shrinks.
        """
        gaps = self._gaps(q, np.arange(len(self.reaches)))
        moved = self.reaches @ room
        near = (gaps - moved <= min(below, float((gaps + moved).min()))).nonzero()[0]
        slopes = np.diff(self._beside(q, near), axis=0)[0]
        best = float(gaps.min())
        for k in range(len(near)):
            best = min(best, self._corner(q, room, np.where(slopes[:, k] > 0.0, -1.0, 1.0), near[k : k + 1]))
        return best

    def _corner(self, q: FloatArray, room: FloatArray, side: FloatArray, pair: IntArray) -> float:
        """The smallest gap of a pair from one corner of a room on, its sides (n,)."""
        best = float(self._gaps(q + side * room, pair)[0])
        for _ in range(SWEEPS):
            before = best
            for joint in room.nonzero()[0].tolist():
                other = side.copy()
                other[joint] = -side[joint]
                gap = float(self._gaps(q + other * room, pair)[0])
                if gap < best:
                    best, side = gap, other
            if best == before:
                break
        return best

    def _smallest(self, q: FloatArray, more: float) -> tuple[IntArray, FloatArray]:
        """Pairs, among them all whose gaps at q (n,) are the smallest or larger by so many metres at most; gaps."""
        room = self._room - self.reaches @ np.abs(q - self._place)
        first = np.array([room.argmin()])
        room[first] = gap = self._gaps(q, first)
        asked = np.flatnonzero(room <= gap + more)
        gaps = self._gaps(q, asked)
        if len(asked) > MANY:
            room[asked] = np.minimum(TRUSTED * gaps, gaps)
            self._place, self._room = q, room
        return asked, gaps

    def _beside(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Gaps of some pairs a step below q (n,) and above, joint by joint, (2, n, pairs)."""
        places = q + SLOPE * np.concatenate([-np.eye(len(q)), np.eye(len(q))])
        self.looks += len(places) * len(pairs)
        return self._checker.gaps_at(places, [pairs] * len(places)).reshape(2, len(q), -1)

    def _gaps(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Coal's distances of some pairs at q (n,)."""
        self.looks += len(pairs)
        return self._checker.gaps_at(q[None], [pairs])

    def touch(self, q: FloatArray) -> str | None:
        """What touches at q (n,), as ``a x b``; limits aside."""
        names = min(self._checker.touching(q), default=None)
        return None if names is None else f"{names[0]} x {names[1]}"


def _unclear(a: FloatArray, b: FloatArray, moved: FloatArray) -> BoolArray:
    """Where a pair that may move ``a`` from one end of a line and ``b`` from the other moves farther than both."""
    unclear: BoolArray = np.asarray(np.maximum(a, 0.0) + np.maximum(b, 0.0) <= moved)
    return unclear
