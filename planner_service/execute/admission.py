"""What may be driven: plans that are proven, for this robot, within what the arm allows, from where it stands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planner_service.collision.names import Kind, Owner, owner_of
from planner_service.errors import InvalidRequest
from planner_service.execute.driver import ArmLimits
from planner_service.geometry import FloatArray
from planner_service.outcome import PlanResult
from planner_service.peaks import TOLERANCE, peaks
from planner_service.plan_file import SavedPlan, SavedTask
from planner_service.robot import Robot
from planner_service.task import Segment, TaskResult
from planner_service.trajectory import Trajectory

__all__ = ["Executable", "Motion", "motions_of", "refusal", "require_drivable", "require_near", "robot_of"]

Executable = PlanResult | SavedPlan | SavedTask | TaskResult | Trajectory

ROUNDED = 1e-4
"""Radians by which a controller's position limits may be rounded: the simulated one's are, to 3e-6."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What is left of a segment once it is known to be proven; width None without a gripper, ``grips``: at its end."""

    name: str
    trajectory: Trajectory
    width: float | None
    grips: bool = False


def require_drivable(motions: Sequence[Motion], robot: Robot, limits: ArmLimits, speed: float, near: float) -> None:
    """Raise for motions that leave what robot and arm allow, or do not follow each other within ``near`` radians."""
    for motion in motions:
        _require_within(motion, robot, limits, speed)
    for before, after in pairwise(motions):
        end, begin = before.trajectory(before.trajectory.duration), after.trajectory(0.0)
        require_near(f"begin of {after.name}", begin, end, robot, near)


def robot_of(plan: Executable, robot: Robot | None) -> Robot:
    """The robot that a plan was made for, as far as that comes with it; else the one that is given."""
    origins = [origin.service.robot for result in _results(plan) if (origin := result.origin) is not None]
    if robot is None:
        if not origins:
            raise InvalidRequest("robot", None, "the robot the plan was made for: only plans of this process know it")
        return origins[0]
    for made in origins:
        opened = robot if robot.gripper is None or made.gripper is None else robot.with_gripper(made.gripper_width)
        if made.hash != opened.hash:
            raise _other_robot(made.name, made.hash, robot)
    if isinstance(plan, SavedPlan | SavedTask) and plan.robot.hash != robot.hash:
        raise _other_robot(plan.robot.name, plan.robot.hash, robot)
    return robot


def _results(plan: Executable) -> list[PlanResult]:
    if isinstance(plan, SavedPlan):
        return [plan.result]
    if isinstance(plan, SavedTask | TaskResult):
        return [segment.result for segment in plan.segments]
    return [plan] if isinstance(plan, PlanResult) else []


def _other_robot(name: str, made_for: str, robot: Robot) -> InvalidRequest:
    return refusal(
        "plan", f"made for {name}, {made_for[:12]}", f"a plan made for this robot ({robot.name}, {robot.hash[:12]})"
    )


def motions_of(plan: Executable, robot: Robot, *, allow_unproven: bool) -> list[Motion]:
    """The motions of a plan, in order, each proven or allowed not to be."""
    if isinstance(plan, Trajectory):
        if not allow_unproven:
            expected = "a plan with its certificate; a bare trajectory only with allow_unproven=True"
            raise InvalidRequest("plan", plan, expected)
        return [_rested("motion", plan, None)]
    if isinstance(plan, SavedPlan):
        plan = plan.result
    if isinstance(plan, PlanResult):
        width = robot.gripper_width if plan.origin is None else plan.origin.service.robot.gripper_width
        return [_proven(Segment("motion", plan, width), robot, allow_unproven=allow_unproven)]
    if not isinstance(plan, SavedTask | TaskResult):
        raise InvalidRequest("plan", plan, "a plan, a saved plan, a task or a trajectory")
    if plan.failure is not None or not plan.segments:
        raise InvalidRequest("plan", str(plan.failure), "a task all of whose motions have a plan")
    return [_proven(segment, robot, allow_unproven=allow_unproven) for segment in plan.segments]


