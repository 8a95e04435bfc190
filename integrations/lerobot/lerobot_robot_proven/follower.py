"""WidowX AI followers for LeRobot: the vendor's features, and no motion that is not proven.

The vendor's plug-in moves the arm when it is connected, and again before it is disconnected, straight to fixed poses.
So it is not wrapped: these followers use the vendor's driver themselves.
"""

from __future__ import annotations

import logging
from contextlib import ExitStack
from typing import Any

import numpy as np
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots.robot import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_proven.cell import ASLEEP, roomy, simulated_arms
from lerobot_robot_proven.config import GateConfig, ProvenBiWidowXAIFollowerConfig, ProvenWidowXAIFollowerConfig
from lerobot_robot_proven.joints import JOINTS, action_keys, prefixes_of
from planner_service import PlannerService, load_robot, load_scene
from planner_service.errors import InvalidRequest
from planner_service.execute import DriverGroup, ExecutionStopped, GatedArm, SimulatedArm, Streaming, TrossenDriver
from planner_service.gate import ActionGate, TargetFilter, Tracking

__all__ = ["ProvenBiWidowXAIFollower", "ProvenWidowXAIFollower"]

logger = logging.getLogger(__name__)

ERROR, LAG, JITTER = 0.02, 0.05, 0.005
"""Of a real arm: radians by which it may be off, seconds by which it may be late, and by which the time between two of
LeRobot's actions may differ from the rate's. A decision that takes longer than the last is too late. Measure yours."""

SIMULATED_ERROR, SIMULATED_LAG = (0.02, 0.02, 0.02, 0.03, 0.05, 0.06), 0.25
"""The same of the simulated arm, whose wrist is slow, while other programs run."""

SIMULATED_JITTER = 0.45
"""Periods: LeRobot, the gate and the simulation share a machine. With 5 ms two arms were lost on two cores."""

FINGER_SPAN = (0.0, 0.04)
"""Metres that a finger may be told to be at."""

GRIPPER_TIME = 1.0
"""Seconds in which the gripper closes before and after the arm's day."""

BEHIND = 0.05
"""Seconds that a simulated arm may fall behind the clock without a word."""


