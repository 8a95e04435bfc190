"""Inverse kinematics, and straight lines of the tool.

Poses are those of the tool frame in the robot's base frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only, set_fields
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import finite_numbers, instance, items, number, numbers, whole
from planner_service.kinematics.tool_arm import descended, tool_arm
from planner_service.kinematics.wxai_inverse import WxaiInverse
from planner_service.presentation.measures import range_text
from planner_service.robot.kinematic_tree import chain_to_base
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
    "ToolChain",
    "ToolLine",
    "closest_configuration",
    "configurations_at",
    "interpolate",
    "inverse_is_complete",
    "inverse_kinematics",
    "nearest_configuration",
    "require_joint_rate",
    "require_within_limits",
    "rotation_distance",
    "sampled_range",
    "shifted",
    "stop_at",
    "straight_tool_line",
    "tool_error",
    "travel",
]

STARTS = 24
"""Random starts per round of the numeric search. On the WidowX AI a start converges for 40 % of reachable poses."""

MAX_ROUNDS = 4
"""Rounds of the numeric search; it stops after the first that finds a solution."""

DISTINCT = 1e-2
"""Numeric solutions closer than this (rad, L2) are one."""

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

BETWEEN = (0.25, 0.5, 0.75)
"""Fractions of a piece at which it is compared with the line; its ends are on the line."""

MAX_STEP = 0.2
"""The most that a joint turns (rad) between two waypoints: a piece that needs more is halved, and finally refused."""

MAX_HALVINGS = 6
"""How often a piece is halved before the line stops: down to 0.03 mm on a 0.1 m line of 60 points."""

TURN_METRES = 0.1
"""Metres of travel that a radian of the tool's rotation counts as, where the tool turns more than its origin moves."""

RATE_SLACK = 1e-6
"""Radians by which a step may exceed its limit per metre: rounding, and the tolerance of numeric solutions."""

LIMIT_SLACK = 1e-9
"""A joint value at most this far outside its limits (rad) is rounding."""


@dataclass(frozen=True, eq=False)
class ToolChain:
    """A robot reduced to the joints that move its tool.

    Attributes:
        robot: A robot of these joints alone, without shapes; the whole robot if all of its joints move the tool.
        columns: The entries of the whole robot's q that they are.
        still: q (n,) of the whole robot; the other joints stay at its values.
    """

    robot: Robot
    columns: Sequence[int]
    still: FloatArray

    @classmethod
    def of(cls, robot: Robot, still: FloatArray) -> ToolChain:
        """The chain of ``robot`` with its other joints at the values of ``still``, n finite numbers.

        Raises:
            InvalidRequest: No joint moves the tool, or a joint outside the chain is beyond its limits.
        """
        columns = _tool_joints(robot)
        if len(columns) == robot.n:
            return cls(robot, columns, still)
        if not columns:
            raise InvalidRequest("tool_frame", robot.tool_frame, "a tool that a joint moves; ask for joint values")
        locked = {}
        limits = zip(*(bound.tolist() for bound in robot.bounds), strict=True)
        for index, (name, value, (low, high)) in enumerate(zip(robot.joint_names, still.tolist(), limits, strict=True)):
            if index not in columns:
                if not low - LIMIT_SLACK <= value <= high + LIMIT_SLACK:
                    raise InvalidRequest(f"still: {name}", value, f"within {range_text(low, high, value)}")
                locked[name] = low  # any value will do: it does not move the chain
        bare = replace(robot, shapes=(), gripper=None, retreats=())
        return cls(bare.locked(locked), columns, still)

    def of_whole(self, q: FloatArray) -> FloatArray:
        """The chain's part of configurations (..., n)."""
        return np.asarray(q[..., self.columns])

    def whole(self, Q: FloatArray) -> FloatArray:
        """Configurations (m, n) of the whole robot for configurations (m, k) of the chain."""
        out = np.repeat(self.still[np.newaxis], len(Q), axis=0)
        out[:, self.columns] = Q
        return out


