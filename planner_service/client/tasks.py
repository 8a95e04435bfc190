"""Tasks of a planner in another process, called as the library's are."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from planner_service.client.claims import require_there
from planner_service.client.remote import Remote, unless_cancelled
from planner_service.collision import CancelToken
from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints
from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray, Vector
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance
from planner_service.grasping.kinds import GraspKinds
from planner_service.kinematics.pose_goal import unit_axis
from planner_service.kinematics.tool_line import LINE_POINTS, MAX_JOINT_RATE, require_joint_rate
from planner_service.memory import Memory
from planner_service.planning.request import Pace, PlanRequest, kept_in
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Handling, TaskResult
from planner_service.records.http.sections import LineSections
from planner_service.robot.model import joint_vector
from planner_service.scene.scene import Obstacle
from planner_service.tasks.contacts import kept_upright
from planner_service.tasks.primitives import require_poses
from planner_service.tasks.tool_motions import Target
from planner_service.timing.laws import Trapezoidal

__all__ = ["move_linear", "pick", "place", "plan_pick_place"]


@unless_cancelled
def pick(
    remote: Remote,
    q: ArrayLike,
    target: str,
    grasps: Sequence[Pose] | GraspKinds | None = None,
    handling: Handling | None = None,
    *,
    memory: Memory | None = None,
) -> TaskResult:
    """Take hold of an object; see ``planner_service.pick``.

    Raises:
        UnknownName: There is no such obstacle or support.
        InvalidRequest: As the library's.
        ServerUnavailable: As ``Remote.plan``.
    """
    start, handling = _started(remote, q, handling)
    obstacle = remote.scene.obstacle(target)
    if not isinstance(grasps, GraspKinds | None):
        require_poses("grasps", grasps)
    body = {"q": start, "target": target, "grasps": grasps, "handling": handling}
    lean = handling.upright
    upright = None if lean is None else _upright(remote, obstacle, grasps, lean)
    asked = _at(start, handling.request)
    return remote._task("pick", body, asked, handling.cancel, memory=memory, taken=target, upright=upright)


@unless_cancelled
def place(
    remote: Remote,
    q: ArrayLike,
    carried: str,
    poses: Sequence[Pose],
    handling: Handling | None = None,
    *,
    memory: Memory | None = None,
) -> TaskResult:
    """Set a carried object down; see ``planner_service.place``.

    Raises:
        UnknownName: There is no such carried object or support.
        InvalidRequest: As the library's.
        ServerUnavailable: As ``Remote.plan``.
    """
    start, handling = _started(remote, q, handling)
    require_poses("poses", poses)
    body = {"q": start, "carried": carried, "poses": poses, "handling": handling}
    return remote._task("place", body, _at(start, handling.request), handling.cancel, memory=memory)


@unless_cancelled
def plan_pick_place(
    remote: Remote,
    target: str,
    onto: str,
    request: PlanRequest,
    *,
    poses: Sequence[Pose] | None = None,
    upright: float | None = None,
    memory: Memory | None = None,
    cancel: CancelToken | None = None,
) -> TaskResult:
    """Plan a whole pick-and-place; see ``planner_service.tasks.plan_pick_place``.

    Raises:
        UnknownName: There is no such obstacle.
        InvalidRequest: As the library's.
        ServerUnavailable: As ``Remote.plan``.
    """
    instance("request", request, PlanRequest, "a PlanRequest")
    start = joint_vector("start", request.start, remote.robot)
    for name in (target, onto):
        remote.scene.obstacle(name)
    if poses is not None:
        require_poses("poses", poses)
    body = {"target": target, "onto": onto, "poses": poses, "start": start, "upright": upright, "request": request}
    obstacle = remote.scene.obstacle(target)
    kept = None if upright is None else _upright(remote, obstacle, None, upright)
    return remote._task("pick_place", body, _at(start, request), cancel, memory=memory, taken=target, upright=kept)


def _upright(
    remote: Remote, target: Obstacle, grasps: Sequence[Pose] | GraspKinds | None, lean: float
) -> Iterator[Constraint]:
    """What an object may keep, by which of the grasps it is taken; grasps that are not given are found as asked for."""
    kinds: Iterable[Sequence[Pose]]
    if isinstance(grasps, GraspKinds | None):
        kinds = (each for _, each, _ in (grasps or GraspKinds()).by_kind(remote.robot, target))
    else:
        kinds = [grasps]
    return (kept_upright(grasp, lean) for poses in kinds for grasp in poses)


@unless_cancelled
def move_linear(
    remote: Remote,
    start: ArrayLike,
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
    """A straight motion of the tool, or several with rounded corners; see ``planner_service.move_linear``.

    Raises:
        InvalidRequest: As the library's.
        ServerUnavailable: As ``Remote.plan``.
    """
    at = joint_vector("start", start, remote.robot)
    body = {
        "start": at,
        "goal": goal,
        "zone": zone,
        "points": points,
        "max_joint_rate": min(require_joint_rate(max_joint_rate), sys.float_info.max),  # JSON has no infinity
        "free_axis": None if free_axis is None else unit_axis(free_axis),
        "partial": partial,
        "pace": pace,
        "padding": padding,
        "constraints": checked_constraints(constraints),
    }
    answer = remote._work("move_linear", body, cancel)
    pace = Pace(Trapezoidal()) if pace is None else pace
    plan = remote._saved_plan(answer, answer.document(), pace=pace)
    require_there(answer, PlanRequest(at, at), plan.result, remote.robot, task=True)
    if plan.result.ok and plan.result.constraints != kept_in(remote.scene, constraints):
        raise InvalidFile(answer.url, ["constraints: others than were asked for"])
    return replace(plan.result, fraction=LineSections.of_plan(plan, answer.url).fraction)


def _started(remote: Remote, q: ArrayLike, handling: Handling | None) -> tuple[FloatArray, Handling]:
    handling = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    return joint_vector("q", q, remote.robot), handling


def _at(start: FloatArray, request: PlanRequest | None) -> PlanRequest:
    """The request of all motions of a task that begins somewhere, as the library writes it."""
    return PlanRequest(start, start) if request is None else replace(request, start=start, goal=start)
