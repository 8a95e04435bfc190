"""What the constraints of a motion look like, and how far it uses their tolerances.

A bound on a coordinate is a rectangle in the region's frame, cut off some way beyond the motion. A bound on the tilt is
a sector of a sphere about the constrained frame, into which its z axis points; a bound on the turn is a sector of a
disc, into which its x axis points once the tilt is undone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner_service.constraints.values import Constraint, JointRange, ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.constraint_set import ROUNDING, ConstraintSet, Placed, Quantity, constraint_set
from planner_service.robot.model import Robot
from planner_service.view.triangles import Triangles, lathe

__all__ = ["PLACES", "Kept", "RegionFrames", "cap", "edges", "fan", "frames_at", "rectangles"]

PLACES = 100
"""Configurations of a motion from which it is known how far it reaches."""

BEYOND = 0.1
"""Metres by which what is drawn of a region without bounds reaches beyond the motion."""

FAR = 1.0
"""Metres from the motion beyond which a bound is not drawn."""

ARC = math.radians(6.0)
"""Of a circle that is drawn as one straight line, at most."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Constraints on a robot, and configurations Q (m, n) of the motion that keeps them."""

    constraints: ConstraintSet
    Q: FloatArray

    @classmethod
    def of(cls, robot: Robot, constraints: tuple[Constraint, ...], Q: FloatArray) -> Kept | None:
        """None if there are no constraints; errors as of ``ConstraintSet``."""
        return cls(constraint_set(robot, constraints), Q) if constraints else None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of all quantities that are bounded, each another one."""
        names = [
            quantity.what if is_joint else f"{quantity.name} {quantity.what}"
            for quantity, is_joint in self._quantities(self.Q[0])
        ]
        before = [names[:k].count(name) for k, name in enumerate(names)]
        return tuple(f"{name} ({n + 1})" if n else name for name, n in zip(names, before, strict=True))

    def used(self, Q: FloatArray) -> FloatArray:
        """How much of its tolerance each quantity uses at Q (m, n), as (m, names): -1 at a lower bound, 1 at an upper
        one. Between two bounds it is linear; where there is one, 0 from a centimetre inside it.
        """
        return np.array([[_used(quantity, is_joint) for quantity, is_joint in self._quantities(q)] for q in Q])

    def _quantities(self, q: FloatArray) -> list[tuple[Quantity, bool]]:
        """Those at q (n,), each with whether it is a joint's value."""
        joints = sum(isinstance(given, JointRange) for given in self.constraints.constraints)
        return [(quantity, k < joints) for k, quantity in enumerate(self.constraints.quantities(q))]

    def broken(self, q: FloatArray) -> list[bool]:
        """Which of the regions are left at q (n,)."""
        robot, regions = self.constraints.robot, self.constraints.regions
        alone = (constraint_set(robot, (placed.region,)) for placed in regions)
        return [max(quantity.share for quantity in one.quantities(q)) > 1.0 + ROUNDING for one in alone]


def _used(quantity: Quantity, is_joint: bool) -> float:
    low, high = quantity.lower, quantity.upper
    if not is_joint and quantity.what in ("tilt", "turn"):
        return quantity.value / high
    if math.isfinite(low) and math.isfinite(high):
        return (2.0 * quantity.value - low - high) / (high - low)
    return max(quantity.share, 0.0) if math.isfinite(high) else -max(quantity.share, 0.0)


@dataclass(frozen=True, eq=False)
class RegionFrames:
    """World poses at m configurations, (m, 4, 4) each.

    Attributes:
        region: The frame of the region.
        held: The constrained frame.
    """

    region: FloatArray
    held: FloatArray

    @property
    def points(self) -> FloatArray:
        """The origin of the constrained frame in the region's, (m, 3)."""
        apart = self.held[:, :3, 3] - self.region[:, :3, 3]
        return np.asarray(np.einsum("mji,mj->mi", self.region[:, :3, :3], apart))

    @property
    def allowed(self) -> FloatArray:
        """The region's frame moved to the origin of the constrained one."""
        out = self.region.copy()
        out[:, :3, 3] = self.held[:, :3, 3]
        return out

    @property
    def turned(self) -> FloatArray:
        """The constrained frame with its tilt undone: its z axis is the region's."""
        A = np.einsum("mji,mjk->mik", self.region[:, :3, :3], self.held[:, :3, :3])
        turn = np.arctan2(A[:, 1, 0] - A[:, 0, 1], A[:, 0, 0] + A[:, 1, 1])
        c, s, out = np.cos(turn)[:, None], np.sin(turn)[:, None], self.allowed
        x, y = self.region[:, :3, 0], self.region[:, :3, 1]
        out[:, :3, 0], out[:, :3, 1] = c * x + s * y, c * y - s * x
        return out


def frames_at(robot: Robot, placed: Placed, Q: FloatArray) -> RegionFrames:
    """The frames of a region at Q (m, n)."""
    turns, places = robot.body_poses_batch(Q)
    bodies = np.zeros((*turns.shape[:2], 4, 4))
    bodies[..., :3, :3], bodies[..., :3, 3], bodies[..., 3, 3] = turns, places, 1.0
    return RegionFrames(bodies[:, placed.base] @ placed.frame.matrix, bodies[:, placed.body] @ placed.at.matrix)


def rectangles(region: ToolRegion, points: FloatArray) -> FloatArray:
    """The bounds on coordinates as rectangles, corners (k, 4, 3) in the region's frame.

    Args:
        points: Where the constrained frame's origin goes, in the region's frame, (m, 3).
    """
    low, high = np.array(region.lower), np.array(region.upper)
    least, most = points.min(axis=0), points.max(axis=0)
    drawn = (low > least - FAR, high < most + FAR)
    bottom = np.where(drawn[0], low, np.minimum(least, high) - BEYOND)
    top = np.where(drawn[1], high, np.maximum(most, low) + BEYOND)
    out = []
    for axis in range(3):
        across, up = (axis + 1) % 3, (axis + 2) % 3
        for is_drawn, level in ((drawn[0], bottom), (drawn[1], top)):
            if is_drawn[axis]:
                corners = np.tile(level, (4, 1))
                corners[:, across] = [bottom[across], top[across], top[across], bottom[across]]
                corners[:, up] = [bottom[up], bottom[up], top[up], top[up]]
                out.append(corners)
    return np.array(out).reshape(-1, 4, 3)


def edges(corners: FloatArray) -> FloatArray:
    """The sides of rectangles with corners (k, 4, 3) as segments (4 k, 2, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)


def cap(tilt: float, length: float) -> Triangles:
    """The sector of a sphere about the origin with all directions up to ``tilt`` radians from z."""
    count = max(2, math.ceil(tilt / ARC))
    rim = [(tilt * (count - k) / count) for k in range(count)]
    outline = [(length * math.sin(angle), length * math.cos(angle)) for angle in rim]
    return lathe([(0.0, 0.0), *outline, (0.0, length)])


def fan(turn: float, length: float) -> Triangles:
    """The sector of a disc about the origin with all directions in the xy plane up to ``turn`` radians from x."""
    count = 2 * max(1, math.ceil(turn / ARC))
    angles = np.linspace(-turn, turn, count + 1)
    rim = length * np.stack([np.cos(angles), np.sin(angles), np.zeros(count + 1)], axis=1)
    k = np.arange(1, count + 1)
    return np.concatenate([np.zeros((1, 3)), rim]), np.stack([np.zeros(count, dtype=np.int64), k, k + 1], axis=1)