@lru_cache(maxsize=32)
def _tool_joints(robot: Robot) -> list[int]:
    """The entries of q that move the tool, sorted."""
    return sorted({robot.bodies[index].q_index for index in chain_to_base(robot.bodies, robot.tool_body)})


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
        }[self.reason]
        return f"{self.name} ends after {100 * self.fraction:.1f} %: {what}"


@dataclass(frozen=True, eq=False)
class ToolLine:
    """Joint waypoints (N, n) that move the tool along a straight line, or along another path.

    Attributes:
        fraction: The share of the line that they cover, 0 to 1.
        stopped: Why they do not cover all of it; None if they do.
        fractions: The share of the line that lies behind each waypoint, (N,).
    """

    waypoints: FloatArray
    fraction: float
    stopped: LineStop | None = None
    fractions: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        set_fields(self, waypoints=read_only(self.waypoints), fractions=read_only(self.fractions))


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


def inverse_kinematics(
    robot: Robot, pose: Pose, *, seed: int = 0, seeds: Sequence[ArrayLike] = (), still: ArrayLike | None = None
) -> FloatArray:
    """Configurations within the joint limits that bring the tool to ``pose``, shape (k, n); k = 0 if none is found.

    With ``robot.inverse`` "wxai" all solutions in closed form, verified by forward kinematics to 1e-7. With "numeric"
    damped least squares from ``seeds``, home and random starts, to 1e-8 m and rad: there may be further solutions, and
    an arm with more than six joints has infinitely many.

    Args:
        seed: Seed of the random starts; equal seeds give equal bits.
        seeds: Configurations (n,) to start from first, or to stay near where a pose leaves an angle free.
        still: A configuration (n,) whose values the joints keep that do not move the tool; None for home.

    Raises:
        InvalidRequest: ``pose`` is not a Pose, a seed is not n finite numbers, no joint moves the tool, another joint
            of ``still`` is outside its limits, or the closed form does not fit the robot.
    """
    if not isinstance(pose, Pose):
        raise InvalidRequest("pose", pose, "a Pose")
    instance("robot", robot, Robot, "a Robot")
    whole("seed", seed, 0, 2**63 - 1)
    starts: tuple[Any, ...] = items("seeds", seeds, object, "configurations")
    given = [finite_numbers(f"seeds[{i}]", q, robot.n) for i, q in enumerate(starts)]
    rest = robot.home if still is None else finite_numbers("still", still, robot.n)
    return configurations_at(robot, pose, seed=seed, seeds=given, still=rest).copy()


def configurations_at(
    robot: Robot, pose: Pose, *, still: FloatArray, seed: int = 0, seeds: Sequence[FloatArray] = ()
) -> FloatArray:
    """``inverse_kinematics`` of configurations that are known to be n finite numbers; read-only."""
    chain = ToolChain.of(robot, still)
    given = [chain.of_whole(q) for q in seeds]
    if robot.inverse == "wxai":
        solutions = WxaiInverse.of(chain.robot).solve(pose, [q.tolist() for q in given])
    else:
        solutions = _numeric_solutions(chain.robot, pose, np.random.default_rng(seed), given)
    found = chain.whole(np.array(solutions, dtype=np.float64).reshape(-1, chain.robot.n))
    found.flags.writeable = False
    return found


def inverse_is_complete(robot: Robot, pose: Pose) -> bool:
    """Whether ``inverse_kinematics`` returns every solution that there is: a closed form, and no angle left free."""
    return robot.inverse == "wxai" and WxaiInverse.of(ToolChain.of(robot, robot.home).robot).determined(pose)


def _numeric_solutions(
    robot: Robot, pose: Pose, rng: np.random.Generator, given: list[FloatArray]
) -> list[tuple[float, ...]]:
    """Distinct solutions, in the order of the starts that led to them."""
    low, high = sampled_range(robot)
    first = [*given, robot.home]
    for _ in range(MAX_ROUNDS):
        starts = np.array([*first, *(low + (high - low) * rng.random((STARTS, robot.n)))])
        end = descended(robot, pose, starts)
        solutions: list[tuple[float, ...]] = []
        for q in end.q[end.arrived].tolist():
            if all(_distance(q, other) > DISTINCT for other in solutions):
                solutions.append(tuple(q))
        if solutions:
            return solutions
        first = []
    return []


