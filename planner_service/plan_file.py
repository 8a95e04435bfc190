"""Plans and tasks in JSON files: written whole, read back bit for bit.

A plan is ``q(t) = path(s(t))``: ``waypoints`` is the polyline, ``blends`` what of it before and after
each waypoint is rounded (``planner_service.blend`` has the formula), and row i of ``coefficients`` holds
c0 to c3 of ``s = c0 + c1 x + c2 x^2 + c3 x^3``, x the time since that piece began, for
``durations[i]`` seconds; s is the L2 length along the polyline. Floats are written with the fewest
digits that read back as the same bits. There is no NaN and no infinity in a file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from planner_service.collision import CheckCounts
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.geometry import Pose
from planner_service.json_file import Node, read_json
from planner_service.optimize import METHODS, Optimise
from planner_service.outcome import Failure, PlanResult
from planner_service.planners import PLANNERS
from planner_service.pose_goal import PoseGoal
from planner_service.regular_file import as_path
from planner_service.request import PlanRequest
from planner_service.result_record import (
    counts_record,
    failure_record,
    gripper_record,
    read_counts,
    read_failure,
    read_gripper,
    read_result,
    read_texts,
    result_record,
)
from planner_service.roadmap import Roadmap, RoadmapReference
from planner_service.scene_file import write_whole
from planner_service.service import PlannerService
from planner_service.task import Segment
from planner_service.timing import SCurve, ToppRa, Trapezoidal

if TYPE_CHECKING:
    from planner_service.view import Viewer

__all__ = [
    "PLAN_FORMAT",
    "TASK_FORMAT",
    "TIMINGS",
    "MadeFor",
    "SavedPlan",
    "SavedTask",
    "load_plan",
    "load_plan_or_task",
    "load_task",
    "save_plan",
]

PLAN_FORMAT = "planner-service/plan"
TASK_FORMAT = "planner-service/task"
VERSION = 2

TIMINGS: Mapping[str, type[Any]] = MappingProxyType({law.name: law for law in (ToppRa, Trapezoidal, SCurve)})
"""Every timing law that can be made from its name alone, by that name."""

_PLANNERS: Mapping[str, type[Any]] = MappingProxyType({**PLANNERS, RoadmapReference.name: RoadmapReference})
"""Those that a name and settings make; of a roadmap the hash is kept."""

_WHOLE = ("seed", "max_checks", "retries")
_REAL = ("padding", "velocity_scale", "acceleration_scale", "blend", "start_tolerance")
_MAYBE = ("time_limit", "max_tool_speed")
"""Numbers or None."""


@dataclass(frozen=True)
class MadeFor:
    """The robot and the scene a plan was made for; a plan for another hash is not valid."""

    robot: str
    robot_hash: str
    joint_names: tuple[str, ...]
    scene: str
    scene_hash: str

    @classmethod
    def of(cls, service: PlannerService) -> MadeFor:
        """What a service plans for."""
        robot, scene = service.robot, service.scene
        return cls(robot.name, robot.hash, robot.joint_names, scene.name, scene.hash)


@dataclass(frozen=True, eq=False)
class SavedPlan:
    """A plan with what was asked; ``request`` is None if its planner or timing law has no name to be made from."""

    made_for: MadeFor
    request: PlanRequest | None
    result: PlanResult

    def document(self) -> dict[str, Any]:
        """The content of the file, of plain JSON values."""
        return {
            **_head(PLAN_FORMAT, self.made_for),
            "request": None if self.request is None else _request(self.request),
            "result": result_record(self.result),
        }


@dataclass(frozen=True, eq=False)
class SavedTask:
    """The motions of a task in order, with the robot and scene at its start.

    Attributes:
        task: What was done, in words.
        choosing: What looking for grasps and placements cost, beyond the segments.
        seconds: Wall time of all of it.
        failure: None if every motion has a plan.
    """

    made_for: MadeFor
    task: str
    segments: tuple[Segment, ...]
    choosing: CheckCounts
    seconds: float
    failure: Failure | None = None
    notes: tuple[str, ...] = ()

    @property
    def counts(self) -> CheckCounts:
        """What the whole task asked of the collision checker."""
        return sum((segment.counts for segment in self.segments), self.choosing)

    def show(self, *, port: int = 8080, block: bool | None = None) -> Viewer:
        """Show the motions one after another on a page in the browser; see ``PlannerService.view``.

        Raises:
            InvalidRequest: it comes from a file, or nothing was planned: ``service.view(task)`` shows it.
            MissingDependency: the extra ``view`` is not installed.
        """
        origin = self.segments[0].result.origin if self.segments else None
        if origin is None:
            expected = "motions that a service in this process planned; show it with service.view(task)"
            raise InvalidRequest("task", "a task from a file, or without motions", expected)
        return origin.service.view(self, port=port, block=block)

    def document(self) -> dict[str, Any]:
        """The content of the file, of plain JSON values."""
        return {
            **_head(TASK_FORMAT, self.made_for),
            "task": self.task,
            "ok": self.failure is None,
            "failure": failure_record(self.failure),
            "counts": counts_record(self.counts),
            "choosing": counts_record(self.choosing),
            "seconds": self.seconds,
            "notes": list(self.notes),
            "segments": [
                {
                    "name": segment.name,
                    "gripper_width": segment.width,
                    "gripper": gripper_record(segment.gripper),
                    "result": result_record(segment.result),
                }
                for segment in self.segments
            ],
        }


def save_plan(plan: SavedPlan | SavedTask, path: str | os.PathLike[str]) -> None:
    """Write a plan or a task, or the failure that is in their place; the file is there whole or not at all.

    Raises:
        InvalidFile: it cannot be written.
    """
    write_whole(as_path("path", path), json.dumps(plan.document(), indent=1, allow_nan=False) + "\n")


def load_plan(path: str | os.PathLike[str]) -> SavedPlan:
    """The plan in a file, its path and trajectory bit for bit as they were saved.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    root, made_for = _opened(as_path("path", path), PLAN_FORMAT)
    request = root.at("request").optional(lambda node: _read_request(node, len(made_for.joint_names)))
    result = read_result(root.at("result"), len(made_for.joint_names))
    _refuse_problems(path, root)
    return SavedPlan(made_for, request, result)


