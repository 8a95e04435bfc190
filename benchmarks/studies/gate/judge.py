"""Whether an arm that is moved along a polyline touches anything, by Coal, looking every 0.2 mm or closer.

Each pair of shapes is looked at for itself: where Coal says how far the two are apart, no look is needed until their
joints have moved them so far, by the auditor's own bound of that pair's motion. So fewer looks tell as much. What is
known of a place is kept for ways that begin near it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from auditor.checker import IndependentChecker
from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["LOOK", "Judge", "Walked"]

LOOK = 0.0002
"""Metres that a point of the robot moves, at most, from one look to the next where something is near."""

TRUSTED = 0.9
"""Of a distance that Coal states, the share on which a longer step relies."""

SLOPE = 1e-4
"""Radians (or metres) for the gap's slope."""

SWEEPS = 4
"""Over all joints, in the search for the corner of a room that is nearest to contact."""

ROUNDING, STILL = 1e-12, 1e-9
"""Metres that are none, and on a whole piece."""


@dataclass(frozen=True, eq=False)
class Walked:
    """A polyline of m pieces that was looked at.

    Attributes:
        touch: What touches where, as ``a x b``; None if nothing does.
        at: The configuration of that touch, (n,); empty without one.
        gaps: A gap that each pair has at least on each piece, metres, (m, pairs); only where nothing touches.
    """

    touch: str | None
    at: FloatArray
    gaps: FloatArray

    @property
    def least(self) -> FloatArray:
        """The smallest of them on each piece, (m,)."""
        return np.asarray(self.gaps.min(axis=1, initial=np.inf))


