"""A task as the world lives through it: the robot and the scene of each motion, and what the gripper does in between.

The gripper's width and what is carried are all that a task says of a motion. The scenes follow from them: what is taken
is no obstacle any more, and what is left is one where it is let go. Nothing else may change.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.errors import InvalidRequest, NotProven
from planner_service.geometry.shapes import FloatArray, Pose
from planner_service.grasping.grasps import offset_from, width_across
from planner_service.grasping.guards import LOOSE_GRASP, MEANT_OVERLAP, PUSHED_ASIDE
from planner_service.kinematics.inverse import rotation_distance
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import PlanResult
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = ["SAME_WIDTH", "Leg", "Step", "fingers_of", "gripped_by", "legs"]

JOIN = 1e-6
"""Radians (or metres) between the end of a motion and the begin of the next: it moves nothing by as much as the margin
of a proof."""

SAME_PLACE = 1e-5
"""Metres and radians by which the tool may miss the pose of a grasp; inverse kinematics is exact to 1e-7."""

SAME_WIDTH = 1e-6
"""Metres."""


@dataclass(frozen=True, eq=False)
class Step:
    """What a task says of one motion.

    Attributes:
        width: Metres between the finger pads during it; 0 without a gripper.
        attached: What is carried during it.
        scene: What the world was like, as far as that is known beside the task itself; None of a file.
    """

    name: str
    result: PlanResult
    width: float
    attached: tuple[Attached, ...]
    scene: Scene | None = None


@dataclass(frozen=True, eq=False)
class Leg:
    """One motion with the robot and the scene as they are during it.

    Attributes:
        taken: The object on which the gripper closes after it, as an obstacle of ``scene``; None if it takes nothing.
        left: The object that the gripper lets go after it, as it is carried in ``scene``; None if it leaves nothing.
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


def legs(robot: Robot, scene: Scene, steps: Sequence[Step]) -> Iterator[Leg]:
    """The motions one after another, each once the one before it and what follows from it are known to be sound.

    Args:
        scene: At the begin, with what is carried then.

    Raises:
        NotProven: a motion has no plan, a width is out of range, two motions do not join, or the scene changes other
            than by one object that the gripper takes or leaves.
    """
    before: Leg | None = None
    for step, after in zip(steps, (*steps[1:], None), strict=True):
        opened, trajectory = _opened(robot, step), _trajectory(step, robot)
        if before is None:
            _require_same_attached(step, scene.attached)
        else:
            scene = _changed(before, step)
            _require_joined(before, step, trajectory)
        if step.scene is not None and not _alike(step.scene, scene):
            found = f"another scene than {'at the start of the plan' if before is None else 'after ' + before.name}"
            raise _unsound(step, found, "a scene that changes only by what the gripper takes and leaves")
        taken, left = (None, None) if after is None else _exchanged(step, after, scene, robot)
        before = Leg(step.name, step.result, trajectory, opened, scene, taken, left)
        if taken is not None and after is not None:
            _require_grasp(before, taken, after)
        yield before


def _unsound(step: Step, found: str, expected: str) -> NotProven:
    return NotProven(f"{step.name}: got {found}; expected {expected}")


def _trajectory(step: Step, robot: Robot) -> Trajectory:
    """The motion, made again of its numbers: what is proven and what is driven are one, whatever was handed over."""
    path, trajectory = step.result.path, step.result.trajectory
    if path is None or trajectory is None:
        raise _unsound(step, str(step.result.failure), "a motion with a path and a trajectory")
    on = trajectory.path
    if on.n != robot.n:
        raise _unsound(step, f"a motion of {on.n} joints", f"one of the {robot.n} joints of {robot.name}")
    if not (np.array_equal(on.waypoints, path.waypoints) and np.array_equal(on.blends, path.blends)):
        raise _unsound(step, "a trajectory along another path than the plan's", "one path")
    try:
        curve = JointPath(on.waypoints, on.blends)
        return Trajectory(curve, trajectory.durations, trajectory.coefficients, trajectory.dilation, trajectory.part)
    except InvalidRequest as error:
        raise NotProven(f"{step.name}: {error}") from None


def _opened(robot: Robot, step: Step) -> Robot:
    if robot.gripper is None:
        return robot
    try:
        return robot.with_gripper(step.width)
    except InvalidRequest:
        expected = f"a gap between the finger pads in [{robot.gripper.lower:g}, {robot.gripper.upper:g}] m"
        raise _unsound(step, f"gripper width {step.width!r}", expected) from None


def _require_same_attached(step: Step, attached: tuple[Attached, ...]) -> None:
    if step.attached != attached:
        found = f"{_names(step.attached)} carried"
        raise _unsound(step, found, f"{_names(attached)}, as in the scene at the start")


def _names(attached: tuple[Attached, ...]) -> str:
    return ", ".join(held.name for held in attached) or "nothing"


def _require_joined(before: Leg, step: Step, trajectory: Trajectory) -> None:
    begin = trajectory(0.0)
    off = np.abs(begin - before.end)
    k = int(np.argmax(off))
    if not off[k] <= JOIN:
        found = f"a start with {before.robot.joint_names[k]} at {begin[k]:.6g}"
        raise _unsound(step, found, f"{before.end[k]:.6g}, where {before.name} ends")


