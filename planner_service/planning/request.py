"""What the planner shall do: a start, goals and all settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import MAX_OVERLAP
from planner_service.collision import EdgeStep, MotionStep
from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints, constraint_names
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, as_sent, read_only, set_fields
from planner_service.geometry.mass_properties import mass_properties
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, number, numbers, whole
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.optimize import FEW_CORNERS, MAX_CLEARANCE, Optimise
from planner_service.presentation.measures import outside_text
from planner_service.robot.inertia import LinkInertia, Payload, tensor_numbers
from planner_service.robot.model import JointLimits, Robot, joint_vector
from planner_service.scene.scene import Attached, Scene
from planner_service.search.planners import BalancedRRTConnect
from planner_service.search.problem import Planner
from planner_service.timing.laws import SCurve, Timing, ToppRa, effective_limits
from planner_service.timing.torque_limits import TorqueLimits

__all__ = [
    "Goal",
    "Goals",
    "Pace",
    "PlanRequest",
    "World",
    "clamp_note",
    "clamped",
    "keeps_torques",
    "kept_in",
    "require_timing",
    "torque_limits",
    "torques_of",
]

SEARCH_SHARE = 0.8
"""Part of ``max_checks`` that one search may use."""

MIN_TOOL_SPEED = 1e-3
"""Metres per second. A lower limit is a mistake in the unit."""

Goal = ArrayLike | Pose | PoseGoal | Sequence[ArrayLike | Pose | PoseGoal]

Goals = tuple[FloatArray | Pose | PoseGoal, ...]
"""The goals of a request one by one, as a robot has them (``PlanRequest.goals``)."""


START_TOLERANCE = 0.01
"""Radians (or metres) by which an end may be outside a joint limit if nothing else is said: more than encoders and
float32 make of a joint at its limit."""


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """A motion from a configuration to a goal, and what it may cost.

    Attributes:
        start: Joint vector, shape (n,). Start and goal are copied in.
        goal: A joint vector (n,), a ``Pose`` of the tool frame in the base frame (every inverse
            kinematics solution is a goal, joints that do not move the tool staying as in the start), a
            ``PoseGoal`` with room around one, or a sequence of these, any of which will do.
        planner: The search, which runs only when no straight line is free; ``BalancedRRTConnect()`` if not given. Or
            ``Optimise(...)``, which does not search but improves straight lines, free or not.
        timing: The law s(t) along the path.
        seed: Decides every random choice; the same request and seed give the same plan and counts.
        max_checks: States the whole plan may check (growing a PRM has its own budget). The default is a backstop for
            requests without a time limit.
        time_limit: Wall seconds for all stages and retries; None for no limit. A result that it changed says
            ``deterministic=False``.
        retries: Further searches with fresh seeds when one gives up, all with equal parts of the checks; None for as
            many as time and checks allow, the later ones longer. Of the default planner's, every second one is by
            ``RRTConnect()``.
        padding: Metres that the search keeps from everything, except from what is closer at an end, near that end.
        velocity_scale: Part in (0, 1] of the robot's velocity limits that may be used.
        acceleration_scale: The same of its accelerations, and of its jerks.
        max_tool_speed: Metres per second that the tool frame's origin may move at most; None for no limit.
        blend: Radians of path that the blend of a corner may replace before and after it; 0 keeps every
            corner a stop.
        improve: Further searches for a shorter path, whose best parts are joined: rounds of at most three times the
            states of the first search. They end early once less than 2 % can be gained; ``PlanResult.improvement``
            says what came of it. Half of the time and of the checks left is theirs at most.
        polish: How the shortened path is optimised; None to leave it. The optimum is kept only if it is no worse, free
            and proven.
        start_tolerance: Radians (or metres) by which the start, or a goal given as joint values, may lie outside a
            joint limit; it is then clamped, and the result says so.
        start_overlap: Metres, at most 0.1, by which pairs may overlap at the start. The plan then begins with a proven
            way out, on which they are never deeper and come apart, and no other pair touches; 0 refuses such a start.
        payload: What the tool carries, by its mass, all along; for ``ToppRa(torque=True)``.
        torque_scale: Part in (0, 1] of the joints' efforts that may be used; for ``ToppRa(torque=True)``.
        pace: Timing, scales, tool speed, payload and torque scale, as one value.
        evidence: Files of the plan have the trail of its proof, which others can check without this package.
        constraints: What must hold along the whole motion, ends included (``planner_service.constraints``), beside
            those of what the robot carries. It is searched by ``BalancedRRTConnect``, and not optimised.

    Raises:
        InvalidRequest: a value is of the wrong kind, not finite, or out of its range.
    """

    start: ArrayLike
    goal: Goal
    planner: Planner | Optimise = field(default_factory=BalancedRRTConnect)
    timing: Timing = field(default_factory=ToppRa)
    seed: int = 0
    max_checks: int = 10_000_000
    time_limit: float | None = 5.0
    retries: int | None = None
    padding: float = 0.001
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    max_tool_speed: float | None = None
    blend: float = 0.5
    start_tolerance: float = START_TOLERANCE
    start_overlap: float = 0.003
    improve: int = 0
    polish: Optimise | None = None
    constraints: Sequence[Constraint] = ()
    payload: Payload | None = None
    torque_scale: float = 1.0
    evidence: bool = False
    pace: Pace = field(init=False, repr=False)
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        start = numbers("start", self.start, "joint values, shape (n,)")
        set_fields(self, start=start, goal=_copied_goal(self.goal))
        seed, checks = whole("seed", self.seed, 0, 2**63 - 1), whole("max_checks", self.max_checks, 1, 10**9)
        retries = None if self.retries is None else whole("retries", self.retries, 0, 1000)
        improve = whole("improve", self.improve, 0, 1000)
        set_fields(self, seed=seed, max_checks=checks, retries=retries, improve=improve)
        _number("padding", self.padding, 0.0, 0.1)
        _number("start_tolerance", self.start_tolerance, 0.0, 0.1)
        _number("start_overlap", self.start_overlap, 0.0, MAX_OVERLAP)
        _number("blend", self.blend, 0.0, 3.0)
        if self.time_limit is not None:
            _number("time_limit", self.time_limit, 0.0, 86_400.0)
        search = callable(getattr(self.planner, "search", None)) and not isinstance(self.planner, type)
        if not isinstance(self.planner, Optimise) and not search:
            raise InvalidRequest("planner", self.planner, "a planner such as BalancedRRTConnect()")
        if self.polish is not None and not isinstance(self.polish, Optimise):
            raise InvalidRequest("polish", self.polish, "Optimise(...) or None")
        if self.polish is not None and isinstance(self.planner, Optimise):
            raise InvalidRequest("polish", self.polish, "None: the planner optimises")
        if improve and isinstance(self.planner, Optimise):
            raise InvalidRequest("improve", improve, "0: the planner optimises straight lines, and searches nothing")
        if self.optimise is not None and self.blend == 0.0:
            raise InvalidRequest("blend", self.blend, "above 0: an optimum is a curve without stops")
        scales = self.velocity_scale, self.acceleration_scale
        pace = Pace(self.timing, *scales, self.max_tool_speed, self.payload, self.torque_scale)
        set_fields(self, pace=pace, constraints=checked_constraints(self.constraints))
        if not isinstance(self.evidence, bool):
            raise InvalidRequest("evidence", self.evidence, "True or False")
        self.require_keeping(self.constraints)

    def require_keeping(self, constraints: Sequence[Constraint]) -> None:
        """Refuse a planner that does not keep constraints, if there are any.

        Raises:
            InvalidRequest: ``planner`` is not ``BalancedRRTConnect``, or there is ``polish``.
        """
        names = constraint_names(constraints)
        if names and not isinstance(self.planner, BalancedRRTConnect):
            raise InvalidRequest("planner", self.planner, f"BalancedRRTConnect(), as there are constraints ({names})")
        if names and self.polish is not None:
            raise InvalidRequest("polish", self.polish, f"None: an optimum does not keep constraints ({names})")

    @cached_property
    def search_states(self) -> int:
        """How many of the states one search may check; the rest is kept for shortcutting and blending."""
        return max(1, int(self.max_checks * SEARCH_SHARE))

    @cached_property
    def optimise(self) -> Optimise | None:
        """How paths are optimised, by ``polish`` or by ``planner``; None if they are not.

        It has as many corners as suit the timing law, and a clearance of at least twice the padding: an optimum is
        checked with the padding, and padded boxes are nearer by up to 1.74 of it at their corners.
        """
        chosen = self.planner if isinstance(self.planner, Optimise) else self.polish
        if chosen is None:
            return None
        few = chosen.corners is None and not isinstance(self.timing, ToppRa)
        clearance = max(chosen.clearance, min(2.0 * self.padding, MAX_CLEARANCE))
        return replace(chosen, corners=FEW_CORNERS if few else chosen.corners, clearance=clearance)

    def goals(self, robot: Robot) -> Goals:
        """The goals one by one, joint vectors copied, checked for shape and finiteness, and clamped.

        Raises:
            InvalidRequest: a goal is neither a pose nor n finite joint values, or there is none.
        """
        if not isinstance(robot, Robot):
            raise InvalidRequest("robot", robot, "a Robot")
        return tuple(
            goal if isinstance(goal, Pose | PoseGoal) else self.clamped(joint_vector(name, goal, robot), robot)
            for name, goal in self.named_goals()
        )

    def named_goals(self) -> tuple[tuple[str, Any], ...]:
        """The goals as they were given, with the names that messages give them."""
        several = isinstance(self.goal, tuple) and len(self.goal) != 1
        goals = self.goal if isinstance(self.goal, tuple) else (self.goal,)
        return tuple((f"goal[{k}]" if several else "goal", goal) for k, goal in enumerate(goals))

    def clamped(self, q: FloatArray, robot: Robot) -> FloatArray:
        """A configuration (n,) with joints that are outside their limits by at most ``start_tolerance`` at them."""
        return clamped(q, robot, self.start_tolerance)


@dataclass(frozen=True, eq=False)
class World:
    """A robot in a scene, and how motions are checked there: all that a ``PlannerService`` is made of.

    Attributes:
        robot: With its gripper as it stands.
        scene: The obstacles, and what the robot carries.
        allowed: Pairs of link or object names that may touch, beside those the robot allows; sorted.
        edge_step: How finely edges are sampled; None if a file does not know, as it cannot hold a rule of your own.
    """

    robot: Robot
    scene: Scene
    allowed: tuple[tuple[str, str], ...] = ()
    edge_step: EdgeStep | None = field(default_factory=MotionStep)


@dataclass(frozen=True)
class Pace:
    """How fast to move along a path.

    Attributes:
        timing: The law s(t).
        velocity_scale: Part in (0, 1] of the robot's velocity limits.
        acceleration_scale: The same of its acceleration and jerk limits. A jerk limit of the law's own is left alone.
        max_tool_speed: Metres per second of the tool frame's origin at most; None for no limit.
        payload: What the tool carries, for a law that keeps torque limits.
        torque_scale: Part in (0, 1] of the joints' efforts, for such a law.

    Raises:
        InvalidRequest: A value is of the wrong kind, a scale is not in (0, 1], or a speed not in [0.001, 100]; or there
            is a payload or a torque scale, and the law keeps no torque limits.
    """

    timing: Timing
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    max_tool_speed: float | None = None
    payload: Payload | None = None
    torque_scale: float = 1.0

    def __post_init__(self) -> None:
        require_timing(self.timing)
        _require_torques(self.timing, self.payload, self.torque_scale)
        _require_scale("velocity_scale", self.velocity_scale)
        _require_scale("acceleration_scale", self.acceleration_scale)
        _require_tool_speed(self.max_tool_speed)

    @classmethod
    def of(cls, request: PlanRequest, timing: Timing | None = None) -> Pace:
        """The pace of a request, with another timing law if one is given."""
        pace = instance("request", request, PlanRequest, "a PlanRequest").pace
        return pace if timing is None else replace(pace, timing=timing)

    @cached_property
    def keeps_torques(self) -> bool:
        """Whether torque limits are kept."""
        return keeps_torques(self.timing)

    def limits(self, robot: Robot) -> JointLimits:
        """The robot's limits, scaled."""
        instance("robot", robot, Robot, "a Robot")
        limits = robot.limits
        if not self.velocity_scale == self.acceleration_scale == 1.0:
            limits = replace(
                limits,
                velocity=limits.velocity * self.velocity_scale,
                acceleration=limits.acceleration * self.acceleration_scale,
                jerk=limits.jerk * self.acceleration_scale,
            )
        return effective_limits(self.timing, limits) if isinstance(self.timing, SCurve) else limits


