"""What may be executed: proven plans for this robot, within the arm's limits, from where it stands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planner_service.errors import InvalidRequest, NotProven
from planner_service.execute.driver import ArmLimits
from planner_service.geometry.arrays import FloatArray
from planner_service.path.trajectory import Trajectory
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment, TaskResult
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.recertify import (
    Plan,
    Recertified,
    planned_elsewhere,
    recertify,
    require_same_robot,
    world_of,
)
from planner_service.records.task_sequence import TaskMotion
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, Owner, owner_of
from planner_service.service import PlannerService
from planner_service.timing.limit_check import TOLERANCE, peaks

__all__ = [
    "Executable",
    "Motion",
    "admitted",
    "needs_a_service",
    "refusal",
    "require_drivable",
    "require_free_opening",
    "require_near",
]

Executable = PlanResult | SavedPlan | SavedTask | TaskResult | Trajectory

ROUNDED = 1e-4
"""Radians by which a controller's position limits may be rounded: the simulated one's are, to 3e-6."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion to execute; its width is None without a gripper, and ``grips`` says if the gripper closes at its end.

    Before it, once the gripper stands so, the arm stands still for ``wait`` seconds.
    """

    name: str
    trajectory: Trajectory
    width: float | None
    grips: bool = False
    wait: float = 0.0


def require_drivable(motions: Sequence[Motion], robot: Robot, limits: ArmLimits, speed: float, near: float) -> None:
    """Raise for motions that leave what robot and arm allow, or do not follow each other within ``near`` radians."""
    for motion in motions:
        _require_within(motion, robot, limits, speed)
    for before, after in pairwise(motions):
        end, begin = before.trajectory(before.trajectory.duration), after.trajectory(0.0)
        require_near(f"begin of {after.name}", begin, end, robot, near)


def admitted(
    plan: Executable,
    robot: Robot | None,
    service: PlannerService | None,
    *,
    allowed: Sequence[tuple[str, str]],
    simulated: bool,
    allow_unproven: bool,
    squeeze: float,
) -> tuple[Robot, list[Motion], Recertified | None]:
    """The robot that a plan is for, its motions in order, and their proof made again, None if none need be.

    Raises:
        InvalidRequest: it is no plan, is of another robot or scene, or comes from a file and is to move a real arm
            without a ``service``.
        NotProven: it is not proven.
    """
    if isinstance(plan, Trajectory):
        if not allow_unproven:
            expected = "a plan with its certificate; a bare trajectory only with allow_unproven=True"
            raise InvalidRequest("plan", plan, expected)
        robot = robot if service is None else service.robot
        if robot is None:
            raise InvalidRequest("robot", None, "the robot that the trajectory was made for")
        return robot, [_rested("motion", plan, None)], None
    if not isinstance(plan, PlanResult | SavedPlan | SavedTask | TaskResult):
        raise InvalidRequest("plan", plan, "a plan, a saved plan, a task or a trajectory")
    for given in (robot, None if service is None else service.robot):
        if given is not None:
            require_same_robot(plan, given)
    if service is None and not simulated and not allow_unproven and planned_elsewhere(plan):
        raise needs_a_service(plan)
    if allow_unproven:
        return *_unproven(plan, robot if service is None else service.robot), None
    proven = recertify(plan, service, allowed=allowed, squeeze=squeeze).required()
    segments = plan.segments if isinstance(plan, SavedTask | TaskResult) else [None] * len(proven.motions)
    motions = [
        replace(_proven(motion.motion), wait=0.0 if segment is None else segment.wait)
        for motion, segment in zip(proven.motions, segments, strict=True)
    ]
    return proven.world.robot, motions, proven


def require_free_opening(proven: Recertified, width: float, near: float) -> None:
    """Raise unless the gripper, standing ``width`` metres open, is free to go to where the first motion has it.

    Args:
        near: Metres within which it is let be.

    Raises:
        NotProven: something is in its way, or it would drop what it carries.
    """
    first = proven.motions[0].motion.robot
    if first.gripper is not None and abs(first.gripper_width - width) > near:
        if dropped := proven.dropped_from(width):
            raise NotProven(f"{proven.motions[0].name}: {dropped}")
        opening = proven.opening_from(width)
        if opening is not None and opening.refused:
            raise NotProven(f"{proven.motions[0].name}: {opening.refused}")


def needs_a_service(plan: Plan) -> InvalidRequest:
    """The error for moving a real arm in a world that only a file describes."""
    made = world_of(plan)
    expected = "your own robot and scene: --robot and --scene, or execute(..., service=PlannerService(robot, scene))"
    message = (
        f"a plan from a file or a server moves a real arm only in {expected}. It says {made.robot.name} "
        f"({made.robot.hash[:12]}) in {made.scene.name or 'a scene without a name'} ({made.scene.hash[:12]})"
    )
    return InvalidRequest("service", None, expected, message=f"service: {message}")


def _unproven(plan: Plan, robot: Robot | None) -> tuple[Robot, list[Motion]]:
    """The motions as they are, their gripper widths apart."""
    made = [] if isinstance(plan, PlanResult) and plan.origin is None else [world_of(plan).robot]
    if robot is None and not made:
        raise InvalidRequest("robot", None, "the robot the plan was made for: only plans of this process know it")
    robot = made[0] if robot is None else robot
    if isinstance(plan, SavedTask | TaskResult):
        return robot, [_as_it_is(segment, robot) for segment in plan.segments]
    result = plan.result if isinstance(plan, SavedPlan) else plan
    width = robot.gripper_width if result.origin is None else result.origin.world.robot.gripper_width
    return robot, [_as_it_is(Segment("motion", result, width), robot)]


def _as_it_is(segment: Segment, robot: Robot) -> Motion:
    result = segment.result
    if result.trajectory is None:
        raise InvalidRequest(segment.name, str(result.failure), "a motion with a trajectory")
    width = None if robot.gripper is None else robot.with_gripper(segment.width).gripper_width
    fingers = {Owner(Kind.LINK, link) for link in (() if robot.gripper is None else robot.gripper.links)}
    meant = [interval.pairs for interval in result.exempt if interval.depth is None]
    touched = {owner_of(name, robot) for pairs in meant for pair in pairs for name in pair}
    motion = _rested(segment.name, result.trajectory, width)
    return replace(motion, grips=bool(fingers & touched), wait=segment.wait)


def _proven(motion: TaskMotion) -> Motion:
    width = None if motion.robot.gripper is None else motion.robot.gripper_width
    return replace(_rested(motion.name, motion.trajectory, width), grips=motion.taken is not None)


def _rested(name: str, trajectory: Trajectory, width: float | None) -> Motion:
    if float(np.abs(trajectory(0.0, 1)).max(initial=0.0)) > TOLERANCE:
        raise InvalidRequest(f"trajectory of {name}", "moving at its begin", "one that begins at rest")
    return Motion(name, trajectory, width)


def _require_within(motion: Motion, robot: Robot, limits: ArmLimits, speed: float) -> None:
    path = motion.trajectory.path
    if path.n != robot.n or len(limits.lower) != robot.n:
        actual = f"{path.n} joints, the arm {len(limits.lower)}"
        raise refusal(f"trajectory of {motion.name}", actual, f"the {robot.n} joints of {robot.name}")
    least, most = path.waypoints.min(axis=0), path.waypoints.max(axis=0)  # blends stay between their waypoints
    for whose, lower, upper, slack in (
        ("the robot", *robot.bounds, TOLERANCE),
        ("the arm", limits.lower, limits.upper, ROUNDED),
    ):
        for k, joint in enumerate(robot.joint_names):
            if least[k] < lower[k] - slack or most[k] > upper[k] + slack:
                actual = f"from {least[k]:.4f} to {most[k]:.4f}"
                raise refusal(f"{joint} in {motion.name}", actual, f"{whose}'s {lower[k]:.4f} to {upper[k]:.4f}")
    peak = peaks(motion.trajectory, replace(robot.limits, velocity=limits.velocity)).velocity
    if peak.ratio * speed > 1.0 + TOLERANCE:
        allowed, joint = limits.velocity[peak.joint], robot.joint_names[peak.joint]
        actual = f"{speed:g}, {joint} moving at {peak.ratio * speed * allowed:.3f} in {motion.name}"
        raise refusal("speed", actual, f"at most {1.0 / peak.ratio:.3f}: the arm's limit is {allowed:.3f}")


def require_near(field: str, actual: FloatArray, wanted: FloatArray, robot: Robot, near: float) -> None:
    """Raise for the joint that is farthest off, if any is too far."""
    if actual.shape != wanted.shape:
        raise InvalidRequest(field, actual, f"{robot.n} joint positions")
    off = np.abs(actual - wanted)
    k = int(np.argmax(np.where(np.isfinite(off), off, math.inf)))
    if not off[k] <= near:
        at = f"{robot.joint_names[k]} at {actual[k]:.4f}"
        raise refusal(field, at, f"{wanted[k]:.4f} within {near:g} (start_tolerance)")


def refusal(field: str, actual: str, expected: str) -> InvalidRequest:
    """What is wrong with a field, the values as they are written."""
    return InvalidRequest(field, actual, expected, message=f"{field}: got {actual}; expected {expected}")