def gripped_by(robot: Robot, attached: Sequence[Attached]) -> tuple[str, ...]:
    """What of all that is carried the fingers hold, rather than the tool has mounted."""
    fingers = set(fingers_of(robot))
    return tuple(held.name for held in attached if fingers & set(held.touch_links))


def _exchanged(step: Step, after: Step, scene: Scene, robot: Robot) -> tuple[Obstacle | None, Attached | None]:
    """What the gripper takes and what it leaves between two motions: one of both, or neither."""
    gained = [held for held in after.attached if held not in step.attached]
    lost = [held for held in step.attached if held not in after.attached]
    gripped = gripped_by(robot, [held for held in step.attached if held in after.attached])
    if gripped and abs(after.width - step.width) > SAME_WIDTH:
        found = f"a gripper that goes from {step.width:.4f} to {after.width:.4f} m around {', '.join(gripped)}"
        raise _unsound(after, found, "a gripper that stays as it is while it holds something")
    if not gained and not lost:
        return None, None
    if len(gained) + len(lost) > 1:
        found = f"{_names(after.attached)} carried after {_names(step.attached)}"
        raise _unsound(after, found, "one object taken or left at a time")
    opens = after.width - step.width
    if lost:
        if not opens > SAME_WIDTH:
            found = f"{lost[0].name} left by a gripper that {'closes' if opens < -SAME_WIDTH else 'stays as it is'}"
            raise _unsound(after, found, "a gripper that opens to leave what it carries")
        return None, lost[0]
    taken = next((obstacle for obstacle in scene.obstacles if obstacle.name == gained[0].name), None)
    if taken is None or taken.shape != gained[0].shape:
        found = f"{gained[0].name} carried from now on"
        raise _unsound(after, found, "an obstacle of that name and shape in the scene before")
    if not opens < -SAME_WIDTH:
        found = f"{taken.name} taken by a gripper that {'opens' if opens > SAME_WIDTH else 'stays as it is'}"
        raise _unsound(after, found, "a gripper that closes on what it takes")
    return taken, None


def _changed(before: Leg, step: Step) -> Scene:
    """The scene once the gripper has taken or left what it does after a motion."""
    scene = before.scene
    if before.taken is not None:
        held = next(held for held in step.attached if held.name == before.taken.name)
        return scene.without(held.name).with_attached(held)
    if before.left is not None:
        there = Pose.from_matrix(before.robot.tool_pose(before.end)) @ before.left.pose
        left = Obstacle(before.left.name, before.left.shape, there)
        return scene.without_attached(left.name).with_obstacle(left)
    return scene


def _require_grasp(leg: Leg, taken: Obstacle, after: Step) -> None:
    """Raise unless a gripper that closes where a motion ends has hold of an object as ``pick`` would."""
    held = next(held for held in after.attached if held.name == taken.name)
    gripper = leg.robot.gripper
    if gripper is None:
        raise _unsound(after, f"{taken.name} taken without a gripper", "a robot with a gripper")
    tool = Pose.from_matrix(leg.robot.tool_pose(leg.end))
    if not _same_place(tool @ held.pose, taken.pose):
        raise _unsound(after, f"{taken.name} carried at another place than where it is taken", "the same place")
    beyond_fingers = set(held.touch_links) - set(fingers_of(leg.robot))
    if beyond_fingers:
        found = f"{taken.name} may touch {', '.join(sorted(beyond_fingers))}"
        raise _unsound(after, found, f"what is taken to touch the fingers alone: {', '.join(fingers_of(leg.robot))}")
    width = width_across(taken, tool, gripper)
    if abs(after.width - width) > MEANT_OVERLAP:
        found = f"a gripper {after.width:.4f} m open around {taken.name}"
        raise _unsound(after, found, f"{width:.4f} m, as wide as that is between the fingers")
    aside, beyond = offset_from(taken, tool, gripper)
    if beyond > LOOSE_GRASP or aside > PUSHED_ASIDE:
        found = f"fingertips {beyond * 1000:.0f} mm away from {taken.name}, and its middle {aside * 1000:.0f} mm aside"
        expected = f"at most {LOOSE_GRASP * 1000:.0f} mm and {PUSHED_ASIDE * 1000:.0f} mm"
        raise _unsound(after, found, expected)


def _same_place(a: Pose, b: Pose) -> bool:
    near = max(abs(x - y) for x, y in zip(a.position, b.position, strict=True)) <= SAME_PLACE
    return near and rotation_distance(a, b) <= SAME_PLACE


def _alike(a: Scene, b: Scene) -> bool:
    """Whether two scenes are one but for the rounding of what was left in them, in whatever order."""
    there = {obstacle.name: obstacle for obstacle in b.obstacles}
    same = a.attached == b.attached and there.keys() == {obstacle.name for obstacle in a.obstacles}
    return same and all(o.shape == there[o.name].shape and _same_place(o.pose, there[o.name].pose) for o in a.obstacles)