def _proven(segment: Segment, robot: Robot, *, allow_unproven: bool) -> Motion:
    result = segment.result
    if result.trajectory is None:
        raise InvalidRequest(segment.name, str(result.failure), "a motion with a trajectory")
    proof, motion = result.certificate, result.trajectory
    begin, end = (-math.inf, math.inf) if proof is None or proof.part is None else proof.part
    if not allow_unproven and (proof is None or not proof.certified or begin > motion.begin or end < motion.end):
        why = "none" if proof is None else str(proof.refusal or f"a proof from s = {begin:g} to {end:g}")
        raise InvalidRequest(
            f"certificate of {segment.name}", why, "a proof of the whole motion, or allow_unproven=True"
        )
    fingers = {Owner(Kind.LINK, link) for link in (() if robot.gripper is None else robot.gripper.links)}
    touched = {owner_of(name, robot) for interval in result.exempt for pair in interval.pairs for name in pair}
    width = None if math.isnan(segment.width) or robot.gripper is None else segment.width
    return replace(_rested(segment.name, motion, width), grips=bool(fingers & touched))


def _rested(name: str, trajectory: Trajectory, width: float | None) -> Motion:
    if float(np.abs(trajectory(0.0, 1)).max(initial=0.0)) > TOLERANCE:
        raise InvalidRequest(f"trajectory of {name}", "moving at its begin", "one that begins at rest")
    return Motion(name, trajectory, width)


def _require_within(motion: Motion, robot: Robot, limits: ArmLimits, speed: float) -> None:
    path = motion.trajectory.path
    if path.n != robot.n or len(limits.lower) != robot.n:
        found = f"{path.n} joints, the arm {len(limits.lower)}"
        raise refusal(f"trajectory of {motion.name}", found, f"the {robot.n} joints of {robot.name}")
    least, most = path.waypoints.min(axis=0), path.waypoints.max(axis=0)  # blends stay between their waypoints
    for whose, lower, upper, slack in (
        ("the robot", robot.limits.lower, robot.limits.upper, TOLERANCE),
        ("the arm", limits.lower, limits.upper, ROUNDED),
    ):
        for k, joint in enumerate(robot.joint_names):
            if least[k] < lower[k] - slack or most[k] > upper[k] + slack:
                found = f"from {least[k]:.4f} to {most[k]:.4f}"
                raise refusal(f"{joint} in {motion.name}", found, f"{whose}'s {lower[k]:.4f} to {upper[k]:.4f}")
    peak = peaks(motion.trajectory, replace(robot.limits, velocity=limits.velocity)).velocity
    if peak.ratio * speed > 1.0 + TOLERANCE:
        allowed, joint = limits.velocity[peak.joint], robot.joint_names[peak.joint]
        found = f"{speed:g}, {joint} moving at {peak.ratio * speed * allowed:.3f} in {motion.name}"
        raise refusal("speed", found, f"at most {1.0 / peak.ratio:.3f}: the arm's limit is {allowed:.3f}")


def require_near(field: str, found: FloatArray, wanted: FloatArray, robot: Robot, near: float) -> None:
    """Raise for the joint that is farthest off, if any is too far."""
    if found.shape != wanted.shape:
        raise InvalidRequest(field, found, f"{robot.n} joint positions")
    off = np.abs(found - wanted)
    k = int(np.argmax(np.where(np.isfinite(off), off, math.inf)))
    if not off[k] <= near:
        at = f"{robot.joint_names[k]} at {found[k]:.4f}"
        raise refusal(field, at, f"{wanted[k]:.4f} within {near:g} (start_tolerance)")


def refusal(field: str, found: str, expected: str) -> InvalidRequest:
    """What is wrong with a field, the values as they are written."""
    return InvalidRequest(field, found, expected, message=f"{field}: got {found}; expected {expected}")
