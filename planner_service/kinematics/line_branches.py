"""A straight tool line from every configuration at its start, and proofs that no motion follows it.

An arm has several configurations for one pose, and a line that one of them cannot follow to its end may be possible
from another. Here each is followed. The first configurations are complete for arms of at most six joints
(docs/design/certified-ik.md); of arms with more, what random starts find.

A proof cuts the line into pieces, and covers all configurations that have the tool near a piece with boxes of joint
values. A motion along the line passes through boxes that touch one another, from the first piece to the last. Without
such a chain there is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, Vector, as_sent
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import finite_numbers, instance, items, number, whole
from planner_service.kinematics.complete_inverse import AXIS, POSE, ROUNDING, TURN, closed_loop, most_joints, searched
from planner_service.kinematics.inverse import ToolChain, configurations_at, solutions_known
from planner_service.kinematics.pose_goal import PoseGoal, turned_about, unit_axis
from planner_service.kinematics.tool_line import (
    LINE_METRES,
    LINE_POINTS,
    LINE_RADIANS,
    ToolLine,
    interpolate,
    require_joint_rate,
    rotation_distance,
    shifted,
    straight_tool_line,
)
from planner_service.kinematics.turning_tool import PLAY, least_turned, with_turns
from planner_service.robot.model import Robot

__all__ = ["LineBranches", "first_configurations", "line_branches", "line_ends"]

MOST_BRANCHES = 256

ANGLES = 16
"""About its free axis at which the tool may begin. With 48 no more of 400 random lines were possible (WidowX AI, UR5,
Jaco 2), with 4 three fewer."""

HALVINGS = 6
"""Of a line, for a proof: down to 64 pieces."""

WIDTH, LEAST_WIDTH = 16.0, 0.01
"""Radians, for each metre of half a piece and an arm of 1 m, below which a box is not split; and at least."""

MOST, MOST_SEEN = 32, 600
"""Boxes of a piece from which on none is split; boxes looked at, likewise."""

MOST_JOINTS = 7

TOUCH = 1e-9
"""Radians, or metres for joints that slide, by which boxes that touch may be apart: above rounding."""


@dataclass(frozen=True, eq=False)
class LineBranches:
    """A straight tool line from each configuration at its start.

    Attributes:
        lines: One for each, those of the whole line first, and of these the ones that move the joints least; the rest
            by the share of the line that they have.
        complete: Whether there is proven to be no other configuration at the start.
        ends: A share of the line, below 1, beyond which it is proven that no motion within the joint limits follows it:
            none keeps the tool (or its free axis) within 1 mm and 5 mrad of a place that goes along the line. None if
            that is not known.

    Raises:
        InvalidRequest: Something else, or a share that is not in [0, 1].
    """

    lines: tuple[ToolLine, ...]
    complete: bool
    ends: float | None = None
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        object.__setattr__(self, "lines", items("lines", self.lines, ToolLine, "ToolLines", MOST_BRANCHES))
        instance("complete", self.complete, bool, "True or False")
        if self.ends is not None:
            object.__setattr__(self, "ends", number("ends", self.ends, "a share in [0, 1]", 0.0, 1.0))

    @property
    def whole(self) -> ToolLine | None:
        """The first line that has all of it; None if none has."""
        return next((line for line in self.lines if line.stopped is None), None)

    @property
    def proven(self) -> bool:
        """Whether it is proven that no motion follows the line."""
        return self.ends is not None

    def __str__(self) -> str:
        count = len(self.lines)
        if self.whole is not None:
            return f"{sum(line.stopped is None for line in self.lines)} of {count} branches have the whole line"
        if self.ends is not None:
            return f"no motion follows the line beyond {100 * self.ends:.1f} %, proven"
        if not self.lines:
            return "no configuration was found at the start of the line"
        far = max(line.fraction for line in self.lines)
        known = "all" if self.complete else "some"
        return f"none of {known} {count} branches was followed beyond {100 * far:.1f} % of the line"


def line_branches(
    robot: Robot,
    begin: Pose,
    to: Pose | ArrayLike,
    *,
    still: ArrayLike | None = None,
    points: int = LINE_POINTS,
    max_joint_rate: float = math.inf,
    free_axis: Vector | None = None,
) -> LineBranches:
    """The straight line of the tool from one pose to another, from every configuration that has the tool at the first.

    Each is followed by ``straight_tool_line``, without jumps. Collisions are not checked. Where none has the whole
    line, a proof is looked for that no motion follows it, for arms of at most seven joints. Without one, a line that
    ends in every branch is only not found: where it ends is worked out in floating point.

    Args:
        begin: Where the tool is first, in the base frame.
        to: A pose, or a shift (3,) in metres along the base's axes that keeps the orientation.
        still: A configuration (n,) whose values the joints keep that do not move the tool; None for home.
        points: As in ``straight_tool_line``; so is ``max_joint_rate``, of which a proof knows nothing.
        free_axis: As in ``straight_tool_line``. At the start, too, the tool may be turned about it in any way: an arm
            of at most five joints has finitely many configurations there, of others every one at 16 angles is followed.
            A proof is about all angles.

    Raises:
        InvalidRequest: As ``straight_tool_line``, or no joint moves the tool.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("begin", begin, Pose, "a Pose")
    whole("points", points, 2, 10_000)
    require_joint_rate(max_joint_rate)
    rest = robot.home if still is None else finite_numbers("still", still, robot.n)
    axis = None if free_axis is None else unit_axis(free_axis)
    end = least_turned(begin, to if isinstance(to, Pose) else shifted(begin, to), axis)
    Q, complete = first_configurations(robot, begin, rest, axis)
    limits: dict[str, Any] = {"points": points, "max_joint_rate": max_joint_rate, "free_axis": axis}
    lines = [straight_tool_line(robot, q, end, **limits) for q in Q]
    lines.sort(key=lambda line: (line.stopped is not None, -line.fraction, _way(line)))
    if lines and lines[0].stopped is None:
        return LineBranches(tuple(lines), complete)
    return LineBranches(tuple(lines), complete, line_ends(robot, begin, end, rest, axis))


