"""Every configuration for a pose of the tool, proven, or a proof that there is none (docs/design/certified-ik.md).

Compiled code (native/kinematics/complete.cpp) cuts the joints' ranges into boxes. Equations of the closed loop show
that a box holds no solution, or make it smaller; a contraction shows that it holds exactly one.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, as_sent, cross
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import copied_in, finite_numbers
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.native.loading import load_core
from planner_service.robot.kinematic_tree import body_matrix, chain_to_base
from planner_service.robot.model import Robot

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = [
    "LIMIT_SLACK",
    "InverseArcs",
    "InverseSolutions",
    "InverseTrail",
    "closed_loop",
    "complete_arcs",
    "complete_solutions",
    "most_joints",
    "searched",
    "shown_solutions",
]

POSE_ERROR = 1e-11
"""Metres and radians within which two poses are one to the proof: far above the rounding of a pose."""

ROUNDING = 1e-12
"""Metres and radians for each metre of the arm: above what rounding of the pose and of the axes at q = 0 makes."""

MOST_BOXES = 20_000
"""Boxes after which what is left is unresolved."""

TURN = 2.0 * math.pi

TURN_ROUNDING = 1e-14
"""Above what a box that is moved by whole turns is off (rad), for joints within 16 turns."""

LIMIT_SLACK = 1e-9
"""A joint value at most this far outside its limits (rad or m) is rounding, to the checkers, too."""

SEAM = 0.7123
"""Where a circle is cut open (rad from the lower limit): not at an angle that people choose."""

POSE, AXIS, POSITION = 0, 1, 2
"""What is wanted of the tool; ``Wanted`` in native/kinematics/loop.hpp."""

ROWS = {POSE: 6, AXIS: 5, POSITION: 3}
"""Equations, hence the most joints."""


@dataclass(frozen=True, eq=False)
class InverseSolutions:
    """All configurations within the joint limits that bring the tool to a pose.

    Every configuration whose tool is within the goal's tolerances (at least 1e-11 m and rad) is in a solution's box or
    in an unresolved one. Each solution's box holds exactly one configuration for each pose within these tolerances,
    or, of an arm with fewer joints than the goal has equations, at most one. Boxes are within the limits, but for the
    1e-9 that count as rounding everywhere; where the arm is nearly singular at a limit, a box that is less sharp may
    exceed it by more. Its q is within the limits, with the tool within the tolerances.

    Attributes:
        q: Shape (k, n), sorted, within the limits. Of continuous joints, values within half a turn of the middle of
            their limits.
        lower: Lowest joint values of each solution's box, (k, n).
        upper: Highest, (k, n).
        unresolved: Boxes (u, 2, n) that may hold others, lower then upper values: at singularities, where solutions
            meet or run on without end, where a limit cuts a box that the goal's tolerances made wide, or all that was
            left when the search gave up. Where a joint can make a whole turn, up to whole turns.
        boxes: Boxes that the search looked at.
        witnesses: Configurations (w, n) in unresolved boxes, within the limits, whose tool is within the tolerances. It
            is not known how many others are beside them.
        resolution: Every configuration within the limits whose tool is within the tolerances is at most this far from
            one of q or witnesses in each joint (rad or m), up to whole turns of joints that can make one. Infinite if
            there are unresolved boxes and no witness.
    """

    q: FloatArray
    lower: FloatArray
    upper: FloatArray
    unresolved: FloatArray
    boxes: int
    witnesses: FloatArray
    resolution: float
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        copied_in(self, "q", "lower", "upper", "unresolved", "witnesses")

    def __len__(self) -> int:
        return len(self.q)

    @property
    def complete(self) -> bool:
        """Whether there are no solutions but these: without any, it is proven that the goal cannot be reached."""
        return not len(self.unresolved)

    @property
    def reachable(self) -> bool | None:
        """Whether the goal can be reached at all; None if that is not known."""
        return True if len(self.q) or len(self.witnesses) else False if self.complete else None


@dataclass(frozen=True, eq=False)
class InverseArcs:
    """All configurations within the joint limits that bring the tool of an arm with one joint too many to a pose.

    They form curves, which are covered by short arcs. For each value of the joint ``joints[k]`` within ``reach[k]`` of
    ``q[k]``, and each pose within the goal's tolerances, exactly one configuration is within ``half[k]`` of
    ``q[k] + (value - q[k][joint]) * along[k]``, in each other joint. Every configuration whose tool is within the
    tolerances (at least 1e-11 m and rad) is there, or in an unresolved box, up to whole turns of joints that go round.

    Attributes:
        joints: Of each arc the entry of q that runs along it, (k,).
        reach: Radians, or metres for joints that slide, (k,).
        q: Their middles, (k, n). An arc may leave the limits; what leaves them is no configuration.
        along: Changes of q for each unit of that joint, (k, n).
        half: Half widths, (k, n); 0 for the joint itself.
        unresolved: Boxes (u, 2, n) that may hold others, lower then upper values.
        rounds: Which joints go round, (n,).
        boxes: Boxes that the search looked at.
    """

    joints: IntArray
    reach: FloatArray
    q: FloatArray
    along: FloatArray
    half: FloatArray
    unresolved: FloatArray
    rounds: BoolArray
    boxes: int
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        copied_in(self, "joints", "reach", "q", "along", "half", "unresolved", "rounds")

    def __len__(self) -> int:
        return len(self.q)

    @property
    def complete(self) -> bool:
        """Whether there are no configurations but these: without any, it is proven that the goal cannot be reached."""
        return not len(self.unresolved)

    def holds(self, q: ArrayLike) -> bool:
        """Whether a configuration (n,) is on one of the arcs or in an unresolved box, up to whole turns.

        Raises:
            InvalidRequest: q is not n finite numbers.
        """
        at = finite_numbers("q", q, len(self.rounds))
        off = at - self.q
        off = np.where(self.rounds, off - TURN * np.round(off / TURN), off)
        rows = np.arange(len(self.q))
        run = off[rows, self.joints]
        off = np.abs(off - run[:, None] * self.along)
        off[rows, self.joints] = 0.0
        on = (np.abs(run) <= self.reach) & np.all(off <= self.half + TURN_ROUNDING, axis=1)
        away = at - self.unresolved.mean(axis=1)
        away = np.where(self.rounds, away - TURN * np.round(away / TURN), away)
        inside = np.abs(away) <= np.ptp(self.unresolved, axis=1) / 2 + TURN_ROUNDING
        return bool(on.any() or np.any(np.all(inside, axis=1)))


@dataclass(frozen=True, eq=False)
class InverseTrail:
    """What shows that the solutions are all: for the auditor, which works it out again.

    Attributes:
        points: A point on each joint's axis at q = 0, from the base to the tool, (m, 3).
        domain: Lowest and highest joint values that were searched, (2, n): of joints that go round, one turn.
        found: Solutions there, each with its box and the box where it is alone, (k, 5, n).
        steps: As ``Step`` in native/kinematics/complete.hpp, (s, 6).
        sums: Of equations, (t, 14).
        equations: Of the loop, (e, 6).
        followed: The points and directions that these follow, (f, 5).
    """

    points: FloatArray
    domain: FloatArray
    found: FloatArray
    steps: FloatArray
    sums: FloatArray
    equations: FloatArray
    followed: FloatArray

    def __post_init__(self) -> None:
        copied_in(self, "points", "domain", "found", "steps", "sums", "equations", "followed")


@lru_cache(maxsize=32)
def closed_loop(robot: Robot) -> tuple[_core.ClosedLoop, BoolArray, float]:
    """The compiled loop of an arm, which joints go round once at least (n,), and metres of all its offsets together."""
    lines, circles, (low, high) = _lines(robot)
    tool = body_matrix(robot.body_poses(np.zeros(robot.n))[robot.tool_body]) @ robot.tool_placement
    loop = load_core().ClosedLoop(lines, np.ascontiguousarray(tool[:3]).ravel(), low, high)
    corners = np.concatenate([np.zeros((1, 3)), lines[:, 6:], tool[None, :3, 3]])
    return loop, circles, float(np.sqrt((np.diff(corners, axis=0) ** 2).sum(axis=1)).sum())


def searched(robot: Robot, circles: BoolArray) -> FloatArray:
    """Lowest and highest joint values among which covers look, (2, n): of joints that go round, one turn."""
    lower, upper = robot.limits.lower, robot.limits.upper
    low = np.where(circles, lower + SEAM, lower)
    return np.stack([low, np.where(circles, low + TURN + 1e-9, upper)])


def _lines(robot: Robot) -> tuple[FloatArray, BoolArray, FloatArray]:
    """The lines of an arm's joints (m, 9), which joints go round once at least, and where they are searched (2, n)."""
    lines = np.array([_line(robot, index) for index in reversed(chain_to_base(robot.bodies, robot.tool_body))])
    _choose_points(lines)
    lower, upper = robot.limits.lower, robot.limits.upper
    circles = np.array(robot.continuous or [False] * robot.n) | (upper - lower >= TURN)
    for slides, entry, multiplier, *_ in lines.tolist():
        circles[int(entry)] &= slides == 0.0 and abs(multiplier) == 1.0
    return lines, circles, searched(robot, circles)