def load_task(path: str | os.PathLike[str]) -> SavedTask:
    """The task in a file, its paths and trajectories bit for bit as they were saved.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    root, made_for = _opened(as_path("path", path), TASK_FORMAT)
    n = len(made_for.joint_names)
    task = SavedTask(
        made_for,
        root.at("task").text(),
        tuple(
            Segment(
                item.at("name").text(),
                read_result(item.at("result"), n),
                item.at("gripper_width").number(),
                gripper=item.at("gripper").optional(read_gripper) if item.has("gripper") else None,
            )
            for item in root.at("segments").items()
        ),
        read_counts(root.at("choosing")),
        root.at("seconds").number(),
        root.at("failure").optional(lambda node: read_failure(node, n)),
        read_texts(root.at("notes")),
    )
    _refuse_problems(path, root)
    return task


def load_plan_or_task(path: str | os.PathLike[str]) -> SavedPlan | SavedTask:
    """Whichever of both is in a file; see ``load_plan`` and ``load_task``.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    kind = Node("", read_json(as_path("path", path)), []).at("format").value
    return load_task(path) if kind == TASK_FORMAT else load_plan(path)


def _head(kind: str, made_for: MadeFor) -> dict[str, Any]:
    joints = list(made_for.joint_names)
    return {
        "format": kind,
        "version": VERSION,
        "robot": {"name": made_for.robot, "hash": made_for.robot_hash, "joint_names": joints},
        "scene": {"name": made_for.scene, "hash": made_for.scene_hash},
    }


def _opened(path: Path, kind: str) -> tuple[Node, MadeFor]:
    """The document at ``path`` and what it was made for; raise at once if its head is not sound."""
    root = Node("", read_json(path), [])
    found, version = root.at("format").text(), root.at("version").whole()
    if not root.problems and found != kind:
        root.problem(f"format: got {found!r}; expected {kind!r}")
    if not root.problems and version != VERSION:
        root.problem(f"version: got {version}; this package reads version {VERSION}")
    _refuse_problems(path, root)
    robot, scene = root.at("robot"), root.at("scene")
    joints = read_texts(robot.at("joint_names"))
    names = robot.at("name").text(), robot.at("hash").text(), joints, scene.at("name").text(), scene.at("hash").text()
    _refuse_problems(path, root)
    return root, MadeFor(*names)


def _refuse_problems(path: str | os.PathLike[str], root: Node) -> None:
    if root.problems:
        raise InvalidFile(os.fspath(path), root.problems)


def _list(values: Any) -> list[float]:
    numbers: list[float] = np.asarray(values, dtype=np.float64).tolist()
    return numbers


def _request(request: PlanRequest) -> dict[str, Any] | None:
    planner, timing = _planner(request.planner), _settings(request.timing, TIMINGS)
    polish = None if request.polish is None else _planner(request.polish)
    if planner is None or timing is None or (polish is None) != (request.polish is None):
        return None
    return {
        "start": _list(request.start),
        "goals": [_goal(goal) for goal in _goals(request.goal)],
        "planner": planner,
        "timing": timing,
        "polish": polish,
        **{name: int(getattr(request, name)) for name in _WHOLE},
        **{name: float(getattr(request, name)) for name in _REAL},
        **{name: None if (value := getattr(request, name)) is None else float(value) for name in _MAYBE},
    }


