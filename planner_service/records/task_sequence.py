"""The motions of a task, each with the robot and the scene as they are during it.

A task says of each motion only how wide the gripper is open and what is carried. The scenes follow: what the gripper
takes is no obstacle any more, and what it leaves becomes one where it is let go. Nothing else may change.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest, NotProven
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.grasping.grasps import offset_from, width_across
from planner_service.grasping.guards import LOOSE_GRASP, MEANT_OVERLAP, PUSHED_ASIDE, grasp_objection
from planner_service.grasping.held import held_by
from planner_service.kinematics.tool_line import rotation_distance
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import JOIN, SAME_WIDTH
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = ["SAME_WIDTH", "ClaimedMotion", "TaskMotion", "fingers_of", "gripped_by", "task_motions"]

SAME_PLACE = 1e-5
"""Metres and radians by which the tool may miss a grasp's pose; inverse kinematics is exact to 1e-7."""


@dataclass(frozen=True, eq=False)
class ClaimedMotion:
    """What a task claims of one motion.

    Attributes:
        width: Metres between the finger pads during it; 0 without a gripper.
        attached: What is carried during it.
        scene: The scene during it, if that is known from elsewhere; None for a task from a file.
    """

    name: str
    result: PlanResult
    width: float
    attached: tuple[Attached, ...]
    scene: Scene | None = None


@dataclass(frozen=True, eq=False)
class TaskMotion:
    """One motion with the robot and the scene as they are during it.

    Attributes:
        taken: The obstacle of ``scene`` on which the gripper closes after it; None if it takes nothing.
        left: The object carried in ``scene`` that the gripper releases after it; None if it leaves nothing.
    """

    name: str
    result: PlanResult
    trajectory: Trajectory
    robot: Robot
    scene: Scene
    taken: Obstacle | None = None
    left: Attached | None = None

    @property
    def end(self) -> FloatArray:
        """Where the robot comes to rest, (n,)."""
        return self.trajectory(self.trajectory.duration)


def fingers_of(robot: Robot) -> tuple[str, ...]:
    """The finger links that can touch anything."""
    shaped = {shape.link for shape in robot.shapes}
    return () if robot.gripper is None else tuple(link for link in robot.gripper.links if link in shaped)


def task_motions(robot: Robot, scene: Scene, claims: Sequence[ClaimedMotion]) -> Iterator[TaskMotion]:
    """The motions of a task one by one, each after all before it were checked.

    Args:
        scene: The scene at the start, with what is carried then.

    Raises:
        NotProven: a motion has no plan, a width is out of range, two motions do not join, or the scene changes by more
            than one object that the gripper takes or leaves.
    """
    before: TaskMotion | None = None
    for claim, after in zip(claims, (*claims[1:], None), strict=True):
        opened, trajectory = _opened(robot, claim), _trajectory(claim, robot)
        if before is None:
            _require_same_attached(claim, scene.attached)
        else:
            scene = _changed(before, claim)
            _require_joined(before, claim, trajectory)
        if claim.scene is not None and not _alike(claim.scene, scene):
            claimed = f"another scene than {'at the start of the plan' if before is None else 'after ' + before.name}"
            raise _unsound(claim, claimed, "a scene that changes only by what the gripper takes and leaves")
        taken, left = (None, None) if after is None else _exchanged(claim, after, scene, robot)
        before = TaskMotion(claim.name, claim.result, trajectory, opened, scene, taken, left)
        if taken is not None and after is not None:
            _require_grasp(before, taken, after)
        yield before


def _unsound(claim: ClaimedMotion, claimed: str, expected: str) -> NotProven:
    return NotProven(f"{claim.name}: got {claimed}; expected {expected}")


