"""The result of an execution: the commands, the measured motion, and how far it is from the plan."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner_service.errors import PlannerServiceError
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.validation import copied_in, numbers, whole
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import Robot

__all__ = ["ExecutedMotion", "ExecutionReport", "ExecutionStopped", "Recording"]

CURVE_POINTS = 2000
"""Points of the planned tool path between which straight lines are taken: half a micrometre off on a 0.3 m arc."""

ROUNDING = 1e-9
"""Seconds."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One motion, tick by tick, the settling after its end included.

    Attributes:
        t: Seconds since the motion began at which the arm was asked where it is, shape (m,).
        commanded: The last command before that, shape (m, n): the plan, ahead by the arm's lag.
        measured: Where the arm was, shape (m, n).
        lateness: Seconds by which each command came late, shape (m,).
        skipped: Ticks that were left out because their time had passed.
    """

    t: FloatArray
    commanded: FloatArray
    measured: FloatArray
    lateness: FloatArray
    skipped: int = 0

    def __post_init__(self) -> None:
        for name in ("t", "commanded", "measured", "lateness"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), "numbers"))
        object.__setattr__(self, "skipped", whole("skipped", self.skipped, 0, sys.maxsize))


@dataclass(frozen=True, eq=False)
class ExecutedMotion:
    """A motion as planned and as it was.

    Attributes:
        name: The segment's, or "motion".
        trajectory: The planned one, slowed down by the speed.
        recording: The measured motion.
        error_max: The largest difference between measured and planned positions while it moved, shape (n,), rad.
        error_rms: The root mean square of the same.
        final_error: The difference once it had settled, shape (n,), rad.
        tool_lag: The largest distance of the tool from where it was planned to be at that time, in metres.
        tool_off_path: The largest distance of the tool from the planned path, in metres.
        late: Ticks that came more than a whole tick late, or were left out.
        ticks: Ticks of the stream, without settling.
        completed: Whether all of it was streamed.
    """

    name: str
    trajectory: Trajectory
    recording: Recording
    error_max: FloatArray
    error_rms: FloatArray
    final_error: FloatArray
    tool_lag: float
    tool_off_path: float
    late: int
    ticks: int
    completed: bool

    def __post_init__(self) -> None:
        copied_in(self, "error_max", "error_rms", "final_error")

    @classmethod
    def of(cls, name: str, trajectory: Trajectory, recording: Recording, robot: Robot, period: float) -> ExecutedMotion:
        """What a recording tells."""
        t = np.minimum(recording.t, trajectory.duration)
        planned = trajectory(t)
        error = np.abs(recording.measured - planned)
        moving = recording.t <= trajectory.duration + ROUNDING
        moving_error = error[moving] if moving.any() else np.zeros((1, robot.n))
        tool, tool_planned = _tool(robot, recording.measured), _tool(robot, planned)
        curve = _tool(robot, trajectory(np.linspace(0.0, trajectory.duration, CURVE_POINTS)))
        return cls(
            name,
            trajectory,
            recording,
            read_only(moving_error.max(axis=0)),
            read_only(np.sqrt((moving_error * moving_error).mean(axis=0))),
            read_only(error[-1] if len(error) else np.zeros(robot.n)),
            float(_norms(tool - tool_planned).max(initial=0.0)),
            max((_distance(point, curve) for point in tool), default=0.0),
            int((recording.lateness[moving] > period).sum()) + recording.skipped,
            int(moving.sum()) + recording.skipped,
            bool(len(t)) and bool(recording.t[-1] >= trajectory.duration - ROUNDING),
        )

    @property
    def duration(self) -> float:
        """Seconds as planned, slower by the speed."""
        return self.trajectory.duration

    def document(self) -> dict[str, Any]:
        """The figures, of plain JSON values."""
        return {
            "name": self.name,
            "seconds": self.duration,
            "completed": self.completed,
            "error_max": self.error_max.tolist(),
            "error_rms": self.error_rms.tolist(),
            "final_error": self.final_error.tolist(),
            "tool_lag_mm": self.tool_lag * 1000.0,
            "tool_off_path_mm": self.tool_off_path * 1000.0,
            "late_ticks": self.late,
            "ticks": self.ticks,
            "latest_tick": float(self.recording.lateness.max(initial=0.0)),
        }


@dataclass(frozen=True, eq=False)
class ExecutionReport:
    """An execution, motion by motion; the last one may be incomplete.

    Attributes:
        motions: In order; those that were begun.
        speed: Part of the planned speed at which they were driven.
        seconds: Wall time of all of it, gripper and settling included.
        simulated: Whether nothing real moved.
        stopped: Why it ended before its end, and what the arm was told then; None if it did not.
    """

    motions: tuple[ExecutedMotion, ...]
    speed: float
    seconds: float
    simulated: bool
    stopped: str | None = None

    def __post_init__(self) -> None:
        copied_in(self, "motions")

    @property
    def ok(self) -> bool:
        """Whether everything was executed."""
        return self.stopped is None

    def document(self) -> dict[str, Any]:
        """The figures, of plain JSON values; positions are in the motions' recordings."""
        return {
            "ok": self.ok,
            "stopped": self.stopped,
            "simulated": self.simulated,
            "speed": self.speed,
            "seconds": self.seconds,
            "motions": [motion.document() for motion in self.motions],
        }


class ExecutionStopped(PlannerServiceError):
    """An execution that ended before its end; the arm was told to hold. ``report`` has what was until then."""

    def __init__(self, report: ExecutionReport) -> None:
        super().__init__(report.stopped)
        self.report = report


def _tool(robot: Robot, q: FloatArray) -> FloatArray:
    """Positions (m, 3) of the tool frame's origin for q (m, n)."""
    rotations, positions = robot.body_poses_batch(q)
    offset = robot.tool_placement[:3, 3]
    return np.asarray((rotations[:, robot.tool_body] * offset).sum(axis=2) + positions[:, robot.tool_body])


def _norms(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=1)))


def _distance(point: FloatArray, curve: FloatArray) -> float:
    """Of a point from a polyline (N, 3)."""
    begin, way = curve[:-1], np.diff(curve, axis=0)
    square = (way * way).sum(axis=1)
    share = ((point - begin) * way).sum(axis=1) / np.where(square > 0.0, square, 1.0)
    nearest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(_norms(point - nearest).min())
