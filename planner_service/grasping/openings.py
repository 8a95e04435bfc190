"""How wide a gripper opens around an object: the usual room first, less where that does not fit among others."""

from __future__ import annotations

import re

from planner_service.errors import InvalidRequest
from planner_service.robot.gripper import Gripper
from planner_service.scene.names import Names

__all__ = ["FINGER_ROOMS", "opened", "openings", "tells_of_fingers"]

FINGER_ROOMS = (0.012, 0.006, 0.003)
"""Metres between each finger and the object when the gripper opens for it, in the order tried: a grasp from a camera is
wrong by up to 3 mm, and boxes that stand 1 cm apart leave no room for more than that beside a finger."""


def openings(gripper: Gripper, width: float, wanted: float | None = None) -> tuple[float, ...]:
    """The openings in metres to try around an object, the widest first; one only where ``wanted`` says which.

    Args:
        width: Metres that the object has between the fingers.
        wanted: ``Handling.open_width``.

    Raises:
        InvalidRequest: The object is wider than the gripper opens, or than ``wanted``; or that is given for a cup.
    """
    if gripper.kind == "vacuum":
        if wanted is not None:
            raise InvalidRequest("open_width", wanted, "None: a cup does not open")
        return (gripper.upper,)
    if width > gripper.upper:
        raise InvalidRequest("target", f"{width:.4f} m wide", f"an object at most {gripper.upper:.4f} m wide")
    if wanted is None:
        return tuple(dict.fromkeys(min(gripper.upper, width + 2 * room) for room in FINGER_ROOMS))
    if wanted < width:
        raise InvalidRequest("open_width", wanted, f"at least the object's width, {width:.4f} m")
    return (wanted,)


def opened(gripper: Gripper, opening: float) -> str:
    """How wide a gripper is open, in words; empty for a cup."""
    return "" if gripper.kind == "vacuum" else f"gripper {opening * 1000:.1f} mm open"


def tells_of_fingers(reason: str, fingers: tuple[str, ...], names: Names) -> bool:
    """Whether a reason says that fingers meet something, which a smaller opening may change.

    Args:
        fingers: The links that can touch anything.
        names: Of the robot and the scene that the reason is about.
    """
    links = "|".join(re.escape(names.link(finger)) for finger in fingers)
    return (
        bool(fingers)
        and re.search(rf"(?:^|\W)(?:{links}) (?:x|would stand) | x (?:{links})(?:\W|$)", reason) is not None
    )
