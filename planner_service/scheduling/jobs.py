"""What arms are to do: an object, where it goes, and which arms may take it there."""

from __future__ import annotations

from dataclasses import dataclass

from planner_service.geometry.arrays import set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import checked_name, instance, items

__all__ = ["PickJob"]

MAX_ARMS = 16


@dataclass(frozen=True)
class PickJob:
    """An object that is taken, and set down elsewhere.

    Attributes:
        object: The obstacle to take.
        place: Where it is set down, in the cell's frame.
        support: The obstacle it then stands on, which it may touch; None if it is set down on nothing.
        arms: The arms that may do it; empty for all.

    Raises:
        InvalidRequest: A value is of the wrong kind.
    """

    object: str
    place: Pose
    support: str | None = None
    arms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        checked_name("object", self.object)
        instance("place", self.place, Pose, "a Pose")
        if self.support is not None:
            checked_name("support", self.support)
        arms = items("arms", self.arms, str, "names of arms", MAX_ARMS)
        for name in arms:
            checked_name("arms", name)
        set_fields(self, arms=arms)
