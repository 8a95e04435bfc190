"""The kinds of grasps, and a value that stands for those that are found when they are needed."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
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
        found = list(self.by_kind(robot, target))
        if not any(poses for _, poses, _ in found):
            refused = "; ".join(f"{kind.value}: {why}" for kind, _, why in found)
            raise InvalidRequest("target", target.name, refused)
        return tuple(pose for _, poses, _ in found for pose in poses)

    def by_kind(self, robot: Robot, target: Obstacle) -> Iterator[tuple[GraspKind, tuple[Pose, ...], str]]:
        """Each kind with its grasps, best first, and with why there are none; looked for when it is asked for.

        Kinds that the gripper cannot do are left out, and so are grasps that an earlier kind has as well.

        Raises:
            InvalidRequest: The robot has no gripper, or one that can do none of these kinds.
        """
        instance("target", target, Obstacle, "an Obstacle, such as service.scene.obstacle(name)")
        gripper = instance("robot", robot, Robot, "a Robot").gripper
        if gripper is None:
            raise InvalidRequest("robot", robot.name, "a robot with a gripper")
        cup = gripper.kind == "vacuum"
        kinds = [kind for kind in self.kinds if kind is GraspKind.TOP or cup == (kind is GraspKind.SUCTION)]
        if not kinds:
            given = ", ".join(kind.value for kind in self.kinds)
            raise InvalidRequest("kinds", given, f"some that a {gripper.kind} gripper can do")
        return self._each(kinds, robot, target)

    def _each(
        self, kinds: Sequence[GraspKind], robot: Robot, target: Obstacle
    ) -> Iterator[tuple[GraspKind, tuple[Pose, ...], str]]:
        """See ``by_kind``."""
        known: set[Pose] = set()
        for kind in kinds:
            try:
                found = tuple(pose for pose in self._of(kind, robot, target) if pose not in known)
            except InvalidRequest as error:
                yield kind, (), str(error.expected)
                continue
            known.update(found)
            yield kind, found, "" if found else "the same as before"

    def _of(self, kind: GraspKind, robot: Robot, target: Obstacle) -> tuple[Pose, ...]:
        if kind is GraspKind.TOP:
            return top_grasps(robot, target)
        if kind is GraspKind.SIDE:
            return side_grasps(robot, target)
        if kind is GraspKind.SUCTION:
            return suction_grasps(robot, target, most=self.most)
        return antipodal_grasps(robot, target, friction=self.friction, seed=self.seed, most=self.most)