def _trajectory(claim: ClaimedMotion, robot: Robot) -> Trajectory:
    """The trajectory rebuilt from its numbers, so that what is proven is what is executed."""
    path, trajectory = claim.result.path, claim.result.trajectory
    if path is None or trajectory is None:
        raise _unsound(claim, str(claim.result.failure), "a motion with a path and a trajectory")
    on = trajectory.path
    if on.n != robot.n:
        raise _unsound(claim, f"a motion of {on.n} joints", f"one of the {robot.n} joints of {robot.name}")
    if not (np.array_equal(on.waypoints, path.waypoints) and np.array_equal(on.blends, path.blends)):
        raise _unsound(claim, "a trajectory along another path than the plan's", "one path")
    try:
        curve = JointPath(on.waypoints, on.blends)
        return Trajectory(curve, trajectory.durations, trajectory.coefficients, trajectory.dilation, trajectory.part)
    except InvalidRequest as error:
        raise NotProven(f"{claim.name}: {error}") from None


def _opened(robot: Robot, claim: ClaimedMotion) -> Robot:
    if robot.gripper is None:
        return robot
    try:
        return robot.with_gripper(claim.width)
    except InvalidRequest:
        expected = f"a gap between the finger pads in [{robot.gripper.lower:g}, {robot.gripper.upper:g}] m"
        raise _unsound(claim, f"gripper width {claim.width!r}", expected) from None


def _require_same_attached(claim: ClaimedMotion, attached: tuple[Attached, ...]) -> None:
    if claim.attached != attached:
        claimed = f"{_names(claim.attached)} carried"
        raise _unsound(claim, claimed, f"{_names(attached)}, as in the scene at the start")


def _names(attached: tuple[Attached, ...]) -> str:
    return ", ".join(held.name for held in attached) or "nothing"


def _require_joined(before: TaskMotion, claim: ClaimedMotion, trajectory: Trajectory) -> None:
    begin = trajectory(0.0)
    off = np.abs(begin - before.end)
    k = int(np.argmax(off))
    if not off[k] <= JOIN:
        claimed = f"a start with {before.robot.joint_names[k]} at {begin[k]:.6g}"
        raise _unsound(claim, claimed, f"{before.end[k]:.6g}, where {before.name} ends")


def gripped_by(robot: Robot, attached: Sequence[Attached]) -> tuple[str, ...]:
    """The carried objects that the fingers hold; others are mounted on the tool."""
    fingers = set(fingers_of(robot))
    return tuple(held.name for held in attached if fingers & set(held.touch_links))


def _exchanged(
    claim: ClaimedMotion, after: ClaimedMotion, scene: Scene, robot: Robot
) -> tuple[Obstacle | None, Attached | None]:
    """What the gripper takes and what it leaves between two motions: one of the two, or neither."""
    gained = [held for held in after.attached if held not in claim.attached]
    lost = [held for held in claim.attached if held not in after.attached]
    gripped = gripped_by(robot, [held for held in claim.attached if held in after.attached])
    if gripped and abs(after.width - claim.width) > SAME_WIDTH:
        claimed = f"a gripper that goes from {claim.width:.4f} to {after.width:.4f} m around {', '.join(gripped)}"
        raise _unsound(after, claimed, "a gripper that stays as it is while it holds something")
    if not gained and not lost:
        return None, None
    if len(gained) + len(lost) > 1:
        claimed = f"{_names(after.attached)} carried after {_names(claim.attached)}"
        raise _unsound(after, claimed, "one object taken or left at a time")
    opens = after.width - claim.width
    moves = robot.gripper is None or robot.gripper.kind != "vacuum"  # a cup takes and lets go without moving
    if lost:
        if moves and not opens > SAME_WIDTH:
            claimed = f"{lost[0].name} left by a gripper that {'closes' if opens < -SAME_WIDTH else 'stays as it is'}"
            raise _unsound(after, claimed, "a gripper that opens to leave what it carries")
        return None, lost[0]
    taken = next((obstacle for obstacle in scene.obstacles if obstacle.name == gained[0].name), None)
    if taken is None or taken.shape != gained[0].shape:
        claimed = f"{gained[0].name} carried from now on"
        raise _unsound(after, claimed, "an obstacle of that name and shape in the scene before")
    if moves and not opens < -SAME_WIDTH:
        claimed = f"{taken.name} taken by a gripper that {'opens' if opens > SAME_WIDTH else 'stays as it is'}"
        raise _unsound(after, claimed, "a gripper that closes on what it takes")
    return taken, None


