"""The formats in which ``planner-service export`` writes a saved plan or task."""

from __future__ import annotations

from collections.abc import Sequence

from planner_service.cli.output import json_text
from planner_service.errors import InvalidRequest
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.trajectory_export import (
    csv_text,
    display_trajectory,
    joint_trajectory,
    robot_trajectory,
    task_csv_text,
    task_trajectories,
    yaml_text,
)
from planner_service.tasks.result import Segment

__all__ = ["FORMATS", "exported"]

MESSAGES = ("joint-trajectory", "robot-trajectory", "display-trajectory")
"""Those of ROS messages."""

FORMATS = (*MESSAGES, "csv")


def exported(saved: SavedPlan | SavedTask, form: str, dt: float, *, as_yaml: bool = False) -> str:
    """The text of the motions in a file.

    Args:
        form: One of ``FORMATS``.
        dt: Seconds between points.
        as_yaml: Write a message as YAML instead of JSON.

    Raises:
        InvalidRequest: ``dt`` is invalid, or YAML is asked for where there is no message.
        MissingDependency: PyYAML is not installed.
    """
    if as_yaml and form not in MESSAGES:
        raise InvalidRequest("--yaml", form, f"a --format of {', '.join(MESSAGES)}")
    names = saved.robot.joint_names
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
