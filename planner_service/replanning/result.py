"""The result of replanning, and the motion under way that it began with."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import numpy as np

from planner_service.certify import Certificate, ExemptInterval
from planner_service.collision import CheckCounts
from planner_service.constraints.values import constraint_names
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import copied_in, number
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import Goal, PlanRequest, keeps_torques
from planner_service.planning.result import Failure, PlanResult
from planner_service.replanning.splice import Underway
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.timing.laws import Timing, ToppRa

__all__ = ["MAX_CHECKS", "OldMotion", "Outcome", "Replanned", "request_for", "underway"]

MAX_CHECKS = 20_000
"""States that replanning may judge unless a request says otherwise: some hundredths of a second."""

PACE = ("velocity_scale", "acceleration_scale", "max_tool_speed")
"""Attributes that a request and a pace have in common."""

MAX_LATENCY = 10.0
"""Seconds. More is a mistake in the unit."""

OUTSIDE = 1e-6
"""Radians by which a waypoint may lie outside a limit before a motion is another robot's."""


class Outcome(enum.Enum):
    """The outcome of replanning."""

    NEW = "new motion"
    """Another motion to the goal begins at the splice."""
    KEPT = "old motion goes on"
    """What is left of the old motion is free, and nothing better was found."""
    STOP = "stop along the old curve"
    """There is no way to the goal; the robot comes to rest on the old curve, which is proven that far."""
    UNSAFE = "nothing is safe"
    """Not even the earliest stop can be proven."""


@dataclass(frozen=True, eq=False)
class Replanned:
    """What to do from the splice on.

    Until then the robot goes on along the old motion, and rests once that has ended. At ``splice`` seconds on the old
    motion's clock the new one begins, at its own time 0. There both have the same position, velocity and acceleration,
    or the robot is at rest.

    Attributes:
        outcome: How it ended. There is a proven motion unless it is UNSAFE.
        result: That motion, with what it cost; a failure if UNSAFE. Its path begins at the waypoint before the robot.
            What is proven, from where the robot was at ``at_time`` to where the motion ends, is its certificate's
            ``part``; if the old motion ends before the splice, what was left of it is proven separately.
        splice: Seconds on the old motion's clock: ``at_time`` plus the latency, or the old motion's end if less than a
            nanoradian is left of it by then.
        request: The request with its start at the splice, and the goal: what the next call goes on with.
        failure: Why there is no new motion to the goal; None if there is one.
        ahead: Old waypoints beyond the end of a stop, shape (k, n): the next call tries them first.
        stop: The earliest stop, which is not proven free, if UNSAFE.
    """

    outcome: Outcome
    result: PlanResult
    splice: float
    request: PlanRequest
    failure: Failure | None
    ahead: FloatArray
    stop: Trajectory | None = None

    def __post_init__(self) -> None:
        copied_in(self, "ahead")

    @property
    def ok(self) -> bool:
        """Whether there is a proven motion, even if it is a stop."""
        return self.outcome is not Outcome.UNSAFE

    @property
    def path(self) -> JointPath | None:
        """The same as of the result."""
        return self.result.path

    @property
    def trajectory(self) -> Trajectory | None:
        """The same as of the result: its time 0 is the splice."""
        return self.result.trajectory

    @property
    def certificate(self) -> Certificate | None:
        """The same as of the result."""
        return self.result.certificate

    @property
    def counts(self) -> CheckCounts:
        """The collision checks it took."""
        return self.result.counts


@dataclass(frozen=True, eq=False)
class OldMotion:
    """The motion that is to be left.

    Attributes:
        splice: Seconds on its clock at which the next motion begins.
        exempt: Stretches on what is left of it on which pairs were not checked.
        ahead: Waypoints beyond its end, shape (k, n), if it is a stop.
        made_in: The scene it was planned in; None if that is not known, for a motion from a file or another process.
    """

    underway: Underway
    splice: float
    exempt: tuple[ExemptInterval, ...]
    ahead: FloatArray
    made_in: Scene | None

    @property
    def end(self) -> FloatArray:
        """Where it was to end."""
        end: FloatArray = (self.ahead if len(self.ahead) else self.underway.path.waypoints)[-1]
        return end

    @property
    def arrives(self) -> bool:
        """Whether it goes all the way there, and does not stop before."""
        return not len(self.ahead) and self.underway.end == self.underway.path.length