def _changed(before: TaskMotion, claim: ClaimedMotion) -> Scene:
    """The scene after a motion, once the gripper has taken or left its object."""
    scene = before.scene
    if before.taken is not None:
        held = next(held for held in claim.attached if held.name == before.taken.name)
        return scene.without(held.name).with_attached(held)
    if before.left is not None:
        pose = Pose.from_matrix(before.robot.tool_pose(before.end)) @ before.left.pose
        left = Obstacle(before.left.name, before.left.shape, pose)
        return scene.without_attached(left.name).with_obstacle(left)
    return scene


def _require_grasp(motion: TaskMotion, taken: Obstacle, after: ClaimedMotion) -> None:
    """Refuse a grasp that ``pick`` would not make, where a motion ends and the gripper closes."""
    held = next(held for held in after.attached if held.name == taken.name)
    gripper = motion.robot.gripper
    if gripper is None:
        raise _unsound(after, f"{taken.name} taken without a gripper", "a robot with a gripper")
    tool = Pose.from_matrix(motion.robot.tool_pose(motion.end))
    if not _same_place(tool @ held.pose, taken.pose):
        raise _unsound(after, f"{taken.name} carried at another place than where it is taken", "the same place")
    beyond_fingers = set(held.touch_links) - set(fingers_of(motion.robot))
    if beyond_fingers:
        claimed = f"{taken.name} may touch {', '.join(sorted(beyond_fingers))}"
        raise _unsound(
            after, claimed, f"what is taken to touch the fingers alone: {', '.join(fingers_of(motion.robot))}"
        )
    width = width_across(taken, tool, motion.robot)
    if abs(after.width - width) > MEANT_OVERLAP and not _as_before(taken, tool, motion.robot, after.width):
        claimed = f"a gripper {after.width:.4f} m open around {taken.name}"
        raise _unsound(after, claimed, f"{width:.4f} m, as wide as that is between the fingers")
    if gripper.kind == "vacuum":
        if objection := grasp_objection(taken, tool, motion.robot):
            raise _unsound(after, objection, "a cup whose rim lies on what is taken")
        return
    aside, beyond = offset_from(taken, tool, motion.robot)
    if beyond > LOOSE_GRASP or aside > PUSHED_ASIDE:
        claimed = (
            f"fingertips {beyond * 1000:.0f} mm away from {taken.name}, and its middle {aside * 1000:.0f} mm aside"
        )
        expected = f"at most {LOOSE_GRASP * 1000:.0f} mm and {PUSHED_ASIDE * 1000:.0f} mm"
        raise _unsound(after, claimed, expected)


def _as_before(taken: Obstacle, tool: Pose, robot: Robot, width: float) -> bool:
    """Whether a gripper is as open as all of an object is wide, as in files from before it closed on parts of one."""
    moves = robot.gripper is not None and robot.gripper.kind != "vacuum"
    return moves and abs(width - held_by(taken, tool, robot).extent) <= MEANT_OVERLAP


def _same_place(a: Pose, b: Pose) -> bool:
    near = max(abs(x - y) for x, y in zip(a.position, b.position, strict=True)) <= SAME_PLACE
    return near and rotation_distance(a, b) <= SAME_PLACE


def _alike(a: Scene, b: Scene) -> bool:
    """Whether two scenes are equal up to the order of their obstacles and the rounding of where something was left."""
    in_b = {obstacle.name: obstacle for obstacle in b.obstacles}
    same = a.attached == b.attached and in_b.keys() == {obstacle.name for obstacle in a.obstacles}
    return same and all(o.shape == in_b[o.name].shape and _same_place(o.pose, in_b[o.name].pose) for o in a.obstacles)
