"""The random numbers of one episode, which do not depend on any other episode."""

from __future__ import annotations

import numpy as np

from planner_service.geometry.shapes import Pose

__all__ = ["RandomDraws"]

STEP = 2.0**-53

EIGHTH_TURN = 0.198912367379658
"""tan(pi / 16), for rotations of up to 45 degrees."""


class RandomDraws:
    """The random numbers of an episode, from the data set's seed and the episode's index.

    The bits come from numpy's PCG64, whose stream is stable across releases; they are turned into numbers by plain
    arithmetic, which is the same on every processor.
    """

    def __init__(self, seed: int, index: int) -> None:
        self._bits = np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(index,)))

    def whole(self) -> int:
        """An integer in [0, 2^63)."""
        return int(self._bits.random_raw()) >> 1

    def between(self, low: float, high: float) -> float:
        """A number in [low, high)."""
        return low + (high - low) * ((int(self._bits.random_raw()) >> 11) * STEP)

    def happens(self, share: float) -> bool:
        """True with this probability."""
        return self.between(0.0, 1.0) < share

    def one_of(self, *values: float) -> float:
        """One of the values, all equally likely."""
        return values[int(self.between(0.0, len(values)))]

    def turned(self, x: float, y: float, z: float) -> Pose:
        """A pose rotated about the vertical by up to 45 degrees to either side, about uniformly.

        The quaternion is computed from t = tan(yaw / 4), which needs no sine; t is uniform, and yaw is to within 4 %.
        """
        t = self.between(-EIGHTH_TURN, EIGHTH_TURN)
        return Pose((x, y, z), ((1.0 - t * t) / (1.0 + t * t), 0.0, 0.0, 2.0 * t / (1.0 + t * t)))