def torque_limits(robot: Robot, scene: Scene, payload: Payload | None = None, scale: float = 1.0) -> TorqueLimits:
    """The torque limits of a robot that carries a payload, and the attached objects of a scene that have a mass.

    Raises:
        InvalidRequest: As ``TorqueLimits``.
    """
    tool = Pose.from_matrix(robot.tool_placement)
    loads = [] if payload is None else [_payload(payload)]
    loads += [inertia_of(held, held.mass) for held in scene.attached if held.mass is not None]
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


def inertia_of(held: Attached, mass: float) -> LinkInertia:
    """An object in the tool frame whose mass is spread evenly over its shape."""
    volume, (x, y, z), tensor = mass_properties(held.shape)
    numbers = tensor_numbers(np.asarray(tensor) * (mass / volume))
    return LinkInertia(held.name, 0, mass, numbers, held.pose @ Pose((float(x), float(y), float(z))))


def kept_in(scene: Scene, asked: Sequence[Constraint]) -> tuple[Constraint, ...]:
    """The constraints of a motion in a scene: the requested ones and those of what the robot carries, each once.

    Raises:
        InvalidRequest: There are more than 16 in all.
    """
    kept = dict.fromkeys((*asked, *scene.constraints))
    return checked_constraints(list(kept)) if kept else ()


