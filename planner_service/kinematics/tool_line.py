"""Straight lines of the tool, walked by compiled code (native/kinematics/line.cpp).

Poses are those of the tool frame in the robot's base frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray, Vector, read_only, set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import finite_numbers, instance, number, numbers, whole
from planner_service.kinematics.complete_inverse import LIMIT_SLACK
from planner_service.kinematics.inverse import ToolChain
from planner_service.kinematics.pose_goal import unit_axis
from planner_service.kinematics.tool_arm import descended, tool_arm
from planner_service.kinematics.turning_tool import LEANS, least_turned, with_turns
from planner_service.presentation.measures import range_text
from planner_service.robot.model import Robot

__all__ = [
    "LINE_METRES",
    "LINE_POINTS",
    "LINE_RADIANS",
    "MAX_HALVINGS",
    "MAX_JOINT_RATE",
    "MAX_STEP",
    "RATE_SLACK",
    "SAMPLED_SHARE",
    "TURN_METRES",
    "LineStop",
    "LineStopReason",
    "ToolLine",
    "interpolate",
    "require_joint_rate",
    "require_within_limits",
    "rotation_distance",
    "shifted",
    "stop_at",
    "straight_tool_line",
    "travel",
    "without_turns",
]

LINE_METRES = 1e-3
LINE_RADIANS = 5e-3
"""How far the tool may deviate from its straight line between two waypoints."""

LINE_POINTS = 60
"""Configurations computed along a straight tool line; only as many are kept as hold the tool on it."""

MAX_JOINT_RATE = 100.0
"""Radians per metre of the tool. Fewer than 1 % of random lines of 5 to 30 cm need more on the WidowX AI, the Panda and
the UR5; the tool could only creep there, at 2 to 7 cm/s."""

SAMPLED_SHARE = 0.9
"""Share of that for the sampled deviation, which may be slightly larger between the quarters of a piece."""

MAX_STEP = 0.2
"""The most that a joint turns (rad) between two waypoints: a piece that needs more is halved, and finally refused."""

MAX_HALVINGS = 6
"""How often a piece is halved before the line stops: down to 0.03 mm on a 0.1 m line of 60 points."""

TURN_METRES = 0.1
"""Metres of travel that a radian of the tool's rotation counts as, where the tool turns more than its origin moves."""

RATE_SLACK = 1e-6
"""Radians by which a step may exceed its limit per metre: rounding, and the tolerance of numeric solutions."""


class LineStopReason(Enum):
    """Why a straight tool line ends early."""

    LIMIT = "limit"
    """It could continue only with a joint beyond its limit."""
    SINGULARITY = "singularity"
    """The arm, stretched or with aligned axes, cannot move the tool on, or only by turning a joint too fast."""
    BRANCH_JUMP = "branch jump"
    """The next joint values are far from those reached."""
    JOINT_RATE = "joint rate"
    """A joint would have to move farther per metre of the tool than is allowed, as near a singularity."""
    AXIS = "axis"
    """An arm of fewer than six joints has none that turns the tool's axis as the line does."""


@dataclass(frozen=True)
class LineStop:
    """Why a line ends, at which joint, after which fraction of it (0 to 1), and what a message calls the line."""

    reason: LineStopReason
    joint: str
    fraction: float
    name: str = "the straight tool line"

    def __str__(self) -> str:
        what = {
            LineStopReason.LIMIT: f"{self.joint} is at its limit",
            LineStopReason.SINGULARITY: f"the arm is singular ({self.joint} would move most)",
            LineStopReason.BRANCH_JUMP: f"only a jump of {self.joint} leads on",
            LineStopReason.JOINT_RATE: f"{self.joint} would move more than max_joint_rate per metre of the tool",
            LineStopReason.AXIS: "no joint turns the tool's axis as the line does",
        }[self.reason]
        return f"{self.name} ends after {100 * self.fraction:.1f} %: {what}"


@dataclass(frozen=True, eq=False)
class ToolLine:
    """Joint waypoints (N, n) that move the tool along a straight line, or along another path.

    Attributes:
        fraction: The share of the line that they cover, 0 to 1.
        stopped: Why they do not cover all of it; None if they do.
        fractions: The share of the line that lies behind each waypoint, (N,).
        turns: How far the tool has turned about its free axis at each waypoint (rad), beside the shortest rotation of
            that axis, (N,); empty without a free axis.
    """

    waypoints: FloatArray
    fraction: float
    stopped: LineStop | None = None
    fractions: FloatArray = field(default_factory=lambda: np.zeros(0))
    turns: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        arrays = (self.waypoints, self.fractions, self.turns)
        waypoints, fractions, turns = map(read_only, arrays)
        set_fields(self, waypoints=waypoints, fractions=fractions, turns=turns)


