"""Pick and place: straight lines first, each checked once, and the planner where one is blocked.

A pick is: open, go to the pregrasp, straight in along the approach, close, straight out. Contact is meant there and
nowhere else: from the pregrasp on the fingers may touch the object; once the object is carried, it may touch its
support while it is within ``support_gap`` of where it stood. The gripper's own opening and closing is proven as the
arm's motions are.
"""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, text
from planner_service.grasping.grasps import top_grasps, width_across
from planner_service.grasping.kinds import GraspKinds
from planner_service.grasping.openings import openings
from planner_service.memory import Memory
from planner_service.planning.task_result import Handling, TaskResult
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle
from planner_service.service import PlannerService
from planner_service.tasks.contacts import gripper_of
from planner_service.tasks.solver import solved
from planner_service.tasks.steps import Approach, Connect, Grasp, GraspSource, Release, Retreat, Step
from planner_service.tasks.task import Task

__all__ = ["pick", "pick_steps", "place", "place_steps", "require_grasps", "require_poses"]


def pick(
    service: PlannerService,
    q: ArrayLike,
    target: str,
    grasps: Sequence[Pose] | GraspSource | None = None,
    handling: Handling | None = None,
    *,
    memory: Memory | None = None,
) -> TaskResult:
    """Take hold of an object: to the pregrasp, straight in, close, straight out.

    The first grasp is used all of whose motions have a plan, over all inverse kinematics solutions, with 8 to 10 cm of
    approach; with less only if no grasp has a plan with so much.

    Args:
        q: Where the robot stands, shape (n,).
        target: The obstacle to take.
        grasps: Tool poses, best first, or what finds them such as ``GraspKinds``. None: those of ``top_grasps``, and
            where none of them has a plan, those of the other kinds.
        memory: What is remembered of this cell, as for ``PlannerService.plan``; ``result.memory`` is what is then.

    Raises:
        UnknownName: There is no such obstacle or support.
        InvalidRequest: An empty list is given, the robot has no gripper, or the object is too wide for it at a grasp
            that is given, or for all grasps.
    """
    instance("service", service, PlannerService, "a PlannerService")
    handling = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    obstacle, gripper = service.scene.obstacle(target), gripper_of(service.robot)
    if grasps is None:
        require_grasps(service.robot, obstacle)
    elif not isinstance(grasps, GraspSource):
        require_poses("grasps", grasps)
        for grasp in grasps:
            openings(gripper, width_across(obstacle, grasp, service.robot), handling.open_width)
    if handling.support is not None:
        service.scene.obstacle(handling.support)
    return _handled(service, q, pick_steps(target, grasps, handling), handling, f"pick {target}", memory)


def place(
    service: PlannerService,
    q: ArrayLike,
    carried: str,
    poses: Sequence[Pose],
    handling: Handling | None = None,
    *,
    memory: Memory | None = None,
) -> TaskResult:
    """Set a carried object down: to above its place, straight in, open, straight out.

    Args:
        q: Where the robot stands, shape (n,).
        carried: The attached object.
        poses: Where the object may be set down, in the base frame, best first.
        memory: As for ``pick``.

    Raises:
        UnknownName: There is no such carried object or support.
        InvalidRequest: No pose is given, the robot has no gripper, or ``handling.upright``, for picks, is given.
    """
    instance("service", service, PlannerService, "a PlannerService")
    handling = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    names = [held.name for held in service.scene.attached]
    if text("carried", carried) not in names:
        raise UnknownName("carried object", carried, names)
    require_poses("poses", poses)
    openings(gripper_of(service.robot), service.robot.gripper_width, handling.open_width)
    if handling.support is not None:
        service.scene.obstacle(handling.support)
    return _handled(service, q, place_steps(carried, poses, handling), handling, f"place {carried}", memory)


def _handled(
    service: PlannerService,
    q: ArrayLike,
    steps: tuple[Step, ...],
    handling: Handling,
    name: str,
    memory: Memory | None,
) -> TaskResult:
    task = Task(steps, name)
    return solved(service, task, q, handling.request, handling.line_timing, memory, handling.cancel, named=False)


def pick_steps(
    object: str,
    grasps: Sequence[Pose] | GraspSource | None = None,
    handling: Handling | None = None,
) -> tuple[Step, ...]:
    """The steps of ``pick``: connect, approach, grasp and retreat.

    Args:
        object: The obstacle to take.
        grasps: As of ``Grasp``.
        handling: Its support, support gap, opening and lean.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range.
    """
    how = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    given = tuple(grasps) if isinstance(grasps, list) else grasps
    act = Grasp(object, given, "", how.open_width, how.support, how.support_gap, how.upright)
    return Connect("to pregrasp"), Approach("descend"), act, Retreat("lift")


def place_steps(
    object: str,
    poses: Sequence[Pose],
    handling: Handling | None = None,
) -> tuple[Step, ...]:
    """The steps of ``place``: connect, approach, release and retreat.

    Args:
        object: What is carried.
        poses: Where it may be set down, in the base frame, best first.
        handling: Its support, support gap and opening.

    Raises:
        InvalidRequest: A value is of the wrong kind or out of its range, or there is ``handling.upright``.
    """
    how = Handling() if handling is None else instance("handling", handling, Handling, "a Handling, or None")
    if how.upright is not None:
        raise InvalidRequest("upright", how.upright, "None for a place: it keeps the carried object's constraints")
    require_poses("poses", poses)
    act = Release(object, tuple(poses), "", how.open_width, how.support, how.support_gap)
    return Connect("transfer"), Approach("lower"), act, Retreat("retreat")


def require_poses(name: str, poses: object) -> None:
    """Refuse what is no list of poses, or an empty one."""
    if not isinstance(poses, list | tuple) or not poses or not all(isinstance(pose, Pose) for pose in poses):
        raise InvalidRequest(name, poses, "a list of at least one Pose")


def require_grasps(robot: Robot, target: Obstacle) -> None:
    """Refuse what a gripper cannot take in any way.

    Raises:
        InvalidRequest: It says why.
    """
    try:
        top_grasps(robot, target, tilts=(0.0,))
    except InvalidRequest:
        if not any(poses for _, poses, _ in GraspKinds().by_kind(robot, target)):
            raise