def _line(robot: Robot, index: int) -> list[float]:
    """Whether a body slides, its entry of q, its multiplier, and its axis and a point on it at q = 0."""
    body, T = robot.bodies[index], body_matrix(robot.body_poses(np.zeros(robot.n))[index])
    axis = T[:3, :3] @ body.axis
    axis /= math.sqrt(float(axis @ axis))
    return [body.prismatic, body.q_index, body.multiplier, *axis.tolist(), *T[:3, 3].tolist()]


def _choose_points(lines: FloatArray) -> None:
    """Move the points along their axes to where neighbouring axes meet or come nearest, for short equations."""
    chosen = [bool(line[0]) for line in lines]
    for k in range(len(lines) - 1):
        here, there = lines[k], lines[k + 1]
        if not (here[0] or there[0]):
            a, b = _nearest(here, there), _nearest(there, here)
            if a is not None and b is not None and np.abs(a - b).max() < 1e-12:
                for line, at in ((k, a), (k + 1, b)):
                    if not chosen[line]:
                        lines[line, 6:], chosen[line] = at, True
    for k, line in enumerate(lines):
        if not chosen[k] and len(lines) > 1:
            other = lines[k - 1 if k else 1]
            nearest = None if other[0] else _nearest(line, other)
            foot = line[6:] + line[3:6] * (line[3:6] @ (other[6:] - line[6:]))
            lines[k, 6:] = foot if nearest is None else nearest


