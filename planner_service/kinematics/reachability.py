"""Why the tool cannot be brought to a pose: out of reach, at another turn only, or with a joint beyond its limit.

It is asked once a plan has failed, and adds to the message. All it says is of the best that it found: from other
starts, a nearer position or turn may exist.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import FloatArray, as_sent, read_only
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in, finite_numbers, instance, whole
from planner_service.kinematics.inverse import ToolChain, inverse_kinematics, sampled_range, tool_error
from planner_service.kinematics.numeric_inverse import approach
from planner_service.kinematics.tool_arm import descended
from planner_service.robot.model import Robot

__all__ = ["Cause", "LimitExcess", "Slip", "Suggestion", "Unreachable", "why_unreachable"]

STARTS = 32
"""Random starts of each search. On the Panda and the UR5, 96 starts of 200 steps find a turn less by more than 5 mrad
for 3 % of poses (16 starts: 18 %), and no position nearer by more than 3 mm."""

MORE_STARTS = 240
"""Random starts of the longer search for a solution: ten rounds of ``inverse_kinematics``."""

STEPS, LAST_STEPS = 30, 10
"""Steps towards the position, and of each part of the search for the nearest turn; steps back onto the position."""

POSITION_WEIGHTS = (10.0, 100.0)
"""A position's error compared to the orientation's while the nearest turn is searched, first and then."""

SAME_METRES, SAME_RADIANS = 1e-5, 1e-5
"""Differences from a pose up to which it is reached: far below what a tool can do, above what the search leaves."""

NARROWINGS = 10
"""Halvings of how far a joint has to go beyond its limit, for arms with more joints than a pose has coordinates."""

TASK = 6
"""Coordinates of a pose; an arm with more joints has infinitely many solutions."""

FAR = 10.0
"""Metres from the base from which on a position may be one in millimetres: a nearer one would be within the base."""


class Cause(enum.Enum):
    """Why no configuration was found for a pose."""

    OUT_OF_REACH = "out of reach"
    """The tool does not come to the position."""
    ORIENTATION = "orientation"
    """It comes to the position, but not with this orientation."""
    JOINT_LIMIT = "joint limit"
    """It would, if one joint went beyond its limit."""
    MISSED = "missed"
    """It does: a longer search found a configuration."""


class Slip(enum.Enum):
    """A common mistake in a pose."""

    MILLIMETRES = "position in millimetres"
    """Where metres are expected."""
    XYZW = "quaternion as x y z w"
    """Where w x y z are expected."""


@dataclass(frozen=True)
class Suggestion:
    """The pose that may have been meant, and the mistakes that would explain the one that was given."""

    slips: tuple[Slip, ...]
    pose: Pose

    def __str__(self) -> str:
        said = " and ".join(f"a {slip.value}" for slip in self.slips)
        place = ", ".join(f"{value:.4g}" for value in self.pose.position)
        turn = ", ".join(f"{value:.4g}" for value in self.pose.quaternion)
        turned = f" with w x y z = ({turn})" if Slip.XYZW in self.slips else ""
        return f"is it {said}? ({place}){turned} can be reached"


@dataclass(frozen=True)
class LimitExcess:
    """A joint, the position it would need (rad, m if prismatic), and its limit, which that is beyond."""

    joint: str
    needed: float
    limit: float

    @property
    def excess(self) -> float:
        """How far beyond, in rad (m for a prismatic joint)."""
        return abs(self.needed - self.limit)

    def __str__(self) -> str:
        return f"{self.joint} = {self.needed:.4f}, {self.excess:.4f} beyond its limit of {self.limit:.4f}"


@dataclass(frozen=True, eq=False)
class Unreachable:
    """Why the tool cannot be brought to a pose, and how near it comes.

    Attributes:
        cause: The kind of reason.
        nearest: Configuration (n,) within the limits that comes nearest in position; if it reaches that, the nearest in
            orientation. With MISSED, a configuration for the pose.
        position: Of the tool there, in metres in the base frame.
        gap: Metres between that and the pose's position.
        turn: Radians between the orientations.
        beyond: The joint that is in the way, with JOINT_LIMIT; else None.
        suggestion: What may have been meant; None if no common mistake explains the pose.
    """

    cause: Cause
    nearest: FloatArray
    position: tuple[float, float, float]
    gap: float
    turn: float
    beyond: LimitExcess | None = None
    suggestion: Suggestion | None = None
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        copied_in(self, "nearest")

    def __str__(self) -> str:
        told = []
        if self.cause is Cause.MISSED:
            told.append(f"a longer search reaches it with {np.round(self.nearest, 4).tolist()}: give joint values")
        if self.beyond is not None:
            told.append(f"it would take {self.beyond}")
        if self.gap > SAME_METRES:
            x, y, z = self.position
            within = "within the limits " if self.beyond else ""
            told.append(f"{within}out of reach by {self.gap * 1e3:.1f} mm, nearest at ({x:.4f}, {y:.4f}, {z:.4f})")
        elif self.cause is not Cause.MISSED:
            within = "within the limits " if self.beyond else ""
            told.append(f"{within}the position is within reach, but with the tool turned by {self.turn:.3f} rad")
        return "; ".join([*told, *([] if self.suggestion is None else [str(self.suggestion)])])


def why_unreachable(robot: Robot, pose: Pose, *, seed: int = 0, still: ArrayLike | None = None) -> Unreachable:
    """Why ``inverse_kinematics`` finds no configuration for a pose. Collisions are not looked at.

    Args:
        seed: Seed of the random starts; equal seeds give equal bits.
        still: A configuration (n,) whose values the joints keep that do not move the tool; None for home.

    Raises:
        InvalidRequest: As ``inverse_kinematics``.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("pose", pose, Pose, "a Pose")
    rng = np.random.default_rng(whole("seed", seed, 0, 2**63 - 1))
    held = robot.home if still is None else finite_numbers("still", still, robot.n)
    chain = ToolChain.of(robot, held)
    arm = chain.robot
    q, beyond = _solution(arm, pose, rng), None
    if q is None:
        q = _nearest(arm, pose, rng)
        beyond = _single_limit(arm, pose, rng)
    gap, turn = tool_error(arm, q.tolist(), pose)
    if gap <= SAME_METRES and turn <= SAME_RADIANS:
        cause, beyond = Cause.MISSED, None
    elif beyond is not None:
        cause = Cause.JOINT_LIMIT
    else:
        cause = Cause.OUT_OF_REACH if gap > SAME_METRES else Cause.ORIENTATION
    x, y, z = (row[3] for row in arm.tool_rows(q.tolist()))
    suggestion = None if cause is Cause.MISSED else _suggestion(robot, pose, seed, held)
    return Unreachable(cause, chain.whole(q[np.newaxis])[0], (x, y, z), gap, turn, beyond, suggestion)


