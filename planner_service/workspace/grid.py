"""A grid of voxels: boxes of positions of the tool, in the base frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.validation import finite_numbers, items, whole

__all__ = ["MOST_VOXELS", "VoxelGrid"]

MOST_VOXELS = 20_000_000

FARTHEST = 100.0
"""Metres from the base."""


@dataclass(frozen=True)
class VoxelGrid:
    """A box of positions, cut into as many closed boxes along each axis as ``counts`` says.

    Attributes:
        lower, upper: Its corners (x, y, z) in metres.
        counts: Voxels along x, y and z.

    Raises:
        InvalidRequest: The corners are not in order, beyond 100 m, or there are more than 20 million voxels.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    counts: tuple[int, int, int]

    def __post_init__(self) -> None:
        low, high = (finite_numbers(name, getattr(self, name), 3) for name in ("lower", "upper"))
        counts = items("counts", self.counts, object, "three whole numbers of voxels")
        if len(counts) != 3:
            raise InvalidRequest("counts", self.counts, "three whole numbers of voxels")
        nx, ny, nz = (whole(f"counts[{k}]", count, 1, MOST_VOXELS) for k, count in enumerate(counts))
        if nx * ny * nz > MOST_VOXELS:
            raise InvalidRequest("counts", (nx, ny, nz), f"at most {MOST_VOXELS:,} voxels together")
        for name, corner in (("lower", low), ("upper", high)):
            if np.abs(corner).max() > FARTHEST:
                raise InvalidRequest(name, corner.tolist(), f"within {FARTHEST:g} m of the base")
        if not np.all(low + 1e-6 * np.array([nx, ny, nz]) <= high):
            raise InvalidRequest("upper", high.tolist(), f"above lower {low.tolist()}, by 1e-6 m for each voxel")
        x, y, z = low.tolist()
        object.__setattr__(self, "lower", (x, y, z))
        x, y, z = high.tolist()
        object.__setattr__(self, "upper", (x, y, z))
        object.__setattr__(self, "counts", (nx, ny, nz))

    def __len__(self) -> int:
        return math.prod(self.counts)

    @property
    def half(self) -> FloatArray:
        """Half the sides of a voxel in metres, (3,)."""
        return np.asarray((np.array(self.upper) - np.array(self.lower)) / (2.0 * np.array(self.counts)))

    def centres(self, cells: IntArray) -> FloatArray:
        """The centres (k, 3) of voxels by their numbers along the axes, (k, 3); beyond the grid, too."""
        return np.asarray(np.array(self.lower) + self.half * (2.0 * cells + 1.0))

    def cell_of(self, position: object) -> tuple[int, int, int]:
        """The numbers of the voxel that a position (3,) is in, of one on a face the higher ones if there are.

        Raises:
            InvalidRequest: It is outside the grid.
        """
        at = finite_numbers("position", position, 3)
        if np.any(at < np.array(self.lower)) or np.any(at > np.array(self.upper)):
            raise InvalidRequest("position", at.tolist(), f"within {list(self.lower)} to {list(self.upper)}")
        steps = np.floor((at - np.array(self.lower)) / (2.0 * self.half)).astype(int)
        x, y, z = np.minimum(steps, np.array(self.counts) - 1).tolist()
        return x, y, z