def _nearest(line: FloatArray, other: FloatArray) -> FloatArray | None:
    """The point on an axis nearest to another; None if they are nearly parallel."""
    a, b, apart = line[3:6], other[3:6], other[6:] - line[6:]
    normal = cross(a, b)
    square = float(normal @ normal)
    if square < 1e-6:
        return None
    return np.asarray(line[6:] + a * (float(cross(apart, b) @ normal) / square))


def most_joints(goal: PoseGoal) -> int:
    """Joints up to which an arm has no infinitely many solutions for a goal: as many as that has equations."""
    return ROWS[_wanted(goal)]


def _wanted(goal: PoseGoal) -> int:
    return POSITION if goal.orientation_tolerance >= math.pi else POSE if goal.free_axis is None else AXIS


def complete_solutions(robot: Robot, goal: PoseGoal, *, most_boxes: int = MOST_BOXES) -> InverseSolutions:
    """All solutions of an arm whose joints all move its tool.

    Raises:
        InvalidRequest: It has more joints than the goal determines.
    """
    excess = robot.n - most_joints(goal)
    if excess > 0:
        expected = f"an arm of at most {most_joints(goal)} joints for this goal: {robot.name!r} has {robot.n}"
        other = ", or ask inverse_arcs" if excess == 1 else ""
        raise InvalidRequest(
            "complete", True, f"{expected}, hence infinitely many solutions; lock {excess} (robot.locked){other}"
        )
    loop, circles, asked = _asked(robot, goal)
    found, left, boxes, near = loop.solve(*asked, most_boxes)
    _require_reached(robot, goal, found[:, 0])
    return _within_limits(robot, goal, circles, found, left, boxes, near)


def complete_arcs(robot: Robot, goal: PoseGoal, *, most_boxes: int = MOST_BOXES) -> InverseArcs:
    """All solutions of an arm whose joints all move its tool, with one joint more than the goal has equations.

    Raises:
        InvalidRequest: It has another number of joints.
    """
    if robot.n != most_joints(goal) + 1:
        expected = f"an arm of {most_joints(goal) + 1} joints for this goal: {robot.name!r} has {robot.n}"
        raise InvalidRequest("robot", robot.n, expected)
    loop, circles, asked = _asked(robot, goal)
    found, left, boxes = loop.arcs(*asked, most_boxes)
    q, along, half = (found[:, 2 + k * robot.n : 2 + (k + 1) * robot.n] for k in range(3))
    _require_reached(robot, goal, q)
    return InverseArcs(found[:, 0].astype(np.intp), found[:, 1], q, along, half, left, circles, boxes)


