"""Motions of the tool along a given path: straight lines, lines with rounded corners, and circular arcs.

The whole path has to be possible. If it is not, the longest part from the start that is: where inverse kinematics ends,
or at the last point before a collision. That part is planned like every other plan, so its share of the path is proven.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial as bound
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import prove_kept
from planner_service.collision import CancelToken, CollisionChecker, Known
from planner_service.constraints import Constraint
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, Vector
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import MAX_LENGTH, flag, instance, number
from planner_service.kinematics.cartesian_waypoints import line_blends, stop_rows, thinned, thinned_along
from planner_service.kinematics.constraint_set import constraint_set
from planner_service.kinematics.line_branches import line_branches
from planner_service.kinematics.pose_goal import unit_axis
from planner_service.kinematics.tool_line import (
    LINE_POINTS,
    MAX_JOINT_RATE,
    ToolLine,
    require_joint_rate,
    shifted,
    straight_tool_line,
)
from planner_service.kinematics.tool_path import ToolPath, circular_arc, rounded_lines, walk_tool_path
from planner_service.kinematics.turning_tool import least_turned, with_turns
from planner_service.path.joint_path import JointPath
from planner_service.planning.accounting import NoPlan, PlanAccounting
from planner_service.planning.request import Pace, clamp_note, clamped
from planner_service.planning.result import Failure, PlanResult, Reason, Stage
from planner_service.robot.model import joint_vector
from planner_service.service import PlannerService

__all__ = ["move_circular", "move_linear"]

LEAST_BLEND = 1e-4
"""Radians. The corners of a tool's path turn by little, so that even narrow blends save a stop."""

FINER = (8, 4, 2, 1)
"""Of so many configurations one is kept, in turn, where the tool's path is within its tolerance but a constraint is not
within its own."""

NOT_EVEN_BEGUN = (Reason.START_IN_COLLISION, Reason.START_VIOLATES_CONSTRAINT)

MAX_ZONE = 1.0
"""Metres. More is a mistake in the unit."""

Target = Pose | Sequence[float]


