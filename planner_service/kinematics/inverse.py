"""Inverse kinematics: the configurations that bring the tool to a pose.

Poses are those of the tool frame in the robot's base frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import FloatArray, joint_distance, read_only
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import finite_numbers, flag, instance, items, whole
from planner_service.kinematics.complete_inverse import (
    LIMIT_SLACK,
    InverseArcs,
    InverseSolutions,
    complete_arcs,
    complete_solutions,
    most_joints,
)
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.tool_arm import descended, tool_arm
from planner_service.presentation.measures import range_text
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot

__all__ = [
    "ToolChain",
    "closest_configuration",
    "configurations_at",
    "inverse_arcs",
    "inverse_is_complete",
    "inverse_kinematics",
    "nearest_configuration",
    "sampled_range",
    "solutions_known",
    "tool_error",
]

STARTS = 24
"""Random starts per round of the numeric search. On the WidowX AI a start converges for 40 % of reachable poses."""

MAX_ROUNDS = 4
"""Rounds of the numeric search; it stops after the first that finds a solution."""

BOXES_OF_A_FAILURE = 2_000
"""Boxes for a proof that a goal is out of reach, which nobody asked for: at most 0.1 s."""

DISTINCT = 1e-2
"""Numeric solutions closer than this (rad, L2) are one."""


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


@overload
def inverse_kinematics(
    robot: Robot,
    pose: Pose,
    *,
    seed: int = 0,
    seeds: Sequence[ArrayLike] = (),
    still: ArrayLike | None = None,
    complete: Literal[False] = False,
) -> FloatArray: ...


@overload
def inverse_kinematics(
    robot: Robot, pose: Pose | PoseGoal, *, still: ArrayLike | None = None, complete: Literal[True]
) -> InverseSolutions: ...


def inverse_kinematics(
    robot: Robot,
    pose: Pose | PoseGoal,
    *,
    seed: int = 0,
    seeds: Sequence[ArrayLike] = (),
    still: ArrayLike | None = None,
    complete: bool = False,
) -> FloatArray | InverseSolutions:
    """Configurations within the joint limits that bring the tool to ``pose``, shape (k, n); k = 0 if none is found.

    With ``complete``, all there are instead, each in a box proven to hold exactly one, or a proof that there is none:
    ``InverseSolutions``. It takes an arm of at most as many joints as the goal has equations: six for a pose,
    five if the tool may turn about an axis, three for a position alone.

    Otherwise, with ``robot.inverse`` "wxai" all solutions in closed form, verified by forward kinematics to 1e-7. With
    "numeric" damped least squares from ``seeds``, home and random starts, to 1e-8 m and rad: there may be further
    solutions, and an arm with more than six joints has infinitely many.

    Args:
        seed: Seed of the random starts; equal seeds give equal bits.
        seeds: Configurations (n,) to start from first, or to stay near where a pose leaves an angle free.
        still: A configuration (n,) whose values the joints keep that do not move the tool; None for home.
        complete: Find and prove all. The goal's tolerances count, its ``candidates`` do not.

    Raises:
        InvalidRequest: ``pose`` is not a Pose, a seed is not n finite numbers, no joint moves the tool, another joint
            of ``still`` is outside its limits, the closed form does not fit the robot, or, with ``complete``, the
            arm has too many joints or a start is given.
    """
    instance("robot", robot, Robot, "a Robot")
    whole("seed", seed, 0, 2**63 - 1)
    starts: tuple[Any, ...] = items("seeds", seeds, object, "configurations")
    if flag("complete", complete):
        if seed or starts:
            raise InvalidRequest("seeds" if starts else "seed", starts or seed, "none with complete: it starts nowhere")
        return _all_configurations(robot, pose, still)
    if not isinstance(pose, Pose):
        raise InvalidRequest("pose", pose, "a Pose")
    given = [finite_numbers(f"seeds[{i}]", q, robot.n) for i, q in enumerate(starts)]
    rest = robot.home if still is None else finite_numbers("still", still, robot.n)
    return configurations_at(robot, pose, seed=seed, seeds=given, still=rest).copy()


def _all_configurations(robot: Robot, pose: object, still: ArrayLike | None) -> InverseSolutions:
    goal = PoseGoal(pose) if isinstance(pose, Pose) else instance("pose", pose, PoseGoal, "a Pose or a PoseGoal")
    chain = ToolChain.of(robot, robot.home if still is None else finite_numbers("still", still, robot.n))
    return _of_whole(chain, complete_solutions(chain.robot, goal))


def _of_whole(chain: ToolChain, found: InverseSolutions) -> InverseSolutions:
    """Solutions of the chain as those of the whole robot."""
    if len(chain.columns) == len(chain.still):
        return found
    whole_boxes = np.stack([chain.whole(found.unresolved[:, k]) for k in (0, 1)], axis=1)
    q, lower, upper, witnesses = map(chain.whole, (found.q, found.lower, found.upper, found.witnesses))
    return InverseSolutions(q, lower, upper, whole_boxes, found.boxes, witnesses, found.resolution)


def inverse_arcs(robot: Robot, pose: Pose | PoseGoal, *, still: ArrayLike | None = None) -> InverseArcs:
    """All configurations of an arm with one joint too many for a pose, on arcs, or a proof that there is none.

    Seven joints for a pose, six if the tool may turn about an axis, four for a position alone. It takes a second or so;
    a proof that there is none takes milliseconds. Columns are the joints that move the tool.

    Args:
        still: A configuration (n,) whose values the joints keep that do not move the tool; None for home.

    Raises:
        InvalidRequest: ``pose`` is neither a Pose nor a PoseGoal, ``still`` is not n finite numbers or outside the
            limits of such a joint, or it has not one joint too many.
    """
    instance("robot", robot, Robot, "a Robot")
    goal = PoseGoal(pose) if isinstance(pose, Pose) else instance("pose", pose, PoseGoal, "a Pose or a PoseGoal")
    chain = ToolChain.of(robot, robot.home if still is None else finite_numbers("still", still, robot.n))
    return complete_arcs(chain.robot, goal)


def configurations_at(
    robot: Robot, pose: Pose, *, still: FloatArray, seed: int = 0, seeds: Sequence[FloatArray] = ()
) -> FloatArray:
    """``inverse_kinematics`` of configurations that are known to be n finite numbers; read-only."""
    chain = ToolChain.of(robot, still)
    given = [chain.of_whole(q) for q in seeds]
    if robot.inverse == "wxai":
        try:
            solutions = tool_arm(chain.robot).solve([*pose.position, *pose.quaternion], given)
        except RuntimeError as off:  # forward kinematics says otherwise
            raise BrokenInvariant(f"{off}, of {robot.name!r} for {pose}") from None
    else:
        solutions = _numeric_solutions(chain.robot, pose, np.random.default_rng(seed), given)
    found = chain.whole(np.array(solutions, dtype=np.float64).reshape(-1, chain.robot.n))
    found.flags.writeable = False
    return found


def inverse_is_complete(robot: Robot, pose: Pose) -> bool:
    """Whether ``inverse_kinematics`` returns every solution that there is: a closed form, and no angle left free."""
    if robot.inverse != "wxai":
        return False
    return tool_arm(ToolChain.of(robot, robot.home).robot).determined([*pose.position, *pose.quaternion])


def solutions_known(robot: Robot, goal: Pose | PoseGoal, *, still: FloatArray) -> InverseSolutions | None:
    """All configurations for a goal, as far as little effort shows them.

    For an arm of one joint too many, that there is none, if so; else, and for more joints, None.
    """
    chain = ToolChain.of(robot, still)
    goal = PoseGoal(goal) if isinstance(goal, Pose) else goal
    excess = chain.robot.n - most_joints(goal)
    if excess == 1:
        arcs = complete_arcs(chain.robot, goal, most_boxes=BOXES_OF_A_FAILURE)
        none = np.zeros((0, robot.n))
        known = arcs.complete and not len(arcs)
        return InverseSolutions(none, none, none, np.zeros((0, 2, robot.n)), arcs.boxes, none, 0.0) if known else None
    if excess > 0:
        return None
    return _of_whole(chain, complete_solutions(chain.robot, goal, most_boxes=BOXES_OF_A_FAILURE))


def _numeric_solutions(
    robot: Robot, pose: Pose, rng: np.random.Generator, given: list[FloatArray]
) -> list[list[float]]:
    """Distinct solutions, in the order of the starts that led to them."""
    low, high = sampled_range(robot)
    first = [*given, robot.home]
    for _ in range(MAX_ROUNDS):
        starts = np.array([*first, *(low + (high - low) * rng.random((STARTS, robot.n)))])
        end = descended(robot, pose, starts)
        solutions: list[list[float]] = []
        for q in end.q[end.arrived].tolist():
            if all(joint_distance(q, other) > DISTINCT for other in solutions):
                solutions.append(q)
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


def tool_error(robot: Robot, q: Sequence[float], pose: Pose) -> tuple[float, float]:
    """The distance (m) and angle (rad) between the tool and ``pose``."""
    turns = shifts = 0.0
    for row, wanted, x in zip(robot.tool_rows(q), pose.rotation_rows, pose.position, strict=True):
        a, b, c = row[0] - wanted[0], row[1] - wanted[1], row[2] - wanted[2]
        turns += a * a + b * b + c * c
        shifts += (row[3] - x) * (row[3] - x)
    return math.sqrt(shifts), 2.0 * math.asin(min(1.0, math.sqrt(turns / 8.0)))  # |R - R'| = sqrt(8) sin(angle / 2)


def nearest_configuration(robot: Robot, pose: Pose, q: FloatArray) -> FloatArray | None:
    """The configuration (n,) to which the numeric search from ``q`` (n,) leads for a pose; None if it fails."""
    end, arrived = closest_configuration(robot, pose, q)
    return end if arrived else None


def closest_configuration(robot: Robot, pose: Pose, q: FloatArray) -> tuple[FloatArray, bool]:
    """Where the numeric search from ``q`` (n,) ends, (n,), and whether the tool is at the pose there."""
    end = descended(robot, pose, q[np.newaxis])
    return read_only(end.q[0]), bool(end.arrived[0])
