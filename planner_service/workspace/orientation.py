"""Orientations of the tool that a map asks about."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import BoolArray, FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.complete_inverse import AXIS, POSE, POSITION
from planner_service.kinematics.pose_goal import PoseGoal

__all__ = ["SAME_RADIANS", "ToolOrientation"]

SAME_RADIANS = 1e-8
"""Beyond the tolerance, at most, that the tool of a witness is turned: what forward kinematics shows of 1e-10."""


@dataclass(frozen=True)
class ToolOrientation:
    """A set of orientations of the tool in the base frame.

    Attributes:
        quaternion: The one in the middle, (w, x, y, z).
        tolerance: Radians by which the tool may be rotated from there; pi for any orientation.
        free_axis: Axis (x, y, z) in the tool frame about which any rotation is allowed besides; None for none.

    Raises:
        InvalidRequest: As ``Pose`` and ``PoseGoal``.
    """

    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    tolerance: float = 0.0
    free_axis: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        goal = PoseGoal(Pose((0.0, 0.0, 0.0), self.quaternion), 0.0, self.tolerance, self.free_axis)
        norm = math.sqrt(math.fsum(x * x for x in goal.pose.quaternion))
        w, x, y, z = (entry / norm for entry in goal.pose.quaternion)
        object.__setattr__(self, "quaternion", (w, x, y, z))
        object.__setattr__(self, "tolerance", float(self.tolerance))
        object.__setattr__(self, "free_axis", goal.free_axis)

    @property
    def rotation(self) -> FloatArray:
        """The matrix of the quaternion, (3, 3)."""
        return Pose((0.0, 0.0, 0.0), self.quaternion).rotation

    @property
    def wanted(self) -> int:
        """What the equations ask for: a pose, an axis or a position."""
        return POSITION if self.tolerance >= math.pi else POSE if self.free_axis is None else AXIS

    def allows(self, R: FloatArray) -> BoolArray:
        """Which of rotation matrices (k, 3, 3) are in the set, up to 1e-8 rad, (k,)."""
        if self.wanted == POSITION:
            return np.ones(len(R), dtype=np.bool_)
        turns = self.rotation.T @ R
        if self.free_axis is None:  # |A - I| = sqrt(8) sin(angle / 2)
            chord = np.sqrt(((turns - np.eye(3)) ** 2).sum(axis=(1, 2)) / 2.0)
        else:
            axis = np.array(self.free_axis)
            chord = np.sqrt(((turns @ axis - axis) ** 2).sum(axis=1))
        return np.asarray(chord <= 2.0 * math.sin(min(self.tolerance + SAME_RADIANS, math.pi) / 2.0))
