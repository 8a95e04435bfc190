"""Boxes of tool positions, halved until each is settled: a witness, a proof that there is none, or in doubt.

Compiled code (native/kinematics/obstruction.cpp) finds for each box of positions boxes of joint values that hold every
configuration whose tool is there, but for those in which the robot collides wherever it is. Halves of a box begin with
what was left of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner_service.collision.checker import CollisionChecker
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray
from planner_service.kinematics.complete_inverse import ROUNDING, TURN, closed_loop, searched
from planner_service.robot.model import Robot
from planner_service.workspace.orientation import ToolOrientation

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["Boxes", "Settled", "VoxelTree"]

WIDTH = 16.0
"""Radians, for each metre of a box of positions and an arm of 1 m, below which a box of joint values is not split."""

LEAST_WIDTH = 0.01
"""And at least that."""

MOST, MOST_SEEN = 24, 400
"""Boxes of joint values for one box of positions from which on none is split; boxes looked at, likewise."""

NEAR = 6
"""Of them, in how many a configuration is looked for."""

TURN_ERROR = 1e-10
"""Radians within which two orientations are one to a proof."""

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class Settled:
    """What was found out about k voxels.

    Attributes:
        doubtful: Whether the voxel may hold the tool of a free configuration, and none was found, (k,).
        blocked: Whether configurations were ruled out because they collide, (k,).
        witness: One that is free, (k, n); NaN where none was found.
    """

    doubtful: BoolArray
    blocked: BoolArray
    witness: FloatArray


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of positions of one size: which voxel each is part of, its centre, and boxes of joint values.

    Attributes:
        voxel: (m,).
        centre: (m, 3).
        offsets: Where in ``joints`` those of each begin, (m + 1,).
        joints: Lowest and highest values, (b, 2, n).
    """

    voxel: IntArray
    centre: FloatArray
    offsets: IntArray
    joints: FloatArray

    def of(self, rows: IntArray) -> Boxes:
        """Some of them."""
        counts = np.diff(self.offsets)[rows]
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        source = np.repeat(self.offsets[rows] - offsets[:-1], counts) + np.arange(offsets[-1])
        return Boxes(self.voxel[rows], self.centre[rows], offsets, self.joints[source])

    def moved(self, voxel: IntArray, shifts: FloatArray) -> Boxes:
        """With other voxels (m,), and centres moved by (m, 3)."""
        return Boxes(voxel, np.ascontiguousarray(self.centre + shifts), self.offsets, self.joints)


class VoxelTree:
    """Settles boxes of positions for one set of orientations.

    Args:
        robot: An arm all of whose joints move the tool.
        obstructed: What may collide everywhere; None leaves collisions out of proofs.
        checker: Says which configurations are free; None if all are.
    """

    def __init__(
        self,
        robot: Robot,
        orientation: ToolOrientation,
        obstructed: _core.Obstructed | None,
        checker: CollisionChecker | None,
    ) -> None:
        self._robot, self._orientation, self._checker, self._obstructed = robot, orientation, checker, obstructed
        self._loop, self._circles, self._length = closed_loop(robot)
        self._domain = searched(robot, self._circles)
        self._rows = np.column_stack([orientation.rotation, np.zeros(3)]).ravel()
        slack = ROUNDING * (1.0 + self._length)
        self._errors = slack, max(orientation.tolerance, TURN_ERROR) + slack

    def whole(self, centres: FloatArray) -> Boxes:
        """Boxes around centres (m, 3), numbered in their order, with all that the joints can do."""
        count = len(centres)
        joints = np.repeat(self._domain[None], count, axis=0)
        return Boxes(np.arange(count), np.ascontiguousarray(centres), np.arange(count + 1, dtype=np.int64), joints)

    def covered(self, boxes: Boxes, half: FloatArray, near: int = 0) -> tuple[Boxes, BoolArray, IntArray, FloatArray]:
        """Boxes of half the sides (3,) with what can bring the tool there, and which have something that collides.

        With ``near``, configurations in up to so many of the boxes of joint values, too: of which box, and (k, n).
        """
        width = max(LEAST_WIDTH, WIDTH * math.sqrt(float((half**2).sum())) / self._length)
        blocked, offsets, joints, at, Q = self._loop.cover(
            boxes.centre,
            half,
            self._rows,
            self._orientation.free_axis or (0.0, 0.0, 0.0),
            self._orientation.wanted,
            self._errors,
            boxes.offsets,
            boxes.joints,
            self._obstructed,
            width,
            (MOST, MOST_SEEN),
            near,
            1,
        )
        left = Boxes(boxes.voxel, boxes.centre, offsets, joints)
        return left, blocked.astype(np.bool_), np.repeat(np.arange(len(boxes.voxel)), np.diff(at)), Q

    def settle(self, boxes: Boxes, half: FloatArray, halvings: int) -> Settled:
        """Settle voxels 0 to k - 1, which the boxes are in their order; each is halved so often along each axis."""
        count = len(boxes.voxel)
        witness = np.full((count, self._robot.n), np.nan)
        blocked, doubtful = np.zeros((2, count), dtype=np.bool_)
        for level in range(halvings + 1):
            boxes, dropped, row, Q = self.covered(boxes, half, NEAR)
            blocked[boxes.voxel[dropped]] = True
            self._look_for_free(boxes, half, row, Q, witness)
            left = np.flatnonzero((np.diff(boxes.offsets) > 0) & np.isnan(witness[boxes.voxel, 0]))
            if level == halvings:
                doubtful[boxes.voxel[left]] = True
            elif not len(left):
                break
            else:
                parts = boxes.of(np.repeat(left, len(CORNERS)))
                boxes = parts.moved(parts.voxel, np.tile(CORNERS, (len(left), 1)) * half)
                half = half / 2.0
        return Settled(doubtful, blocked, witness)

    def _look_for_free(self, boxes: Boxes, half: FloatArray, row: IntArray, Q: FloatArray, witness: FloatArray) -> None:
        """Note the first free one of configurations Q (k, n) that are said to be of the boxes ``row`` (k,)."""
        Q = self._within_limits(Q)
        there = self.holds(Q, boxes.centre[row], half)
        row, Q = row[there], Q[there]
        voxel, order = boxes.voxel[row], np.arange(len(row)) - np.searchsorted(row, row)
        for turn in range(NEAR):
            asked = np.flatnonzero((order == turn) & np.isnan(witness[voxel, 0]))
            if len(asked):
                free = asked if self._checker is None else asked[self._checker.states_are_free(Q[asked])]
                witness[voxel[free[::-1]]] = Q[free[::-1]]  # so that of several the first is kept

    def holds(self, Q: FloatArray, centres: FloatArray, half: FloatArray) -> BoolArray:
        """Which of configurations (k, n) have the tool in boxes around ``centres`` (k, 3), turned as it should be."""
        tool, place = self._robot.tool_body, self._robot.tool_placement
        R, p = (each[:, tool] for each in self._robot.body_poses_batch(Q))
        apart = np.abs(R @ place[:3, 3] + p - centres)
        return np.asarray(np.all(apart <= half, axis=1)) & self._orientation.allows(R @ place[:3, :3])

    def _within_limits(self, Q: FloatArray) -> FloatArray:
        """Joints that go round, moved by whole turns into their limits."""
        lower = self._robot.limits.lower
        turns = np.where(self._circles, np.ceil((lower - Q) / TURN), 0.0)
        return np.asarray(np.clip(Q + TURN * turns, lower, self._robot.limits.upper))
