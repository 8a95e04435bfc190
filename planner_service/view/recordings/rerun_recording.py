"""Motions as recordings of Rerun: robot and scene, the curve of the tool, clearance and speeds over time."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.files.reading import as_path
from planner_service.files.writing import write_whole
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.path.trajectory import Trajectory
from planner_service.presentation.page import Showable
from planner_service.service import PlannerService
from planner_service.view.lines import curve_lines, tool_points
from planner_service.view.playback import Clip
from planner_service.view.state import ViewState
from planner_service.view.triangles import TOOL, Solid, placements, robot_solids, scene_solids

__all__ = ["RECORDING", "log_motions", "rerun_bytes", "write_rerun"]

RECORDING = re.compile(rb"RRF\d")
"""How a recording begins."""

TIMELINE = "time"

CURVE: tuple[int, int, int] = (30, 80, 200)

STEP = 1e-6
"""Seconds before and after a moment between which the tool's speed is measured."""


def log_motions(recording: Any, service: PlannerService, shown: Showable, *, dt: float = 0.02) -> None:
    """Log a plan, or the motions of a task one after another, to a recording of Rerun's.

    On the timeline ``time``, in seconds of motion, every ``dt`` and at the exact ends: ``robot/<link>``, ``tool`` with
    what is carried below it, ``scene/<obstacle>``, ``curve/<motion>`` of the tool, ``clearance`` as proven in metres,
    ``speed/tool`` in m/s, and ``joint/<position, velocity, acceleration>/<name>``.

    Args:
        recording: A ``rerun.RecordingStream``, wherever it goes to.
        service: Plans for the robot and the scene as they are before the first motion.
        shown: A PlanResult, TaskResult or SavedTask.

    Raises:
        InvalidRequest: There is no motion in it, it is something else, or ``dt`` is not positive or gives more than a
            million moments.
        MissingDependency: Rerun is not installed.
    """
    _rerun()
    playback = ViewState.of(service, shown).playback
    if playback is None:
        raise InvalidRequest("shown", shown, "a plan or a task with a motion")
    drawn: dict[str, Solid] = {}
    for number, clip in enumerate(playback.clips):
        drawn = _log_solids(recording, clip, drawn)
        _log_clip(recording, clip, f"{number} {clip.name}", dt)


def rerun_bytes(service: PlannerService, shown: Showable, *, dt: float = 0.02) -> bytes:
    """The content of an .rrd file of what ``log_motions`` logs.

    Raises:
        InvalidRequest, MissingDependency: as of ``log_motions``.
    """
    rerun = _rerun()
    recording = rerun.RecordingStream("planner-service")
    memory = recording.memory_recording()
    log_motions(recording, service, shown, dt=dt)
    content: bytes = memory.drain_as_bytes()
    return content


def write_rerun(service: PlannerService, shown: Showable, path: str | os.PathLike[str], *, dt: float = 0.02) -> None:
    """Write ``rerun_bytes`` to a file, which is there whole or not at all.

    Raises:
        InvalidRequest, MissingDependency: as of ``log_motions``.
        InvalidFile: it cannot be written.
    """
    write_whole(as_path("path", path), rerun_bytes(service, shown, dt=dt), RECORDING)


def _log_solids(recording: Any, clip: Clip, drawn: dict[str, Solid]) -> dict[str, Solid]:
    """Log what is drawn otherwise than in the motion before, and take away what is gone."""
    rerun, world = _rerun(), clip.service.world
    solids = {_path("robot", solid.name): solid for solid in robot_solids(world.robot)}
    for solid in scene_solids(world.scene):
        solids[_path("scene" if solid.frame is None else "tool", solid.name)] = solid
    recording.set_time(TIMELINE, duration=clip.begin)
    for path in drawn.keys() - solids.keys():
        recording.log(path, rerun.Clear(recursive=True))
    for path, solid in solids.items():
        before = drawn.get(path)
        if before is None or not np.array_equal(before.vertices, solid.vertices):
            faces = solid.faces.astype(np.uint32)
            recording.log(
                path, rerun.Mesh3D(vertex_positions=solid.vertices, triangle_indices=faces, albedo_factor=solid.colour)
            )
    return solids


def _log_clip(recording: Any, clip: Clip, name: str, dt: float) -> None:
    rerun, robot, trajectory = _rerun(), clip.service.robot, clip.trajectory
    assert isinstance(trajectory, Trajectory)
    recording.log(_path("curve", name), rerun.LineStrips3D(curve_lines(robot, trajectory.path), colors=[CURVE]))
    t, q, qd, qdd = trajectory.sample(dt)
    times = [rerun.TimeColumn(TIMELINE, duration=t + clip.begin)]
    frames = [placements(robot, row) for row in q]
    for frame in frames[0]:
        poses = [Pose.from_matrix(each[frame]) for each in frames]
        turned = [(*pose.quaternion[1:], pose.quaternion[0]) for pose in poses]
        moved = rerun.Transform3D.columns(translation=[pose.position for pose in poses], quaternion=turned)
        recording.send_columns("tool" if frame == TOOL else _path("robot", frame), times, moved)
    curves = {"position": q, "velocity": qd, "acceleration": qdd}
    for kind, values in curves.items():
        for joint, column in zip(robot.joint_names, values.T, strict=True):
            recording.send_columns(_path("joint", kind, joint), times, rerun.Scalars.columns(scalars=column))
    ahead, behind = (tool_points(robot, q + sign * STEP * qd) for sign in (1.0, -1.0))
    speed: FloatArray = np.sqrt(((ahead - behind) ** 2).sum(axis=1)) / (2.0 * STEP)
    for path, values in ((_path("speed", "tool"), speed), ("clearance", clip.clearances(t))):
        recording.send_columns(path, times, rerun.Scalars.columns(scalars=values))


def _path(*parts: str) -> str:
    """An entity's path; names may have any characters."""
    path: str = _rerun().new_entity_path(list(parts))
    return path


def _rerun() -> Any:
    try:
        import rerun
    except ImportError:
        raise MissingDependency("rerun", "rerun") from None
    return rerun