def shown_solutions(robot: Robot, goal: PoseGoal) -> tuple[InverseSolutions, InverseTrail]:
    """``complete_solutions`` of an arm that has not too many joints, and what shows that they are all."""
    loop, circles, asked = _asked(robot, goal)
    found, left, boxes, near, *shown = loop.shown(*asked, MOST_BOXES)
    _require_reached(robot, goal, found[:, 0])
    lines, _, domain = _lines(robot)
    trail = InverseTrail(lines[:, 6:], domain, found, *shown)
    return _within_limits(robot, goal, circles, found, left, boxes, near), trail


def _asked(
    robot: Robot, goal: PoseGoal
) -> tuple[_core.ClosedLoop, BoolArray, tuple[FloatArray, tuple[float, float, float], int, float, float]]:
    """The loop, which joints go round, and what is asked of the loop."""
    loop, circles, length = closed_loop(robot)
    pose = goal.pose
    unit = Pose(pose.position, tuple((np.array(pose.quaternion) / math.hypot(*pose.quaternion)).tolist()))
    rows = np.array([[*row, at] for row, at in zip(unit.rotation_rows, unit.position, strict=True)])
    shift, turn = (
        max(each, POSE_ERROR) + ROUNDING * (1.0 + length)
        for each in (goal.position_tolerance, goal.orientation_tolerance)
    )
    return loop, circles, (rows.ravel(), goal.free_axis or (0.0, 0.0, 0.0), _wanted(goal), shift, turn)


def _within_limits(
    robot: Robot, goal: PoseGoal, circles: BoolArray, found: FloatArray, left: FloatArray, boxes: int, near: FloatArray
) -> InverseSolutions:
    """What of the solutions and boxes in doubt is within the limits, at each whole turn of the joints that go round.

    A solution's box counts as within a limit that it exceeds by no more than ``LIMIT_SLACK``, if some of it is within,
    or if a configuration in it is within the limits and brings the tool to the goal.
    """
    n, (lower, upper, endless) = robot.n, _ranges(robot)
    middle = (lower + upper) / 2
    found = found[_first_of_their_kind(found, circles)]
    nearest = np.where(endless, np.round((middle - found[:, 0]) / TURN), np.ceil((lower - found[:, 2]) / TURN))
    farthest = np.where(endless, nearest, np.floor((upper - found[:, 1]) / TURN))
    rows, turns = list[int](), list[tuple[int, ...]]()
    for k, (first, last) in enumerate(zip(nearest.astype(int).tolist(), farthest.astype(int).tolist(), strict=True)):
        ranges = [range(a, b + 1) if c else (0,) for a, b, c in zip(first, last, circles.tolist(), strict=True)]
        for each in itertools.product(*ranges):
            rows.append(k)
            turns.append(each)
    shifts = np.array(turns, dtype=np.float64).reshape(-1, n)
    moved = found[rows, :3] + TURN * shifts[:, None]
    moved[shifts.any(axis=1)] += TURN_ROUNDING * np.array([[0.0], [-1.0], [1.0]])
    low, high = moved[:, 1], moved[:, 2]
    touching = np.all(((lower <= high) & (low <= upper)) | endless, axis=1)
    inside = np.all(((lower - LIMIT_SLACK <= low) & (high <= upper + LIMIT_SLACK)) | endless, axis=1) & touching
    for k in np.flatnonzero(touching & ~inside).tolist():
        room = np.where(endless, moved[k, 1:], np.clip(moved[k, 1:], lower, upper))
        loop, _, asked = _asked(robot, goal)
        one = loop.reached_in(*asked, room)
        if _at_goal(robot, goal, one).any():
            moved[k, 0], inside[k] = one[0], True
    solutions, doubtful = moved[inside], moved[touching & ~inside, 1:]
    solutions = solutions[np.lexsort(solutions[:, 0].T[::-1])]
    q = np.where(endless, solutions[:, 0], np.clip(solutions[:, 0], lower, upper))
    left, witnesses = np.concatenate([left, doubtful]), _witnesses(robot, goal, circles, near)
    widths = [np.ptp(solutions[:, 1:], axis=1).ravel(), [_around_witnesses(box, witnesses, circles) for box in left]]
    resolution = float(np.concatenate(widths).max(initial=0.0))
    return InverseSolutions(q, solutions[:, 1], solutions[:, 2], left, boxes, witnesses, resolution)