def rotation_distance(a: Pose, b: Pose) -> float:
    """The angle (rad, 0 to pi) between two orientations."""
    w, x, y, z = a.quaternion
    ow, ox, oy, oz = b.quaternion
    apart = math.sqrt((w - ow) ** 2 + (x - ox) ** 2 + (y - oy) ** 2 + (z - oz) ** 2)
    opposed = math.sqrt((w + ow) ** 2 + (x + ox) ** 2 + (y + oy) ** 2 + (z + oz) ** 2)
    return 4.0 * math.atan2(min(apart, opposed), max(apart, opposed))  # q and -q are one orientation


def interpolate(a: Pose, b: Pose, u: float) -> Pose:
    """The pose at fraction ``u`` from ``a`` to ``b``: linear in position, by the shortest rotation (slerp)."""
    (ax, ay, az), (bx, by, bz) = a.position, b.position
    position = (ax + u * (bx - ax), ay + u * (by - ay), az + u * (bz - az))
    half = rotation_distance(a, b) / 2
    sine = math.sin(half)
    if sine < 1e-9:  # the formula would divide rounding by rounding
        return Pose(position, b.quaternion if u > 0.5 else a.quaternion)
    w, x, y, z = a.quaternion
    ow, ox, oy, oz = b.quaternion
    near = math.sin((1.0 - u) * half) / sine
    far = math.copysign(math.sin(u * half) / sine, w * ow + x * ox + y * oy + z * oz)
    return Pose(position, (near * w + far * ow, near * x + far * ox, near * y + far * oy, near * z + far * oz))


def straight_tool_line(
    robot: Robot,
    q_start: ArrayLike,
    to: Pose | ArrayLike,
    *,
    points: int = LINE_POINTS,
    max_joint_rate: float = math.inf,
    free_axis: Vector | None = None,
) -> ToolLine:
    """Joint waypoints that move the tool straight from its pose at ``q_start`` to ``to``, as far as the arm can.

    The position moves linearly, the orientation by the shortest rotation. While the joints go straight between two
    waypoints, the tool stays within 1 mm and 5 mrad of the line; pieces that would not are halved. The first waypoint
    is ``q_start``; the last has the tool at ``to`` (to 1e-7 in closed form, else 1e-8) unless ``stopped`` says why not.
    Joints that do not move the tool stay. Collisions are not checked.

    Args:
        q_start: Shape (n,), within the limits.
        to: A pose, or a shift (3,) in metres along the base's axes that keeps the orientation.
        points: Waypoints of a line without halved pieces; at least 2.
        max_joint_rate: The most that a joint may move between two waypoints per metre of the line, in rad/m (m/m for a
            prismatic joint). Where the tool turns by more than 10 rad per metre, each radian counts as 0.1 m.
        free_axis: An axis (x, y, z) in the tool frame about which the tool may turn as it likes: this axis goes along
            the line, and turns by the shortest rotation. The joints move as little as that allows. None for none.

    Raises:
        InvalidRequest: A wrong shape, a number that is not finite or out of range, or ``q_start`` outside the limits.
    """
    instance("robot", robot, Robot, "a Robot")
    whole("points", points, 2, 10_000)
    require_joint_rate(max_joint_rate)
    axis = None if free_axis is None else unit_axis(free_axis)
    q = finite_numbers("q_start", q_start, robot.n)
    robot = robot.around(q)
    require_within_limits("q_start", robot, q)
    arm, start = with_turns(robot, q[np.newaxis], np.zeros(1), axis)
    chain = ToolChain.of(arm, start[0])
    begin = chain.of_whole(start[0])
    pose = Pose.from_matrix(chain.robot.tool_pose(begin))
    end = least_turned(pose, to if isinstance(to, Pose) else shifted(pose, to), axis)
    line = _walked(chain.robot, begin, pose, end, points)
    line = without_turns(replace(line, waypoints=chain.whole(line.waypoints)), robot.n)
    return _within_rate(robot, line, travel(pose, end), max_joint_rate)


def without_turns(line: ToolLine, joints: int) -> ToolLine:
    """A line of an arm with further joints, the last of which turns its tool (``turning``), as one of the arm alone."""
    if line.waypoints.shape[1] == joints:
        return line
    stop = line.stopped
    if stop is not None and stop.joint in LEANS:
        stop = replace(stop, reason=LineStopReason.AXIS)
    return replace(line, waypoints=line.waypoints[:, :joints], turns=-line.waypoints[:, -1], stopped=stop)