def first_configurations(
    robot: Robot, pose: Pose, still: FloatArray, free_axis: Vector | None = None
) -> tuple[FloatArray, bool]:
    """Configurations (k, n) for a pose, the tool maybe turned about an axis, and whether there is proven to be no
    other."""
    goal, joints = PoseGoal(pose, free_axis=free_axis), ToolChain.of(robot, still).robot.n
    if free_axis is not None and joints > most_joints(goal):
        turned = (pose @ turned_about(free_axis, math.tau * k / ANGLES) for k in range(ANGLES))
        if joints > most_joints(PoseGoal(pose)):
            Q = np.concatenate([configurations_at(robot, each, still=still) for each in turned])
        else:
            Q = np.concatenate([first_configurations(robot, each, still)[0] for each in turned])
        if len(Q):
            return Q[np.unique(np.linspace(0, len(Q) - 1, MOST_BRANCHES).astype(np.intp))], False
    known = solutions_known(robot, goal, still=still)
    if known is not None and (len(known) or (known.complete and free_axis is None)):
        return known.q[:MOST_BRANCHES], known.complete and len(known) <= MOST_BRANCHES
    if free_axis is None:
        return configurations_at(robot, pose, still=still)[:MOST_BRANCHES], False
    arm, rest = with_turns(robot, still[None], np.zeros(1), free_axis)
    found = configurations_at(arm, pose, still=rest[0])[:MOST_BRANCHES, : robot.n]
    if len(found):
        return found, False
    leaning = solutions_known(robot, replace(goal, orientation_tolerance=1.5 * PLAY), still=still)
    return found, leaning is not None and leaning.reachable is False


def line_ends(robot: Robot, begin: Pose, end: Pose, still: FloatArray, free_axis: Vector | None = None) -> float | None:
    """A share of the line beyond which it is proven that no motion follows it; None without a proof.

    The line is halved until the boxes of its pieces show it.

    Args:
        free_axis: As in ``straight_tool_line``: then ``end`` is as ``least_turned`` makes it.
    """
    arm = ToolChain.of(robot, still).robot
    if arm.n > MOST_JOINTS:
        return None
    cover = _Cover(arm, begin, end, free_axis)
    for level in range(HALVINGS + 1):
        pieces = 1 << level
        boxes = cover.halved() if level else cover.first()
        last = _farthest(boxes, cover.rounds)
        if last < pieces - 1:
            return (last + 1) / pieces
    return None


