"""What LeRobot calls the joints of a WidowX AI, which is what the vendor's plug-in calls them."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["FINGER", "JOINTS", "action_keys", "prefixes_of"]

FINGER = "left_carriage_joint"
"""The joint of the gripper, in metres: of one finger, and the other mirrors it."""

JOINTS = (*(f"joint_{k}" for k in range(6)), FINGER)


def prefixes_of(arms: int) -> tuple[str, ...]:
    """What the names of each arm's joints begin with."""
    return ("",) if arms == 1 else ("left_", "right_")


def action_keys(prefixes: Sequence[str]) -> list[str]:
    """The keys of an action, arm by arm."""
    return [f"{prefix}{joint}.pos" for prefix in prefixes for joint in JOINTS]
