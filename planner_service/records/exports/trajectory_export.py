"""Trajectories for others: in the shape of ROS messages, as JSON or YAML, and as a table of text."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any

import numpy as np

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.files.reading import as_path
from planner_service.files.writing import write_whole
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import text
from planner_service.path.trajectory import Samples, Trajectory
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment, require_joined

__all__ = [
    "CSV_BEGINNING",
    "MESSAGE_BEGINNING",
    "csv_text",
    "display_trajectory",
    "follow_goal",
    "joint_trajectory",
    "on_one_clock",
    "robot_trajectory",
    "sampled",
    "task_csv_text",
    "task_messages",
    "task_trajectories",
    "write_csv",
    "yaml_text",
]

_STAMP = rb'"header":\s*\{\s*"stamp":\s*\{\s*"sec":\s*0,\s*"nanosec":\s*0\s*\},\s*"frame_id":[^\n]*\s*\},'
_YAML_STAMP = rb"header:\n +stamp: \{sec: 0, nanosec: 0\}\n +frame_id:[^\n]*\n *"
_MORE_LINES = rb"(?: [^\n]*\n|\n)*"

CSV_BEGINNING = re.compile(rb't,(?:motion,gripper_width,)?"?q_[^\n]*,"?qd_[^\n]*,"?qdd_')
MESSAGE_BEGINNING = re.compile(
    b"|".join(
        [
            rb'\s*\{\s*(?:"(?:joint_)?trajectory":\s*\{\s*)?' + _STAMP + rb'\s*"joint_names"',
            rb'\s*\{\s*"motions":\s*\[\s*\{\s*"name":[^\n]*\s*"begin":',
            rb'\s*\{\s*"model_id":[^\n]*\s*"trajectory":\s*\[',
            rb"(?:(?:joint_)?trajectory:\n +)?" + _YAML_STAMP + rb"joint_names:",
            rb"motions:\n- name:[^\n]*\n" + _MORE_LINES + rb"  begin:",
            rb"model_id:[^\n]*\n" + _MORE_LINES + rb"trajectory:\n- joint_trajectory:",
        ]
    )
)
"""How tables and messages begin that are written here; no other file is replaced by one."""

SECOND = 1_000_000_000
"""Nanoseconds."""

MAX_SECONDS = 2**31
"""A ROS duration counts its seconds in 32 bits."""


def joint_trajectory(
    motion: Trajectory | PlanResult, joint_names: Sequence[str], dt: float, *, frame_id: str = ""
) -> dict[str, Any]:
    """A trajectory every ``dt`` seconds and at its exact end, in the shape of ROS 2's trajectory_msgs/JointTrajectory.

    Of plain JSON values: ``header``, ``joint_names`` and ``points`` with ``positions``, ``velocities``,
    ``accelerations``, an empty ``effort`` and ``time_from_start``, which always grows; a time is rounded to the
    nanosecond, the values are those before rounding. The header's stamp is 0: start when received.

    Raises:
        InvalidRequest: not one name for each joint, ``dt`` is not positive or gives more than a million points, or
            the trajectory lasts longer than the message can say.
        PlanningFailed: a result without a plan.
    """
    trajectory, names = _checked(motion, joint_names)
    if not trajectory.duration < MAX_SECONDS:
        raise InvalidRequest("trajectory", trajectory.duration, f"a duration below {MAX_SECONDS:,} s")
    samples = trajectory.sample(dt)
    times, rows = _growing([round(t * SECOND) for t in samples.t.tolist()])
    values = [_plain(part[rows]) for part in samples[1:]]
    return {
        "header": _header(frame_id),
        "joint_names": names,
        "points": [
            {"positions": q, "velocities": qd, "accelerations": qdd, "effort": [], "time_from_start": _time(t)}
            for t, q, qd, qdd in zip(times, *values, strict=True)
        ],
    }


def robot_trajectory(
    motion: Trajectory | PlanResult, joint_names: Sequence[str], dt: float, *, frame_id: str = ""
) -> dict[str, Any]:
    """The same in the shape of MoveIt's moveit_msgs/RobotTrajectory: a ``joint_trajectory`` beside one of no joints.

    Raises:
        InvalidRequest, PlanningFailed: as of ``joint_trajectory``.
    """
    return {
        "joint_trajectory": joint_trajectory(motion, joint_names, dt, frame_id=frame_id),
        "multi_dof_joint_trajectory": {"header": _header(frame_id), "joint_names": [], "points": []},
    }


def follow_goal(
    motion: Trajectory | PlanResult, joint_names: Sequence[str], dt: float, *, frame_id: str = ""
) -> dict[str, Any]:
    """The same in the shape of ROS 2's control_msgs/action/FollowJointTrajectory goal, with a controller's tolerances.

    Raises:
        InvalidRequest, PlanningFailed: as of ``joint_trajectory``.
    """
    return {
        "trajectory": joint_trajectory(motion, joint_names, dt, frame_id=frame_id),
        "multi_dof_trajectory": {"header": _header(frame_id), "joint_names": [], "points": []},
        **{name: [] for name in ("path_tolerance", "component_path_tolerance")},
        **{name: [] for name in ("goal_tolerance", "component_goal_tolerance")},
        "goal_time_tolerance": _time(0),
    }


def display_trajectory(
    segments: Sequence[Segment], joint_names: Sequence[str], dt: float, *, model_id: str, frame_id: str = ""
) -> dict[str, Any]:
    """Motions, one after another, in the shape of MoveIt's moveit_msgs/DisplayTrajectory, which RViz plays.

    Of plain JSON values: ``model_id``, ``trajectory`` with a ``robot_trajectory`` for each motion, each with its own
    time 0, and ``trajectory_start``, a RobotState with the first configuration. The message has no place for names of
    motions and widths of grippers: ``task_trajectories`` has both.

    Args:
        model_id: The robot's name, as in its URDF.

    Raises:
        InvalidRequest: as of ``joint_trajectory``, there is no motion, or one does not begin where the last one ends.
        PlanningFailed: a motion without a plan.
    """
    results = [segment.result for segment, _ in on_one_clock(segments)]
    trajectories = [robot_trajectory(result, joint_names, dt, frame_id=frame_id) for result in results]
    first = trajectories[0]["joint_trajectory"]["points"][0]
    state = {"header": _header(frame_id), "name": list(joint_names), "position": first["positions"]}
    no_joints: dict[str, Any] = {"joint_names": [], "transforms": [], "twist": [], "wrench": []}
    return {
        "model_id": text("model_id", model_id),
        "trajectory": trajectories,
        "trajectory_start": {
            "joint_state": {**state, "velocity": [], "effort": []},
            "multi_dof_joint_state": {"header": _header(frame_id), **no_joints},
            "attached_collision_objects": [],
            "is_diff": False,
        },
    }


def yaml_text(message: dict[str, Any]) -> str:
    """A message as YAML that ``ros2 topic pub`` reads back as the same bits; lists of numbers stand on one line.

    Raises:
        MissingDependency: PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError:
        raise MissingDependency("yaml", "yaml") from None
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    written: str = yaml.dump(message, Dumper=dumper, sort_keys=False, default_flow_style=None, width=2**30)
    return written


