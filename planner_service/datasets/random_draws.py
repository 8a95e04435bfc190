"""Random numbers of one episode: the same whatever was drawn before, by whom and in which order."""

from __future__ import annotations

import numpy as np

from planner_service.geometry.shapes import Pose

__all__ = ["Draws"]

STEP = 2.0**-53

EIGHTH_TURN = 0.198912367379658
"""tan(pi / 16): of 45 degrees, what ``turned`` takes."""


class Draws:
    """The numbers of an episode, by its number and the seed of all of them.

    The bits are those of numpy's PCG64, whose stream is kept from release to release; what is made of them is plain
    arithmetic, so that every processor draws the same.
    """

    def __init__(self, seed: int, index: int) -> None:
        self._bits = np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(index,)))

    def whole(self) -> int:
        """A whole number in [0, 2^63)."""
        return int(self._bits.random_raw()) >> 1

    def between(self, low: float, high: float) -> float:
        """A number in [low, high)."""
        return low + (high - low) * ((int(self._bits.random_raw()) >> 11) * STEP)

    def happens(self, share: float) -> bool:
        """True in so many of all cases."""
        return self.between(0.0, 1.0) < share

    def one_of(self, *values: float) -> float:
        """One of them, each as often as the others."""
        return values[int(self.between(0.0, len(values)))]

    def turned(self, x: float, y: float, z: float) -> Pose:
        """A pose at a place, turned about the vertical by up to 45 degrees to either side, each about as often.

        The quaternion is that of t = tan(yaw / 4), which needs no sine; t is drawn evenly, yaw is to within 4 %.
        """
        t = self.between(-EIGHTH_TURN, EIGHTH_TURN)
        return Pose((x, y, z), ((1.0 - t * t) / (1.0 + t * t), 0.0, 0.0, 2.0 * t / (1.0 + t * t)))
