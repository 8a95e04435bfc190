"""How plans are executed: speed, command rate, and what stops the arm."""

from __future__ import annotations

from dataclasses import dataclass, fields

from planner_service.geometry.validation import number

__all__ = ["HARDWARE_SPEED", "Streaming"]

HARDWARE_SPEED = 0.2
"""Fraction of the planned speed: slow enough to reach the emergency stop in time."""


@dataclass(frozen=True)
class Streaming:
    """How plans are executed.

    Attributes:
        speed: Fraction of the planned speed, in (0, 1]: time is stretched, so velocities fall by it and accelerations
            by its square. None for 1 in simulation, else 0.2.
        rate: Commands per second.
        start_tolerance: Radians (or metres) by which the arm may stand elsewhere than where a motion begins, and than
            where it ends once the arm has settled; MoveIt's.
        tracking_tolerance: Radians (or metres) by which a moving joint may be away from everywhere it was to be within
            the last ``latest`` and the arm's lag; beyond it something is in the way, and the stream is stopped.
        settle: Seconds that the arm may take to come to rest after the end of each motion; it is recorded until then.
        latest: Seconds by which a command may be late before the stream is stopped.
        gripper_time: Seconds in which the gripper opens or closes.
        gripper_tolerance: Metres by which the gripper may be open more or less than a motion was proven with.
        squeeze: Metres that the gripper is told to close beyond an object, so that it presses.

    Raises:
        InvalidRequest: a value is no number, or out of its range.
    """

    speed: float | None = None
    rate: float = 250.0
    start_tolerance: float = 0.01
    tracking_tolerance: float = 0.1
    settle: float = 2.0
    latest: float = 0.1
    gripper_time: float = 1.0
    gripper_tolerance: float = 0.005
    squeeze: float = 0.01

    def __post_init__(self) -> None:
        if self.speed is not None:
            number("speed", self.speed, "a part of the planned speed in (0, 1]", 1e-3, 1.0)
        ranges = {"rate": (10.0, 1000.0), "start_tolerance": (0.0, 0.1), "settle": (0.0, 10.0), "latest": (0.001, 1.0)}
        ranges |= {"gripper_time": (0.1, 10.0), "squeeze": (0.0, 0.02)}
        ranges |= {"tracking_tolerance": (0.0, 1.0), "gripper_tolerance": (0.0, 0.1)}
        for item in fields(self)[1:]:
            lowest, highest = ranges[item.name]
            number(item.name, getattr(self, item.name), f"a number from {lowest:g} to {highest:g}", lowest, highest)
