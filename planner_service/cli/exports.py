"""The formats in which ``planner-service export`` writes a saved plan or task."""

from __future__ import annotations

import re
from collections.abc import Sequence

from planner_service.cli.output import json_text
from planner_service.errors import InvalidRequest
from planner_service.records.mujoco_keyframes import keyframes_text
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.trajectory_export import (
    OURS,
    csv_text,
    display_trajectory,
    joint_trajectory,
    robot_trajectory,
    task_csv_text,
    task_trajectories,
    yaml_text,
)
from planner_service.service import PlannerService
from planner_service.tasks.result import Segment
from planner_service.view.rerun_recording import RECORDING, rerun_bytes

__all__ = ["FORMATS", "exported", "file_kind"]

MESSAGES = ("joint-trajectory", "robot-trajectory", "display-trajectory")
"""Those of ROS messages."""

MUJOCO = "mujoco"

RERUN = "rrd"

FORMATS = (*MESSAGES, "csv", MUJOCO, RERUN)


def file_kind(form: str) -> re.Pattern[bytes]:
    """How files of a format begin."""
    return RECORDING if form == RERUN else OURS


def exported(
    saved: SavedPlan | SavedTask, form: str, dt: float, *, as_yaml: bool = False, model: str | None = None
) -> str | bytes:
    """The motions in a file, in another format; a recording of Rerun's is bytes, all else is text.

    Args:
        form: One of ``FORMATS``.
        dt: Seconds between points.
        as_yaml: Write a message as YAML instead of JSON.
        model: The MJCF model whose keyframes are written.

    Raises:
        InvalidRequest: ``dt`` is invalid, YAML is asked for where there is no message, or the model is missing or not
            the robot's.
        InvalidFile: The model cannot be read.
        MissingDependency: PyYAML, Rerun or mujoco is not installed.
    """
    if (model is None) == (form == MUJOCO):
        raise InvalidRequest("--model", model, f"an MJCF file with --format {MUJOCO}, and none with another format")
    if as_yaml and form not in MESSAGES:
        raise InvalidRequest("--yaml", form, f"a --format of {', '.join(MESSAGES)}")
    if form == RERUN:
        shown = saved if isinstance(saved, SavedTask) else saved.result
        return rerun_bytes(PlannerService.of(saved.begin), shown, dt=dt)
    names = saved.robot.joint_names
    if model is not None:
        return keyframes_text(_motions(saved), names, dt, model=model)
    if form == "csv":
        if isinstance(saved, SavedTask):
            return task_csv_text(saved.segments, names, dt)
        return csv_text(saved.result, names, dt)
    moveit = form == "robot-trajectory"
    if form == "display-trajectory":
        message = display_trajectory(_motions(saved), names, dt, model_id=saved.robot.name)
    elif isinstance(saved, SavedTask):
        message = task_trajectories(saved.segments, names, dt, moveit=moveit)
    else:
        message = (robot_trajectory if moveit else joint_trajectory)(saved.result, names, dt)
    return yaml_text(message) if as_yaml else json_text(message)


def _motions(saved: SavedPlan | SavedTask) -> Sequence[Segment]:
    if isinstance(saved, SavedTask):
        return saved.segments
    return (Segment("plan", saved.result, saved.robot.gripper_width),)