def move_linear(
    service: PlannerService,
    start: ArrayLike | Pose,
    goal: Target | Sequence[Target],
    *,
    zone: float = 0.0,
    points: int = LINE_POINTS,
    max_joint_rate: float = MAX_JOINT_RATE,
    free_axis: Vector | None = None,
    partial: bool = False,
    pace: Pace | None = None,
    padding: float = 0.0,
    constraints: Sequence[Constraint] = (),
    cancel: CancelToken | None = None,
) -> PlanResult:
    """A straight motion of the tool, or several with rounded corners, checked once, proven and timed.

    The position moves linearly from pose to pose, the orientation by the shortest rotation. The tool stays within 1 mm
    and 5 mrad of its path. ``result.fraction`` is the share of the path's length that is possible; if it is below 1,
    the failure (or, with ``partial``, a note) says where the path ends and why: a joint at its limit, a singular arm,
    a joint that would have to jump or move too far, a pair that collides, or a constraint that is not kept.

    Args:
        start: Joint vector, shape (n,), clamped as the waypoints of ``PlannerService.follow``. Or the tool's pose: then
            the motion begins in a configuration from which all of it is possible, if there is one (see
            ``planner_service.kinematics.line_branches``), and a note says which; of several the one from which the
            joints move least is tried first. Joints that do not move the tool are where they are at home. The failure
            is ``proven`` if it is that no motion within the limits follows the line.
        goal: The tool's pose at the end in the base frame, or its displacement (x, y, z) in metres along the base's
            axes (the orientation is kept). Or a list of these, to pass one after the other; a displacement counts from
            the pose before it.
        zone: Metres before and after a pose on the way within which the corner there is rounded, at most half of each
            line beside it; the tool passes inside the corner, and position and orientation both change smoothly. With
            0 the tool stops at each pose. It stops in any case where it turns on the spot or goes straight back.
        points: Configurations computed along a single line, 50 to 100; along several lines one every 5 mm.
        max_joint_rate: Radians that any joint may move per metre of the tool between two of these configurations
            (metres per metre for a prismatic joint). Where the tool turns by more than 10 rad/m, each radian of that
            counts as 0.1 m.
        free_axis: An axis (x, y, z) in the tool frame about which the tool may turn as it likes, at the start, too, if
            that is a pose: of a pen, a torch or a disc. The orientations of poses then count up to such turns, and the
            tool's axis stays within 5 mrad of its path. None for none.
        partial: Return the part from the start that is possible, instead of a failure.
        pace: The law s(t) along the path; ``Pace(Trapezoidal())`` if not given.
        padding: Metres that pairs are to keep, as in ``PlannerService.follow``.
        constraints: What must hold all along, beside the constraints of what the robot carries. They do not change the
            line: one that breaks them is possible up to there.
        cancel: As in ``PlannerService.plan``.

    Raises:
        InvalidRequest: As ``PlannerService.follow`` and ``straight_tool_line``, or ``goal`` is an empty list, or
            ``zone`` is not in [0, 1].
    """
    axis = None if free_axis is None else unit_axis(free_axis)
    settings: dict[str, Any] = {"pace": pace, "padding": padding, "constraints": constraints, "cancel": cancel}
    number("zone", zone, f"metres in [0, {MAX_ZONE:g}]", 0.0, MAX_ZONE)
    if isinstance(start, Pose):
        limits: dict[str, Any] = {"points": points, "max_joint_rate": max_joint_rate, "free_axis": axis}
        from_there = bound(move_linear, goal=goal, zone=zone, partial=partial, **limits, **settings)
        return _from_any(service, start, _targets(goal), limits, cancel, from_there, partial=flag("partial", partial))
    q, follow = _begun(service, start, settings, partial=partial)
    robot, targets = service.robot, _targets(goal)
    if len(targets) == 1:
        line = straight_tool_line(robot, q, targets[0], points=points, max_joint_rate=max_joint_rate, free_axis=axis)

        def kept(count: int, stride: int | None) -> tuple[FloatArray, FloatArray]:
            arm, rows = with_turns(robot, line.waypoints[:count], line.turns, axis)
            waypoints = thinned(arm, rows) if stride is None else rows[_every(stride, count)]
            waypoints = waypoints[:, : robot.n]
            return waypoints, line_blends(robot, waypoints)

        return follow(line, kept, "the straight tool line")
    poses = [Pose.from_matrix(robot.tool_pose(q))]
    for k, target in enumerate(targets):
        poses.append(least_turned(poses[-1], _pose(f"goal[{k}]", target, poses[-1]), axis))
    return _along(service, q, rounded_lines(poses, zone), max_joint_rate, follow, axis)


def move_circular(
    service: PlannerService,
    start: ArrayLike,
    via: Target,
    goal: Target,
    *,
    max_joint_rate: float = MAX_JOINT_RATE,
    free_axis: Vector | None = None,
    partial: bool = False,
    pace: Pace | None = None,
    padding: float = 0.0,
    constraints: Sequence[Constraint] = (),
    cancel: CancelToken | None = None,
) -> PlanResult:
    """A motion of the tool along the circular arc from where it is through ``via`` to ``goal``, proven and timed.

    The origin of the tool frame follows the arc, and the orientation turns from that at the start to that of ``goal``
    by the shortest rotation, evenly along the arc. The tool stays within 1 mm and 5 mrad of this. A path that is not
    possible as a whole is reported as by ``move_linear``. Two arcs make a full circle.

    Args:
        start: Joint vector, shape (n,), clamped as the waypoints of ``PlannerService.follow``.
        via: A point on the arc: a pose in the base frame, whose orientation is ignored, or a displacement (x, y, z) in
            metres from the start along the base's axes.
        goal: The tool's pose at the end, or its displacement from the start (the orientation is kept).
        max_joint_rate: As in ``move_linear``, between configurations every 5 mm or less.
        free_axis: As in ``move_linear``; so are ``partial``, ``pace``, ``padding``, ``constraints`` and ``cancel``.

    Raises:
        InvalidRequest: As ``PlannerService.follow``, or ``start`` is outside the limits, or ``via`` is less than 0.1 mm
            off the line through start and goal, or these coincide.
    """
    axis = None if free_axis is None else unit_axis(free_axis)
    settings = {"pace": pace, "padding": padding, "constraints": constraints, "cancel": cancel}
    q, follow = _begun(service, start, settings, partial=partial)
    begin = Pose.from_matrix(service.robot.tool_pose(q))
    end = least_turned(begin, _pose("goal", goal, begin), axis)
    path = circular_arc(begin, _pose("via", via, begin).position, end)
    return _along(service, q, path, max_joint_rate, follow, axis)


