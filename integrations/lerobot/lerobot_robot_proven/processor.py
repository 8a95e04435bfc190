"""A gate in LeRobot's pipeline of actions, for any robot of which there is a URDF."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lerobot.processor import ProcessorStepRegistry, RobotActionProcessorStep, TransitionKey

from planner_service import PlannerService, load_robot
from planner_service.errors import InvalidRequest
from planner_service.gate import ActionGate, FilteredTarget, Kind, TargetFilter, Tracking
from planner_service.geometry.arrays import FloatArray

__all__ = ["ProvenActionStep"]


@ProcessorStepRegistry.register("proven_action")
@dataclass
class ProvenActionStep(RobotActionProcessorStep):  # type: ignore[misc]
    """Lets actions pass that are proven free, and gives one that brakes in place of another.

    To be the last step of a ``robot_action_processor``, which gets actions with the observation that they are for. It
    sees joint positions only: what a robot does when it is connected or disconnected does not come by here.

    Attributes:
        robot: The name or file (``robot.toml``, URDF) of a robot.
        scene: The name or file of its scene.
        joints: For each key of an action that is a joint's position, the joint's name in the robot, in its order.
        degrees: Whether these are degrees; else rad. Sliding joints are in m.
        rate: Actions a second.
        goal_time, error, lag: See ``planner_service.gate.Tracking``.
        acceleration_scale: Part of the robot's acceleration limits that actions may use.
        jump: Radians; an action that is farther from a robot at rest is reached on a plan.

    Raises:
        InvalidRequest: no such robot or scene, or other joints.
    """

    robot: str
    scene: str
    joints: dict[str, str]
    degrees: bool = False
    rate: float = 30.0
    goal_time: float = 0.1
    error: float = 0.02
    lag: float = 0.05
    acceleration_scale: float = 4.0
    jump: float = 0.2
    last: FilteredTarget | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        robot = load_robot(self.robot).with_finger_room()
        if tuple(self.joints.values()) != robot.joint_names:
            raise InvalidRequest("joints", list(self.joints.values()), f"{', '.join(robot.joint_names)}, in this order")
        gate = ActionGate(
            PlannerService(robot, self.scene),
            rate=self.rate,
            tracking=Tracking(self.goal_time, self.error, lag=self.lag),
            acceleration_scale=self.acceleration_scale,
            slow=True,
        )
        self._targets = TargetFilter(gate, jump=self.jump)
        self._units = np.array([1.0 if slides or not self.degrees else math.pi / 180.0 for slides in robot.sliding])
        self._passed_at: float | None = None

    @property
    def gate(self) -> ActionGate:
        """What decides, with its counts."""
        return self._targets.gate

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """What may be sent in place of an action.

        Raises:
            ConnectionError: the robot is not where its driver should have it.
        """
        observation = self._current_transition.get(TransitionKey.OBSERVATION) or {}
        measured, wanted = (
            self._values(name, known) for name, known in (("observation", observation), ("action", action))
        )
        now = time.perf_counter()
        elapsed = None if self._passed_at is None else now - self._passed_at
        self.last = self._targets.next(measured, wanted, elapsed=elapsed)
        self._passed_at = now
        refused = self.last.verdict.refused
        if refused is not None and refused.kind is Kind.TRACKING:
            raise ConnectionError(refused.detail)
        return {**action, **dict(zip(self.joints, (self.last.q / self._units).tolist(), strict=True))}

    def _values(self, name: str, known: dict[str, Any]) -> FloatArray:
        missing = [key for key in self.joints if key not in known]
        if missing:
            raise InvalidRequest(name, sorted(known), f"one with {', '.join(missing)}")
        return np.asarray([float(known[key]) for key in self.joints] * self._units)

    def reset(self) -> None:
        """Begin anew with a robot at rest."""
        self._targets.reset()
        self._passed_at = self.last = None

    def get_config(self) -> dict[str, Any]:
        """What makes an equal step."""
        names = (
            "robot",
            "scene",
            "joints",
            "degrees",
            "rate",
            "goal_time",
            "error",
            "lag",
            "acceleration_scale",
            "jump",
        )
        return {name: getattr(self, name) for name in names}

    def transform_features(self, features: Any) -> Any:
        """The same."""
        return features
