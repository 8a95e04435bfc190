"""The camera of a picture: perspective, from a place that has everything that matters in view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray, read_only

__all__ = ["Camera", "combined"]

FIELD = 0.36
"""Half the picture's width over its distance: a long lens, which distorts little."""

NEAREST = 0.02
"""Share of the distance to the farthest point in view; anything nearer is cut off."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Attributes:
        eye: Where it is in the world, (3,).
        axes: Rows: the directions to the right, downwards and ahead in the world, (3, 3).
        focal: Pixels that one metre spans at a distance of one.
        middle: The pixel (right, down) straight ahead of the eye.
        nearest: Metres ahead of the eye; anything nearer is not drawn.
    """

    eye: FloatArray
    axes: FloatArray
    focal: float
    middle: tuple[float, float]
    nearest: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "eye", read_only(self.eye))
        object.__setattr__(self, "axes", read_only(self.axes))

    @classmethod
    def around(cls, points: FloatArray, size: tuple[int, int], azimuth: float, elevation: float) -> Camera:
        """A camera that has points (k, 3) just in view, in a picture of ``size`` (width, height) pixels.

        Args:
            azimuth, elevation: The direction from them to the eye, in rad: about z from x, and above the ground.
        """
        axes = _axes(azimuth, elevation)
        x, y, z = combined(axes, points).T
        wide, high = FIELD, FIELD * size[1] / size[0]
        # x - ex <= wide (z - ez) and three more like it, for the nearest eye e, and the middle where there is room
        right, left = float((x - wide * z).max()), float((-x - wide * z).max())
        below, above = float((y - high * z).max()), float((-y - high * z).max())
        ahead = min(-(right + left) / (2 * wide), -(below + above) / (2 * high))
        eye = combined(axes.T, np.array([(right - left) / 2, (below - above) / 2, ahead]))
        nearest = max(NEAREST * float(z.max() - ahead), 1e-9)
        return cls(eye, axes, size[0] / (2 * wide), (size[0] / 2, size[1] / 2), nearest)

    def seen(self, points: FloatArray) -> FloatArray:
        """World points (..., 3) as metres to the right, down and ahead of the eye."""
        return combined(self.axes, points - self.eye)

    def pixels(self, seen: FloatArray) -> FloatArray:
        """What ``seen`` returned, all ahead, as pixels right and down, and nearness: ``nearest`` over metres ahead.

        Nearness, 1 to 0, is linear in the picture along straight lines of the world.
        """
        near = 1.0 / seen[..., 2]
        across, down = (seen[..., k] * near * self.focal + self.middle[k] for k in range(2))
        return np.stack([across, down, self.nearest * near], axis=-1)

    def resized(self, factor: float) -> Camera:
        """The same view in a picture of so many times the width and height."""
        x, y = self.middle
        return Camera(self.eye, self.axes, self.focal * factor, (x * factor, y * factor), self.nearest)


def combined(rows: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 3) turned by a matrix (3, 3), without BLAS: the same bits on every machine."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in rows], axis=-1)


def _axes(azimuth: float, elevation: float) -> FloatArray:
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    return np.array([[-sa, ca, 0.0], [se * ca, se * sa, -ce], [-ce * ca, -ce * sa, -se]])