def _from_any(
    service: PlannerService,
    start: Pose,
    targets: Sequence[Any],
    limits: Mapping[str, Any],
    cancel: CancelToken | None,
    from_there: Callable[..., PlanResult],
    *,
    partial: bool,
) -> PlanResult:
    """The motion from a configuration for the pose ``start`` from which all of it is possible, or the best there is.

    Args:
        limits: Settings of ``straight_tool_line``.
        from_there: Plans from a configuration.
    """
    instance("service", service, PlannerService, "a PlannerService")
    robot, home = service.robot, service.robot.home
    accounting = PlanAccounting(service.checker, cancel=cancel)
    found = line_branches(robot, start, _pose("goal", targets[0], start), still=home, **limits)
    if not found.lines:
        detail = "no configuration has the tool at the start" if found.complete else str(found)
        failure = Failure(Stage.ENDPOINTS, Reason.NO_IK_SOLUTION, detail, proven=found.complete)
        return replace(accounting.result(failure=failure), fraction=0.0)
    whole = [line for line in found.lines if line.stopped is None]
    tried = list[PlanResult]()
    for line in found.lines if partial else whole or found.lines[:1]:
        result = accounting.with_plan(from_there(service, line.waypoints[0]))
        tried.append(result)
        done = result.ok and result.fraction == 1.0
        if done or (result.failure is not None and result.failure.reason is Reason.PREEMPTED):
            break
    best = max(tried, key=lambda result: result.fraction or 0.0)
    note = f"{'all' if found.complete else 'some'} branches followed: {found}"
    if best.ok:
        return replace(best, notes=(*best.notes, note))
    assert best.failure is not None
    if best.failure.reason is Reason.PREEMPTED:
        return best
    proven = found.proven and len(targets) == 1  # a rounded corner leaves the line
    failure = replace(best.failure, detail=f"{best.failure.detail}; {note}", proven=proven)
    return replace(best, failure=failure)


def _begun(
    service: PlannerService, start: ArrayLike, settings: Mapping[str, Any], *, partial: bool
) -> tuple[FloatArray, Follow]:
    """Where a motion begins, (n,), and what plans along its line.

    Args:
        settings: Arguments of ``PlannerService.follow``.
    """
    instance("service", service, PlannerService, "a PlannerService")
    given = joint_vector("start", start, service.robot)
    q = clamped(given, service.robot)
    note = clamp_note("start", given, q, service.robot)
    return q, bound(_follow, service, settings, note, partial=flag("partial", partial))


def _targets(goal: Any) -> list[Any]:
    """The poses or displacements that were given."""
    nested = (Pose, list, tuple, np.ndarray)
    if isinstance(goal, np.ndarray) and goal.ndim != 2:
        return [goal]
    if isinstance(goal, list | tuple | np.ndarray) and any(isinstance(target, nested) for target in goal):
        return list(goal)
    if isinstance(goal, list | tuple) and not goal:
        raise InvalidRequest("goal", goal, "at least one Pose, or displacement of 3 finite numbers in metres")
    return [goal]


def _pose(name: str, target: Any, before: Pose) -> Pose:
    pose = target if isinstance(target, Pose) else shifted(before, target, name)
    if not all(abs(x) <= MAX_LENGTH for x in pose.position):
        raise InvalidRequest(name, target, f"a position within {MAX_LENGTH:g} m of the base")
    return pose


class Waypoints(Protocol):
    """Makes the waypoints and blends to follow of the first so many configurations of a line."""

    def __call__(self, count: int, stride: int | None) -> tuple[FloatArray, FloatArray]:
        """As few as hold the tool on the line; with a stride one in so many, and the last."""


Follow = Callable[[ToolLine, Waypoints, str], PlanResult]
"""The plan along a line, with its name for a message."""