def underway(previous: PlanResult | Replanned, robot: Robot, at_time: float, latency: float) -> OldMotion:
    """The motion that is to be left, checked.

    Raises:
        InvalidRequest: ``previous`` is not a motion of this robot, or a time is out of range.
    """
    result = previous.result if isinstance(previous, Replanned) else previous
    expected = "a plan of this robot that is being executed"
    if not isinstance(result, PlanResult):
        raise InvalidRequest("previous", previous, expected)
    if result.path is None or result.trajectory is None:
        raise InvalidRequest("previous", str(result.failure), expected)
    path, trajectory = result.path, result.trajectory
    made = None if result.origin is None else result.origin.world
    lower, upper = robot.bounds
    if path.n != robot.n or not np.all((path.waypoints >= lower - OUTSIDE) & (path.waypoints <= upper + OUTSIDE)):
        given = f"a motion of {path.n} joints" if path.n != robot.n else "a motion outside this robot's joint limits"
        raise InvalidRequest("previous", given, expected)
    if made is not None and made.robot.hash != robot.hash:
        given = f"a motion of {made.robot.name}, {made.robot.hash[:12]}"
        expected = f"one of {robot.name}, {robot.hash[:12]}, its gripper as wide open as then"
        raise InvalidRequest("previous", given, expected)
    duration = trajectory.duration
    now = number("at_time", at_time, f"seconds on the old motion, from 0 to {duration:.6g}", 0.0, duration)
    late = number("latency", latency, f"seconds from 0 to {MAX_LATENCY:g}", 0.0, MAX_LATENCY)
    motion = Underway(trajectory, now, min(now + late, duration))
    if motion.arrived:
        motion = Underway(trajectory, now, duration)
    passed = float(path.knots[len(path.waypoints) - len(motion.path.waypoints)])
    exempt = [
        replace(e, s_start=motion.moved(e.s_start), s_end=motion.moved(e.s_end))
        for e in result.exempt
        if e.s_end >= passed
    ]
    ahead = previous.ahead if isinstance(previous, Replanned) else np.zeros((0, robot.n))
    return OldMotion(motion, max(now + late, motion.splice), tuple(exempt), ahead, None if made is None else made.scene)


def request_for(
    previous: PlanResult | Replanned, old: OldMotion, request: PlanRequest | None, goal: Goal | None
) -> PlanRequest:
    """The request to go on with: the given one, or the one before, with its start at the splice.

    The timing law of a plan is replaced by ``ToppRa``, and its states are limited to ``MAX_CHECKS``.

    Raises:
        InvalidRequest: The timing law cannot begin at speed, or there are constraints, which would not be kept.
    """
    start = old.underway.trajectory(old.underway.splice)
    if isinstance(previous, Replanned):
        goal = previous.request.goal if goal is None else goal
        request = request or previous.request
    goal = old.end if goal is None else goal
    if request is None and isinstance(previous, PlanResult):
        if previous.constraints:
            names = constraint_names(previous.constraints)
            expected = "a plan without constraints, which replan does not keep; or give a request without them"
            raise InvalidRequest("previous", f"constraints ({names})", expected)
        known = _request_of(previous)
        _require_no_torques(known.timing)
        return replace(known, start=start, goal=goal)
    if not isinstance(request, PlanRequest):
        raise InvalidRequest("request", request, "a PlanRequest")
    if request.constraints:
        names = constraint_names(request.constraints)
        raise InvalidRequest("request.constraints", names, "none: replan does not keep constraints")
    if not isinstance(request.timing, ToppRa):
        raise InvalidRequest("request.timing", request.timing, "ToppRa(), the law that can begin at speed")
    _require_no_torques(request.timing)
    return replace(request, start=start, goal=goal)


def _require_no_torques(timing: Timing) -> None:
    if keeps_torques(timing):
        raise InvalidRequest("request.timing", timing, "ToppRa() without torque: replan keeps no torque limits")


def _request_of(plan: PlanResult) -> PlanRequest:
    """The request of a plan, as far as it is known, for another motion that begins at speed."""
    origin = plan.origin
    if origin is None:
        return PlanRequest((), (), max_checks=MAX_CHECKS)
    request = origin.request
    if request is not None:
        timing = request.timing if isinstance(request.timing, ToppRa) else ToppRa()
        return replace(request, timing=timing, max_checks=min(request.max_checks, MAX_CHECKS))
    if origin.pace is not None:
        _require_no_torques(origin.pace.timing)
    pace, padding = origin.pace, max(plan.padding, PlanRequest((), ()).padding)
    scales = {} if pace is None else {name: getattr(pace, name) for name in PACE}
    return PlanRequest((), (), padding=padding, max_checks=MAX_CHECKS, **scales)
