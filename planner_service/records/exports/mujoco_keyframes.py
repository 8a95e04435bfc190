"""Trajectories as the keyframes of a MuJoCo model."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.task_result import Segment
from planner_service.records.exports.trajectory_export import on_one_clock, sampled
from planner_service.robot.macros.expansion import package_folders, robot_folders
from planner_service.robot.mjcf.mjcf_reader import joint_places

__all__ = ["BEGINNING", "keyframes_text"]

BEGINNING = re.compile(rb"<mujoco>\n  <keyframe>\n    <key name=[\"']0 [^\n]* time=")
"""How such a file begins."""


def keyframes_text(
    segments: Sequence[Segment], joint_names: Sequence[str], dt: float, *, model: str | os.PathLike[str]
) -> str:
    """Motions one after another as keyframes, every ``dt`` seconds and at the exact ends: a file that a model includes.

    Each keyframe has its time, ``qpos`` and ``qvel``, whose floats read back as the same bits, and a name made of a
    number and its motion. The robot's joints are found by their names; every other joint of the model, also of the
    fingers, stays where the model has it, at rest.

    Args:
        model: An MJCF file with the robot's joints, which mujoco compiles in a process of its own.

    Raises:
        InvalidRequest: as of ``task_csv_text``, or the model has no joint of one of the names.
        PlanningFailed: a motion without a plan.
        InvalidFile: The model cannot be read.
        MissingDependency: mujoco is not installed.
    """
    rows = [
        (segment.name, begin + t, q, qd)
        for segment, begin in on_one_clock(segments)
        for t, q, qd, _ in zip(*sampled(segment.result, joint_names, dt), strict=True)
    ]
    path = as_path("model", model)
    joints = joint_places(path, robot_folders(path, package_folders(path)))
    missing = [name for name in joint_names if name not in joints.places]
    if missing:
        raise InvalidRequest("model", os.fspath(model), f"a model with a hinge or slide {missing[0]!r}")
    positions, velocities = (list(row) for row in zip(*(joints.places[name] for name in joint_names), strict=True))
    qpos, qvel = np.array(joints.qpos, dtype=np.float64), np.zeros(joints.velocities)
    lines = []
    for number, (name, t, q, qd) in enumerate(rows):
        qpos[positions], qvel[velocities] = q, qd
        attributes = {"name": f"{number} {name}", "time": repr(float(t)), "qpos": _words(qpos), "qvel": _words(qvel)}
        lines.append(f"    <key {' '.join(f'{key}={quoteattr(value)}' for key, value in attributes.items())}/>\n")
    return "".join(["<mujoco>\n  <keyframe>\n", *lines, "  </keyframe>\n</mujoco>\n"])


def _words(values: FloatArray) -> str:
    numbers: Iterable[float] = (values + 0.0).tolist()
    return " ".join(map(repr, numbers))