class _Cover:
    """Boxes of joint values around all configurations with the tool near each piece of a line."""

    def __init__(self, arm: Robot, begin: Pose, end: Pose, free_axis: Vector | None) -> None:
        self._loop, self.rounds, self._length = closed_loop(arm)
        self._domain = searched(arm, self.rounds)
        self._begin, self._end, self._axis = begin, end, free_axis
        self._turn = rotation_distance(begin, end)
        self._boxes: list[FloatArray] = []

    def first(self) -> list[FloatArray]:
        """Those of the whole line, (b, 2, n)."""
        self._boxes = [self._around(0.0, 1.0, self._domain[None])]
        return self._boxes

    def halved(self) -> list[FloatArray]:
        """Those of twice as many pieces."""
        size, out = 1.0 / (2 * len(self._boxes)), []
        for k, boxes in enumerate(self._boxes):
            out += [self._around((2 * k + half) * size, (2 * k + half + 1) * size, boxes) for half in (0, 1)]
        self._boxes = out
        return out

    def _around(self, low: float, high: float, boxes: FloatArray) -> FloatArray:
        if not len(boxes):
            return boxes
        ends = np.array([interpolate(self._begin, self._end, u).position for u in (low, high)])
        middle = interpolate(self._begin, self._end, (low + high) / 2.0)
        slack = ROUNDING * (1.0 + self._length)
        half = np.abs(ends[1] - ends[0]) / 2.0 * (1.0 + 1e-9) + LINE_METRES
        turn = self._turn * (high - low) / 2.0 * (1.0 + 1e-9) + LINE_RADIANS
        if turn >= math.pi:  # the equations of a pose bound nothing
            return boxes
        width = max(LEAST_WIDTH, WIDTH * math.sqrt(float((half**2).sum())) / self._length)
        _, _, left, _, _ = self._loop.cover(
            np.array([ends.mean(axis=0)]),
            half,
            np.column_stack([middle.rotation, np.zeros(3)]).ravel(),
            self._axis or (0.0, 0.0, 0.0),
            POSE if self._axis is None else AXIS,
            (slack, turn + slack),
            np.array([0, len(boxes)], dtype=np.int64),
            np.ascontiguousarray(boxes),
            None,
            width,
            (MOST, MOST_SEEN),
            0,
            1,
        )
        return left


def _farthest(pieces: list[FloatArray], rounds: BoolArray) -> int:
    """The last piece that a chain of touching boxes from the first piece comes to; -1 if the first has none."""
    Q = np.concatenate(pieces)
    piece: IntArray = np.repeat(np.arange(len(pieces)), [len(boxes) for boxes in pieces])
    seen = piece == 0
    if not seen.any():
        return -1
    fresh = np.flatnonzero(seen)
    while len(fresh):
        near = np.zeros(len(Q), dtype=np.bool_)
        for k in fresh.tolist():
            rows = np.flatnonzero(~seen & ~near & (np.abs(piece - piece[k]) <= 1))
            near[rows[_touching(Q[k], Q[rows], rounds)]] = True
        seen |= near
        fresh = np.flatnonzero(near)
    return int(piece[seen].max())


def _touching(box: FloatArray, others: FloatArray, rounds: BoolArray) -> BoolArray:
    """Which of boxes (k, 2, n) touch another (2, n), joints that go round up to whole turns."""
    middles, halves = others.mean(axis=1) - box.mean(axis=0), (np.ptp(others, axis=1) + np.ptp(box, axis=0)) / 2.0
    middles = np.where(rounds, middles - TURN * np.round(middles / TURN), middles)
    return np.asarray(np.all(np.abs(middles) <= halves + TOUCH, axis=1))


def _way(line: ToolLine) -> float:
    """How far the joints move along a line."""
    return float(np.abs(np.diff(line.waypoints, axis=0)).sum())
