"""Methods of values that need what is built on those values: which function each of them calls.

Each is imported with its first call: pages, files and pydantic take a while to load.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from planner_service.concurrency.library_import import loaded
from planner_service.memory.memory import Memory, load_memory, save_memory
from planner_service.planning.result import load_steps, save_plan, save_steps
from planner_service.presentation.page import OpenPage, recording_bytes, show_page
from planner_service.roadmap.roadmap import Roadmap, load_roadmap, save_roadmap
from planner_service.robot.model import Robot, group_of, lock_joints, robot_from_urdf
from planner_service.service import PlannerService, solve_task

__all__ = list[str]()


@show_page.by
def _show_page(*shown: Any, **where: Any) -> OpenPage:
    """``PlannerService.view``, and ``show`` of a plan, a task, and a saved task."""
    from planner_service.view import show

    return show(*shown, **where)


@recording_bytes.by
def _recording_bytes(form: str, *shown: Any, dt: float) -> bytes:
    """Of formats of export that show robot and scene."""
    from planner_service.view.recordings import mcap_recording, rerun_recording

    return (rerun_recording.rerun_bytes if form == "rrd" else mcap_recording.mcap_bytes)(*shown, dt=dt)


@save_plan.by
def _save_plan(plan: Any, path: str | os.PathLike[str]) -> None:
    """``save`` of a plan and of a task."""
    from planner_service.records.evidence import save_plan

    save_plan(plan, path)


@save_memory.by
def _save_memory(memory: Memory, path: str | os.PathLike[str]) -> None:
    """``Memory.save``."""
    from planner_service.memory.memory_file import save_memory

    save_memory(memory, path)


@load_memory.by
def _load_memory(path: str | os.PathLike[str]) -> Memory:
    """``Memory.load``."""
    from planner_service.memory.memory_file import load_memory

    return load_memory(path)


@solve_task.by
def _solve_task(service: PlannerService, *given: Any, **settings: Any) -> Any:
    """``PlannerService.solve``."""
    from planner_service.tasks.solver import solve

    return solve(service, *given, **settings)


@save_steps.by
def _save_steps(task: Any, path: str | os.PathLike[str]) -> None:
    """``Task.save``."""
    from planner_service.records.steps import save_steps

    save_steps(task, path)


@load_steps.by
def _load_steps(path: str | os.PathLike[str]) -> Any:
    """``Task.load``."""
    from planner_service.records.steps import load_steps

    return load_steps(path)


@save_roadmap.by
def _save_roadmap(roadmap: Roadmap, path: str | os.PathLike[str]) -> None:
    """``Roadmap.save``."""
    from planner_service.roadmap.roadmap_file import save_roadmap

    save_roadmap(roadmap, path)


@load_roadmap.by
def _load_roadmap(path: str | os.PathLike[str]) -> Roadmap:
    """``Roadmap.load``."""
    from planner_service.roadmap.roadmap_file import load_roadmap

    return load_roadmap(path)


@robot_from_urdf.by
def _robot_from_urdf(path: Path, folders: Sequence[Path], **selection: Any) -> Robot:
    """``Robot.from_urdf``."""
    loaded(_robot_files)
    from planner_service.robot.loading import Selection, robot_from_urdf

    return robot_from_urdf(path, folders, Selection(**selection))


def _robot_files() -> None:
    import planner_service.robot.loading  # noqa: F401  pydantic takes 0.1 s


@lock_joints.by
def _lock_joints(robot: Robot, joints: Mapping[str, float]) -> Robot:
    """``Robot.locked``."""
    from planner_service.robot.locking import lock_joints

    return lock_joints(robot, joints)


@group_of.by
def _group_of(robot: Robot, name: str) -> Robot:
    """``Robot.group``."""
    from planner_service.robot.locking import group_of

    return group_of(robot, name)