def _copied_goal(goal: object) -> Pose | PoseGoal | FloatArray | tuple[Pose | PoseGoal | FloatArray, ...]:
    """One goal, or a tuple of several, with joint values copied; their shape is checked against the robot later."""
    if isinstance(goal, Pose | PoseGoal):
        return goal
    expected = "joint values, a Pose, a PoseGoal, or a list of these"
    if isinstance(goal, list | tuple) and any(isinstance(g, Pose | PoseGoal | list | tuple | np.ndarray) for g in goal):
        poses = (Pose, PoseGoal)
        several = [g if isinstance(g, poses) else numbers(f"goal[{k}]", g, expected) for k, g in enumerate(goal)]
    else:
        array = numbers("goal", goal, expected)
        if array.ndim != 2:
            return array
        several = list(array)
    if not several:
        raise InvalidRequest("goal", goal, "at least one goal")
    return tuple(several)


def clamped(Q: FloatArray, robot: Robot, tolerance: float = START_TOLERANCE) -> FloatArray:
    """Configurations (..., n) with joints that are outside their limits by at most a tolerance at them."""
    lower, upper = robot.bounds
    if not ((lower > Q) | (upper < Q)).any():
        return Q
    inside = np.clip(Q, lower, upper)
    moved = (inside != Q) & (np.abs(inside - Q) <= tolerance)
    return read_only(np.where(moved, inside, Q)) if moved.any() else Q