def csv_text(motion: Trajectory | PlanResult, joint_names: Sequence[str], dt: float) -> str:
    """A trajectory every ``dt`` seconds and at its exact end, as a table of comma-separated values under a head.

    The columns are ``t``, then ``q_<joint>``, ``qd_<joint>`` and ``qdd_<joint>`` of all joints, in seconds, radians
    (or metres) and their derivatives; every float has the digits that read back as the same bits.

    Raises:
        InvalidRequest: not one name for each joint, or ``dt`` is not positive or gives more than a million rows.
        PlanningFailed: a result without a plan.
    """
    samples = sampled(motion, joint_names, dt)
    return _table(["t", *_columns(joint_names)], _plain(np.column_stack(samples)))


def task_csv_text(segments: Sequence[Segment], joint_names: Sequence[str], dt: float) -> str:
    """The motions of a task in one table on one clock, each every ``dt`` seconds and at its exact end.

    The columns are ``t``, ``motion`` and ``gripper_width``, then those of ``csv_text``. The clock counts motion only:
    where ``motion`` changes, the arm is at rest, two rows have the same time, and a gripper whose width changes has to
    be waited for.

    Raises:
        InvalidRequest: as of ``csv_text``, there is no motion, or one does not begin where the last one ends.
        PlanningFailed: a motion without a plan.
    """
    rows: list[list[Any]] = []
    for segment, begin in on_one_clock(segments):
        values = _plain(np.column_stack(sampled(segment.result, joint_names, dt)))
        rows += [[begin + t, segment.name, _width(segment), *rest] for t, *rest in values]
    return _table(["t", "motion", "gripper_width", *_columns(joint_names)], rows)


