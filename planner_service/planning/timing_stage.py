"""Timing a certified path: as fast as allowed, with its peaks measured.

The tool's speed is not a polynomial in time, so its peak is found by sampling, ever denser around the highest samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from planner_service.concurrency.polling import waited
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mass_properties import mass_properties
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.tool_speed import peak_tool_speed, tool_speeds
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.accounting import NoPlan, PlanAccounting
from planner_service.planning.request import Pace
from planner_service.planning.result import Failure, MotionReport, Reason, Stage
from planner_service.robot.inertia import LinkInertia, Payload, tensor_numbers
from planner_service.robot.model import JointLimits, Robot
from planner_service.scene.scene import Attached, Scene
from planner_service.timing.laws import TimingFailed, stop_duration, time_with_peaks
from planner_service.timing.segments import SpeedLimit
from planner_service.timing.torque_limits import TorqueLimits

T = TypeVar("T")

__all__ = ["timed", "tool_speed_limit", "torque_limits", "torques_of"]

LONG = 200
"""Waypoints beyond which a path may take long to time: then the time limit is watched meanwhile."""


def timed(path: JointPath, pace: Pace, robot: Robot, accounting: PlanAccounting) -> tuple[Trajectory, MotionReport]:
    """The path in time, and how the robot then moves, as the TIMING stage.

    Raises:
        NoPlan: The timing law has no solution.
    """
    limits, torque_limits = pace.limits(robot), accounting.torque_limits

    def away(work: Callable[[], T]) -> T:
        return waited(work) if len(path.knots) > LONG else work()

    with accounting.during(Stage.TIMING) as entry:
        try:
            limit = tool_speed_limit(path, pace, robot)
            trajectory, ratios = away(lambda: time_with_peaks(pace.timing, path, limits, limit, torque_limits))
            tool_speed = away(lambda: peak_tool_speed(robot, trajectory))
            if pace.max_tool_speed is not None and tool_speed > pace.max_tool_speed:
                factor, tool_speed = tool_speed / pace.max_tool_speed, pace.max_tool_speed
                trajectory, ratios = trajectory.dilated(factor), ratios.dilated(factor)
                if torque_limits is not None:
                    ratios = replace(ratios, torques=torque_limits.samples(trajectory).peaks())
            stops = away(lambda: _stop_duration(trajectory, pace, robot, limits, torque_limits))
        except TimingFailed as failed:
            raise NoPlan(Failure(Stage.TIMING, Reason.TIMING_FAILED, str(failed))) from failed
        entry.note, entry.length = f"{pace.timing.name}, {trajectory.duration:.2f} s", path.length
        settle = robot.settle_time if path.length > 0.0 else 0.0
        return trajectory, MotionReport(ratios, tool_speed, trajectory.duration, stops, settle)


def tool_speed_limit(path: JointPath, pace: Pace, robot: Robot) -> SpeedLimit | None:
    """The largest ds/dt at which the tool is no faster than allowed; None without a limit."""
    speed = pace.max_tool_speed
    if speed is None:
        return None

    def limit(s: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(speed / tool_speeds(robot, path(s), path(s, 1)))

    return limit


def _stop_duration(
    trajectory: Trajectory, pace: Pace, robot: Robot, limits: JointLimits, torque_limits: TorqueLimits | None
) -> float:
    """Seconds that the path would take with a stop at each of its corners; infinite if the law then fails."""
    path = trajectory.path
    if not path.blended.any():
        return trajectory.duration
    try:
        return _stopping(path, pace, robot, limits, torque_limits)
    except TimingFailed:
        return math.inf


def _stopping(
    path: JointPath, pace: Pace, robot: Robot, limits: JointLimits, torque_limits: TorqueLimits | None
) -> float:
    if pace.max_tool_speed is None:
        return stop_duration(path, pace.timing, limits, torque_limits)
    sharp = path.with_blends(None)
    speed_limit = tool_speed_limit(sharp, pace, robot)
    stopping, _ = time_with_peaks(pace.timing, sharp, limits, speed_limit, torque_limits)
    return stopping.duration * max(1.0, peak_tool_speed(robot, stopping) / pace.max_tool_speed)


def torque_limits(robot: Robot, scene: Scene, payload: Payload | None = None, scale: float = 1.0) -> TorqueLimits:
    """The torque limits of a robot that carries a payload, and the attached objects of a scene that have a mass.

    Raises:
        InvalidRequest: As ``TorqueLimits``.
    """
    tool = Pose.from_matrix(robot.tool_placement)
    loads = [] if payload is None else [_payload(payload)]
    loads += [_attached(held, held.mass) for held in scene.attached if held.mass is not None]
    carried = (replace(load, body=robot.tool_body, pose=tool @ load.pose) for load in loads)
    return TorqueLimits(robot, tuple(carried), scale)


def torques_of(pace: Pace, robot: Robot, scene: Scene) -> TorqueLimits | None:
    """The torque limits that a pace asks for; None if it asks for none.

    Raises:
        InvalidRequest: As ``TorqueLimits``.
    """
    return torque_limits(robot, scene, pace.payload, pace.torque_scale) if pace.keeps_torques else None


def _payload(payload: Payload) -> LinkInertia:
    """A payload in the tool frame."""
    return LinkInertia("payload", 0, payload.mass, payload.inertia, Pose(payload.com))


def _attached(held: Attached, mass: float) -> LinkInertia:
    """An object in the tool frame whose mass is spread evenly over its shape."""
    volume, (x, y, z), tensor = mass_properties(held.shape)
    numbers = tensor_numbers(np.asarray(tensor) * (mass / volume))
    return LinkInertia(held.name, 0, mass, numbers, held.pose @ Pose((float(x), float(y), float(z))))