class _ProvenFollower(Robot):  # type: ignore[misc]
    """One arm, or several as one."""

    def __init__(self, config: GateConfig, addresses: list[str | None]) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = make_cameras_from_configs(config.cameras)
        self._prefixes = prefixes_of(len(addresses))
        known = [address for address in addresses if address]
        if len(known) != (0 if config.simulated else len(addresses)):
            expected = "none for simulated arms" if config.simulated else f"{len(addresses)}, or --robot.simulated=true"
            raise InvalidRequest("ip_address", ", ".join(known) or None, expected)
        if len(config.staged_positions) != len(JOINTS):
            raise InvalidRequest("staged_positions", config.staged_positions, f"{len(JOINTS)} numbers, of each arm")
        self._addresses = known
        self._robot, scene = load_robot(config.model), load_scene(config.scene)
        allowed = [_pair(each) for each in config.allow]
        self.service = PlannerService(roomy(self._robot, self._prefixes), scene, allowed=allowed)
        simulated = SIMULATED_ERROR * len(addresses), SIMULATED_LAG, SIMULATED_JITTER / config.loop_rate
        error, lag, jitter = simulated if config.simulated else (ERROR, LAG, JITTER)
        self.gate = ActionGate(
            self.service,
            rate=config.loop_rate,
            tracking=Tracking(
                goal_time=config.min_time_to_move_multiplier / config.loop_rate,
                error=error if config.tracking_error is None else config.tracking_error,
                jitter=jitter if config.tracking_jitter is None else config.tracking_jitter,
                lag=lag if config.tracking_lag is None else config.tracking_lag,
            ),
            acceleration_scale=config.acceleration_scale,
            slow=True,
            log=config.log,
        )
        self._arms: list[TrossenDriver] = []
        self._arm: GatedArm | None = None
        self._simulated: list[SimulatedArm] = []
        self._refused = ""

    def __str__(self) -> str:
        return str(self.id or self.name)

    # -- what LeRobot calls -----------------------------------------------------------------------

    @property
    def observation_features(self) -> dict[str, Any]:
        """Positions, what else was asked for, and images."""
        kinds = ["pos", *(name for name, asked in self._extra.items() if asked)]
        features: dict[str, Any] = {
            f"{prefix}{joint}.{kind}": float for prefix in self._prefixes for kind in kinds for joint in JOINTS
        }
        return features | {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}

    @property
    def action_features(self) -> dict[str, type]:
        """Positions, in rad, and of the fingers in m."""
        return dict.fromkeys(action_keys(self._prefixes), float)

    @property
    def is_connected(self) -> bool:
        """Whether the arms and all cameras are."""
        return self._arm is not None and all(camera.is_connected for camera in self.cameras.values())

    @property
    def is_calibrated(self) -> bool:
        """The arms know where they are."""
        return True

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """Go to the staged pose, on a plan from wherever the arms are, all of them together."""
        self.reset()

    def connect(self, calibrate: bool = True) -> None:
        """Connect, and go to the staged pose, on a plan from wherever the arms are, all of them together.

        Raises:
            DeviceAlreadyConnectedError: they are.
            InvalidRequest: no arm answers, or there is no plan; nothing has moved, and nothing is connected.
        """
        if self._arm is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        try:
            if self.config.simulated:
                self._simulated = simulated_arms(self._robot, self.service.scene, self._prefixes)
                for arm in self._simulated:
                    self._arms.append(arm.connect())
            else:
                for address in self._addresses:
                    self._arms.append(TrossenDriver(address))
            for camera in self.cameras.values():
                camera.connect()
            streaming = Streaming(speed=self.config.move_speed)
            targets = TargetFilter(self.gate, jump=self.config.jump)
            self._arm = GatedArm(DriverGroup(self._arms), targets, streaming)
            self.configure()
        except BaseException:
            self._let_go()
            raise
        logger.info("%s connected", self)

    def reset(self) -> None:
        """Go to the staged pose and close the grippers, on a plan from wherever the arms are, all of them together.

        Raises:
            DeviceNotConnectedError: they are not connected.
            InvalidRequest: there is no plan; nothing has moved.
            ExecutionStopped: it was stopped; the arms hold.
        """
        *pose, finger = self.config.staged_positions
        self._move_to(pose, finger)

    def get_observation(self) -> dict[str, Any]:
        """What ``observation_features`` says."""
        self._connected()
        names = {"pos": "positions", "vel": "velocities", "eff": "efforts", "ext_eff": "external_efforts"}
        observation: dict[str, Any] = {}
        for prefix, arm in zip(self._prefixes, self._arms, strict=True):
            readings = arm.readings()
            for kind in ("pos", *(name for name, asked in self._extra.items() if asked)):
                values = readings[names[kind]].tolist()
                observation |= {f"{prefix}{joint}.{kind}": value for joint, value in zip(JOINTS, values, strict=True)}
        return observation | {name: camera.async_read() for name, camera in self.cameras.items()}

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Send what passes the gate of an action, and return it: the action itself, a slower one, or one that brakes.

        Raises:
            DeviceNotConnectedError: the arms are not connected.
            ConnectionError: an arm is not where its driver should have it. It was told to stay where it is.
        """
        arm, duration = self._connected(), self.gate.tracking.goal_time
        values = np.array([float(action[key]) for key in action_keys(self._prefixes)])
        values = values.reshape(len(self._prefixes), len(JOINTS))
        done = arm.send(values[:, :-1].ravel())
        for driver, finger in zip(self._arms, values[:, -1].tolist(), strict=True):
            driver.move_gripper(2.0 * _within(finger), duration)
        self._tell(done.verdict.refused)
        if arm.lost:
            raise ConnectionError(f"{self}: {arm.lost}")
        sent = np.column_stack([done.q.reshape(len(self._prefixes), -1), [_within(each) for each in values[:, -1]]])
        return dict(zip(action_keys(self._prefixes), sent.ravel().tolist(), strict=True))

    def disconnect(self) -> None:
        """Go to rest, on a plan from wherever the arms are, all of them together, and let go of them.

        Where that cannot be, they are let go of where they are, and the log says why.
        """
        self._connected()
        with ExitStack() as stack:
            stack.callback(self._let_go)
            try:
                self._move_to(ASLEEP, 0.0)
            except (InvalidRequest, ExecutionStopped, ConnectionError) as error:
                logger.error("%s is left where it is: %s", self, error)
        counts = self.gate.counts
        refused = ", ".join(f"{number} {kind}" for kind, number in sorted(counts.refused.items())) or "none"
        text = "%s disconnected; of %d actions %d passed (%d slowed down), refused: %s"
        logger.info(text, self, counts.chunks, counts.accepted, counts.slowed, refused)

    # -- how --------------------------------------------------------------------------------------

    @property
    def _extra(self) -> dict[str, bool]:
        config = self.config
        return {
            "vel": config.include_velocity,
            "eff": config.include_effort,
            "ext_eff": config.include_external_effort,
        }

    def _connected(self) -> GatedArm:
        if self._arm is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._arm

    def _move_to(self, pose: Any, finger: float) -> None:
        arm = self._connected()
        report = arm.move_to(np.tile(np.asarray(pose, dtype=np.float64), len(self._prefixes)))
        for driver in self._arms:
            driver.move_gripper(2.0 * _within(finger), GRIPPER_TIME)
        logger.info("%s is at its goal, after %.1f s on a proven plan", self, report.seconds)

    def _let_go(self) -> None:
        arm, self._arm = self._arm, None
        drivers, self._arms = self._arms, []
        simulated, self._simulated = self._simulated, []
        with ExitStack() as stack:
            for each in simulated:
                stack.callback(each.close)
                stack.callback(_tell_of, each)
            for camera in self.cameras.values():
                if camera.is_connected:
                    stack.callback(camera.disconnect)
            for driver in drivers:
                stack.callback(driver.close)
            if arm is not None:
                stack.callback(arm.close)

    def _tell(self, refused: Any) -> None:
        """Log what is refused once, however often it is wanted again."""
        what = "" if refused is None or refused.pair is None else " x ".join(refused.pair)
        if what and what != self._refused:
            logger.warning("%s brakes instead: %s", self, refused.detail)
            self._refused = what


def _tell_of(arm: SimulatedArm) -> None:
    if (behind := arm.behind()) > BEHIND:
        logger.info("the simulated arm is %.2f s behind the clock", behind)
    touched = "; ".join(str(contact) for contact in arm.contacts()) or "nothing"
    logger.info("the simulated arm touched %s", touched)


class ProvenWidowXAIFollower(_ProvenFollower):
    """A WidowX AI by Trossen Robotics."""

    config_class = ProvenWidowXAIFollowerConfig
    name = "proven_widowxai_follower"

    def __init__(self, config: ProvenWidowXAIFollowerConfig) -> None:
        super().__init__(config, [config.ip_address])


class ProvenBiWidowXAIFollower(_ProvenFollower):
    """Two WidowX AI on one table."""

    config_class = ProvenBiWidowXAIFollowerConfig
    name = "proven_bi_widowxai_follower"

    def __init__(self, config: ProvenBiWidowXAIFollowerConfig) -> None:
        super().__init__(config, [config.left_arm_ip_address, config.right_arm_ip_address])


def _pair(text: str) -> tuple[str, str]:
    first, colon, second = text.partition(":")
    if not (first and colon and second):
        raise InvalidRequest("allow", text, "two names, such as finger_left:table")
    return first, second


def _within(finger: float) -> float:
    """Where a finger may be; closed if that is no number."""
    return min(max(finger, FINGER_SPAN[0]), FINGER_SPAN[1]) if finger == finger else FINGER_SPAN[0]