def task_trajectories(
    segments: Sequence[Segment], joint_names: Sequence[str], dt: float, *, moveit: bool = False
) -> dict[str, Any]:
    """The motions of a task, of plain JSON values: ``motions``, each a ``joint_trajectory`` with its own time 0.

    Beside its ``trajectory`` each has ``name``, ``gripper_width`` in metres during it (null or 0 without fingers) and
    ``begin``, seconds of motion before it. After a motion the arm is at rest; a gripper whose width changes is to be
    waited for before the next.

    Args:
        moveit: Give each as a ``robot_trajectory``.

    Raises:
        InvalidRequest: as of ``joint_trajectory``, there is no motion, or one does not begin where the last one ends.
        PlanningFailed: a motion without a plan.
    """
    return task_messages(segments, joint_names, dt, robot_trajectory if moveit else joint_trajectory)


def task_messages(
    segments: Sequence[Segment], joint_names: Sequence[str], dt: float, message: Callable[..., dict[str, Any]]
) -> dict[str, Any]:
    """``task_trajectories`` with messages of another kind, made like a ``joint_trajectory``."""
    return {
        "motions": [
            {
                "name": segment.name,
                "begin": begin,
                "gripper_width": _width(segment),
                "trajectory": message(segment.result, joint_names, dt),
            }
            for segment, begin in on_one_clock(segments)
        ]
    }


def on_one_clock(segments: Sequence[Segment]) -> list[tuple[Segment, float]]:
    """The motions with the seconds of motion and of waiting before each."""
    require_joined(segments)
    ends = accumulate((segment.wait + segment.result.unwrap()[1].duration for segment in segments), initial=0.0)
    return [(segment, before + segment.wait) for segment, before in zip(segments, ends, strict=False)]


def _width(segment: Segment) -> float | None:
    return None if math.isnan(segment.width) else segment.width


def _columns(names: Sequence[str]) -> list[str]:
    return [f"{kind}_{name}" for kind in ("q", "qd", "qdd") for name in names]


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    written = io.StringIO(newline="")
    table = csv.writer(written, lineterminator="\n")
    table.writerow(head)
    table.writerows(rows)  # floats by repr
    return written.getvalue()


def write_csv(
    motion: Trajectory | PlanResult, path: str | os.PathLike[str], joint_names: Sequence[str], dt: float
) -> None:
    """Write ``csv_text`` to a file, which is there whole or not at all.

    Raises:
        InvalidRequest: as of ``csv_text``.
        PlanningFailed: a result without a plan.
        InvalidFile: it cannot be written.
    """
    target = as_path("path", path)
    write_whole(target, csv_text(motion, joint_names, dt), CSV_BEGINNING)


def sampled(motion: Trajectory | PlanResult, joint_names: Sequence[str], dt: float) -> Samples:
    """A trajectory every ``dt`` seconds and at its exact end.

    Raises:
        InvalidRequest, PlanningFailed: as of ``csv_text``.
    """
    return _checked(motion, joint_names)[0].sample(dt)


def _checked(motion: Trajectory | PlanResult, joint_names: Sequence[str]) -> tuple[Trajectory, list[str]]:
    trajectory = motion.unwrap()[1] if isinstance(motion, PlanResult) else motion
    if not isinstance(trajectory, Trajectory):
        raise InvalidRequest("motion", motion, "a Trajectory or a PlanResult")
    n = trajectory.path.n
    good = isinstance(joint_names, (list, tuple)) and all(isinstance(name, str) and name for name in joint_names)
    if not good or not len(joint_names) == len(set(joint_names)) == n:
        raise InvalidRequest("joint_names", joint_names, f"{n} names, one for each joint")
    return trajectory, list(joint_names)


def _growing(times: list[int]) -> tuple[list[int], list[int]]:
    """Times that grow by at least a nanosecond, and which of the given ones they are: the first and the last are in."""
    last = len(times) - 1
    rows = [0]
    for k in range(1, last):
        if times[rows[-1]] < times[k] < times[last]:
            rows.append(k)
    kept = [times[k] for k in rows]
    if last > 0:
        rows.append(last)
        kept.append(max(times[last], kept[-1] + 1))
    return kept, rows


def _header(frame_id: str) -> dict[str, Any]:
    return {"stamp": _time(0), "frame_id": text("frame_id", frame_id)}


def _time(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // SECOND, "nanosec": nanoseconds % SECOND}


def _plain(rows: FloatArray) -> list[list[float]]:
    values: list[list[float]] = (rows + 0.0).tolist()  # without the sign of -0.0
    return values
