"""The vendor's driver of the WidowX AI as a ``Driver``; the same for the arm and for its simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.execute.driver import ArmLimits
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.validation import numbers

__all__ = ["JOINT_NAMES", "READINGS", "SIMULATED_LAG", "TrossenDriver"]

JOINTS = 6

JOINT_NAMES = tuple(f"joint_{k}" for k in range(JOINTS))
"""By which the vendor's models of the arm, and robots that are made of them, call its joints."""

READINGS = ("positions", "velocities", "efforts", "external_efforts")
"""What the driver says of each joint: rad, rad/s and Nm, of the finger m, m/s and N."""

SIMULATED_LAG = (0.05, 0.05, 0.05, 0.05, 0.10, 0.10)
"""Seconds: kv / kp of the simulated controller's joints, which knows no feed-forward."""


class TrossenDriver:
    """A WidowX AI follower arm (wxai_v0), in position mode from the moment of connecting: it holds where it is.

    Closing sets the arm to idle, in which the vendor's firmware brakes its joints, and closes the gripper gently.

    Args:
        address: The controller's IP address.
        simulated: It is a ``SimulatedArm``'s: plans are executed at full speed by default.
        lag: As in ``Driver``; zero if None: the firmware follows velocities and accelerations.
        timeout: Seconds to wait for an answer.

    Raises:
        MissingDependency: trossen_arm is not installed (extra ``sim``).
        InvalidRequest: nothing answers there, or something else than this arm.
    """

    def __init__(
        self, address: str, *, simulated: bool = False, lag: ArrayLike | None = None, timeout: float = 5.0
    ) -> None:
        try:
            import trossen_arm
        except ImportError:
            raise MissingDependency("trossen_arm", "sim") from None
        seconds = numbers("lag", np.zeros(JOINTS) if lag is None else lag, f"seconds, shape ({JOINTS},)")
        if seconds.shape != (JOINTS,) or not np.all((seconds >= 0.0) & (seconds <= 1.0)):
            raise InvalidRequest("lag", seconds, f"seconds from 0 to 1, shape ({JOINTS},)")
        self._lag, self._simulated = read_only(seconds), simulated
        self._arm: Any = trossen_arm.TrossenArmDriver()
        self._arm.set_log_level(trossen_arm.LogLevel.error)
        try:
            self._arm.configure(
                trossen_arm.Model.wxai_v0, trossen_arm.StandardEndEffector.wxai_v0_follower, address, False, timeout
            )
            self._arm.set_all_modes(trossen_arm.Mode.position)
        except (trossen_arm.RuntimeError, trossen_arm.LogicError, RuntimeError) as error:
            self._arm.cleanup()
            raise InvalidRequest("address", address, f"that of an arm, switched on and in no error: {error}") from None

    @property
    def simulated(self) -> bool:
        """Whether nothing real moves."""
        return self._simulated

    @property
    def lag(self) -> FloatArray:
        """See ``Driver``."""
        return self._lag

    def limits(self) -> ArmLimits:
        """Those of the controller."""
        joints = self._arm.get_joint_limits()[:JOINTS]
        return ArmLimits(*(np.array([getattr(one, name) for one in joints]) for name in _LIMITS))

    def positions(self) -> FloatArray:
        """Where the joints are, in rad, shape (6,)."""
        return np.array(self._arm.get_arm_positions())

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        """See ``Driver``; the gripper stays as it was told."""
        self._arm.set_arm_positions(np.asarray(q), 0.0, False, np.asarray(qd), np.asarray(qdd))

    def go(self, q: ArrayLike, seconds: float) -> None:
        """Go straight to q, shape (6,), to be there after so many seconds, unless another command comes before.

        The vendor's driver moves its setpoint there; it goes straight for less than 0.2 seconds only.
        """
        self._arm.set_arm_positions(np.asarray(q), seconds, False)

    def hold(self, q: ArrayLike) -> None:
        """See ``Driver``."""
        rest = np.zeros(JOINTS)
        self.command(q, rest, rest)

    def readings(self) -> dict[str, FloatArray]:
        """Positions, velocities, efforts and external efforts of all joints at one instant, the finger's last: (7,)."""
        joints = self._arm.get_robot_output().joint.all
        return {name: np.array(getattr(joints, name)) for name in READINGS}

    def gripper_width(self) -> float:
        """Metres between the pads: each finger stands at half of it."""
        return 2.0 * float(self._arm.get_gripper_position())

    def move_gripper(self, width: float, seconds: float) -> None:
        """See ``Driver``."""
        self._arm.set_gripper_position(width / 2.0, seconds, False)

    def close(self) -> None:
        """See ``Driver``."""
        self._arm.cleanup()


_LIMITS = ("position_min", "position_max", "velocity_max")
