"""The signed distance from the obstacles of a scene, on a grid of voxels, with its gradient.

At a grid point outside, the distance is that to the nearest piece, exact up to rounding; inside, it is that to the
nearest grid point outside, to half a voxel. Between grid points it is interpolated trilinearly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from planner_service.collision import CollisionChecker
from planner_service.collision.pairs import Part
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["DistanceField", "field_of"]

BAND = 0.25
"""Metres; larger distances are replaced by this one."""

MAX_VOXELS = 30_000_000
"""120 MB; a hall in voxels of a centimetre has more."""

POINTS_PER_POLL = 50_000
"""Grid points computed between two polls."""

CACHED_FIELDS = 4
"""Fields kept in memory; the least recently used is dropped first."""


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Distances in metres at the points ``low + voxel * (i, j, k)``; ``values`` has shape (x, y, z), all at least 2."""

    low: FloatArray
    voxel: float
    values: FloatArray

    def may_be_within(self, points: FloatArray, limits: FloatArray) -> NDArray[np.bool_]:
        """Which points (k, 3) may be nearer than their limits (k,), by the nearest grid point; the others are not."""
        place = np.rint((points - self.low) / self.voxel).astype(np.intp)
        sizes = np.array(self.values.shape)
        inside = ((place >= 0) & (place < sizes)).all(axis=1)
        x, y, z = np.clip(place, 0, sizes - 1).T
        return np.asarray(inside & (self.values[x, y, z] < limits + self.voxel))  # half a diagonal is less

    def at(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distances (k,) at points (k, 3), and their gradients (k, 3); BAND and 0 outside the grid."""
        place = (points - self.low) / self.voxel
        sizes = np.array(self.values.shape)
        inside = np.asarray(((place >= 0.0) & (place <= sizes - 1)).all(axis=1))
        cell = np.clip(place.astype(np.intp), 0, sizes - 2)
        share = place - cell
        corner = self.values[
            tuple(cell[:, axis, None, None, None] + offset for axis, offset in enumerate(np.ogrid[:2, :2, :2]))
        ].astype(np.float64)
        x, y, z = (share[:, axis] for axis in range(3))
        along_z = corner[..., 0] + (corner[..., 1] - corner[..., 0]) * z[:, None, None]
        along_y = along_z[:, :, 0] + (along_z[:, :, 1] - along_z[:, :, 0]) * y[:, None]
        value = along_y[:, 0] + (along_y[:, 1] - along_y[:, 0]) * x
        rise_y = along_z[:, :, 1] - along_z[:, :, 0]
        rise_z = corner[..., 1] - corner[..., 0]
        rise_z = rise_z[:, :, 0] + (rise_z[:, :, 1] - rise_z[:, :, 0]) * y[:, None]
        gradient = np.stack(
            [
                along_y[:, 1] - along_y[:, 0],
                rise_y[:, 0] + (rise_y[:, 1] - rise_y[:, 0]) * x,
                rise_z[:, 0] + (rise_z[:, 1] - rise_z[:, 0]) * x,
            ],
            axis=1,
        )
        return np.where(inside, value, BAND), np.where(inside[:, None], gradient / self.voxel, 0.0)


@dataclass(frozen=True)
class _Key:
    """What a field is computed from; the scene's hash, the voxel size and the robot's reach identify it."""

    scene: str
    voxel: float
    reach: float
    standing: Sequence[Part] = field(compare=False, repr=False)
    poll: Callable[[], None] = field(compare=False, repr=False)


def field_of(checker: CollisionChecker, voxel: float) -> DistanceField | None:
    """The field of a checker's scene as far as its robot reaches, computed once; None for an empty scene.

    Raises:
        SearchStopped: A limit of the checker ended it; limits are checked between slabs of the grid.
        InvalidRequest: It would have more than 30,000,000 voxels.
    """
    standing = tuple(part for part in checker.parts.parts if part.body < 0)
    reach = math.fsum(checker.robot.reach().tolist())
    return _made(_Key(checker.scene.hash, voxel, reach, standing, checker.ledger.poll)) if standing else None


@lru_cache(maxsize=CACHED_FIELDS)
def _made(key: _Key) -> DistanceField:
    boxes = [_box(part) for part in key.standing]
    low = np.maximum(np.min([low for low, _ in boxes], axis=0), -key.reach) - BAND
    high = np.minimum(np.max([high for _, high in boxes], axis=0), key.reach) + BAND
    sizes = np.maximum(np.ceil((high - low) / key.voxel).astype(np.intp) + 1, 2)
    if math.prod(sizes.tolist()) > MAX_VOXELS:
        raise InvalidRequest("voxel", key.voxel, f"at most {MAX_VOXELS:,} voxels of that size: {sizes.tolist()}")
    values = np.full(sizes.tolist(), BAND, dtype=np.float32)
    for part, box in zip(key.standing, boxes, strict=True):
        first, end = _range(box, low, key.voxel, sizes)
        if (first < end).all():
            axes = [low[k] + key.voxel * np.arange(first[k], end[k]) for k in range(3)]
            window = values[tuple(slice(a, b) for a, b in zip(first, end, strict=True))]
            thick = max(1, POINTS_PER_POLL // window[0].size)
            for x in range(0, len(window), thick):
                key.poll()
                slab = window[x : x + thick]
                np.minimum(slab, _distances(part, [axes[0][x : x + thick], *axes[1:]]), out=slab)
    key.poll()
    return DistanceField(low, key.voxel, _with_depths(values, key.voxel))


def _box(part: Part) -> tuple[FloatArray, FloatArray]:
    """The axis-aligned box around a piece in the world frame: its low and high corner."""
    R, t = part.T[:3, :3], part.T[:3, 3]
    reach = [[part.shape.support(sign * R[axis])[k] for k in range(3)] for axis in range(3) for sign in (1.0, -1.0)]
    ends = [math.fsum(R[k // 2, j] * reach[k][j] for j in range(3)) + t[k // 2] for k in range(6)]
    return np.array(ends[1::2]), np.array(ends[::2])


def _range(
    box: tuple[FloatArray, FloatArray], low: FloatArray, voxel: float, sizes: IntArray
) -> tuple[IntArray, IntArray]:
    """The range of grid points within BAND of a box: first and end along each axis."""
    first = np.clip(np.floor((box[0] - BAND - low) / voxel).astype(np.intp), 0, sizes)
    end = np.clip(np.ceil((box[1] + BAND - low) / voxel).astype(np.intp) + 1, 0, sizes)
    return first, end


def _distances(part: Part, axes: Sequence[FloatArray]) -> FloatArray:
    """The distance from each grid point to a piece, 0 inside, shape (x, y, z)."""
    x, y, z = np.meshgrid(*(values - part.T[k, 3] for k, values in enumerate(axes)), indexing="ij")
    R = part.T[:3, :3]
    local = np.stack([x * R[0, k] + y * R[1, k] + z * R[2, k] for k in range(3)], axis=-1)
    return np.asarray(part.shape.distance(local))


def _with_depths(values: FloatArray, voxel: float) -> FloatArray:
    """The field with negative distances inside, by a distance transform of the grid."""
    from scipy.ndimage import distance_transform_edt

    inside = values <= 0.0
    if inside.any():
        box = tuple(
            slice(max(int(k.min()) - 1, 0), int(k.max()) + 2) for k in inside.nonzero()
        )  # with a rim of points outside
        depths = np.asarray(distance_transform_edt(inside[box])) * voxel - 0.5 * voxel
        values[box] = np.where(inside[box], -depths, values[box])
    return values
