"""Whether an arm that is moved along a polyline touches anything, by Coal, looking every 0.2 mm or closer.

Where Coal says that everything is far, no look is needed until the arm has moved so far: a point moves at most
``reach`` times what the joints do, in the auditor's own bound. So fewer looks tell as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from auditor.checker import IndependentChecker
from planner_service.geometry.arrays import FloatArray

__all__ = ["LOOK", "Judge", "Walked"]

LOOK = 0.0002
"""Metres that a point of the robot moves, at most, from one look to the next where something is near."""

TRUSTED = 0.9
"""Of a distance that Coal states, the share on which a longer step relies."""

MARGINS = (LOOK / TRUSTED, 0.001, 0.004, 0.015, 0.05, 0.15)
"""Metres; Coal is asked first whether everything is so far apart, which it answers ten times as fast as how far."""

SLOPE = 1e-4
"""Radians (or metres) for the gap's slope."""


@dataclass(frozen=True, eq=False)
class Walked:
    """A polyline of m pieces that was looked at.

    Attributes:
        touch: What touches where, as ``a x b``; None if nothing does.
        at: The configuration of that touch, (n,); empty without one.
        least: A gap that every place of a piece has at least, metres, (m,); only where nothing touches.
    """

    touch: str | None
    at: FloatArray
    least: FloatArray


class Judge:
    """Looks at ways of one robot in one scene.

    Attributes:
        looks: Configurations that Coal was asked about.
    """

    def __init__(self, checker: IndependentChecker) -> None:
        self._checker = checker
        self.reach = checker.reach
        self.looks = 0
        self._rung = 0

    def gap(self, q: FloatArray) -> float:
        """The smallest of Coal's distances at q (n,), metres."""
        self.looks += 1
        return min(self._checker.gaps(q).values())

    def walked(self, points: FloatArray) -> Walked:
        """A look at a polyline (m + 1, n), from one end to the other."""
        least = np.empty(len(points) - 1)
        for k in range(len(points) - 1):
            touch, at, least[k] = self._piece(points[k], points[k + 1])
            if touch is not None:
                return Walked(touch, at, least[:k])
        return Walked(None, np.empty(0), least)

    def beside(self, a: FloatArray, b: FloatArray, off: FloatArray, least: FloatArray) -> tuple[str | None, FloatArray]:
        """What touches between configurations a and b, (m, n) each, and where, if all around them is known already.

        Args:
            off: Metres that a point of the robot is on each way from where it is known, at most, (m,).
            least: The gap there, (m,).
        """
        for k in np.flatnonzero(off >= TRUSTED * least):
            touch, at, _ = self._piece(a[k], b[k])
            if touch is not None:
                return touch, at
        return None, np.empty(0)

    def slope(self, q: FloatArray) -> FloatArray:
        """By how much the smallest gap grows with each joint, metres a radian (or metre), (n,)."""
        steps = SLOPE * np.eye(len(q))
        return np.array([(self.gap(q + step) - self.gap(q - step)) / (2.0 * SLOPE) for step in steps])

    def _piece(self, a: FloatArray, b: FloatArray) -> tuple[str | None, FloatArray, float]:
        """What touches between two configurations, where, and a gap that everything between has at least."""
        way = float(self.reach @ np.abs(b - a))
        at, least = 0.0, np.inf
        while True:
            q = a + (b - a) * at
            gap = self._gap_at_least(q)
            if gap <= 0.0:
                return self.touch(q), q, gap
            rest = way * (1.0 - at)
            step = min(rest, max(LOOK, TRUSTED * gap))
            least = min(least, gap - step)
            if rest <= 0.0:
                return None, np.empty(0), least
            at = min(1.0, at + step / way)

    def touch(self, q: FloatArray) -> str | None:
        """What touches at q (n,), as ``a x b``; limits aside."""
        names = min(self._checker.touching(q), default=None)
        return None if names is None else f"{names[0]} x {names[1]}"

    def _gap_at_least(self, q: FloatArray) -> float:
        """Metres that everything is apart at least at q (n,), asked with margins; <= 0 where something touches."""
        rung = self._rung
        if self._far(q, rung):
            while rung + 1 < len(MARGINS) and self._far(q, rung + 1):
                rung += 1
        else:
            rung -= 1
            while rung >= 0 and not self._far(q, rung):
                rung -= 1
        self._rung = max(rung, 0)
        return MARGINS[rung] if rung >= 0 else self.gap(q)

    def _far(self, q: FloatArray, rung: int) -> bool:
        self.looks += 1
        return not self._checker.nearer(q, MARGINS[rung])