def _random(robot: Robot, count: int, rng: np.random.Generator) -> FloatArray:
    low, high = sampled_range(robot)
    return np.asarray(low + (high - low) * rng.random((count, robot.n)))


def _solution(robot: Robot, pose: Pose, rng: np.random.Generator) -> FloatArray | None:
    """A configuration for the pose that fewer starts missed."""
    end = descended(robot, pose, _random(robot, MORE_STARTS, rng))
    return read_only(end.q[end.arrived][0]) if end.arrived.any() else None


def _nearest(robot: Robot, pose: Pose, rng: np.random.Generator) -> FloatArray:
    """The configuration nearest in position; if that is reached, among these the nearest in orientation."""
    Q = approach(robot, pose, np.array([robot.home, *_random(robot, STARTS, rng)]), (1.0, 0.0), steps=STEPS)
    gaps = np.array([tool_error(robot, q, pose)[0] for q in Q.tolist()])
    if gaps.min() > SAME_METRES:
        return read_only(Q[int(gaps.argmin())])
    Q = Q[gaps <= SAME_METRES]
    for weight in POSITION_WEIGHTS:
        Q = approach(robot, pose, Q, (weight, 1.0), steps=STEPS)
    Q = approach(robot, pose, Q, (1.0, 0.0), steps=LAST_STEPS)
    turns = [turn if gap <= SAME_METRES else math.inf for gap, turn in (tool_error(robot, q, pose) for q in Q.tolist())]
    return read_only(Q[turns.index(min(turns))])


