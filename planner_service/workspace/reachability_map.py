"""What is known of each voxel of a grid and each set of orientations."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, as_sent, read_only
from planner_service.geometry.validation import copied_in, instance, items, text, whole
from planner_service.workspace.grid import MOST_VOXELS, VoxelGrid
from planner_service.workspace.orientation import ToolOrientation

__all__ = ["BLOCK", "MOST_ORIENTATIONS", "ReachabilityMap", "VoxelVerdict", "block_counts"]

BLOCK = 16
"""Voxels along each side of a block, the piece of a map that is done at once."""

MOST_ORIENTATIONS = 100


class VoxelVerdict(IntEnum):
    """What is known of a voxel: the tool's origin in it (faces included), the tool turned as a set allows."""

    UNKNOWN = 0
    """Neither of the others is known, or the voxel was not looked at yet."""
    REACHABLE = 1
    """Some position in it, with an orientation of the set, has a configuration within the joint limits that the
    collision checker calls free: the witness."""
    OUT_OF_REACH = 2
    """Proven: no position in it, with any orientation of the set, has a configuration within the joint limits."""
    BLOCKED = 3
    """Proven: none has one that is free. Some may have one that collides."""
    SAID_UNREACHABLE = 4
    """A file says that it is out of reach or blocked, and nobody has proven it here."""


def block_counts(grid: VoxelGrid) -> tuple[int, int, int]:
    """Blocks along each axis."""
    x, y, z = (-(-count // BLOCK) for count in grid.counts)
    return x, y, z


@dataclass(frozen=True, eq=False)
class ReachabilityMap:
    """Verdicts about all voxels, with a witness for each that is reachable.

    Attributes:
        grid: The voxels.
        orientations: Sets of orientations.
        robot, scene: The hashes of what it is about.
        still: A configuration (n,), whose values the joints keep that do not move the tool.
        verdicts: ``VoxelVerdict`` of each set and voxel, (orientations, nx, ny, nz).
        witnesses: Configurations (k, n) of the reachable voxels, in the order of ``verdicts``.
        done: Which blocks of 16 voxels along each side were looked at, (orientations, bx, by, bz).

    Raises:
        InvalidRequest: Shapes or values that do not fit each other.
    """

    grid: VoxelGrid
    orientations: tuple[ToolOrientation, ...]
    robot: str
    scene: str
    still: FloatArray
    verdicts: NDArray[np.uint8]
    witnesses: FloatArray
    done: BoolArray
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        instance("grid", self.grid, VoxelGrid, "a VoxelGrid")
        sets = items("orientations", self.orientations, ToolOrientation, "ToolOrientations", MOST_ORIENTATIONS)
        object.__setattr__(self, "orientations", sets)
        for name in ("robot", "scene"):
            text(name, getattr(self, name))
        if not sets or len(sets) * len(self.grid) > MOST_VOXELS:
            raise InvalidRequest("orientations", len(sets), f"at least one, and {MOST_VOXELS:,} voxels of all together")
        shapes = {"verdicts": (len(sets), *self.grid.counts), "done": (len(sets), *block_counts(self.grid))}
        for name, kind in (("verdicts", np.uint8), ("done", np.bool_)):
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.dtype != kind or array.shape != shapes[name]:
                raise InvalidRequest(
                    name, getattr(array, "shape", type(array).__name__), f"an array {shapes[name]} of {kind.__name__}"
                )
        if int(self.verdicts.max(initial=0)) > max(VoxelVerdict):
            raise InvalidRequest("verdicts", int(self.verdicts.max()), f"at most {int(max(VoxelVerdict))}")
        still, found = (self._floats(name) for name in ("still", "witnesses"))
        reached = int((self.verdicts == VoxelVerdict.REACHABLE).sum())
        if still.ndim != 1 or not np.isfinite(still).all():
            raise InvalidRequest("still", still.shape, "a configuration of finite numbers")
        if found.shape != (reached, len(still)) or not np.isfinite(found).all():
            raise InvalidRequest("witnesses", found.shape, f"finite numbers ({reached}, {len(still)})")
        object.__setattr__(self, "still", read_only(still.copy()))
        object.__setattr__(self, "witnesses", read_only(found.copy()))
        copied_in(self, "verdicts", "done")

    def _floats(self, name: str) -> FloatArray:
        array = getattr(self, name)
        if not isinstance(array, np.ndarray) or array.dtype != np.float64:
            raise InvalidRequest(name, type(array).__name__, "an array of float64")
        return array

    @property
    def complete(self) -> bool:
        """Whether every block was looked at."""
        return bool(self.done.all())

    def verdict(self, position: object, orientation: int = 0) -> VoxelVerdict:
        """Of the voxel that a position (3,) is in, for one of the sets.

        Raises:
            InvalidRequest: It is outside the grid, or there is no such set.
        """
        k = whole("orientation", orientation, 0, len(self.orientations) - 1)
        return VoxelVerdict(int(self.verdicts[k][self.grid.cell_of(position)]))

    def witness(self, position: object, orientation: int = 0) -> FloatArray | None:
        """A free configuration (n,) whose tool is in the voxel that a position is in; None if it is not reachable.

        Raises:
            InvalidRequest: As ``verdict``.
        """
        if self.verdict(position, orientation) is not VoxelVerdict.REACHABLE:
            return None
        cell = np.ravel_multi_index((orientation, *self.grid.cell_of(position)), self.verdicts.shape)
        before = self.verdicts.reshape(-1)[: int(cell)] == VoxelVerdict.REACHABLE
        return read_only(self.witnesses[int(before.sum())])

    def share(self, verdict: VoxelVerdict) -> float:
        """Of all voxels and sets, those of a verdict.

        Raises:
            InvalidRequest: It is none.
        """
        instance("verdict", verdict, VoxelVerdict, "a VoxelVerdict")
        return float((self.verdicts == verdict).mean())

    def __str__(self) -> str:
        kinds = ", ".join(
            f"{name} {100.0 * self.share(kind):.2f} %"
            for kind, name in (
                (VoxelVerdict.REACHABLE, "reachable"),
                (VoxelVerdict.OUT_OF_REACH, "out of reach"),
                (VoxelVerdict.BLOCKED, "blocked"),
                (VoxelVerdict.SAID_UNREACHABLE, "said to be unreachable"),
                (VoxelVerdict.UNKNOWN, "unknown"),
            )
            if kind in (VoxelVerdict.REACHABLE, VoxelVerdict.UNKNOWN) or self.share(kind)
        )
        rest = "" if self.complete else f"; {int(self.done.sum())} of {self.done.size} blocks done"
        return f"{self.verdicts.size:,} voxels: {kinds}{rest}"