def require_within_limits(name: str, robot: Robot, q: FloatArray) -> None:
    """Refuse a configuration (n,) outside the joint limits.

    Raises:
        InvalidRequest: Naming the joint that is farthest outside.
    """
    outside = np.maximum(robot.limits.lower - q, q - robot.limits.upper)
    worst = int(outside.argmax())
    if outside[worst] > LIMIT_SLACK:
        value, low, high = (float(values[worst]) for values in (q, robot.limits.lower, robot.limits.upper))
        raise InvalidRequest(f"{name}: {robot.joint_names[worst]}", value, f"within {range_text(low, high, value)}")


def require_joint_rate(value: object) -> float:
    """The limit on joint motion per metre of the tool that a caller gave.

    Raises:
        InvalidRequest: It is not a number above 0.
    """
    expected = "rad (m for a prismatic joint) per metre of the tool's path, at least 0.01, such as 100"
    return number("max_joint_rate", value, expected, 0.01, math.inf)


def _walked(robot: Robot, q: FloatArray, begin: Pose, end: Pose, points: int) -> ToolLine:
    """The line from ``begin``, where the tool is at q (n,)."""
    if begin == end:
        return ToolLine(q[np.newaxis], 1.0, fractions=np.zeros(1))
    first, last = ([*pose.position, *pose.quaternion] for pose in (begin, end))
    try:
        waypoints, fractions, stop, beyond = tool_arm(robot).walk(first, last, q, points)
    except RuntimeError as off:  # forward kinematics says otherwise
        raise BrokenInvariant(f"{off}, of {robot.name!r} from {begin} to {end}") from None
    if stop is None:
        return ToolLine(waypoints, 1.0, fractions=np.array(fractions))
    other = np.array(beyond) if beyond else None
    why = stop_at(robot, interpolate(begin, end, stop), waypoints[-1], other, fractions[-1])
    return ToolLine(waypoints, fractions[-1], why, np.array(fractions))


def travel(a: Pose, b: Pose) -> float:
    """Metres between two poses, or 0.1 m for each radian between them if that is more."""
    return max(math.dist(a.position, b.position), TURN_METRES * rotation_distance(a, b))


def _within_rate(robot: Robot, line: ToolLine, whole_travel: float, rate: float) -> ToolLine:
    """The line up to where a joint would move too far per metre of ``whole_travel``."""
    if rate == math.inf or len(line.waypoints) < 2:
        return line
    moves = np.abs(line.waypoints[1:] - line.waypoints[:-1])
    allowed = rate * whole_travel * (line.fractions[1:] - line.fractions[:-1])
    too_far = moves.max(axis=1) > allowed + RATE_SLACK
    if not too_far.any():
        return line
    k = int(too_far.argmax())
    fraction = float(line.fractions[k])
    stop = LineStop(LineStopReason.JOINT_RATE, robot.joint_names[int(moves[k].argmax())], fraction)
    return ToolLine(line.waypoints[: k + 1], fraction, stop, line.fractions[: k + 1], line.turns[: k + 1])


def shifted(pose: Pose, shift: Any, name: str = "to") -> Pose:
    """The pose moved by (x, y, z) metres along the base's axes.

    Raises:
        InvalidRequest: ``shift`` is not 3 finite numbers; the message calls it ``name``.
    """
    expected = "a Pose, or a shift of 3 finite numbers in metres"
    values = numbers(name, shift, expected)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InvalidRequest(name, shift, expected)
    dx, dy, dz = values.tolist()
    x, y, z = pose.position
    return Pose((x + dx, y + dy, z + dz), pose.quaternion)


def stop_at(robot: Robot, pose: Pose, q: FloatArray, other: FloatArray | None, fraction: float) -> LineStop:
    """Why a line that has come to ``q`` does not continue to ``pose``, just ahead.

    Args:
        other: The nearest configuration for that pose, (n,); None if there is none.
        fraction: The share of the line that lies behind.
    """
    free = descended(robot, pose, q[np.newaxis], (np.full(robot.n, -np.inf), np.full(robot.n, np.inf)))
    move = np.abs(free.q[0] - q)
    beyond = np.maximum(robot.limits.lower - free.q[0], free.q[0] - robot.limits.upper)
    reason = LineStopReason.SINGULARITY
    if free.arrived[0] and float(move.max()) <= MAX_STEP:
        if float(beyond.max()) > 0.0:
            reason, move = LineStopReason.LIMIT, beyond
    elif other is not None:
        reason, move = LineStopReason.BRANCH_JUMP, np.abs(other - q)
    return LineStop(reason, robot.joint_names[int(move.argmax())], fraction)
