"""The limits of a robot that targets for its driver are to keep.

A setpoint goes to each target at an even speed. That speed is what limits of velocity are about, however early or late
targets come; the change of speed at a target, over the period between two, if all come in time, what those of
acceleration are about; and the change of that what those of jerk are about. Torques are what these speeds and
accelerations take at the place where the target comes.
"""

from __future__ import annotations

import math

import numpy as np

from planner_service.gate.tracking import Course, Setpoint, Tracking
from planner_service.gate.verdict import Kind, Refused
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import number
from planner_service.planning.request import torque_limits
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.timing.torque_limits import TorqueLimits

__all__ = ["CommandLimits"]

MAX_SCALE = 10.0

MAX_BRAKES = 5000
"""Targets that brake the arm; at 200 Hz 25 seconds."""

ROUNDING = 1e-9
"""Of an acceleration that is as large as it may be, relative."""


def _scale(field: str, value: object) -> float:
    return number(field, value, f"a number in (0, {MAX_SCALE:g}]", math.ulp(0.0), MAX_SCALE)


class CommandLimits:
    """Judges targets for a driver by the limits of its robot.

    Args:
        robot: Whose limits.
        scene: What it holds in it counts for torques.
        rate: Targets a second.
        tracking: What is assumed of the driver.
        acceleration_scale: Part of the limits of acceleration, in (0, 10].
        jerk_scale: The same of jerk; None if that is not judged.
        torque_scale: Share of the efforts, in (0, 1]; None if torques are not judged.

    Attributes:
        torques: The limits of torque, with what the arm carries by now; None if they are not judged.

    Raises:
        InvalidRequest: a scale out of range, or torques that are not known of this robot.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        rate: float,
        tracking: Tracking,
        *,
        acceleration_scale: float,
        jerk_scale: float | None,
        torque_scale: float | None,
    ) -> None:
        self._names, self._rate, self._goal_time = robot.joint_names, rate, tracking.goal_time
        self._shares = tracking.shares(1.0 / rate)
        self.lower, self.upper = robot.bounds
        self.velocity = robot.limits.velocity
        self.acceleration = _scale("acceleration_scale", acceleration_scale) * robot.limits.acceleration
        self._jerk = None if jerk_scale is None else _scale("jerk_scale", jerk_scale) * robot.limits.jerk
        if torque_scale is not None:
            number("torque_scale", torque_scale, "a share in (0, 1] of the efforts", math.ulp(0.0), 1.0)
        self._robot, self._torque_scale = robot, torque_scale
        self.torques = self.torques_in(scene)

    def torques_in(self, scene: Scene) -> TorqueLimits | None:
        """The limits of torque with what a scene has in the gripper; None if torques are not judged.

        Raises:
            InvalidRequest: torques that are not known of this robot.
        """
        return None if self._torque_scale is None else torque_limits(self._robot, scene, scale=self._torque_scale)

    def refuse(self, kind: Kind, index: int, joint: int, what: str) -> Refused:
        """The refusal of a target because of a joint."""
        name = self._names[joint]
        return Refused(kind, index, f"{name}: {what}", index / self._rate, name)

    def inside(self, rows: FloatArray) -> bool:
        """Whether targets (k, n) are within the joint limits."""
        return bool(((rows >= self.lower) & (rows <= self.upper)).all())

    def fastest(self, course: Course, targets: FloatArray) -> FloatArray:
        """How fast the setpoint may go to each of targets (k, n) at most, however early or late they come, (k, n)."""
        k = len(targets)
        return np.asarray((np.abs(targets - course.places[:k]) + course.radii[:k]) / self._goal_time)

    def slow_enough(self, course: Course, targets: FloatArray) -> bool:
        """Whether the setpoint keeps the limits of velocity on its way to targets (k, n)."""
        return bool((self.fastest(course, targets) <= self.velocity * (1.0 + ROUNDING)).all())

    def strong_enough(self, course: Course, targets: FloatArray) -> bool:
        """Whether targets (k, n) that come in time take no more torque than is allowed; true if that is not judged."""
        if self.torques is None:
            return True
        return bool((self._taken(self.torques, course, len(targets)) <= self.torques.limit * (1.0 + ROUNDING)).all())

    def _taken(self, torques: TorqueLimits, course: Course, k: int) -> FloatArray:
        """The torques that the first k targets take, (k, n)."""
        rates = (course.speeds[:k] - course.before[:k]) * self._rate
        return np.abs(torques.torques(course.due[:k], course.speeds[:k], rates))

    def may_brake(self, now: Setpoint) -> bool:
        """Whether the first target of those that brake a setpoint keeps the limits of velocity, wherever it can be."""
        left = float((np.abs(now.speed) * self._rate / self.acceleration).max())
        way = now.due - now.place + max(0.0, 1.0 - 1.0 / max(left, 1.0)) * self._goal_time * now.speed
        return bool((np.abs(way) + now.radius <= self._goal_time * self.velocity * (1.0 + ROUNDING)).all())

    def beyond(self, targets: FloatArray) -> Refused | None:
        """The first target outside the joint limits, or that is no number."""
        inside = (targets >= self.lower) & (targets <= self.upper)
        if inside.all():
            return None
        index, joint = (int(each[0]) for each in np.nonzero(~inside))
        value = targets[index, joint]
        if not math.isfinite(value):
            return self.refuse(Kind.NUMBER, index, joint, f"{value} is no finite number")
        span = f"[{self.lower[joint]:.6g}, {self.upper[joint]:.6g}]"
        return self.refuse(Kind.LIMIT, index, joint, f"{value:.6g} is outside its limits {span}")

    def objection(self, course: Course, targets: FloatArray) -> Refused | None:
        """The first target that breaks a limit of speed, acceleration, jerk or torque, and which."""
        k = len(targets)
        changes = course.speeds - course.before[:k]
        asked = [
            (Kind.SPEED, self.fastest(course, targets), self.velocity, "rad (or m) / s"),
            (Kind.ACCELERATION, np.abs(changes) * self._rate, self.acceleration, "rad (or m) / s^2"),
        ]
        if self._jerk is not None:
            jerks = np.abs(changes - course.changes[:k]) * self._rate**2
            asked.append((Kind.JERK, jerks, self._jerk, "rad (or m) / s^3"))
        if self.torques is not None:
            asked.append((Kind.TORQUE, self._taken(self.torques, course, k), self.torques.limit, "Nm (or N)"))
        wrong = [values > limit * (1.0 + ROUNDING) for _, values, limit, _ in asked]
        rows = [int(each.any(axis=1).argmax()) if each.any() else k for each in wrong]
        index = min(rows)
        if index == k:
            return None
        kind, values, limit, unit = asked[rows.index(index)]
        joint = int((values[index] / limit).argmax())
        words = f"{kind.value} {values[index, joint]:.4g} {unit}, of {limit[joint]:.4g}"
        return self.refuse(kind, index, joint, words)

    def braking(self, now: Setpoint) -> FloatArray | None:
        """Targets that bring a setpoint to rest, (m, n): each takes as much speed as the acceleration allows, in time.

        Of all joints alike, so that the arm goes straight on, until so little is left that the driver may stop. None
        if that takes more than ``MAX_BRAKES`` targets.
        """
        left = float((np.abs(now.speed) * self._rate / self.acceleration).max())
        count = max(math.ceil(left), 1) - 1 if left <= MAX_BRAKES else MAX_BRAKES
        if count == MAX_BRAKES:
            return None
        speeds = ((left - np.arange(1, count + 1)) / max(left, 1.0))[:, None] * now.speed
        moved = np.cumsum(self._shares[1] * self._goal_time * speeds, axis=0)
        places = now.due + np.concatenate([np.zeros((1, len(now.due))), moved])
        return np.asarray(np.concatenate([places[:-1] + self._goal_time * speeds, places[-1:]]))
