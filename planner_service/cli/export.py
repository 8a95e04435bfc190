"""The commands ``planner-service export`` and ``join``: saved plans and tasks for other tools, and as one task."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Annotated

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import bad_input_exits, report_error
from planner_service.cli.options import argument, option
from planner_service.cli.output import emit, json_text
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.writing import require_writable, write_whole
from planner_service.planning.task_result import Segment
from planner_service.records.evidence import save_plan
from planner_service.records.exports import mujoco_keyframes
from planner_service.records.exports.mujoco_keyframes import keyframes_text
from planner_service.records.exports.trajectory_export import (
    CSV_BEGINNING,
    MESSAGE_BEGINNING,
    csv_text,
    display_trajectory,
    joint_trajectory,
    robot_trajectory,
    task_csv_text,
    task_trajectories,
    yaml_text,
)
from planner_service.records.plan_file import OURS, SavedPlan, SavedTask, load_plan_or_task, load_task
from planner_service.service import PlannerService
from planner_service.view.rerun_recording import RECORDING, rerun_bytes

__all__ = ["export", "join"]

MESSAGES = ("joint-trajectory", "robot-trajectory", "display-trajectory")
"""Those of ROS messages."""

MUJOCO = "mujoco"

RERUN = "rrd"

FORMATS = (*MESSAGES, "csv", MUJOCO, RERUN)


def export(
    plan_file: options.PlanFile,
    form: Annotated[str, option("--format", "FORMAT", f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}.")] = FORMATS[0],
    dt: Annotated[float, option("SECONDS", "Time between points; the exact end is always one.")] = 0.01,
    out: Annotated[str | None, option("FILE", "Write to this file instead of printing.")] = None,
    as_yaml: Annotated[bool, option("--yaml", "Write ROS messages as YAML instead of JSON.")] = False,
    model: Annotated[str | None, option("FILE", "The MJCF model that the keyframes are for (--format mujoco).")] = None,
    allow: options.Allow = None,
) -> None:
    """Write a saved trajectory as points in time: positions, velocities and accelerations of all joints.

    The motions of a task share one clock, which stops while the gripper moves; each motion has its name and the
    gripper's width. The first three formats are messages of ROS 2 and MoveIt, as JSON; mujoco is keyframes for
    a model to include, rrd a recording for Rerun.
    """
    with bad_input_exits():
        if form not in FORMATS:
            raise UnknownName("format", form, FORMATS)
        if (model is None) == (form == MUJOCO):
            raise InvalidRequest("--model", model, f"an MJCF file with --format {MUJOCO}, and none with another format")
        if as_yaml and form not in MESSAGES:
            raise InvalidRequest("--yaml", form, f"a --format of {', '.join(MESSAGES)}")
        if out is not None and os.path.realpath(out) == os.path.realpath(plan_file):
            raise InvalidRequest("--out", out, "another file than the plan itself")
        if out is None and form == RERUN:
            raise InvalidRequest("--out", out, "a file for the recording")
        if out is not None:
            require_writable(out, _file_kind(form))
        saved = load_plan_or_task(plan_file)
        if saved.failure is not None:
            raise InvalidRequest("FILE", plan_file, "a file that holds a plan, not a failure")
        arguments.require_proven(saved, allow)
        content = _exported(saved, form, dt, as_yaml, model)
        if out is not None:
            write_whole(Path(out), content, _file_kind(form))
    report_error(f"note: {arguments.from_file(saved)}")
    if _motions(saved)[0].result.unwrap()[1].s(0.0, 1) > 0.0:
        report_error(
            "note: it begins at speed, as replanned motions do: only a robot that moves like that can follow it"
        )
    if out is None and isinstance(content, str):
        emit(content)


def join(
    task_files: Annotated[list[str], argument("FILE...", "Tasks, each planned from where the one before it ends.")],
    out: Annotated[str, option("FILE", "Save them here as one task.")],
    allow: options.Allow = None,
) -> None:
    """Write saved tasks, such as a pick and its place, as one, which is proven before it is written."""
    with bad_input_exits():
        require_writable(out, OURS)
        first, *others = [load_task(each) for each in task_files]
        whole = reduce(SavedTask.followed_by, others, first)
        arguments.require_proven(whole, allow)
        save_plan(whole, out)
    emit(str(whole))


def _file_kind(form: str) -> re.Pattern[bytes]:
    """How files of a format begin."""
    return {RERUN: RECORDING, MUJOCO: mujoco_keyframes.BEGINNING, "csv": CSV_BEGINNING}.get(form, MESSAGE_BEGINNING)


def _exported(saved: SavedPlan | SavedTask, form: str, dt: float, as_yaml: bool, model: str | None) -> str | bytes:
    """The motions in a file, in another format; a recording of Rerun's is bytes, all else is text."""
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
