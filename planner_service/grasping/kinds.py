"""The kinds of grasps, and a value that stands for those that are found when they are needed."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, items, whole
from planner_service.grasping.antipodal import MAX_SEED, antipodal_grasps
from planner_service.grasping.covering import MAX_GRASPS, MOST
from planner_service.grasping.grasps import side_grasps, top_grasps
from planner_service.grasping.held import FRICTION, require_friction
from planner_service.grasping.suction import suction_grasps
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = ["GraspKind", "GraspKinds"]


class GraspKind(enum.Enum):
    """How grasps of an object are found."""

    TOP = "top"
    """From above, through its middle: ``top_grasps``."""
    SIDE = "side"
    """From the side, through its middle: ``side_grasps``; for fingers."""
    ANTIPODAL = "antipodal"
    """Where two contacts face each other: ``antipodal_grasps``; for fingers."""
    SUCTION = "suction"
    """On any flat face: ``suction_grasps``; for a cup."""


@dataclass(frozen=True)
class GraspKinds:
    """Grasps of some kinds, one kind after the other, as a value for tasks: found for the object as it stands then.

    Attributes:
        kinds: In the order of preference. Those that the gripper cannot do are left out.
        friction: As for ``antipodal_grasps``; so are the others.
        seed: Of antipodal grasps.
        most: Antipodal grasps, or of suction, at most.

    Raises:
        InvalidRequest: No kind, one twice, or a value out of its range.
    """

    kinds: Sequence[GraspKind] = tuple(GraspKind)
    friction: float = FRICTION
    seed: int = 0
    most: int = MOST

    def __post_init__(self) -> None:
        kinds = items("kinds", self.kinds, GraspKind, "a list of GraspKind", len(GraspKind))
        if not kinds or len(set(kinds)) != len(kinds):
            raise InvalidRequest("kinds", kinds, "at least one GraspKind, each once")
        friction, seed = require_friction(self.friction), whole("seed", self.seed, 0, MAX_SEED)
        set_fields(self, kinds=kinds, friction=friction, seed=seed, most=whole("most", self.most, 1, MAX_GRASPS))

    def poses(self, robot: Robot, target: Obstacle) -> tuple[Pose, ...]:
        """The grasps of an object, best first.

        Raises:
            InvalidRequest: The robot has no gripper, or there is no grasp of these kinds; it says why for each.
        """
        instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
        gripper = instance("robot", robot, Robot, "a Robot").gripper
        if gripper is None:
            raise InvalidRequest("robot", robot.name, "a robot with a gripper")
        cup = gripper.kind == "vacuum"
        found, refused = dict[Pose, None](), list[str]()
        for kind in self.kinds:
            if kind is not GraspKind.TOP and cup != (kind is GraspKind.SUCTION):
                continue
            try:
                found.update(dict.fromkeys(self._of(kind, robot, target)))
            except InvalidRequest as error:
                refused.append(f"{kind.value}: {error.expected}")
        if found:
            return tuple(found)
        if not refused:
            given = ", ".join(kind.value for kind in self.kinds)
            raise InvalidRequest("kinds", given, f"some that a {gripper.kind} gripper can do")
        raise InvalidRequest("target", target.name, "; ".join(refused))

    def _of(self, kind: GraspKind, robot: Robot, target: Obstacle) -> tuple[Pose, ...]:
        if kind is GraspKind.TOP:
            return top_grasps(robot, target)
        if kind is GraspKind.SIDE:
            return side_grasps(robot, target)
        if kind is GraspKind.SUCTION:
            return suction_grasps(robot, target, most=self.most)
        return antipodal_grasps(robot, target, friction=self.friction, seed=self.seed, most=self.most)