def _around_witnesses(box: FloatArray, witnesses: FloatArray, circles: BoolArray) -> float:
    """How far anything in a box (2, n) is from a witness, in each joint, up to whole turns; infinite without any."""
    off = witnesses - box.mean(axis=0)
    off = np.abs(np.where(circles, off - TURN * np.round(off / TURN), off))
    return float((off + np.ptp(box, axis=0) / 2).max(axis=1).min(initial=math.inf))


@lru_cache(maxsize=32)
def _ranges(robot: Robot) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Lower and upper ends of what each joint's values are taken from, and which joints turn without end."""
    endless = np.array(robot.continuous or [False] * robot.n)
    middle = (robot.limits.lower + robot.limits.upper) / 2
    lower = np.where(endless, middle - math.pi, robot.limits.lower)
    return lower, np.where(endless, middle + math.pi, robot.limits.upper), endless


def _first_of_their_kind(found: FloatArray, circles: BoolArray) -> BoolArray:
    """Of solutions (k, 5, n) those whose box is not where an earlier one is alone, up to whole turns.

    Where a circle is cut open, one is found from both sides.
    """
    if len(found) < 2 or not circles.any():
        return np.ones(len(found), dtype=bool)
    q, box, lone = found[:, 0], found[:, None, 1:3], found[:, 3:]
    turns = np.where(circles, TURN * np.round(((box[:, :, 0] + box[:, :, 1]) / 2 - q) / TURN), 0.0)
    low, high = box[:, :, 0] - turns, box[:, :, 1] - turns
    same = np.all((lone[:, 0] + TURN_ROUNDING <= low) & (high <= lone[:, 1] - TURN_ROUNDING), axis=2)
    return ~np.asarray(np.tril(same, -1).any(axis=1))


def _witnesses(robot: Robot, goal: PoseGoal, circles: BoolArray, near: FloatArray) -> FloatArray:
    """Of configurations in doubt those whose tool is at a goal by forward kinematics, within the limits."""
    if not len(near):
        return near
    lower, upper, _ = _ranges(robot)
    q = np.where(circles & (near > upper), near - TURN, near)
    return np.asarray(q[_at_goal(robot, goal, q) & np.all((lower <= q) & (q <= upper), axis=1)])


def _at_goal(robot: Robot, goal: PoseGoal, Q: FloatArray) -> BoolArray:
    """At which configurations (k, n) the tool is within the tolerances of the goal, by forward kinematics."""
    shifts, turns = _off(robot, goal, Q)
    room = max(goal.position_tolerance, POSE_ERROR), max(goal.orientation_tolerance, POSE_ERROR)
    return np.asarray((shifts <= room[0]) & (turns <= room[1]))


def _require_reached(robot: Robot, goal: PoseGoal, Q: FloatArray) -> None:
    """That forward kinematics, which the search does without, agrees.

    Raises:
        BrokenInvariant: It does not.
    """
    shifts, turns = _off(robot, goal, Q)
    if np.any(shifts > goal.position_tolerance + 1e-8) or np.any(turns > goal.orientation_tolerance + 1e-6):
        raise BrokenInvariant(f"forward kinematics of {robot.name!r} differs from the closed loop for {goal}")


def _off(robot: Robot, goal: PoseGoal, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Metres and radians between the tool at configurations (m, n) and a goal's pose, or its free axis there."""
    R, p = (each[:, robot.tool_body] for each in robot.body_poses_batch(Q))
    shifts = R @ robot.tool_placement[:3, 3] + p - np.array(goal.pose.position)
    turns = goal.pose.rotation.T @ R @ robot.tool_placement[:3, :3]
    if goal.orientation_tolerance >= math.pi:
        angles = np.zeros(len(Q))
    elif goal.free_axis is None:
        chords = np.sqrt(((turns - np.eye(3)) ** 2).sum(axis=(1, 2)) / 8.0)
        angles = 2.0 * np.arcsin(np.minimum(chords, 1.0))
    else:
        axis = np.array(goal.free_axis)
        chords = np.sqrt(((turns @ axis - axis) ** 2).sum(axis=1)) / 2.0
        angles = 2.0 * np.arcsin(np.minimum(chords, 1.0))
    return np.sqrt((shifts**2).sum(axis=1)), angles