def _single_limit(robot: Robot, pose: Pose, rng: np.random.Generator) -> LimitExcess | None:
    """The joint that reaches the pose by going the least beyond its limit, the others staying within theirs."""
    free = np.full(robot.n, np.inf)
    starts = _random(robot, STARTS, rng)
    if not descended(robot, pose, starts, (-free, free)).arrived.any():
        return None
    least, joint = None, 0
    for j in range(robot.n):
        found = _beyond(robot, pose, starts, j, math.inf)
        while found is not None and (least is None or found.excess < least.excess):
            least, joint = found, j
            found = _beyond(robot, pose, starts, j, found.excess / 2.0) if robot.n > TASK else None
    if least is None or robot.n <= TASK:
        return least
    low, high = 0.0, least.excess
    for _ in range(NARROWINGS):
        room = (low + high) / 2.0
        found = _beyond(robot, pose, starts, joint, room)
        if found is None:
            low = room
        else:
            least, high = found, found.excess
    return least


def _beyond(robot: Robot, pose: Pose, starts: FloatArray, joint: int, room: float) -> LimitExcess | None:
    """How far one joint goes beyond its limit to reach the pose, at most ``room``; None if that does not help.

    Args:
        starts: Configurations (m, n); the joint's own values are replaced.
    """
    lower, upper = robot.limits.lower.tolist()[joint], robot.limits.upper.tolist()[joint]
    turns = not next(body.prismatic for body in robot.bodies if body.q_index == joint)
    middle = (lower + upper) / 2.0
    if turns and upper - lower >= 2.0 * math.pi:
        return None
    low, high = robot.limits.lower.copy(), robot.limits.upper.copy()
    low[joint], high[joint] = lower - room, upper + room
    spread = min((upper - lower) / 2.0 + room, math.pi) if turns else (upper - lower) / 2.0
    begin = starts.copy()
    begin[:, joint] = np.linspace(middle - spread, middle + spread, len(starts))
    end = descended(robot, pose, begin, (low, high))
    values = end.q[end.arrived][:, joint].tolist()
    if turns:  # the same pose by the shortest way from the middle of the range
        values = [middle + math.remainder(value - middle, 2.0 * math.pi) for value in values]
    limits = [LimitExcess(robot.joint_names[joint], value, lower if value < middle else upper) for value in values]
    outside = [each for each in limits if not lower <= each.needed <= upper]
    return min(outside, key=lambda each: each.excess, default=None)


def _suggestion(robot: Robot, pose: Pose, seed: int, still: FloatArray) -> Suggestion | None:
    """The first pose that common mistakes would explain and that has a configuration."""
    for slips, meant in _meant(pose):
        if len(inverse_kinematics(robot, meant, seed=seed, still=still)):
            return Suggestion(slips, meant)
    return None


def _meant(pose: Pose) -> Iterator[tuple[tuple[Slip, ...], Pose]]:
    """Poses that may have been meant, those by one mistake first."""
    a, b, c, d = pose.quaternion
    turned = replace(pose, quaternion=(d, a, b, c))
    yield (Slip.XYZW,), turned
    if math.hypot(*pose.position) >= FAR:
        x, y, z = (value / 1000.0 for value in pose.position)
        yield (Slip.MILLIMETRES,), replace(pose, position=(x, y, z))
        yield (Slip.MILLIMETRES, Slip.XYZW), replace(turned, position=(x, y, z))