def _along(
    service: PlannerService,
    q: FloatArray,
    path: ToolPath,
    max_joint_rate: float,
    follow: Follow,
    free_axis: Vector | None = None,
) -> PlanResult:
    rate = require_joint_rate(max_joint_rate)
    line = walk_tool_path(service.robot, q, path, max_joint_rate=rate, free_axis=free_axis)
    at = line.fractions * path.length

    def kept(count: int, stride: int | None) -> tuple[FloatArray, FloatArray]:
        if stride is None:
            return thinned_along(service.robot, line.waypoints[:count], at[:count], path, line.turns, free_axis)
        stops = stop_rows(at[:count], path)
        rows = sorted({*_every(stride, count), *stops})
        widths = line_blends(service.robot, line.waypoints[rows])
        widths[np.isin(rows, stops)] = 0.0
        return line.waypoints[rows], widths

    return follow(line, kept, path.name)


def _every(stride: int, count: int) -> list[int]:
    """One in ``stride`` of so many rows, and the last."""
    return sorted({*range(0, count, stride), count - 1})


def _follow(
    service: PlannerService,
    settings: Mapping[str, Any],
    note: str,
    line: ToolLine,
    kept: Waypoints,
    name: str,
    *,
    partial: bool,
) -> PlanResult:
    """The plan along a line, or along the longest part of it that has one.

    Args:
        settings: Arguments of ``PlannerService.follow``.
        note: What a person should know of the start.
    """
    accounting = PlanAccounting(service.checker, cancel=settings["cancel"])
    accounting.notes += [note] if note else []

    def followed(count: int) -> PlanResult:
        """Through more configurations, if through few the line leaves a constraint."""

        def through(waypoints: FloatArray, blends: FloatArray) -> PlanResult:
            result = service.follow(waypoints, blends=blends, min_blend=LEAST_BLEND, **settings)
            return accounting.with_plan(result)

        result = through(*kept(count, None))
        if result.failure is None or result.failure.reason is not Reason.CONSTRAINT_NOT_CERTIFIED:
            return result
        for stride in FINER:
            waypoints, blends = kept(count, stride)
            if isinstance(prove_kept(service.robot, JointPath(waypoints), result.constraints), tuple):
                return through(waypoints, blends)
        return result

    whole = followed(len(line.waypoints))
    failure = whole.failure
    if failure is None:
        if line.stopped is None:
            return replace(whole, fraction=1.0)
        failure = Failure(Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED, str(line.stopped))
        return _cut(whole, failure, line.fraction, partial=partial)
    if failure.reason not in (Reason.LINE_BLOCKED, Reason.NOT_CERTIFIED, Reason.CONSTRAINT_NOT_CERTIFIED):
        return replace(whole, fraction=0.0 if failure.reason in NOT_EVEN_BEGUN else None)
    try:
        count, why = _good_count(service.checker, line.waypoints, whole.constraints, accounting)
    except NoPlan as cancelled:
        return accounting.result(failure=cancelled.failure)
    part, step = whole, 1
    while count > 1 and not (part := followed(count)).ok:
        count, step = count - step, 2 * step
    fraction = float(line.fractions[count - 1]) if part.ok else 0.0
    detail = f"{name} ends after {100 * fraction:.1f} %: {why or failure.detail}"
    return _cut(part, replace(failure, detail=detail), fraction, partial=partial)


def _good_count(
    checker: CollisionChecker, waypoints: FloatArray, constraints: tuple[Constraint, ...], accounting: PlanAccounting
) -> tuple[int, str]:
    """How many configurations lie before the first collision or broken constraint, and what that is; all and "" if
    there is none."""
    kept = constraint_set(checker.robot, constraints) if constraints else None

    def checked() -> tuple[int, str]:
        with accounting.during(Stage.STRAIGHT_LINE):
            for k in range(1, len(waypoints)):
                violated = None if kept is None else kept.violation(waypoints[k])
                if violated is not None:
                    return k, f"it does not keep {violated}"
                hit = checker.edge_hit(waypoints[k - 1], waypoints[k], known=Known.START)
                if hit is not None:
                    return k, f"{hit.a} x {hit.b} collide"
        return len(waypoints) - 1, ""

    return accounting.within_limits(checked)


def _cut(part: PlanResult, failure: Failure, fraction: float, *, partial: bool) -> PlanResult:
    """The plan of a part of the path if the caller wants it, else the failure of the whole."""
    if not part.ok or fraction == 0.0 or not partial:
        return replace(part, path=None, trajectory=None, motion=None, failure=failure, fraction=fraction)
    return replace(part, fraction=fraction, notes=(*part.notes, f"only a part: {failure.detail}"))
