"""Motions as samples in time for any program: as JSON with the gripper's events, as an array, as actions of LeRobot."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from planner_service.planning.request import World
from planner_service.planning.task_result import SAME_WIDTH, Segment
from planner_service.records.exports.deviation import Between, deviation
from planner_service.records.exports.robot_programs import even_samples
from planner_service.records.exports.trajectory_export import on_one_clock, sampled
from planner_service.robot.model import Robot

__all__ = ["array_bytes", "events", "lerobot_actions", "sampled_motions", "worst_deviation"]


def sampled_motions(segments: Sequence[Segment], begin: World, dt: float) -> dict[str, Any]:
    """Motions one after another with all that is needed to run them, of plain JSON values.

    ``motions`` have ``name``, ``begin`` and ``duration`` in seconds of motion, ``t`` from their own 0, every ``dt`` and
    at the exact end, and rows of ``positions``, ``velocities`` and ``accelerations``, in the order of ``joint_names``
    and in ``units`` and their derivatives by seconds. ``events`` are those of the gripper; see ``events``.
    ``deviation`` bounds the distance of each joint from the proven curve if lines, cubics or quintics are drawn
    between the points; see ``deviation.deviation``.

    Raises:
        InvalidRequest, PlanningFailed: as of ``task_csv_text``.
    """
    robot = begin.robot
    motions = []
    for segment, start in on_one_clock(segments):
        t, q, qd, qdd = ((part + 0.0).tolist() for part in sampled(segment.result, robot.joint_names, dt))
        motion = {"name": segment.name, "begin": start, "duration": segment.result.unwrap()[1].duration, "t": t}
        motions.append(motion | {"positions": q, "velocities": qd, "accelerations": qdd})
    return {
        "robot": robot.name,
        "joint_names": list(robot.joint_names),
        "units": ["m" if slides else "rad" for slides in robot.sliding],
        "dt": dt,
        "deviation": {between: worst_deviation(segments, robot, dt, between) for between in get_args(Between)},
        "motions": motions,
        "events": events(segments, begin),
    }


def events(segments: Sequence[Segment], begin: World) -> list[dict[str, Any]]:
    """What the gripper does between motions, while the arm stands: ``at`` in seconds of motion, and ``before`` which.

    A gripper with fingers has its ``width`` in metres, one that sucks has whether it does, in ``suction``.
    """
    found: list[dict[str, Any]] = []
    world, width, sucks = begin, math.nan, bool(begin.scene.attached)
    for segment, at in on_one_clock(segments):
        world = segment.world_after(world)
        gripper = world.robot.gripper
        where = {"at": at, "before": segment.name}
        if gripper is None:
            continue
        if gripper.kind == "vacuum":
            if bool(world.scene.attached) != sucks:
                sucks = not sucks
                found.append(where | {"suction": sucks})
        elif not abs(segment.width - width) <= SAME_WIDTH and not math.isnan(segment.width):
            width = segment.width
            found.append(where | {"width": width})
    return found


def worst_deviation(segments: Sequence[Segment], robot: Robot, dt: float, between: Between) -> float:
    """The largest ``deviation`` of any motion, in radians (or metres)."""
    trajectories = [segment.result.unwrap()[1] for segment in segments]
    return max(deviation(each, sampled(each, robot.joint_names, dt), between) for each in trajectories)


def array_bytes(segments: Sequence[Segment], robot: Robot, dt: float) -> bytes:
    """An npy file of float64, shape (m, 1 + 3 n): t on one clock, then q, qd and qdd, the rows of ``task_csv_text``.

    Raises:
        InvalidRequest, PlanningFailed: as of ``task_csv_text``.
    """
    parts = []
    for segment, begin in on_one_clock(segments):
        t, *rest = sampled(segment.result, robot.joint_names, dt)
        parts.append(np.column_stack([begin + t, *rest]))
    written = io.BytesIO()
    np.save(written, np.ascontiguousarray(np.concatenate(parts)), allow_pickle=False)
    return written.getvalue()


def lerobot_actions(segments: Sequence[Segment], robot: Robot, dt: float) -> dict[str, Any]:
    """Motions as actions of LeRobot, of plain JSON values: ``fps`` and ``actions``, each for ``robot.send_action``.

    Keys are ``<joint>.pos``, in radians (or metres), of the arm's joints and of the first finger's. Actions are at
    equal distances on each motion's curve, which is driven slower by less than one action; ``motions`` has the name of
    each and the number of its first action.

    Raises:
        InvalidRequest, PlanningFailed: as of ``task_csv_text``.
    """
    names = [f"{name}.pos" for name in robot.joint_names]
    gripper = robot.gripper
    actions: list[dict[str, float]] = []
    motions = []
    for segment, _ in on_one_clock(segments):
        motions.append({"name": segment.name, "first": len(actions)})
        held = (
            {f"{gripper.joints[0]}.pos": gripper.position(segment.width)}
            if gripper is not None and gripper.kind != "vacuum"
            else {}
        )
        rows = (even_samples(segment.result.unwrap()[1], dt).q + 0.0).tolist()
        actions += [dict(zip(names, row, strict=True)) | held for row in rows]
    return {"fps": 1.0 / dt, "motions": motions, "actions": actions}