def clamp_note(name: str, stated: FloatArray, used: FloatArray, robot: Robot) -> str:
    """Says how far a configuration that was clamped was outside its limits; nothing of one that was not."""
    if stated.tolist() == used.tolist():
        return ""
    joint = int(np.argmax(np.abs(stated - used)))
    low, high = (float(bound[joint]) for bound in robot.bounds)
    words = f"{robot.joint_names[joint]} = {outside_text(float(stated[joint]), low, high)}"
    return f"{name}: {words}; it was clamped to the limit"


def require_timing(value: object) -> None:
    """Raise for what is not a timing law."""
    if isinstance(value, type) or not callable(getattr(value, "time_path", None)):
        raise InvalidRequest("timing", value, "a timing law such as ToppRa()")


def keeps_torques(timing: Timing) -> bool:
    """Whether a timing law keeps torque limits."""
    return isinstance(timing, ToppRa) and timing.torque


def _require_torques(timing: Timing, payload: object, scale: object) -> None:
    """Raise for what is no payload or no share of torques, and for either with a law that would not look at it."""
    instance("payload", payload, (Payload, NoneType), "a Payload, or None")
    _require_scale("torque_scale", scale)
    if not keeps_torques(timing):
        for name, given in (("payload", payload), ("torque_scale", None if scale == 1.0 else scale)):
            if given is not None:
                expected = f"none with {timing.name}: only timing=ToppRa(torque=True) keeps torque limits"
                raise InvalidRequest(name, given, expected)


def _number(name: str, value: object, low: float, high: float) -> float:
    return number(name, value, f"a number in [{low:g}, {high:g}]", low, high)


def _require_scale(name: str, value: object) -> None:
    """Raise for what is not a share in (0, 1] of a limit."""
    part = "a part in (0, 1] of the limit"
    if number(name, value, part, 0.0, 1.0) == 0.0:
        raise InvalidRequest(name, value, part)


def _require_tool_speed(value: object) -> None:
    """Raise for what is neither None nor a speed in m/s."""
    if value is not None:
        _number("max_tool_speed", value, MIN_TOOL_SPEED, 100.0)
