"""What ``--robot.*`` and ``--teleop.*`` can say."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig

__all__ = ["GateConfig", "ProvenBiWidowXAIFollowerConfig", "ProvenWidowXAIFollowerConfig", "ScriptedLeaderConfig"]

STAGED = (0.0, math.pi / 3, math.pi / 6, math.pi / 5, 0.0, 0.0, 0.0)
"""Where the vendor's plug-in has the arm wait, in rad, and its finger, in m."""


@dataclass(kw_only=True)
class GateConfig(RobotConfig):  # type: ignore[misc]
    """What both kinds of follower have.

    Attributes:
        scene: The name or file of the scene that the arm stands in, as ``planner-service`` reads it.
        model: The name or file of the robot.
        allow: Pairs that may touch, such as ``finger_left:table``, beside those that the robot allows.
        simulated: Start a simulated arm among the scene's obstacles instead of connecting to a real one.
        loop_rate: Targets a second, as LeRobot's ``fps``.
        min_time_to_move_multiplier: Periods after which a target is due, as of the vendor's plug-in.
        tracking_error, tracking_lag, tracking_jitter: What is assumed of the arm and of this machine, see
            ``planner_service.gate.Tracking``; if not given 0.02 rad, 0.05 s and 0.005 s, and of the simulated one what
            was measured on a busy machine.
        acceleration_scale: Part of the robot's acceleration limits that targets may use.
        jump: Radians; a target that is farther from an arm at rest is reached on a plan.
        move_speed: Part of the planned speed of connecting, resetting and disconnecting; 1 in simulation, else 0.2.
        log: A file to which all that is refused or changed is added, as lines of JSON.
        include_velocity, include_effort, include_external_effort: Whether observations have them.
    """

    scene: str
    model: str
    allow: list[str] = field(default_factory=list)
    simulated: bool = False
    loop_rate: int = 30
    min_time_to_move_multiplier: float = 3.0
    tracking_error: float | None = None
    tracking_lag: float | None = None
    tracking_jitter: float | None = None
    acceleration_scale: float = 4.0
    jump: float = 0.2
    move_speed: float | None = None
    log: str | None = None
    include_velocity: bool = False
    include_effort: bool = False
    include_external_effort: bool = False
    staged_positions: list[float] = field(default_factory=lambda: list(STAGED))
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


@RobotConfig.register_subclass("proven_widowxai_follower")
@dataclass(kw_only=True)
class ProvenWidowXAIFollowerConfig(GateConfig):
    """A WidowX AI.

    Attributes:
        ip_address: Of its controller.
    """

    model: str = "wxai"
    ip_address: str | None = None


@RobotConfig.register_subclass("proven_bi_widowxai_follower")
@dataclass(kw_only=True)
class ProvenBiWidowXAIFollowerConfig(GateConfig):
    """Two of them on one table.

    Attributes:
        left_arm_ip_address, right_arm_ip_address: Of their controllers.
    """

    model: str = "wxai_dual"
    left_arm_ip_address: str | None = None
    right_arm_ip_address: str | None = None


@TeleoperatorConfig.register_subclass("scripted_leader")
@dataclass(kw_only=True)
class ScriptedLeaderConfig(TeleoperatorConfig):  # type: ignore[misc]
    """A leader that needs no hardware.

    Attributes:
        arms: One or two.
        rate: Actions a second.
        lunge: Seconds between two lunges, each towards the table.
    """

    arms: int = 1
    rate: int = 30
    lunge: float = 4.0
