"""Tool poses with tolerances: a round object may be gripped from any side, a block put down slightly off its place."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import number, whole

__all__ = ["PoseGoal", "turned_about", "unit_axis"]

MAX_CANDIDATES = 1000
"""Each candidate is an inverse kinematics problem."""

PRIMES = (2, 3, 5, 7, 11, 13)
"""Bases of the Halton sequence, one for each coordinate that is drawn."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""Multiples of this share of a full turn never repeat, and any number of them is evenly spread (Weyl)."""


@dataclass(frozen=True)
class PoseGoal:
    """A goal that any tool pose within the tolerances of ``pose`` reaches, in the base frame.

    Attributes:
        pose: The pose in the middle.
        position_tolerance: Metres by which the tool frame's origin may deviate.
        orientation_tolerance: Radians by which the tool may be rotated.
        free_axis: Axis (x, y, z) in the tool frame about which any rotation is allowed; None for none. (1, 0, 0) for a
            round object and a tool that approaches along +x.
        candidates: How many poses are tried: ``pose`` first, the others evenly spread, the same on every machine.

    Raises:
        InvalidRequest: A tolerance is negative or more than a metre or pi, the axis has no length, or ``candidates``
            is not from 1 to 1000.
    """

    pose: Pose
    position_tolerance: float = 0.0
    orientation_tolerance: float = 0.0
    free_axis: tuple[float, float, float] | None = None
    candidates: int = 16

    def __post_init__(self) -> None:
        if not isinstance(self.pose, Pose):
            raise InvalidRequest("pose", self.pose, "a Pose of the tool")
        number("position_tolerance", self.position_tolerance, "metres in [0, 1]", 0.0, 1.0)
        number("orientation_tolerance", self.orientation_tolerance, "radians in [0, pi]", 0.0, math.pi)
        if self.free_axis is not None:
            object.__setattr__(self, "free_axis", unit_axis(self.free_axis))
        object.__setattr__(self, "candidates", whole("candidates", self.candidates, 1, MAX_CANDIDATES))

    def poses(self) -> tuple[Pose, ...]:
        """The candidates; only ``pose`` if there is no tolerance."""
        room = self.position_tolerance > 0.0 or self.orientation_tolerance > 0.0 or self.free_axis is not None
        return tuple(self._candidate(k) for k in range(self.candidates if room else 1))

    def _candidate(self, k: int) -> Pose:
        if k == 0:
            return self.pose
        shift = _in_ball(k, PRIMES[:3], self.position_tolerance)
        turned = self.pose
        if self.free_axis is not None:
            turned = turned @ turned_about(self.free_axis, 2.0 * math.pi * ((k * GOLDEN) % 1.0))
        lean = _in_ball(k, PRIMES[3:], self.orientation_tolerance)
        angle = math.sqrt(math.fsum(x * x for x in lean))
        if angle > 0.0:
            turned = turned @ turned_about((lean[0] / angle, lean[1] / angle, lean[2] / angle), angle)
        x, y, z = (p + s for p, s in zip(self.pose.position, shift, strict=True))
        return Pose((x, y, z), turned.quaternion)


def unit_axis(axis: object) -> tuple[float, float, float]:
    """The direction of a free axis (x, y, z), of length 1.

    Raises:
        InvalidRequest: It is not three numbers, or has no length.
    """
    expected = "three numbers that are not all 0"
    if not isinstance(axis, Sequence) or isinstance(axis, str) or len(axis) != 3:
        raise InvalidRequest("free_axis", axis, expected)
    x, y, z = (number("free_axis", value, expected, -1e3, 1e3) for value in axis)
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-9:
        raise InvalidRequest("free_axis", axis, expected)
    return (x / length, y / length, z / length)


def turned_about(axis: tuple[float, float, float], angle: float) -> Pose:
    """A turn by an angle (rad) about a unit vector."""
    x, y, z = axis
    s = math.sin(angle / 2.0)
    return Pose(quaternion=(math.cos(angle / 2.0), x * s, y * s, z * s))


def _in_ball(k: int, bases: Sequence[int], radius: float) -> tuple[float, float, float]:
    """The k-th of evenly spread points in a ball, from Halton's sequence (Numerische Mathematik 2, 1960)."""
    u, v, w = (_halton(k, base) for base in bases)
    away = radius * math.pow(u, 1.0 / 3.0)
    height, angle = 2.0 * v - 1.0, 2.0 * math.pi * w
    across = math.sqrt(max(0.0, 1.0 - height * height))
    return (away * across * math.cos(angle), away * across * math.sin(angle), away * height)


def _halton(k: int, base: int) -> float:
    """The radical inverse: the digits of k in ``base``, mirrored behind the point."""
    out, share = 0.0, 1.0
    while k:
        share /= base
        out += share * (k % base)
        k //= base
    return out