class Judge:
    """Looks at ways of one robot in one scene.

    Attributes:
        looks: Gaps that Coal was asked for.
    """

    def __init__(self, checker: IndependentChecker) -> None:
        self._checker = checker
        self.reach, self.reaches = checker.reach, checker.pair_reaches()
        self.looks = 0
        self._known: tuple[FloatArray, FloatArray] | None = None  # a place, and a gap that each pair has there at least

    def gap(self, q: FloatArray) -> float:
        """The smallest of Coal's distances at q (n,), metres."""
        return float(self._gaps(q, np.arange(len(self.reaches))).min())

    def walked(self, points: FloatArray) -> Walked:
        """A look at a polyline (m + 1, n), from one end to the other."""
        gaps, spare = np.zeros(len(self.reaches)), np.zeros(len(self.reaches))
        if self._known is not None:
            gaps = self._known[1] - self.reaches @ np.abs(points[0] - self._known[0])
            spare = TRUSTED * gaps
        m, pairs = len(points) - 1, np.arange(len(gaps))
        least, known, moved = np.empty((m, len(gaps))), np.empty((m + 1, len(gaps))), np.empty((m, len(gaps)))
        for k in range(m):
            place = None if k else points[0]
            known[k] = gaps
            touch, at = self._piece(points[k], points[k + 1], pairs, gaps, spare, least[k], place)
            if touch is not None:
                return Walked(touch, at, least[:k])
            moved[k] = self.reaches @ np.abs(points[k + 1] - points[k])
        known[m] = gaps
        for k in range(m - 1, -1, -1):  # what is known of the end of a piece bounds it as well
            back = known[k + 1] - moved[k]
            np.maximum(least[k], back, out=least[k])
            np.maximum(known[k], back, out=known[k])
        return Walked(None, np.empty(0), least)

    def beside(
        self, points: FloatArray, off: FloatArray, ends: FloatArray, off_ends: FloatArray, gaps: FloatArray
    ) -> tuple[str | None, FloatArray]:
        """What touches on a polyline, or straight on from its corners, and where, if all around it is known already.

        Args:
            points: Configurations (m + 1, n).
            off: How far each joint is on each piece from where it is known, at most, (m, n).
            ends: Where another way leads from the end of each of the first pieces, (k, n).
            off_ends: How far each joint is on that, at most, from where the piece before it is known to end, (k, n).
            gaps: The gap of each pair on each piece, as it is known, (m, pairs).
        """
        room, free = off.max(axis=0, initial=0.0), TRUSTED * gaps.min(axis=0, initial=np.inf)
        some = (self.reaches @ np.maximum(room, off_ends.max(axis=0, initial=0.0)) >= free).nonzero()[0]
        if not len(some):
            return None, np.empty(0)
        reaches, free = self.reaches[some].T, TRUSTED * gaps[:, some]
        corner = np.maximum(free[: len(ends)], free[1 : len(ends) + 1])  # both pieces tell of it
        near, near_end = off @ reaches >= free, off_ends @ reaches >= corner
        now, spare, walked = np.zeros(len(some)), np.zeros(len(some)), np.full(len(some), -2)
        any_end = near_end.any(axis=1).tolist()
        for k, any_near in enumerate(near.any(axis=1).tolist()):
            if any_near:
                pairs = near[k].nonzero()[0]
                here, left = now[pairs], np.where(walked[pairs] == k - 1, spare[pairs], 0.0)
                touch, at = self._piece(points[k], points[k + 1], some[pairs], here, left, np.empty(len(pairs)), None)
                if touch is not None:
                    return touch, at
                now[pairs], spare[pairs], walked[pairs] = here, left, k
            if k < len(ends) and any_end[k]:
                pairs = near_end[k].nonzero()[0]
                here, left = now[pairs], np.where(walked[pairs] == k, spare[pairs], 0.0)
                touch, at = self._piece(points[k + 1], ends[k], some[pairs], here, left, np.empty(len(pairs)), None)
                if touch is not None:
                    return touch, at
        return None, np.empty(0)

    def slope(self, q: FloatArray) -> FloatArray:
        """By how much the smallest gap grows with each joint, metres a radian (or metre), (n,)."""
        gaps = self._gaps(q, np.arange(len(self.reaches)))
        near = np.flatnonzero(gaps <= gaps.min() + 2.0 * SLOPE * self.reaches.max())  # what may be the smallest beside
        steps = SLOPE * np.eye(len(q))
        ends = ((self._gaps(q + step, near).min(), self._gaps(q - step, near).min()) for step in steps)
        return np.array([(more - less) / (2.0 * SLOPE) for more, less in ends])

    def lowest(self, q: FloatArray, room: FloatArray, below: float = np.inf) -> float:
        """The smallest gap found at corners of a room about q, (n,) each; only what may be less than ``below`` counts.

        Of each pair that may be the nearest a corner is looked for by its slope, and from there joint by joint as long
        as its gap shrinks.
        """
        gaps = self._gaps(q, np.arange(len(self.reaches)))
        moved = self.reaches @ room
        near = (gaps - moved <= min(below, float((gaps + moved).min()))).nonzero()[0]
        steps = SLOPE * np.eye(len(q))
        slopes = np.array([self._gaps(q + step, near) - self._gaps(q - step, near) for step in steps])  # (n, near)
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

    def _gaps(self, q: FloatArray, pairs: IntArray) -> FloatArray:
        """Coal's distances of some pairs at q (n,)."""
        self._checker.place(q)
        self.looks += len(pairs)
        return np.array([self._checker.gap_of(pair) for pair in pairs.tolist()])

    def touch(self, q: FloatArray) -> str | None:
        """What touches at q (n,), as ``a x b``; limits aside."""
        names = min(self._checker.touching(q), default=None)
        return None if names is None else f"{names[0]} x {names[1]}"

    def _piece(
        self,
        a: FloatArray,
        b: FloatArray,
        pairs: IntArray,
        gaps: FloatArray,
        spare: FloatArray,
        least: FloatArray,
        place: FloatArray | None,
    ) -> tuple[str | None, FloatArray]:
        """What of some pairs touches between two configurations, and where.

        Args:
            gaps: What each of them is apart at least, metres; changed to what it is at the end.
            spare: Metres that each may still move before the next look; changed likewise.
            least: To be what each is apart at least on the way.
            place: What is known there is kept for the next way; None to keep nothing.
        """
        rates = self.reaches[pairs] @ np.abs(b - a)
        slowly = np.maximum(rates, STILL)
        at = 0.0
        least[:] = np.inf
        while True:
            due = (spare <= ROUNDING).nonzero()[0]
            if len(due):
                q = a + (b - a) * at
                gaps[due] = found = self._gaps(q, pairs[due])
                spare[due] = np.maximum(LOOK, TRUSTED * found)
                if found.min() <= 0.0:
                    names = self._checker.pairs[int(pairs[due[found.argmin()]])]
                    return f"{names[0]} x {names[1]}", q
            if place is not None:
                self._known, place = (place, gaps.copy()), None
            if at >= 1.0:
                return None, np.empty(0)
            step = min(1.0 - at, float((spare / slowly).min(initial=np.inf)))
            at = 1.0 if step >= 1.0 - at else at + step
            spare -= rates * step
            gaps -= rates * step
            np.minimum(least, gaps, out=least)
