"""The arm behind a driver: every answer is copied and checked, every call can be watched.

A reading is believed if the arm can be there: near the last reading, or on the way from there to where it was
commanded, plus what its joints can move in the meantime. After one impossible reading, no other is believed.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.execute.driver import ArmLimits, Driver
from planner_service.execute.preconditions import refusal
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import number, numbers
from planner_service.robot.model import Robot

__all__ = ["Arm", "Call"]

NOISE = 0.05
"""Radians (or metres) by which a reading may be off what the arm can have done: noise, and answers that come late."""

ABSURD = 0.5
"""Radians (or metres) that an arm cannot be away from where it was or was commanded, however long ago that was."""

MAX_LAG = 1.0
"""Seconds; an arm that lags more cannot be commanded in a stream."""

MAX_WIDTH = 10.0
"""Metres between finger pads, beyond which a unit is wrong."""


@dataclass(frozen=True, eq=False)
class Call:
    """One call of a driver's method."""

    name: str


class Arm:
    """A driver's arm while a plan is executed.

    Attributes:
        simulated, lag, limits: As the driver says, checked; velocities no higher than the robot's.
        stopping: Set from outside to have calls raise, except those of an arm that is being told to hold.
        holding: Set while the arm is being told to hold.
        abandoned: Set from outside to have every call raise: one did not return.
        call: The call under way, an object of its own; None in between.

    Raises:
        InvalidRequest: the driver does not answer, or what it says makes no sense.
    """

    def __init__(self, driver: Driver, robot: Robot) -> None:
        self.driver, self.joints = driver, robot.joint_names
        self.stopping = self.holding = self.abandoned = self._doubted = False
        self.call: Call | None = None
        self._seen: FloatArray | None = None
        self._since = 0.0
        try:
            simulated, lag, limits = driver.simulated, driver.lag, driver.limits()
        except InvalidRequest:
            raise
        except Exception as error:
            raise _silent(error) from error
        if not isinstance(simulated, bool | np.bool_):
            raise InvalidRequest("simulated", simulated, "True if nothing real moves, else False")
        if not isinstance(limits, ArmLimits):
            raise InvalidRequest("limits", limits, "an ArmLimits")
        if len(limits.lower) != robot.n:
            raise refusal("arm", f"{len(limits.lower)} joints", f"the {robot.n} joints of {robot.name}")
        expected = f"seconds from 0 to {MAX_LAG:g} for each joint, shape ({robot.n},)"
        self.lag = numbers("lag", lag, expected)
        if self.lag.shape != (robot.n,) or not np.all((self.lag >= 0.0) & (self.lag <= MAX_LAG)):
            raise InvalidRequest("lag", lag, expected)
        self.simulated = bool(simulated)
        self.limits = ArmLimits(limits.lower, limits.upper, np.minimum(limits.velocity, robot.limits.velocity))

    def positions(self, commanded: FloatArray) -> FloatArray:
        """A copy of where the joints are, shape (n,), if they can be there.

        Args:
            commanded: Where the arm was last told to be, (m, n): at one of these, or between them.

        Raises:
            InvalidRequest: the reading is no n finite numbers, or none that can be believed.
        """
        now = time.perf_counter()
        expected = f"{len(self.joints)} joint positions"
        try:
            answer = self._asked("positions")
        except Exception as error:
            if self._seen is None:  # nothing was commanded yet
                raise _silent(error) from error
            raise
        reading = numbers("positions", answer, expected)
        if reading.shape != (len(self.joints),):
            raise InvalidRequest("positions", reading, expected)
        if not np.all(np.isfinite(reading)):
            k = int(np.argmin(np.isfinite(reading)))
            raise refusal("arm", f"{self.joints[k]} at {reading[k]}", "a finite position")
        if self._seen is not None:
            self._require_believable(reading, np.vstack([commanded, self._seen]))
        self._seen, self._since = reading, now
        return reading

    def _require_believable(self, measured: FloatArray, way: FloatArray) -> None:
        seconds = time.perf_counter() - self._since
        near = np.clip(measured, way.min(axis=0), way.max(axis=0))
        reach = NOISE + np.minimum(self.limits.velocity * seconds, ABSURD)
        beyond = np.abs(measured - near) - reach
        k = int(np.argmax(beyond))
        if self._doubted or beyond[k] > 0.0:
            self._doubted = True
            expected = f"{near[k]:.4f} within {reach[k]:.3f}, {seconds * 1000.0:.0f} ms after the last reading"
            raise refusal("arm", f"{self.joints[k]} at {measured[k]:.4f}", expected)

    def command(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> None:
        """See ``Driver``; it gets copies."""
        self._asked("command", q.copy(), qd.copy(), qdd.copy())

    def hold(self, q: FloatArray) -> None:
        """See ``Driver``; it gets a copy."""
        self._asked("hold", q.copy())

    def gripper_width(self) -> float:
        """Metres between the finger pads.

        Raises:
            InvalidRequest: the driver says what is no width.
        """
        return number("gripper", self._asked("gripper_width"), "metres between the finger pads", -MAX_WIDTH, MAX_WIDTH)

    def move_gripper(self, width: float, seconds: float) -> None:
        """See ``Driver``."""
        self._asked("move_gripper", width, seconds)

    def _asked(self, name: str, *given: Any) -> Any:
        """What the driver answers, as far as it is still to be asked."""
        if self.abandoned or (self.stopping and not self.holding):
            raise InterruptedError("the stream is to end")
        self.call = Call(name)
        try:
            return getattr(self.driver, name)(*given)
        finally:
            self.call = None


def _silent(error: Exception) -> InvalidRequest:
    return refusal("driver", f"{type(error).__name__}: {error}", "an arm that answers")