def sampled_range(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """At most one full turn of each joint, around zero if possible: more turns repeat the same poses."""
    lower, upper = robot.limits.lower, robot.limits.upper
    half = np.minimum((upper - lower) / 2, math.pi)
    middle = np.minimum(np.maximum(0.0, lower + half), upper - half)
    return middle - half, middle + half


def _distance(a: Sequence[float], b: Sequence[float]) -> float:
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += (x - y) * (x - y)
    return math.sqrt(total)


# --- straight tool lines


def _deviation(
    robot: Robot, ends: tuple[list[float], list[float]], line: tuple[Pose, Pose], fractions: Sequence[float]
) -> tuple[float, float]:
    metres = radians = 0.0
    for u in fractions:
        q = [a + u * (b - a) for a, b in zip(*ends, strict=True)]
        shift, turn = tool_error(robot, q, interpolate(*line, u))
        metres, radians = max(metres, shift), max(radians, turn)
    return metres, radians


def tool_error(robot: Robot, q: Sequence[float], pose: Pose) -> tuple[float, float]:
    """The distance (m) and angle (rad) between the tool and ``pose``."""
    turns = shifts = 0.0
    for row, wanted, x in zip(robot.tool_rows(q), pose.rotation_rows, pose.position, strict=True):
        a, b, c = row[0] - wanted[0], row[1] - wanted[1], row[2] - wanted[2]
        turns += a * a + b * b + c * c
        shifts += (row[3] - x) * (row[3] - x)
    return math.sqrt(shifts), 2.0 * math.asin(min(1.0, math.sqrt(turns / 8.0)))  # |R - R'| = sqrt(8) sin(angle / 2)


def straight_tool_line(
    robot: Robot,
    q_start: ArrayLike,
    to: Pose | ArrayLike,
    *,
    points: int = LINE_POINTS,
    max_joint_rate: float = math.inf,
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

    Raises:
        InvalidRequest: A wrong shape, a number that is not finite or out of range, or ``q_start`` outside the limits.
    """
    instance("robot", robot, Robot, "a Robot")
    whole("points", points, 2, 10_000)
    require_joint_rate(max_joint_rate)
    q = finite_numbers("q_start", q_start, robot.n)
    robot = robot.around(q)
    require_within_limits("q_start", robot, q)
    chain = ToolChain.of(robot, q)
    line = _within_rate(chain.robot, _walked(chain.robot, chain.of_whole(q), to, points), to, max_joint_rate)
    return replace(line, waypoints=chain.whole(line.waypoints))


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


def _walked(robot: Robot, q: FloatArray, to: Pose | ArrayLike, points: int) -> ToolLine:
    begin = Pose.from_matrix(robot.tool_pose(q))
    walk = _Walk(robot, begin, to if isinstance(to, Pose) else shifted(begin, to), q)
    if begin == walk.end:
        return ToolLine(q[np.newaxis], 1.0, fractions=np.zeros(1))
    arm = tool_arm(robot, closed_form=robot.inverse == "wxai")
    whole_line = arm.walk(_numbers(begin), _numbers(walk.end), q, points)
    if whole_line is not None:
        return ToolLine(whole_line, 1.0, fractions=_fractions(robot, whole_line, points))
    shortest = 1.0 / (points - 1) / 2**MAX_HALVINGS
    for k in range(1, points):
        stop = walk.to(k / (points - 1), shortest)
        if stop is not None:
            return ToolLine(np.array(walk.waypoints), walk.fraction, stop, np.array(walk.fractions))
    return ToolLine(np.array(walk.waypoints), 1.0, fractions=np.array(walk.fractions))


def _fractions(robot: Robot, waypoints: FloatArray, points: int) -> FloatArray:
    """The share of a whole line behind each of its waypoints, (N,)."""
    if len(waypoints) == points:
        return np.arange(points) / (points - 1)
    poses = [Pose.from_matrix(robot.tool_pose(q)) for q in waypoints]
    behind = [travel(poses[0], pose) for pose in poses]
    return np.array(behind) / behind[-1]


def travel(a: Pose, b: Pose) -> float:
    """Metres between two poses, or 0.1 m for each radian between them if that is more."""
    return max(math.dist(a.position, b.position), TURN_METRES * rotation_distance(a, b))


def _within_rate(robot: Robot, line: ToolLine, to: Pose | ArrayLike, rate: float) -> ToolLine:
    """The line up to where a joint would move too far per metre."""
    if rate == math.inf or len(line.waypoints) < 2:
        return line
    begin = Pose.from_matrix(robot.tool_pose(line.waypoints[0]))
    whole_travel = travel(begin, to if isinstance(to, Pose) else shifted(begin, to))
    moves = np.abs(line.waypoints[1:] - line.waypoints[:-1])
    allowed = rate * whole_travel * (line.fractions[1:] - line.fractions[:-1])
    too_far = moves.max(axis=1) > allowed + RATE_SLACK
    if not too_far.any():
        return line
    k = int(too_far.argmax())
    fraction = float(line.fractions[k])
    stop = LineStop(LineStopReason.JOINT_RATE, robot.joint_names[int(moves[k].argmax())], fraction)
    return ToolLine(line.waypoints[: k + 1], fraction, stop, line.fractions[: k + 1])


def _numbers(pose: Pose) -> list[float]:
    """Position and quaternion."""
    return [*pose.position, *pose.quaternion]


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


class _Walk:
    """Follows a straight tool line, collecting waypoints."""

    def __init__(self, robot: Robot, begin: Pose, end: Pose, q: FloatArray) -> None:
        self._robot, self._begin, self.end = robot, begin, end
        self._closed_form = WxaiInverse.of(robot) if robot.inverse == "wxai" else None
        self.waypoints, self.fractions = [q], [0.0]
        self.fraction = 0.0
        self._pose = begin

    def to(self, fraction: float, shortest: float) -> LineStop | None:
        """Continue to ``fraction`` in pieces no shorter than ``shortest``; returns the reason if that fails."""
        pending = [fraction]
        while pending:
            pose = interpolate(self._begin, self.end, pending[-1])
            q = self._next(pose, self.waypoints[-1])
            if q is not None and self._fits(q, pose):
                self.waypoints.append(q)
                self.fraction, self._pose = pending.pop(), pose
                self.fractions.append(self.fraction)
            elif pending[-1] - self.fraction <= shortest * (1.0 + 1e-9):
                return self._stop(pose, q)
            else:
                pending.append((self.fraction + pending[-1]) / 2)
        return None

    def _next(self, pose: Pose, before: FloatArray) -> FloatArray | None:
        """The configuration for a pose nearest to the one before, or None."""
        if self._closed_form is None:
            return nearest_configuration(self._robot, pose, before)
        near = before.tolist()
        solutions = self._closed_form.solve(pose, [near])
        if not solutions:
            return None
        return read_only(min(solutions, key=lambda q: max(abs(a - b) for a, b in zip(q, near, strict=True))))

    def _fits(self, q: FloatArray, pose: Pose) -> bool:
        before = self.waypoints[-1]
        if float(np.abs(q - before).max()) > MAX_STEP:
            return False
        metres, radians = _deviation(self._robot, (before.tolist(), q.tolist()), (self._pose, pose), BETWEEN)
        return metres <= SAMPLED_SHARE * LINE_METRES and radians <= SAMPLED_SHARE * LINE_RADIANS

    def _stop(self, pose: Pose, other: FloatArray | None) -> LineStop:
        return stop_at(self._robot, pose, self.waypoints[-1], other, self.fraction)


def nearest_configuration(robot: Robot, pose: Pose, q: FloatArray) -> FloatArray | None:
    """The configuration (n,) to which the numeric search from ``q`` (n,) leads for a pose; None if it fails."""
    end, arrived = closest_configuration(robot, pose, q)
    return end if arrived else None


def closest_configuration(robot: Robot, pose: Pose, q: FloatArray) -> tuple[FloatArray, bool]:
    """Where the numeric search from ``q`` (n,) ends, (n,), and whether the tool is at the pose there."""
    end = descended(robot, pose, q[np.newaxis])
    return read_only(end.q[0]), bool(end.arrived[0])


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
