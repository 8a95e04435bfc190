"""The commands ``planner-service export`` and ``join``: saved plans and tasks for other tools, and as one task."""

from __future__ import annotations

import os
from functools import reduce
from pathlib import Path
from typing import Annotated

from planner_service.cli import arguments, options
from planner_service.cli.exit_codes import bad_input_exits, report_error
from planner_service.cli.options import argument, option
from planner_service.cli.output import emit
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.files.writing import require_writable, write_whole
from planner_service.records.evidence import save_plan
from planner_service.records.exports.formats import FORMATS, How, exported, kept
from planner_service.records.plan_file import OURS, SavedTask, load_plan_or_task, load_task

__all__ = ["export", "join"]


def export(
    plan_file: options.PlanFile,
    form: Annotated[str, option("--format", "FORMAT", f"{', '.join(FORMATS)}.")] = "joint-trajectory",
    dt: Annotated[float, option("SECONDS", "Time between points; the exact end is always one.")] = How.dt,
    tolerance: Annotated[
        float, option("RADIANS", "Between the proven curve and the joint moves of a controller's program.")
    ] = How.tolerance,
    out: Annotated[str | None, option("FILE", "Write to this file instead of printing.")] = None,
    as_yaml: Annotated[bool, option("--yaml", "Write ROS messages as YAML instead of JSON.")] = False,
    model: Annotated[str | None, option("FILE", "The MJCF model that the keyframes are for (--format mujoco).")] = None,
    allow: options.Allow = None,
) -> None:
    """Write a saved trajectory for other programs: points in time, messages, a controller's program, a recording.

    The motions of a task share one clock, which stops while the gripper moves; each motion has its name and the
    gripper's width. What a format keeps of the proven curve is said on standard error, with the largest deviation.
    """
    with bad_input_exits():
        if form not in FORMATS:
            raise UnknownName("format", form, tuple(FORMATS))
        if out is not None and os.path.realpath(out) == os.path.realpath(plan_file):
            raise InvalidRequest("--out", out, "another file than the plan itself")
        binary = form in ("npy", "rrd", "mcap")
        if out is None and binary:
            raise InvalidRequest("--out", out, f"a file: {form} is not text")
        if out is not None:
            require_writable(out, FORMATS[form].beginning)
        saved = load_plan_or_task(plan_file)
        if saved.failure is not None:
            raise InvalidRequest("FILE", plan_file, "a file that holds a plan, not a failure")
        arguments.require_proven(saved, allow)
        how = How(dt, tolerance, as_yaml, model)
        content = exported(saved, form, how)
        if out is not None:
            write_whole(Path(out), content, FORMATS[form].beginning)
    report_error(f"note: {arguments.from_file(saved)}")
    report_error(f"note: {kept(saved, form, how)}")
    if saved.segments[0].result.unwrap()[1].s(0.0, 1) > 0.0:
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
