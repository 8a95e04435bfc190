"""The constraints that the page offers: each with one number, and for the rest by where the tool is at the start."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from planner_service.constraints import Constraint, KeepOrientation, KeepUpright, ToolRegion
from planner_service.geometry.shapes import Pose

__all__ = ["CONSTRAINTS", "ConstraintChoice"]

DEGREES = 10.0
ROOM = 0.05
"""Metres that the tool may go beyond where it is at the start, if nothing else is said."""


@dataclass(frozen=True)
class ConstraintChoice:
    """A constraint that can be added on the page.

    Attributes:
        default: The number that is suggested, by the pose of the tool at the start.
        of: The constraint, by that pose and a number.
    """

    default: Callable[[Pose], float]
    of: Callable[[Pose, float], Constraint]


def _upright(tool: Pose, degrees: float) -> Constraint:
    return KeepUpright(tool.rotation_rows[2], math.radians(degrees))


def _orientation(tool: Pose, degrees: float) -> Constraint:
    return KeepOrientation(tool, math.radians(degrees))


def _above(_: Pose, height: float) -> Constraint:
    return ToolRegion(lower=(-math.inf, -math.inf, height), name="above")


def _below(_: Pose, height: float) -> Constraint:
    return ToolRegion(upper=(math.inf, math.inf, height), name="below")


CONSTRAINTS: Mapping[str, ConstraintChoice] = MappingProxyType(
    {
        "lean at most (deg)": ConstraintChoice(lambda _: DEGREES, _upright),
        "turn at most (deg)": ConstraintChoice(lambda _: DEGREES, _orientation),
        "stay above (m)": ConstraintChoice(lambda tool: round(tool.position[2] - ROOM, 3), _above),
        "stay below (m)": ConstraintChoice(lambda tool: round(tool.position[2] + ROOM, 3), _below),
    }
)
"""By what the page calls them."""
