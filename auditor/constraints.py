"""Whether a motion keeps constraints, judged at dense samples with Pinocchio's kinematics.

Constraints are plain numbers here: names of links, 4 x 4 poses, bounds. Angles are read off rotation matrices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from auditor.checker import IndependentChecker

__all__ = ["Deviation", "Range", "Region", "deviations", "violations"]

FloatArray = NDArray[np.float64]

MOTION_STEP = 2e-4
"""Metres that a point of the robot moves between two samples, at most."""

SLACK = 2e-9
"""Metres or radians by which a deviation may exceed its tolerance: rounding in two programs."""


def _unmoved() -> FloatArray:
    return np.eye(4)


@dataclass(frozen=True)
class Region:
    """A frame of the robot stays in a region of another frame.

    Attributes:
        link: The link that carries the constrained frame.
        tool: The constrained frame in it, 4 x 4.
        relative_to: The link that carries the region; None for the world.
        frame: The frame of the region in it, 4 x 4.
        lower, upper: Bounds of the constrained frame's origin along the axes of the region's frame, metres or infinite.
        tilt: Radians between the two z axes at most; None for any.
        turn: Radians about z at most, once the z axis is turned back onto that of the region the shortest way; or None.
        name: For messages.
    """

    link: str
    tool: ArrayLike = field(default_factory=_unmoved)
    relative_to: str | None = None
    frame: ArrayLike = field(default_factory=_unmoved)
    lower: Sequence[float] = (-math.inf, -math.inf, -math.inf)
    upper: Sequence[float] = (math.inf, math.inf, math.inf)
    tilt: float | None = None
    turn: float | None = None
    name: str = "region"


@dataclass(frozen=True)
class Range:
    """A joint stays between two values, rad or m."""

    joint: str
    lower: float
    upper: float


@dataclass(frozen=True)
class Deviation:
    """The largest deviation of a motion from what a constraint bounds.

    Attributes:
        name: Of the constraint.
        quantity: "tilt", "turn"; "x", "y", "z" or a joint: the distance from the middle between two bounds; "+x" the
            coordinate, where it has an upper bound only; "-x" its negative, where it has a lower bound only.
        amount: In metres or radians.
        tolerance: How large it may be.
        q: Where it is largest.
    """

    name: str
    quantity: str
    amount: float
    tolerance: float
    q: tuple[float, ...]

    @property
    def exceeds(self) -> bool:
        """Whether the tolerance is exceeded, by more than rounding; also if it is not a number."""
        return not self.amount <= self.tolerance + SLACK


def deviations(
    checker: IndependentChecker, samples: FloatArray, constraints: Iterable[Region | Range]
) -> list[Deviation]:
    """The largest deviations at configurations (m, n), of all that is bounded."""
    found = []
    for constraint in constraints:
        if isinstance(constraint, Range):
            name, table = constraint.joint, _of_joint(checker, samples, constraint)
        else:
            name, table = constraint.name, _of_region(checker, samples, constraint)
        for quantity, (amounts, tolerance) in table.items():
            k = int(np.where(np.isnan(amounts), np.inf, amounts).argmax())
            found.append(Deviation(name, quantity, float(amounts[k]), tolerance, tuple(samples[k].tolist())))
    return found


def violations(
    checker: IndependentChecker,
    q: Callable[[Any], FloatArray],
    length: float,
    constraints: Iterable[Region | Range],
    motion_step: float = MOTION_STEP,
) -> list[Deviation]:
    """What exceeds its tolerance on a curve q(s), s in [0, length], (m,) in and (m, n) out.

    No point of the robot moves more than ``motion_step`` metres from one sample to the next.
    """
    return [item for item in deviations(checker, checker.along(q, length, motion_step), constraints) if item.exceeds]


Table = dict[str, tuple[FloatArray, float]]


def _of_joint(checker: IndependentChecker, samples: FloatArray, constraint: Range) -> Table:
    values = samples[:, checker.joints.index(constraint.joint)]
    return _between(constraint.joint, values, constraint.lower, constraint.upper)


def _of_region(checker: IndependentChecker, samples: FloatArray, region: Region) -> Table:
    poses = _poses(checker, samples, region)
    table: Table = {}
    for axis, lower, upper in zip("xyz", region.lower, region.upper, strict=True):
        table |= _between(axis, poses[:, "xyz".index(axis), 3], lower, upper)
    z = poses[:, :3, 2]
    across = np.sqrt(z[:, 0] ** 2 + z[:, 1] ** 2)
    if region.tilt is not None:
        table["tilt"] = np.arctan2(across, z[:, 2]), region.tilt
    if region.turn is not None:
        table["turn"] = np.abs(_turns(poses[:, :3, :3])), region.turn
    return table


def _poses(checker: IndependentChecker, samples: FloatArray, region: Region) -> FloatArray:
    """The constrained frame in that of the region, (m, 4, 4)."""
    links = [region.link] if region.relative_to is None else [region.link, region.relative_to]
    placed = checker.poses_along(samples, links)
    inner = np.asarray(region.frame, dtype=np.float64)
    if region.relative_to is not None:
        inner = placed[:, 1] @ inner
    return np.asarray(np.linalg.inv(inner) @ placed[:, 0] @ np.asarray(region.tool, dtype=np.float64))


def _between(name: str, values: FloatArray, lower: float, upper: float) -> Table:
    if math.isfinite(lower) and math.isfinite(upper):
        return {name: (np.abs(values - (lower + upper) / 2.0), (upper - lower) / 2.0)}
    if math.isfinite(upper):
        return {f"+{name}": (values, upper)}
    if math.isfinite(lower):
        return {f"-{name}": (-values, -lower)}
    return {}


def _turns(R: FloatArray) -> FloatArray:
    """The angles (m,) about z that are left once z axes are turned back onto (0, 0, 1) about what is square to both."""
    z = R[:, :, 2]
    sine = np.hypot(z[:, 0], z[:, 1])
    x, y = z[:, 1] / np.where(sine > 0.0, sine, 1.0), -z[:, 0] / np.where(sine > 0.0, sine, 1.0)  # z x (0, 0, 1)
    K, none = np.zeros_like(R), np.zeros_like(x)
    K[:, 0], K[:, 1], K[:, 2] = (np.stack(row, axis=1) for row in ((none, none, y), (none, none, -x), (-y, x, none)))
    turned = (np.eye(3) + sine[:, None, None] * K + (1.0 - z[:, 2])[:, None, None] * (K @ K)) @ R
    return np.asarray(np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1]))