def _goals(goal: Any) -> list[Any]:
    if isinstance(goal, Pose | PoseGoal):
        return [goal]
    several = any(isinstance(entry, Pose | PoseGoal) or np.ndim(entry) > 0 for entry in goal)
    return list(goal) if several else [goal]


def _goal(goal: Any) -> dict[str, Any]:
    if isinstance(goal, Pose):
        return {"pose": _pose(goal)}
    if isinstance(goal, PoseGoal):
        room = {item.name: getattr(goal, item.name) for item in fields(goal) if item.name != "pose"}
        return {"pose": _pose(goal.pose), "room": room | {"free_axis": goal.free_axis and list(goal.free_axis)}}
    return {"joints": _list(goal)}


def _pose(pose: Pose) -> dict[str, Any]:
    return {"position": list(pose.position), "quaternion_wxyz": list(pose.quaternion)}


def _settings(chosen: Any, known: Mapping[str, type[Any]]) -> dict[str, Any] | None:
    """Name and settings of a planner or timing law, None if it is not one that a name and settings make."""
    if type(chosen) is not known.get(getattr(chosen, "name", "")):
        return None
    return {"name": chosen.name, "settings": {item.name: getattr(chosen, item.name) for item in fields(chosen)}}


def _planner(chosen: Any) -> dict[str, Any] | None:
    """As ``_settings``; an optimisation has those of its method among its own, a roadmap its hash."""
    if not isinstance(chosen, Optimise):
        chosen = RoadmapReference(chosen.hash) if isinstance(chosen, Roadmap) else chosen
        return _settings(chosen, _PLANNERS)
    method = _settings(chosen.method, METHODS)
    told = None if method is None else _settings(chosen, {chosen.name: Optimise})
    if told is not None:
        told["settings"]["method"] = method
    return told


def _read_request(node: Node, n: int) -> PlanRequest | None:
    goals = [
        _read_tool_goal(item) if item.has("pose") else item.at("joints").numbers(n) for item in node.at("goals").items()
    ]
    if len(goals) == 0:
        node.at("goals").wrong("at least one goal")
    limits: dict[str, Any] = {name: node.at(name).whole() for name in _WHOLE}
    limits |= {name: node.at(name).number() for name in _REAL}
    limits |= {name: node.at(name).optional(Node.number) for name in _MAYBE}
    start = node.at("start").numbers(n)
    planner = _read_planner(node.at("planner"))
    polish = node.at("polish").optional(_read_planner) if node.has("polish") else None  # files of before have none
    timing = _read_settings(node.at("timing"), "timing law", TIMINGS)
    if planner is None or timing is None:
        return None
    return node.attempt(
        lambda: PlanRequest(
            start, goals[0] if len(goals) == 1 else tuple(goals), planner, timing, polish=polish, **limits
        )
    )


def _read_planner(node: Node) -> Any:
    optimise = Optimise().name
    if node.at("name").value != optimise:
        return _read_settings(node, "planner", _PLANNERS)
    settings = node.at("settings")
    method = _read_settings(settings.at("method"), "method", METHODS)
    if method is None:
        return None
    return _made(
        settings, [item.name for item in fields(Optimise)], lambda **given: Optimise(**{**given, "method": method})
    )


def _read_tool_goal(node: Node) -> Pose | PoseGoal:
    pose = _read_pose(node.at("pose"))
    if not node.has("room"):
        return pose
    room = node.at("room")
    axis = room.at("free_axis").optional(lambda at: _axis(at.numbers(3)))
    tolerances = room.at("position_tolerance").number(), room.at("orientation_tolerance").number()
    count = room.at("candidates").whole()
    return room.attempt(lambda: PoseGoal(pose, *tolerances, axis, count)) or pose


def _axis(values: Any) -> tuple[float, float, float]:
    x, y, z = values
    return (x, y, z)


def _read_pose(node: Node) -> Pose:
    (x, y, z), (w, i, j, k) = node.at("position").numbers(3), node.at("quaternion_wxyz").numbers(4)
    return node.attempt(lambda: Pose((x, y, z), (w, i, j, k))) or Pose()


def _read_settings(node: Node, kind: str, known: Mapping[str, type[Any]]) -> Any:
    name, settings = node.at("name").text(), node.at("settings")
    if not node.sound:
        return None
    if name not in known:
        node.problem(str(UnknownName(kind, name, known)))
        return None
    return _made(settings, [item.name for item in fields(known[name])], known[name])


def _made(node: Node, allowed: Sequence[str], make: Callable[..., Any]) -> Any:
    """What settings make, none of which has another name; None if they make nothing."""
    if not isinstance(node.value, dict) or not set(node.value) <= set(allowed):
        node.wrong(f"an object with no other keys than {', '.join(allowed)}")
        return None
    return node.attempt(lambda: make(**node.value))
