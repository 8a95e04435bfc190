"""What a cell is made of, as a value: enough to make the same cell again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from planner_service.cell.arms import Arm
from planner_service.geometry.arrays import set_fields
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Scene

__all__ = ["Layout"]


@dataclass(frozen=True, eq=False)
class Layout:
    """Robots at places in a scene, or one robot whose joints are those of several arms.

    Attributes:
        scene: What stands there, in the cell's frame.
        arms: Robots at places, by the names of the arms; empty for one robot with several arms.
        whole: The robot with several arms; None for robots at places.
        groups: The joints of each of its arms.
        tools: The link that is the tool, for those of its arms whose tool is not the robot's.
        carried: What arms hold, by their names, at poses in their tool frames.
    """

    scene: Scene
    arms: Mapping[str, Arm] = field(default_factory=dict)
    whole: Robot | None = None
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    tools: Mapping[str, str] = field(default_factory=dict)
    carried: Mapping[str, tuple[Attached, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        groups = {name: tuple(joints) for name, joints in self.groups.items()}
        carried = {name: tuple(held) for name, held in self.carried.items()}
        for name, given in (("arms", self.arms), ("groups", groups), ("tools", self.tools), ("carried", carried)):
            set_fields(self, **{name: MappingProxyType(dict(given))})
